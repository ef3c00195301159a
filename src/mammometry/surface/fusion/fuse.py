"""First surface from range images (paper 2.5).

Signed distances on a grid of cubes, then marching cubes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from mammometry.base.errors import SurfaceError
from mammometry.base.progress import Progress, no_progress, part
from mammometry.geometry import Array, Float64, Rig, bounds, mesh_kernels
from mammometry.geometry.mesh import TriangleMesh, on_microns
from mammometry.matching.foreground.foreground import Foreground
from mammometry.surface.fusion.field import (
    TRUNCATION_MM,
    ClosingBox,
    Field,
    Rule,
    block_seeds,
    build_field,
    closing_box,
)
from mammometry.surface.fusion.isosurface import Isosurface
from mammometry.surface.fusion.voxels import sample_blocks
from mammometry.surface.ranges.range_image import RangeImage
from mammometry.surface.ranges.visibility import check_agreement
from mammometry.surface.settings import CUBE_MM, ExtractSettings


def largest_part(mesh: TriangleMesh) -> TriangleMesh:
    """Return the connected part that encloses the largest volume.

    This drops crumbs, and also cavities, whose volume is negative.
    """
    count, label = mesh.components()
    if count <= 1:
        return mesh
    volumes = mesh_kernels.part_volumes(mesh.vertices, mesh.faces, label, count)
    return mesh.submesh(label[mesh.faces[:, 0]] == np.argmax(volumes))


def tunnel_places(mesh: TriangleMesh, cell_mm: float) -> Float64[Array, "n 3"]:
    """Places of the tunnels and handles of a closed mesh, mm.

    They are cells whose total curvature is that of a handle. By Gauss and Bonnet the angles missing from 2π at the
    vertices sum to 2π·(V − E + F); a handle takes 4π, which no saddle of a body does within a cell a few millimetres
    wide.
    """
    defect = mesh_kernels.angle_defects(mesh.vertices, mesh.faces)
    low, _ = bounds(mesh.vertices)
    cell = tuple(((mesh.vertices - low) / cell_mm).astype(np.int64).T)
    shape = tuple(int(axis.max()) + 1 for axis in cell)
    total = np.bincount(np.ravel_multi_index(cell, shape), defect)
    found = np.stack(np.unravel_index(np.flatnonzero(total < -np.pi), shape), axis=1)
    return low + (found + 0.5) * cell_mm


SMOOTHING_CUBES = 1.0
"""Standard deviation of the Gaussian on the signed distance, cubes. Without it the surface has tunnels."""
NEAR_MM = 2.0
"""Distance from all range data beyond which the surface is only closed, mm, in cubes four times as large. The repair
moves nothing so far away.
"""
BACK_MM = 10.0
"""How far behind the furthest datum the unseen back is closed, mm."""
AROUND_MM = 20.0
"""Distance of the closing box's other sides from the data, mm. Silhouettes bound the solid earlier."""
_HEALING_ATTEMPTS = 5  # at smoothing a tunnel away, each wider by the growth; all chosen by eye
_HEALING_GROWTH = 1.5  # factor on radius and Gaussian from attempt to attempt
_HEALING_REACH_MM, _HEALING_SIGMA_MM = 4.0, 1.0  # radius of the first attempt, and its Gaussian
_TUNNEL_CELL_MM = 6.0  # a cell holds a tunnel's whole curvature, and no bend of a body that curves as much
_MIN_DATA = 50  # a view with fewer says nothing; chosen by eye
_SILHOUETTE_SAMPLES = 5000  # data looked up in a mask: the share that misses it, to 1 %
_MOST_BESIDE = 0.5  # share of a view's data that another camera may see beside the subject
_LEAST_IN_PICTURE = 0.2  # share of a view's data that a camera must have in its picture to judge them; chosen by eye
_LONGEST_SIDE_PX = 4.0  # of an open surface's triangles: neighbours on skin at 75° are that far apart


