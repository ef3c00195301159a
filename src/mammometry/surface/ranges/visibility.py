"""Comparison of world points with the surface that a view saw. Labels as in docs/conventions.md.

`field_kernels.sample_field` is the compiled form for the millions of cubes of the first surface.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from itertools import combinations

import numpy as np

from mammometry.base.errors import SurfaceError
from mammometry.base.machine.cores import in_bands, map_in_threads
from mammometry.geometry.arrays import Array, Float32, Float64, Int64, UInt8
from mammometry.surface.ranges import image_kernels
from mammometry.surface.ranges.range_image import SIGMAS, RangeImage

_AGREEMENT_SAMPLES = 20000  # data of a view that are compared: their median is accurate to 1 %
JUMP_MM = 5.0
"""Difference of ranges above which they belong to two surfaces, mm. Not critical."""
_APART_MM = 1.0  # largest median distance between two views
_FEWEST_COMMON = 500  # fewest common data of two views that are compared
_CULPRIT_RATIO = 1.2  # ratio to the next pair's differences from which a pair is named as the moved one
_ALIKE_DEG = 20.0  # largest angle between normals of two views on the same skin; not critical
LEAST_COSINE = 0.5
"""60° from the normal: data seen at larger angles are not compared."""


class Label(IntEnum):
    """Position of a point relative to the surface that a view saw."""

    OUTSIDE = 0
    """Outside the image, or no datum there."""
    IN_FRONT = 1
    """Between the camera and the surface: free space."""
    OVERLAPPING = 2
    """Within ε of the seen surface."""
    BEHIND = 3
    """Behind the surface: hidden from the view."""


def gap_mm(points_world: Float64[Array, "n 3"], range_image: RangeImage) -> Float64[Array, " n"]:
    """Signed distance |r_B(m, n)| − D along the ray from points to the surface that a view saw, mm.

    D is the point's distance from the perspective centre. Positive in front of the surface, negative behind it; NaN
    where the nearest element has no datum, outside the image and behind the camera. The range is interpolated between
    four data on one surface: at 70° from the normal, half a pixel would look like a disagreement.
    """
    transform = range_image.camera.camera_from_world

    def gaps(part: slice) -> Float64[Array, " k"]:
        return image_kernels.ray_gaps(
            np.ascontiguousarray(points_world[part], dtype=np.float64),
            np.ascontiguousarray(transform.rotation),
            np.ascontiguousarray(transform.translation_mm),
            range_image.camera.intrinsics,
            range_image.range_mm,
            range_image.valid,
            JUMP_MM,
        )

    return np.concatenate(in_bands(gaps, len(points_world)))


def compare(points_world: Float64[Array, "n 3"], range_image: RangeImage, epsilon_mm: float) -> UInt8[Array, " n"]:
    """Label world points, mm, against one range image (paper 2.6.1). Overlapping is |r_B − D| ≤ ε.

    The paper prints the overlapping case without the absolute value, which contradicts its other cases.
    """
    gap = gap_mm(points_world, range_image)
    labels = np.full(gap.shape, Label.OUTSIDE, dtype=np.uint8)
    with np.errstate(invalid="ignore"):
        labels[gap > epsilon_mm] = Label.IN_FRONT
        labels[gap < -epsilon_mm] = Label.BEHIND
        labels[np.abs(gap) <= epsilon_mm] = Label.OVERLAPPING
    return labels


def check_agreement(range_images: Sequence[RangeImage]) -> None:
    """Refuse views that contradict each other: a camera has moved, or the calibration is wrong.

    Two views are compared where their surfaces face the same way and neither can hide the other. The median distance
    along the normal must be at most 1 mm, or three expected standard deviations (σ) if that is more, as in small or
    noisy photographs of weak texture. Clean captures have less than 0.1 mm and 0.7 σ. Views with fewer than 500 common
    data are not compared.

    Raises:
        SurfaceError: lists the pairs that disagree, and the one that disagrees most if it is clearly the worst.
    """
    found = disagreement_mm(range_images)
    differences = {names: distance_mm for names, (distance_mm, _) in found.items()}
    limits = {names: max(_APART_MM, SIGMAS * sigma_mm) for names, (_, sigma_mm) in found.items()}
    bad = {names: value for names, value in differences.items() if value > limits[names]}
    if not bad:
        return
    names = sorted({name for pair in bad for name in pair})
    total = {name: sum(value for pair, value in differences.items() if name in pair) for name in names}
    first, second = sorted(names, key=lambda name: -total[name])[:2]
    worst = max(bad, key=lambda names: bad[names] / limits[names])
    raise SurfaceError(
        f"pairs {' and '.join(names)}",
        found=f"surfaces {bad[worst]:.1f} mm apart (median, {worst[0]} against {worst[1]})",
        expected=f"agreement within {limits[worst]:.2g} mm",
        remedy=(
            f"A camera of {first} has probably moved since the calibration: calibrate again"
            if total[first] > _CULPRIT_RATIO * total[second]
            else "A camera has probably moved since the calibration, or photographs were exchanged: calibrate again"
        ),
    )


def disagreement_mm(range_images: Sequence[RangeImage]) -> dict[tuple[str, str], tuple[float, float]]:
    """Pairs of views → median distance along the normal and its expected σ, mm.

    Compared are data whose normals agree (20°) and that both views see within 60° of the normal. View pairs with fewer
    than 500 such data are left out.
    """
    views = map_in_threads(ComparedView.of, range_images)
    result: dict[tuple[str, str], tuple[float, float]] = {}
    for view, other in combinations(views, 2):
        common = np.concatenate([_distances_across(view, other), _distances_across(other, view)])
        if len(common) >= _FEWEST_COMMON:
            distance_mm, sigma_mm = np.median(common, axis=0).tolist()
            result[view.image.name, other.image.name] = distance_mm, sigma_mm
    return result


def _distances_across(view: ComparedView, other: ComparedView) -> Float64[Array, "n 2"]:
    """Distances of a view's data from the other's surface along the normal, and their expected σ, mm.

    Data far behind the other's surface are left out: it may hide them. If two views contradict each other, one of them
    has its data in front of the other's surface.
    """
    common = common_skin(view, other)
    shown = common.distance_mm > -JUMP_MM
    return np.stack([np.abs(common.distance_mm[shown]), common.sigma_mm[shown]], axis=1)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ComparedView:
    """A view with up to 20,000 of its data, to be compared with other views."""

    image: RangeImage
    normals_camera: Float32[Array, "h w 3"]
    """Of all its data: `RangeImage.normals_camera`."""
    rows: Int64[Array, " n"]
    columns: Int64[Array, " n"]
    points: Float64[Array, "n 3"]
    """The data, world frame, mm."""
    normals: Float64[Array, "n 3"]
    """Their normals, world frame."""

    @classmethod
    def of(cls, image: RangeImage) -> ComparedView:
        """The view with an evenly spaced subset of its data."""
        stride = max(1, int(image.valid.sum()) // _AGREEMENT_SAMPLES)
        rows, columns = (index[::stride] for index in np.nonzero(image.valid))
        rays = image.camera.rays_world(np.stack([columns, rows], axis=-1).astype(np.float64))
        normals_camera = image.normals_camera()
        return cls(
            image=image,
            normals_camera=normals_camera,
            rows=rows,
            columns=columns,
            points=image.camera.centre_world + rays * image.range_mm[rows, columns].astype(np.float64)[:, None],
            normals=normals_camera[rows, columns] @ image.camera.camera_from_world.rotation,
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CommonSkin:
    """Data of one view on skin that another view sees too."""

    points: Float64[Array, "n 3"]
    """World frame, mm."""
    normals: Float64[Array, "n 3"]
    """Normals of the other surface, towards its camera, world frame."""
    own_cosine: Float64[Array, " n"]
    """Cosine between the view's own normal and its line of sight."""
    distance_mm: Float64[Array, " n"]
    """Distance from the other surface along its normal. Positive in front of it."""
    sigma_mm: Float64[Array, " n"]
    """Standard deviation of that distance, from the expected errors of both data."""


