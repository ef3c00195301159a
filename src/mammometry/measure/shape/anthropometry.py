"""Everything measured on a breast beside its volume: landmarks, shape, lengths, ptosis."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from mammometry.geometry.arrays import Array, Float64, UInt8, read_only
from mammometry.geometry.mesh import TriangleMesh
from mammometry.geometry.nearest import closest_on_mesh, point_tree
from mammometry.measure.landmarks.landmarks import Landmark, picked_landmarks
from mammometry.measure.landmarks.nipples import propose_nipple
from mammometry.measure.settings import MeasureSettings
from mammometry.measure.shape.lengths import LinearMeasure, Ptosis, by_name, linear_measures, ptosis
from mammometry.measure.shape.shape import BreastShape, shape_of
from mammometry.measure.trunk.mirror_plane import MirrorPlane
from mammometry.measure.volume.measurement import VolumeMeasurement


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Dimensions:
    """Shape, lengths and ptosis of all breasts of one subject."""

    frame: Float64[Array, "3 3"]
    """Rows: the patient's left, the head, straight ahead, as used. World frame."""
    shapes: tuple[BreastShape, ...]
    lengths: tuple[LinearMeasure, ...]
    ptosis: tuple[Ptosis, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "frame", read_only(self.frame))


def find_landmarks(
    mesh: TriangleMesh,
    colours: UInt8[Array, "n 3"],
    measurements: Sequence[VolumeMeasurement],
    picked: Mapping[str, Float64[Array, "k 3"]],
    frame: Float64[Array, "3 3"] | None,
    settings: MeasureSettings = MeasureSettings(),
) -> tuple[Landmark, ...]:
    """Picked landmarks, and proposed nipples where none was picked.

    Args:
        mesh: the whole surface, mm, world frame.
        colours: colour of each vertex, sRGB.
        measurements: one for each breast.
        picked: landmark → its points, mm.
        frame: rows: the patient's left, the head, straight ahead; None if not known.
        settings: how nipples are proposed, and how well a picked landmark is known.

    Raises:
        MeasureError: a picked landmark lies off the surface or on the wrong side.
    """
    middles = [measured.boundary_world.mean(axis=0) for measured in measurements if measured.name != "model"]
    middle = np.mean(middles, axis=0) if len(middles) == 2 else None
    found = list(picked_landmarks(picked, mesh, frame, sigma_mm=settings.picked_sigma_mm, middle_world=middle))
    tree = point_tree(mesh.vertices)
    for measured in measurements:
        name = f"nipple_{measured.name}"
        if name in picked:
            continue
        skin = measured.skin
        nearest = tree.query(skin.vertices)[1]
        proposal = propose_nipple(name, skin, colours[nearest], measured.boundary_world, settings.nipple)
        if proposal is not None:
            place = closest_on_mesh(proposal.points_world, mesh).points
            found.append(replace(proposal, points_world=place))
    return tuple(found)


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
            named.get(f"inframammary_fold_{measured.name}"),
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
