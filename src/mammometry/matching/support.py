"""The board or table under the subject.

Every pair sees it, and it is not the subject. If half of what is near is in a plane and the rest in front of it, the
plane is a support: a body curves away behind the plane that fits it best. All pairs are used together first: a plane
that one of them sees clearly is the support in all, including those that see little of it, or see it at a grazing
angle.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from mammometry.geometry import Array, Bool, Camera, Float32, Float64
from mammometry.matching.foreground.seeded_segmentation import SMALLEST_PART

LEAST_SHARE = 0.02
"""Smallest near share of the image for a pair to be used."""
LEAST_STANDING = 0.004
"""Smallest share of the image of an object on a wide table."""

# Unless another source is stated, chosen on the simulated captures of docs/decisions/0028.
_FLATNESS = 0.012  # largest relative depth difference of an inlier: a pixel of disparity, a tenth of a cast's height
_STANDING = 1.5  # factor on it beyond which a point is certainly in front of the plane
_BOARD, _ON_BOARD, _BELOW = 0.5, 0.03, 0.4  # least near share on a board, in front; most behind, of those in front
_TABLE = 0.8  # least share of near pixels on a wide table
_SOME, _TRIALS, _LEAST_AREA, _DRAWN = 1500, 150, 0.02, 28  # points and planes tested, their share of the image, seed
_FITS = 3  # refits by least squares to the plane's inliers


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NearDepths:
    """Depths of one pair, and its pixels in the working volume."""

    camera: Camera
    """The left rectified camera."""
    depth_mm: Float32[Array, "h w"]
    """z of each of its pixels, mm. NaN if unknown."""
    near: Bool[Array, "h w"]
    """Pixels in the working volume. Some have no depth, since small gaps are closed."""
    textured: Bool[Array, "h w"]
    """Pixels whose depth is reliable. A dark background matches by chance, in front of a plane as well as behind it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Split:
    """Parts of what one pair sees nearby, in pixels, and of the whole image."""

    lying: int
    standing: int
    behind: int
    standing_share: float
    """Share of the image, without small spots."""
    behind_share: float


def find_supports(views: Sequence[NearDepths]) -> list[Float64[Array, 4] | None]:
    """Find the plane on which the subject is or against which it leans, for each pair.

    A plane that explains what all pairs see together, or what each of most pairs sees, is the support of all. Otherwise
    each pair may have its own, such as a wall close behind the body that only one pair sees.

    Returns:
        (nx, ny, nz, d) of the plane n·X = d, world frame, mm. None without a support.
    """
    planes = [_best_plane(view) for view in views]
    candidates = [plane for plane in planes if plane is not None]
    splits = [[_split(view, plane) for view in views if _enough(view.near)] for plane in candidates]
    supports = [index for index, split in enumerate(splits) if _is_support(split) or _by_most(split)]
    if len(candidates) > 1 and supports:
        best = max(supports, key=lambda index: sum(one.lying for one in splits[index]))
        return [candidates[best]] * len(views)
    return [
        plane if plane is not None and _is_support([_split(view, plane)]) else None
        for view, plane in zip(views, planes, strict=True)
    ]


def _by_most(splits: Sequence[_Split]) -> bool:
    """Whether most pairs find a support separately: a repeating pattern may mislead one pair."""
    return 2 * sum(_is_support([one]) for one in splits) > len(splits)


def reciprocal_depth(plane_world: Float64[Array, 4], camera: Camera) -> Float64[Array, 3]:
    """Express a plane in an image.

    Args:
        plane_world: (nx, ny, nz, d) of n·X = d, world frame, mm.
        camera: without lens distortion.

    Returns:
        a, b, c of its reciprocal depth a u + b v + c, 1/mm, which is linear in the image for every plane.
    """
    pose = camera.camera_from_world
    normal = pose.rotation @ plane_world[:3]
    scaled = normal / (plane_world[3] + normal @ pose.translation_mm)
    found: Float64[Array, 3] = np.linalg.solve(camera.matrix.T, scaled)
    return found


def parted(
    depth: Float32[Array, "h w"], near: Bool[Array, "h w"], plane: Float64[Array, 3]
) -> tuple[Bool[Array, "h w"], Bool[Array, "h w"]]:
    """Split near pixels at a support: in front, and on or behind. The plane is that of `reciprocal_depth`."""
    rows, columns = np.indices(depth.shape)
    with np.errstate(invalid="ignore"):
        ahead = 1 - (plane[0] * columns + plane[1] * rows + plane[2]) * depth
    return near & (ahead >= _STANDING * _FLATNESS), near & (ahead < _FLATNESS)


