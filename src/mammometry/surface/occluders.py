"""Places where a silhouette does not bound the subject.

Something else stands in front. A rail of a posing frame cuts a body in two in a photograph, and a dark strap looks
like background. A silhouette alone would then carve away what other cameras see. Measured skin shows it: a point that
a pair has measured, and that most other cameras see on the subject too, cannot lie beside the subject in the rest.
Something hides it there. Such places are unknown and carve nothing. A point that most others see beside the subject is
no part of it: their silhouettes hold.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from mammometry.geometry.arrays import Array, Bool, Float32, Float64, read_only
from mammometry.geometry.camera import Rig
from mammometry.matching.foreground import Foreground
from mammometry.surface.range_image import RangeImage

_REFERENCE_DIAGONAL_PX = 1353.0  # of the 1126 × 750 images on which widths were measured, as in `matching.foreground`
_BLOCK_PX = 2.0  # pixels a block, at that size: a bar of 4 px is seen, and a million data are looked up in a second
_GUARD_PX = 3.0  # nearer to a silhouette than this, at that size, a datum's own error may put it beside; chosen by eye
_SAMPLES = 300_000  # of a view's data that are looked up: a dozen a block that the subject fills
_LEAST_SHARE = 2e-4  # of the subject's blocks that a blocked place covers, at least: fewer are outliers; chosen by eye
_GAP_BLOCKS = 4  # gaps between data that are narrower than twice this belong to the place, at least; chosen by eye
_WIDENING = 1.25  # of the widest blocked place: gaps as wide as what blocks the view belong to it; chosen by eye


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Blocked:
    """Where one camera's view of the subject is blocked."""

    camera: str
    blocks: Bool[Array, "H W"]
    """Squares of `step` pixels that show something before the subject."""
    step: int
    share: float
    """Of the subject in that photograph, the blocked places included."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "blocks", read_only(self.blocks))

    def pixels(self, shape_hw: tuple[int, int]) -> Bool[Array, "h w"]:
        """The blocked pixels of the photograph."""
        whole = self.blocks.repeat(self.step, axis=0).repeat(self.step, axis=1)
        return whole[: shape_hw[0], : shape_hw[1]]


def find_blocked(
    range_images: Sequence[RangeImage], foregrounds: Mapping[str, Foreground], rig: Rig
) -> dict[str, Blocked]:
    """Find the places where cameras see something before the subject.

    A datum counts if, of the cameras of other pairs that have it in their picture, at least one sees it on the subject,
    and no more see it beside the subject than on it.

    Args:
        range_images: measured skin of each pair, without what is dented.
        foregrounds: silhouettes by camera; those that are not known have no say.
        rig: the calibrated cameras.

    Returns:
        Camera → where it is blocked, for the cameras that are.
    """
    outside = {
        name: _outside_px(foreground)
        for name, foreground in foregrounds.items()
        if not foreground.everything and foreground.mask.any()
    }
    hits = {name: np.zeros(distance.shape, dtype=np.int32) for name, (distance, _) in outside.items()}
    for image in range_images:
        points = image.valid_points_world()
        points = points[:: max(1, len(points) // _SAMPLES)]
        places: dict[str, tuple[Array, Array, Array]] = {}
        on, beside = (np.zeros(len(points), dtype=np.int32) for _ in range(2))
        for name, (distance, step) in outside.items():
            if name in rig.pair_names[image.name]:
                continue
            index, row, column = _seen(points, rig, name, step, distance.shape)
            away = distance[row, column] > _GUARD_PX
            on[index[~away]] += 1
            beside[index[away]] += 1
            places[name] = index[away], row[away], column[away]
        agreed = (on > 0) & (beside <= on)
        for name, (index, row, column) in places.items():
            kept = agreed[index]
            np.add.at(hits[name], (row[kept], column[kept]), 1)
    found = {}
    for name, count in hits.items():
        distance, step = outside[name]
        subject = distance <= 0
        blocks = _joined(count > 0, subject)
        if blocks.any():
            share = np.count_nonzero(blocks) / (np.count_nonzero(blocks) + np.count_nonzero(subject))
            found[name] = Blocked(camera=name, blocks=blocks, step=step, share=float(share))
    return found


def unblocked(foregrounds: Mapping[str, Foreground], blocked: Mapping[str, Blocked]) -> dict[str, Foreground]:
    """Silhouettes that carve nothing where the view is blocked.

    The others as they are.
    """
    opened = {}
    for name, foreground in foregrounds.items():
        if name in blocked:
            pixels = blocked[name].pixels(foreground.coverage.shape)
            coverage = np.where(pixels, np.float32(1.0), foreground.coverage)
            opened[name] = replace(foreground, coverage=coverage)
        else:
            opened[name] = foreground
    return opened


def _outside_px(foreground: Foreground) -> tuple[Float32[Array, "H W"], int]:
    """Distance of each block outside the silhouette, and the blocks' step.

    Distances are pixels of the reference size.
    """
    height, width = foreground.coverage.shape
    unit = max(1.0, float(np.hypot(height, width)) / _REFERENCE_DIAGONAL_PX)
    step = round(_BLOCK_PX * unit)
    distance = ndimage.distance_transform_edt(~foreground.mask[::step, ::step]) * (step / unit)
    return distance.astype(np.float32), step


def _seen(
    points_world: Float64[Array, "n 3"], rig: Rig, camera: str, step: int, shape: tuple[int, int]
) -> tuple[Array, Array, Array]:
    """Which points a camera sees, and their blocks' row and column."""
    with np.errstate(invalid="ignore"):
        column, row = (rig.cameras[camera].project(points_world) / step).T
        inside = (column >= 0) & (row >= 0) & (column < shape[1]) & (row < shape[0])
    index = np.flatnonzero(inside)
    return index, row[index].astype(np.intp), column[index].astype(np.intp)


def _joined(hit: Bool[Array, "H W"], subject: Bool[Array, "H W"]) -> Bool[Array, "H W"]:
    """Hit places without outliers, with gaps closed up to the subject."""
    labels, _ = ndimage.label(hit, structure=np.ones((3, 3)))
    sizes = np.bincount(labels.ravel())
    sizes[0] = 0
    large = (sizes >= max(_LEAST_SHARE * np.count_nonzero(subject), 2))[labels]
    if not large.any():
        return large
    # A bar is about as wide where nobody has measured the skin behind it.
    radius = max(_GAP_BLOCKS, _WIDENING * _half_width(large))
    pad = int(radius) + 2
    whole = np.pad(large | subject, pad, mode="edge")
    near = ndimage.distance_transform_edt(~whole) <= radius
    closed = (ndimage.distance_transform_edt(near) > radius)[pad:-pad, pad:-pad]
    around = ndimage.distance_transform_edt(~large) <= 2 * radius
    joined: Bool[Array, "H W"] = (closed & around & ~subject) | large
    return joined


def _half_width(place: Bool[Array, "H W"]) -> float:
    """Half the width of a place where it is widest, blocks."""
    return float(ndimage.distance_transform_edt(np.pad(place, 1))[1:-1, 1:-1].max())
