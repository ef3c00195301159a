"""Everything measured on a breast beside its volume: landmarks, shape, lengths, ptosis."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from mammometry.base.value import value
from mammometry.geometry import Array, Float64, TriangleMesh, UInt8
from mammometry.geometry.nearest import closest_on_mesh, point_tree
from mammometry.measure.boundary.boundary import Boundary
from mammometry.measure.landmarks.hollows import EndSigmas, propose_ends, propose_on_midline
from mammometry.measure.landmarks.landmarks import PICKED_SIGMA_MM, Landmark, picked_landmarks
from mammometry.measure.landmarks.nipples import propose_nipple
from mammometry.measure.settings import MeasureSettings
from mammometry.measure.shape.lengths import LinearMeasure, Ptosis, by_name, linear_measures, ptosis
from mammometry.measure.shape.shape import BreastShape, shape_of
from mammometry.measure.trunk.body import Body
from mammometry.measure.trunk.mirror_plane import MirrorPlane
from mammometry.measure.volume.measurement import VolumeMeasurement


@value(eq=False)
class Dimensions:
    """Shape, lengths and ptosis of all breasts of one subject."""

    frame: Float64[Array, "3 3"]
    """Rows: the patient's left, the head, straight ahead, as used. World frame."""
    shapes: tuple[BreastShape, ...]
    lengths: tuple[LinearMeasure, ...]
    ptosis: tuple[Ptosis, ...]


def find_landmarks(
    mesh: TriangleMesh,
    colours: UInt8[Array, "n 3"],
    measurements: Sequence[VolumeMeasurement],
    picked: Mapping[str, Float64[Array, "k 3"]],
    body: Body | None,
    settings: MeasureSettings = MeasureSettings(),
    *,
    boundaries: Sequence[Boundary] = (),
) -> tuple[Landmark, ...]:
    """Picked landmarks, and proposed ones where none was picked.

    Proposed are nipples, the ends of the boundaries, and what the trunk shows on its mid-sagittal plane.

    Args:
        mesh: the whole surface, mm, world frame.
        colours: colour of each vertex, sRGB.
        measurements: one for each breast.
        picked: landmark → its points, mm.
        body: the patient's own directions; None: of a cast. Without a mid-sagittal plane nothing on the midline is
            proposed.
        settings: how well a drawn boundary is known.
        boundaries: of the breasts, with what is known of each of their points.

    Raises:
        MeasureError: a picked landmark lies off the surface or on the wrong side.
    """
    middles = [measured.boundary_world.mean(axis=0) for measured in measurements if measured.name != "model"]
    middle = np.mean(middles, axis=0) if len(middles) == 2 else None
    frame = None if body is None else body.frame
    found = list(picked_landmarks(picked, mesh, frame, sigma_mm=PICKED_SIGMA_MM, middle_world=middle))
    tree = point_tree(mesh.vertices)
    for measured in measurements:
        name = f"nipple_{measured.name}"
        if name in picked:
            continue
        skin = measured.skin
        nearest = tree.query(skin.vertices)[1]
        proposal = propose_nipple(name, skin, colours[nearest], measured.boundary_world)
        if proposal is not None:
            place = closest_on_mesh(proposal.points_world, mesh).points
            found.append(replace(proposal, points_world=place))
    if body is not None:
        proposed = _of_torso(mesh, measurements, body, settings, boundaries)
        found += [mark for mark in proposed if mark.name not in picked]
    return tuple(found)


def _of_torso(
    mesh: TriangleMesh,
    measurements: Sequence[VolumeMeasurement],
    body: Body,
    settings: MeasureSettings,
    boundaries: Sequence[Boundary],
) -> Iterator[Landmark]:
    """Yield the ends of the breasts, and what lies on the midline."""
    frame, plane = body.frame, body.plane
    scatter = settings.observers
    curves = {
        measurement.name: measurement.boundary_world for measurement in measurements if measurement.name != "model"
    }
    for side, curve in curves.items():
        across = next((boundary.across_mm for boundary in boundaries if boundary.name == side), None)
        sigmas = EndSigmas(
            lower_mm=scatter.lower_mm, medial_mm=scatter.medial_mm, lateral_mm=scatter.lateral_mm, across_mm=across
        )
        yield from propose_ends(side, curve, frame, sigmas)
    if plane is not None and curves:
        heights = (np.concatenate(list(curves.values())) - plane.point_world) @ frame[1]
        lowest, highest = float(heights.min()), float(heights.max())
        yield from propose_on_midline(mesh, frame, plane.point_world, plane.sigma_mm, lowest, highest)


def dimensions(
    mesh: TriangleMesh,
    measurements: Sequence[VolumeMeasurement],
    landmarks: Sequence[Landmark],
    frame: Float64[Array, "3 3"],
    settings: MeasureSettings = MeasureSettings(),
    *,
    plane: MirrorPlane | None = None,
) -> Dimensions:
    """Measure shape, lengths and ptosis.

    Args:
        mesh: the whole surface, mm, world frame.
        measurements: one for each breast.
        landmarks: of this surface; those that are hardly probable are left out.
        frame: rows: the patient's left, the head, straight ahead; world frame.
        settings: uncertainty of the boundary.
        plane: the mid-sagittal plane, which replaces a midline that was not picked.

    Raises:
        MeasureError: landmarks on parts of the surface that are not connected.
    """
    named = by_name([mark for mark in landmarks if mark.probability >= settings.nipple.least_probability])
    sigma = settings.observers.mean_mm
    midline = None if plane is None else (plane.point_world, plane.normal_world, plane.sigma_mm)
    sagging = [
        ptosis(
            measured,
            frame[1],
            named[f"nipple_{measured.name}"],
            _picked(named.get(f"inframammary_fold_{measured.name}")),
            boundary_sigma_mm=sigma,
        )
        for measured in measurements
        if measured.name != "model" and f"nipple_{measured.name}" in named
    ]
    return Dimensions(
        frame=frame,
        shapes=tuple(
            shape_of(measured, frame, named.get(f"nipple_{measured.name}"), boundary_sigma_mm=sigma)
            for measured in measurements
        ),
        lengths=linear_measures(named, mesh, midline=midline),
        ptosis=tuple(sagging),
    )


def _picked(landmark: Landmark | None) -> Landmark | None:
    """The landmark, unless it is but proposed: the boundary's own lowest point is surer than the middle of its foot."""
    return None if landmark is None or landmark.proposed else landmark