def extract(
    range_images: Sequence[RangeImage],
    foregrounds: Mapping[str, Foreground],
    rig: Rig,
    settings: ExtractSettings = ExtractSettings(),
    *,
    progress: Progress = no_progress,
) -> TriangleMesh:
    """Build the first watertight surface from range images and silhouettes.

    Paper 2.5, silhouettes of all cameras. World frame, mm. A cube's corner takes the weighted mean of the signed
    distances of all views within whose band it lies (weights cos²/σ²); else it is free space where a view looks
    through it, or where it lies before what spans a view's gap, else inside where some view's surface stands before
    it. The silhouettes and a box behind the data bound the result. Of the isosurface the part with the largest volume
    stays. Where it has tunnels, the field is smoothed more, there alone, a few times, ever wider; the surface with the
    fewest stays.

    Raises:
        SurfaceError: no view has data, the views contradict each other or the silhouettes, or they enclose nothing.
    """
    return meshed(solid_of(range_images, foregrounds, rig, settings.rule), settings, progress=progress)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Solid:
    """The signed distance to mesh. Silhouettes, which are large, are needed no more."""

    distance: Field
    seen: tuple[RangeImage, ...]
    """Range images with data: the surface passes near those."""


def solid_of(
    range_images: Sequence[RangeImage], foregrounds: Mapping[str, Foreground], rig: Rig, rule: Rule = "default"
) -> Solid:
    """The first half of `extract`.

    Raises:
        SurfaceError: no view has data, or the views contradict each other or the silhouettes.
    """
    seen = usable(range_images)
    check_silhouettes(seen, foregrounds, rig)
    check_agreement(seen)
    box = closing_box_of(seen)
    distance = build_field(seen, foregrounds, rig, box, rule)
    return Solid(distance=distance, seen=tuple(seen))


def meshed(
    solid: Solid, settings: ExtractSettings = ExtractSettings(), *, progress: Progress = no_progress
) -> TriangleMesh:
    """The second half of `extract`.

    Raises:
        SurfaceError: views and silhouettes enclose nothing.
    """
    progress(0.1)
    surface, mesh = _surface(solid, settings, NEAR_MM, part(progress, 0.1, 0.9))
    best = largest_part(mesh)
    candidate: TriangleMesh | None = best
    for attempt in range(_HEALING_ATTEMPTS if len(best.faces) else 0):
        if candidate is None or _euler_number(best) == 2:
            break
        wider = _HEALING_GROWTH**attempt
        places = tunnel_places(candidate, _TUNNEL_CELL_MM)
        if not len(places):  # what is left are rings as large as limbs, closed through what no camera saw
            break
        surface.heal(places, reach_mm=_HEALING_REACH_MM * wider, sigma_mm=_HEALING_SIGMA_MM * wider)
        healed = surface.mesh()
        candidate = None if healed is None else largest_part(healed)
        if candidate is not None and abs(_euler_number(candidate) - 2) < abs(_euler_number(best) - 2):
            best = candidate
    if len(best.faces) == 0:
        raise SurfaceError(
            f"pairs {', '.join(image.name for image in solid.seen)}",
            found="range data and silhouettes that enclose nothing",
            expected="silhouettes around the surface that the range data show",
            remedy="Check the foreground previews: a mask may be inverted or belong to another photograph",
        )
    progress(1.0)
    return TriangleMesh(vertices=on_microns(best.vertices), faces=best.faces)


def _surface(
    solid: Solid, settings: ExtractSettings, near_mm: float, progress: Progress
) -> tuple[Isosurface, TriangleMesh]:
    """Sample and mesh. Where fine and coarse cubes do not fit together, all are fine."""
    corners = solid.distance.box.corners
    grid = sample_blocks(
        solid.distance.sample,
        np.array([corners.min(axis=0), corners.max(axis=0)]),
        block_seeds(solid.seen),
        cube_mm=settings.cube_mm or CUBE_MM,
        truncation_mm=TRUNCATION_MM,
        near_mm=near_mm,
        progress=part(progress, 0.0, 0.6),
    )
    surface = Isosurface(grid, smoothing=SMOOTHING_CUBES, progress=part(progress, 0.6, 1.0))
    mesh = surface.mesh()
    return (surface, mesh) if mesh is not None else _surface(solid, settings, np.inf, progress)


