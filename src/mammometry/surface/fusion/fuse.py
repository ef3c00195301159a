"""First surface from range images by signed distances and marching cubes (paper 2.5)."""

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
    DistanceField,
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
    """The connected part that encloses the largest volume. Fragments and cavities are removed."""
    count, label = mesh.components()
    if count <= 1:
        return mesh
    volumes = mesh_kernels.part_volumes(mesh.vertices, mesh.faces, label, count)
    return mesh.submesh(label[mesh.faces[:, 0]] == np.argmax(volumes))


def tunnel_places(mesh: TriangleMesh, cell_mm: float) -> Float64[Array, "n 3"]:
    """Centres of the cells that contain a tunnel or handle of a closed mesh, mm.

    By Gauss and Bonnet, the angle defects of all vertices sum to 2π·(V − E + F). A handle contributes −4π; a saddle of
    a body is far from that within a cell of some millimetres.
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
"""Distance from all range data beyond which cubes are four times as large, mm. The repair moves no vertex there."""
BACK_MM = 10.0
"""Distance of the closing box's back behind the farthest datum, mm."""
AROUND_MM = 20.0
"""Distance of the closing box's other sides from the data, mm. Silhouettes bound the solid earlier."""
_HEALING_ATTEMPTS = 5  # most attempts to smooth a tunnel away; not critical
_HEALING_GROWTH = 1.5  # factor on radius and Gaussian from attempt to attempt; not critical
_HEALING_REACH_MM, _HEALING_SIGMA_MM = 4.0, 1.0  # radius of the first attempt, and its Gaussian; not critical
_TUNNEL_CELL_MM = 6.0  # contains a tunnel's whole curvature; no part of a body of that size is as curved
_MIN_DATA = 50  # fewest data of a usable view; not critical
_SILHOUETTE_SAMPLES = 5000  # data looked up in a mask: gives the share outside it to 1 %
_MOST_OUTSIDE = 0.5  # largest share of a view's data that another camera may see outside the subject
_LEAST_IN_PICTURE = 0.2  # least share of a view's data in a camera's image for this test; not critical
_LONGEST_SIDE_PX = 4.0  # longest side of an open surface's triangles: distance of neighbours on skin at 75°


def extract(
    range_images: Sequence[RangeImage],
    foregrounds: Mapping[str, Foreground],
    rig: Rig,
    settings: ExtractSettings = ExtractSettings(),
    *,
    progress: Progress = no_progress,
) -> TriangleMesh:
    """Watertight first surface from range images and the silhouettes of all cameras (paper 2.5).

    World frame, mm. A cube's corner gets the weighted mean of the signed distances of all views in whose band it is
    (weights cos²/σ²). Otherwise it is free if a view sees through it or it is in front of a view's span, and inside if
    it is behind a view's surface. Silhouettes and a box behind the data bound the result. The isosurface's part with
    the largest volume is kept. Tunnels are removed by smoothing the field more around them, several times with growing
    radius; the surface with the fewest is kept.

    Raises:
        SurfaceError: no view has data, the views contradict each other or the silhouettes, or they enclose nothing.
    """
    return meshed(solid_of(range_images, foregrounds, rig, settings.rule), settings, progress=progress)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FusedField:
    """Signed distance to be meshed. The silhouettes, which are large, are no longer needed."""

    distance: DistanceField
    seen: tuple[RangeImage, ...]
    """Range images with data, which the surface passes near."""


def solid_of(
    range_images: Sequence[RangeImage], foregrounds: Mapping[str, Foreground], rig: Rig, rule: Rule = "default"
) -> FusedField:
    """Signed distance of the solid: the first half of `extract`.

    Raises:
        SurfaceError: no view has data, or the views contradict each other or the silhouettes.
    """
    seen = usable(range_images)
    check_silhouettes(seen, foregrounds, rig)
    check_agreement(seen)
    box = closing_box_of(seen)
    distance = build_field(seen, foregrounds, rig, box, rule)
    return FusedField(distance=distance, seen=tuple(seen))


def meshed(
    solid: FusedField, settings: ExtractSettings = ExtractSettings(), *, progress: Progress = no_progress
) -> TriangleMesh:
    """Surface of the solid: the second half of `extract`.

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
        if not len(places):  # the remaining handles are as large as limbs, and closed where no camera sees
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
    solid: FusedField, settings: ExtractSettings, near_mm: float, progress: Progress
) -> tuple[Isosurface, TriangleMesh]:
    """Sample the field and mesh it. If fine and coarse cubes do not fit together, use fine cubes only."""
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
    """Mesh of the range data, view by view, neither closed nor merged: for subjects that are not solid.

    Each square of four neighbouring data gives two triangles, three data give one, none with an edge longer than
    `_LONGEST_SIDE_PX` pixel widths on the surface. Faces are counter-clockwise seen from the camera.

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
    """The views that have data.

    Raises:
        SurfaceError: no view has data.
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
    """Refuse a view whose data are of the background.

    Such a view has most of its data outside the subject as another camera sees it. Only cameras with a known foreground
    and enough of the data in their image count.

    Raises:
        SurfaceError: names the pair, and the camera that sees most of its data outside.
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
        if worst is not None and excluded[worst] > _MOST_OUTSIDE:
            raise SurfaceError(
                f"pair {image.name}",
                found=f"range data of which camera {worst} sees {100 * excluded[worst]:.0f} % outside the subject",
                expected="range data of the subject, inside the silhouette of every camera",
                remedy=f"Check the foreground previews of {image.name} and {worst}: the pair may have seen only "
                "background, or a camera has moved since the calibration",
            )


def closing_box_of(range_images: Sequence[RangeImage]) -> ClosingBox:
    """Box that closes the solid where no camera saw it."""
    return closing_box(range_images, back_mm=BACK_MM, around_mm=AROUND_MM)