def common_skin(view: ComparedView, other: ComparedView) -> CommonSkin:
    """Compare the data of a view with another view, where both see the same skin.

    The normals must agree (20°), and the other view must see the data within 60° of their normal.
    """
    camera, image = other.image.camera, view.image
    gap = gap_mm(view.points, other.image)
    known = np.flatnonzero(np.isfinite(gap))
    points, own, gap = view.points[known], view.normals[known], gap[known]
    uv = np.rint(camera.project(points)).astype(np.intp)
    theirs = other.normals_camera[uv[:, 1], uv[:, 0]] @ camera.camera_from_world.rotation
    cosine = _cosine(theirs, camera.centre_world - points)
    with np.errstate(invalid="ignore"):
        alike = (np.einsum("ij,ij->i", own, theirs) > np.cos(np.radians(_ALIKE_DEG))) & (cosine > LEAST_COSINE)
    known, uv, points, gap, cosine = known[alike], uv[alike], points[alike], gap[alike], cosine[alike]
    own_sigma = image.sigma_mm[view.rows[known], view.columns[known]]
    sigma = np.hypot(own_sigma, other.image.sigma_mm[uv[:, 1], uv[:, 0]])
    return CommonSkin(
        points=points,
        normals=theirs[alike],
        own_cosine=_cosine(own[alike], image.camera.centre_world - points),
        distance_mm=gap * cosine,
        sigma_mm=sigma * cosine,
    )


def _cosine(normals: Float64[Array, "n 3"], towards: Float64[Array, "n 3"]) -> Float64[Array, " n"]:
    towards = towards / np.linalg.norm(towards, axis=1, keepdims=True)
    cosine: Float64[Array, " n"] = np.einsum("ij,ij->i", normals, towards)
    return cosine