def extract_open(range_images: Sequence[RangeImage], *, progress: Progress = no_progress) -> TriangleMesh:
    """Mesh the range data view by view, without closing or merging.

    This is for subjects that are no solid. Each square of four neighbouring data gives two triangles, three give one;
    none has an edge longer than `_LONGEST_SIDE_PX` pixels' widths on the surface. Faces are counter-clockwise seen
    from the camera.

    Raises:
        SurfaceError: no view has data.
    """
    seen = usable(range_images)
    vertices, faces, count = [], [], 0
    for number, image in enumerate(seen):
        points = image.valid_points_world()
        number_of = np.full(image.valid.shape, -1, dtype=np.int64)
        number_of[image.valid] = np.arange(len(points))
        a, b = number_of[:-1, :-1], number_of[:-1, 1:]
        c, d = number_of[1:, :-1], number_of[1:, 1:]
        with_diagonal = (a >= 0) & (d >= 0)
        other = ~with_diagonal & (b >= 0) & (c >= 0)
        triangles = np.concatenate(
            [
                np.stack(corners, axis=-1)[chosen]
                for corners, chosen in (
                    ((a, c, d), with_diagonal),
                    ((a, d, b), with_diagonal),
                    ((a, c, b), other),
                    ((b, c, d), other),
                )
            ]
        )
        triangles = triangles[(triangles >= 0).all(axis=1)]
        corners3 = points[triangles]
        longest = np.linalg.norm(corners3 - np.roll(corners3, 1, axis=1), axis=2).max(axis=1)
        triangles = triangles[longest <= _LONGEST_SIDE_PX * image.pixel_mm()]
        used, inverse = np.unique(triangles, return_inverse=True)
        vertices.append(points[used])
        faces.append(inverse.reshape(-1, 3) + count)
        count += len(used)
        progress((number + 1) / len(seen))
    return TriangleMesh(vertices=np.concatenate(vertices), faces=np.concatenate(faces).astype(np.int32))


def _euler_number(closed: TriangleMesh) -> int:
    """V − E + F of a closed mesh without unused vertices. Every edge has two faces: E = 3F/2."""
    return len(closed.vertices) - len(closed.faces) // 2


def usable(range_images: Sequence[RangeImage]) -> list[RangeImage]:
    """Return the views that have data. One that saw nothing is left out.

    Raises:
        SurfaceError: none has any; names the pairs.
    """
    seen = [image for image in range_images if int(image.valid.sum()) >= _MIN_DATA]
    if not seen:
        names = ", ".join(image.name for image in range_images) or "none"
        raise SurfaceError(
            f"pairs {names}",
            found="no range data in any of them",
            expected="range data of the subject in at least one pair",
            remedy="Check the disparity previews: the subject may be out of view, out of focus or without texture",
        )
    return seen


def check_silhouettes(range_images: Sequence[RangeImage], foregrounds: Mapping[str, Foreground], rig: Rig) -> None:
    """Refuse a view that has matched the background.

    Other cameras see most of its data beside the subject. Other cameras tell whose foreground is known and in whose
    picture a fair share of the data lies.

    Raises:
        SurfaceError: names the pair, and the camera that excludes most of its data.
    """
    masks = {name: foreground.mask for name, foreground in foregrounds.items() if not foreground.everything}
    for image in range_images:
        points = image.valid_points_world()
        points = points[:: max(1, len(points) // _SILHOUETTE_SAMPLES)]
        excluded = {}
        for name, mask in masks.items():
            if not mask.any() or name in rig.pair_names[image.name]:
                continue
            uv = np.rint(rig.cameras[name].project(points))
            with np.errstate(invalid="ignore"):
                inside = ((uv >= 0) & (uv < mask.shape[::-1])).all(axis=1)
            column, row = uv[inside].astype(np.intp).T
            if inside.mean() > _LEAST_IN_PICTURE:
                excluded[name] = float((~mask[row, column]).mean())
        worst = max(excluded, key=lambda name: excluded[name], default=None)
        if worst is not None and excluded[worst] > _MOST_BESIDE:
            raise SurfaceError(
                f"pair {image.name}",
                found=f"range data of which camera {worst} sees {100 * excluded[worst]:.0f} % outside the subject",
                expected="range data of the subject, inside the silhouette of every camera",
                remedy=f"Check the foreground previews of {image.name} and {worst}: the pair may have seen only "
                "background, or a camera has moved since the calibration",
            )


def closing_box_of(range_images: Sequence[RangeImage]) -> ClosingBox:
    """Box that closes what no camera saw, as `extract` uses it."""
    return closing_box(range_images, back_mm=BACK_MM, around_mm=AROUND_MM)