def cleaned(mask: Bool[Array, "h w"], least_share: float) -> Bool[Array, "h w"]:
    """Close small gaps, and remove thin parts and small ones."""
    opened = ndimage.binary_opening(ndimage.binary_closing(mask), iterations=2)
    labels, count = ndimage.label(opened)
    if count == 0:
        return opened
    sizes = np.bincount(labels.ravel())
    sizes[0] = 0
    large: Bool[Array, "h w"] = (sizes >= max(SMALLEST_PART * sizes.max(), least_share * mask.size))[labels]
    return large


def _enough(near: Bool[Array, "h w"]) -> bool:
    return bool(np.count_nonzero(near) >= LEAST_SHARE * near.size)


def _best_plane(view: NearDepths) -> Float64[Array, 4] | None:
    """The plane that contains most of what a pair sees nearby, world frame. None if it sees too little."""
    if not _enough(view.near):
        return None
    rows, columns = np.nonzero(view.near & np.isfinite(view.depth_mm))
    places = np.stack([columns, rows, np.ones(len(rows))], axis=1).astype(np.float64)
    inverse = 1.0 / view.depth_mm[rows, columns].astype(np.float64)
    rng = np.random.default_rng(_DRAWN)
    some = rng.choice(len(rows), size=min(len(rows), _SOME), replace=False)
    best, most = None, -1
    for _ in range(_TRIALS):
        three = rng.choice(some, size=3, replace=False)
        if abs(np.linalg.det(places[three])) < _LEAST_AREA * view.near.size:
            continue
        plane = np.linalg.solve(places[three], inverse[three])
        on = int(np.count_nonzero(np.abs(places[some] @ plane - inverse[some]) < _FLATNESS * inverse[some]))
        if on > most:
            best, most = plane, on
    if best is None:
        return None
    for _ in range(_FITS):  # the errors of three points grow towards the image's corners
        on_it = np.abs(places @ best - inverse) < _FLATNESS * inverse
        if np.count_nonzero(on_it) >= 3:
            best = np.linalg.lstsq(places[on_it], inverse[on_it])[0]
    scaled, pose = view.camera.matrix.T @ best, view.camera.camera_from_world
    return np.append(scaled @ pose.rotation, 1.0 - scaled @ pose.translation_mm)


def _split(view: NearDepths, plane_world: Float64[Array, 4]) -> _Split:
    """Split what a pair sees nearby at a plane. In front and behind, only reliable depths count."""
    rows, columns = np.indices(view.depth_mm.shape)
    a, b, c = reciprocal_depth(plane_world, view.camera)
    known = view.near & np.isfinite(view.depth_mm)
    reliable = known & view.textured
    ahead = np.where(known, 1 - (a * columns + b * rows + c) * view.depth_mm, 0.0)
    before, beyond = reliable & (ahead >= _FLATNESS), reliable & (ahead <= -_FLATNESS)
    return _Split(
        lying=int(np.count_nonzero(known & (np.abs(ahead) < _FLATNESS))),
        standing=int(np.count_nonzero(before)),
        behind=int(np.count_nonzero(beyond)),
        standing_share=float(cleaned(reliable & (ahead >= _STANDING * _FLATNESS), 0.0).mean()),
        behind_share=float(cleaned(beyond, 0.0).mean()),
    )


def _is_support(splits: Sequence[_Split]) -> bool:
    """Whether the subject is on a plane, by what pairs see of both.

    At least half of the near pixels are in the plane, and most others in front of it. On a table, which may be nearly
    everything that is near, the subject may be small.
    """
    lying, standing, behind = (
        float(sum(getattr(one, part) for one in splits)) for part in ("lying", "standing", "behind")
    )
    total = lying + standing + behind
    if lying >= _BOARD * total and standing >= _ON_BOARD * total and behind <= _BELOW * standing:
        return True
    before, beyond = (
        float(np.mean([getattr(one, part) for one in splits])) for part in ("standing_share", "behind_share")
    )
    return bool(lying >= _TABLE * total and before >= LEAST_STANDING and beyond <= _BELOW * before)
