"""Subject against background, from seeds whose depth is known.

Where a coarse stereo of the whole photographs shows what is near and what is far, brightness need not be asked. The
seeds give the colours of both sides; what is seen too smooth or too dark for stereo goes with the seeds whose colours
it has, and between those the border runs where the picture changes most (watershed; Meyer and Beucher 1990).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import ndimage
from skimage.segmentation import watershed

from mammometry.base.value import value
from mammometry.geometry.arrays import Array, Bool, Float32, Int32
from mammometry.matching.foreground.block_segmentation import CHROMATICITY, DARKEST

# Where no other source is named: chosen on the simulated captures of docs/decisions/0028.
_FATTENED = 4.0  # small pixels by which the coarse stereo may carry a depth over a border
_SHARE_BINS, _LIGHT_BINS = 48, 24  # of red's and green's share of all light, and of light
_SURE = 4.0  # ratio of the frequencies of a colour on either side that makes it one side's
_SEEN = 1e-5  # frequency below which a colour is hardly seen: it tells nothing
_CLEAR_PX = 12.0  # nearer to near seeds than this, pixels of the reference size, colour makes no background
_SPECK_PX = 3.0  # half the width of what a colour must fill to be a marker
_TELLING = 0.5  # of the near seeds: where fewer have a colour of their own, colour tells nothing
_PRUNINGS = 2  # rounds in which seeds of the other side's colour are dropped
SMALLEST_PART = 0.02  # of the largest part: smaller ones are chance
# Shares above which depth contradicts brightness: of the near seeds that it leaves out, of its subject that is far, and
# of its subject that neither depth nor colour joins to the seeds.
_MISSED, _BEHIND, _BEYOND = 0.04, 0.02, 0.04
_FAR_END = 0.04, 0.15  # of the bright subject: far places in it, and what they would take off, if it is an arm's end
_LONG_END, _NECK = 0.3, 0.25  # of the bright subject, if it is joined to the rest by so much of its rim; chosen by eye
_CUT_OFF = 0.9  # of a part that something parts from the rest: its blocks of the subject's chromaticity; by eye
_AROUND, _WITHIN = 1.5, 0.95  # times the bright subject, of which so much is within: it lies on something


@value(eq=False)
class DepthSeeds:
    """Certainly near and certainly far pixels of one photograph."""

    camera: str
    step: int
    """Pixels of the photograph to a block."""
    near: Bool[Array, "h w"]
    """Blocks in the working volume."""
    far: Bool[Array, "h w"]
    """Blocks behind it."""


def laid_out(seeds: DepthSeeds, shape: tuple[int, int], step: int) -> tuple[Bool[Array, "H W"], Bool[Array, "H W"]]:
    """Near and far, for blocks of another step. Without the rims that may be carried over a border."""
    places = [((np.arange(size) + 0.5) * step / seeds.step).astype(np.intp) for size in shape]
    made = []
    for mask in (seeds.near, seeds.far):
        # Beyond the frame the seeds go on: what it crops has no rim there.
        pad = int(_FATTENED) + 1
        inner = ndimage.distance_transform_edt(np.pad(mask, pad, mode="edge"))[pad:-pad, pad:-pad] > _FATTENED
        rows, columns = (np.minimum(place, size - 1) for place, size in zip(places, mask.shape, strict=True))
        made.append(inner[np.ix_(rows, columns)])
    return made[0], made[1]


def agreed(
    encoded: Float32[Array, "h w channels"],
    bright: Bool[Array, "h w"] | None,
    seeds: Sequence[DepthSeeds],
    step: int,
    unit: float,
) -> Bool[Array, "h w"] | None:
    """The subject's blocks by brightness, or by depth where depth contradicts that.

    Args:
        encoded: means over blocks of sRGB-encoded values, 0…1; one channel or three.
        bright: the subject by brightness and colour alone (`segment.segment`); None where nothing stands out.
        seeds: of each pair that the camera is in, maybe none.
        step: pixels to a block.
        unit: blocks to a pixel of the reference size.

    Returns:
        `bright` itself where the seeds do not contradict it, or say nothing; None where they do and yet nothing of the
        picture is certainly background.
    """
    laid = [laid_out(one, encoded.shape[:2], step) for one in seeds]
    if not laid:
        return bright
    near, far = (np.any([one[side] for one in laid], axis=0) for side in (0, 1))
    near, far = near & ~far, far & ~near
    found = segment_by_depth(encoded, near, far, unit) if near.any() else None
    if found is None:
        return bright
    if bright is None:
        return found.subject if found.bounded else None
    size = np.count_nonzero(bright)
    most_far, most_lost = _FAR_END
    lost = np.count_nonzero(bright & ~found.subject)
    end = lost <= most_lost * size or (lost <= _LONG_END * size and _by_a_neck(bright, found.subject, far))
    if 0 < np.count_nonzero(far & bright) <= most_far * size and end:
        far &= ~bright  # the subject's own far end, as an arm that is held away: it marks no background
        found = segment_by_depth(encoded, near, far, unit) or found
    behind = np.count_nonzero(found.far & bright) / size
    other = _unlike_the_rest(encoded, found.near, bright)
    missed = np.count_nonzero(found.near & ~bright & ~other) / np.count_nonzero(found.near)
    cut_off = _cut_off(encoded, bright, found, far)
    # A rim of some blocks is where depth is unsure of the border: of a small subject it is a large share.
    beyond = np.count_nonzero(_solid(bright & ~found.subject & ~cut_off, unit)) / size
    if missed <= _MISSED and behind <= _BEHIND and beyond <= _BEYOND:
        return bright
    around = (
        np.count_nonzero(found.subject) > _AROUND * size and np.count_nonzero(bright & found.subject) > _WITHIN * size
    )
    if around:  # what it lies on is as near: brightness alone tells
        return bright
    if other.any():
        found = segment_by_depth(encoded, near & ~other, far | other, unit) or found
    return found.subject | cut_off if found.bounded else None


def _by_a_neck(bright: Bool[Array, "h w"], kept: Bool[Array, "h w"], far: Bool[Array, "h w"]) -> bool:
    """Whether what far places take off hangs on the rest by a small part of its rim.

    An arm does. What lies behind the body borders on it all along.
    """
    lost = bright & ~kept
    labels, count = ndimage.label(lost)
    rim = lost & ~ndimage.binary_erosion(lost, border_value=1)  # beyond the frame the subject goes on
    joined = lost & ndimage.binary_dilation(bright & kept)
    numbers = np.arange(1, count + 1)
    taken = ndimage.sum_labels(far, labels, numbers) > 0
    rims, joints = (ndimage.sum_labels(mask, labels, numbers) for mask in (rim, joined))
    return bool(np.all(joints[taken] <= _NECK * rims[taken]))


def _cut_off(
    encoded: Float32[Array, "h w channels"], bright: Bool[Array, "h w"], found: ByDepth, far: Bool[Array, "h w"]
) -> Bool[Array, "h w"]:
    """Parts of the bright subject that do not touch what depth joins to the seeds.

    A rail before the body parts them. They have the subject's chromaticity, and no depth contradicts them.
    """
    lost, taken = bright & ~found.subject, found.near & bright
    labels, count = ndimage.label(bright)
    if count < 2 or not taken.any() or not lost.any():
        return np.zeros_like(bright)
    numbers = np.arange(count + 1)
    alike = _Colours(encoded, taken).ratio(taken, lost, by_light=False) > 1 / _SURE
    apart = ~(ndimage.sum_labels(bright & found.subject, labels, numbers) > 0)
    apart &= ~(ndimage.sum_labels(far, labels, numbers) > 0)
    apart &= ndimage.sum_labels(alike, labels, numbers) >= _CUT_OFF * ndimage.sum_labels(bright, labels, numbers)
    apart[0] = False
    found_apart: Bool[Array, "h w"] = apart[labels] & lost
    return found_apart


def _unlike_the_rest(
    encoded: Float32[Array, "h w channels"], near: Bool[Array, "h w"], bright: Bool[Array, "h w"]
) -> Bool[Array, "h w"]:
    """Near seeds of a chromaticity unlike the subject's.

    Brightness leaves them out. They are no subject: a rail in front of it, or trousers. Empty if brightness leaves out
    most.
    """
    taken, left_out = near & bright, near & ~bright
    if np.count_nonzero(taken) < np.count_nonzero(left_out):
        return np.zeros_like(near)
    return left_out & ~(_Colours(encoded, taken).ratio(taken, left_out, by_light=False) > 1 / _SURE)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ByDepth:
    """A subject that was grown from seeds."""

    subject: Bool[Array, "h w"]
    near: Bool[Array, "h w"]
    """Seeds of the subject whose colour is no more frequent elsewhere."""
    far: Bool[Array, "h w"]
    """Seeds of the background with a colour no more frequent among the near."""
    bounded: bool
    """Whether anything is certainly background: the subject's border is guessed if not."""


def segment_by_depth(
    encoded: Float32[Array, "h w channels"], near: Bool[Array, "h w"], far: Bool[Array, "h w"], unit: float
) -> ByDepth | None:
    """Grow the subject's blocks from seeds. None where these have no colour of their own.

    Args:
        encoded: means over blocks of sRGB-encoded values, 0…1; one channel or three.
        near: blocks of the subject, some at least.
        far: blocks of the background, maybe none.
        unit: blocks to a pixel of the reference size.
    """
    light = ndimage.gaussian_filter(encoded, (0.7 * unit, 0.7 * unit, 0), mode="nearest")
    colours = _Colours(light, near)
    measured = np.count_nonzero(near)
    for _ in range(_PRUNINGS):  # a depth carried over a border brings the other side's colour with it
        near, far = near & (colours.ratio(near, ~near) > 1), far & (colours.ratio(near, far) < 1)
        if np.count_nonzero(near) < _TELLING * measured:
            return None
    near, far = _solid(near, unit), _solid(far, unit)
    if not near.any():
        return None
    near = _closed(near, far)
    ratio = colours.ratio(near, ~near)
    # Elsewhere there is the subject, too, in other light: only another chromaticity makes it background.
    other = (ratio < 1 / _SURE) & (colours.ratio(near, ~near, by_light=False) < 1)
    distance = ndimage.distance_transform_edt(~near)
    backdrop = _from_outside(far | (_solid(other, unit) & (distance > _CLEAR_PX * unit)), far)
    subject = near | (_solid((ratio > _SURE) & ~other, unit) & ~far)
    subject = ndimage.binary_propagation(near, mask=subject & ~backdrop)
    if backdrop.any():
        markers = subject.astype(np.int32) + 2 * (backdrop & ~subject).astype(np.int32)
        subject = _divided(light, markers) == 1
    bounded = bool(backdrop.any())
    return ByDepth(subject=_parts_with(subject, near), near=near, far=far, bounded=bounded)


class _Colours:
    """Each block's colour, and its frequency in one place over another."""

    def __init__(self, light: Float32[Array, "h w channels"], near: Bool[Array, "h w"]) -> None:
        total = np.maximum(light.sum(axis=2), 1e-3)
        self.dark = total < DARKEST * np.median(total[near])
        """Where chromaticity is noise."""
        self.places = [_binned(total / light.shape[2], _LIGHT_BINS)]
        if light.shape[2] > 1:
            shares = [(light[..., c] / total - low) / (high - low) for c, (low, high) in enumerate(CHROMATICITY)]
            self.places += [_binned(share, _SHARE_BINS) for share in shares]

    def ratio(
        self, here: Bool[Array, "h w"], there: Bool[Array, "h w"], *, by_light: bool = True
    ) -> Float32[Array, "h w"]:
        """How many times more frequent each block's colour is here than there.

        By chromaticity alone where asked and where there is light enough for it; 1 where there is no chromaticity.
        """
        if not by_light:
            if len(self.places) == 1:
                return np.where(self.dark, np.float32(0), np.float32(1))
            return np.where(self.dark, np.float32(0), self._ratio(self.places[1:], here, there))
        return self._ratio(self.places, here, there)

    @staticmethod
    def _ratio(places: list[Array], here: Bool[Array, "h w"], there: Bool[Array, "h w"]) -> Float32[Array, "h w"]:
        shape = tuple(_LIGHT_BINS if k == 0 and len(places) != 2 else _SHARE_BINS for k in range(len(places)))
        index = np.ravel_multi_index(places, shape)

        def share(where: Bool[Array, "h w"]) -> Array:
            counts = np.bincount(index[where], minlength=int(np.prod(shape))).reshape(shape)
            return ndimage.gaussian_filter(counts / max(int(np.count_nonzero(where)), 1), 1.0, mode="constant").ravel()

        found: Float32[Array, "h w"] = ((share(here) + _SEEN) / (share(there) + _SEEN)).astype(np.float32)[index]
        return found


def _binned(values: Float32[Array, "h w"], count: int) -> Array:
    return np.clip(values * count, 0, count - 1).astype(np.intp)


def _divided(light: Float32[Array, "h w channels"], markers: Int32[Array, "h w"]) -> Int32[Array, "h w"]:
    """Grow both sides' markers until they meet, where the picture changes most."""
    steepest = np.zeros(light.shape[:2], dtype=np.float32)
    for channel in range(light.shape[2]):
        along = [ndimage.sobel(light[..., channel], axis=axis) for axis in (0, 1)]
        steepest = np.maximum(steepest, np.hypot(*along))
    found: Int32[Array, "h w"] = watershed(steepest, markers)  # type: ignore[no-untyped-call]
    return found


def _solid(mask: Bool[Array, "h w"], unit: float) -> Bool[Array, "h w"]:
    """Keep the parts of a mask that are as wide as a marker must be."""
    radius = _SPECK_PX * unit
    pad = int(np.ceil(radius)) + 1
    padded = np.pad(mask, pad, mode="edge")
    inner = ndimage.distance_transform_edt(padded) > radius
    opened: Bool[Array, "h w"] = ((ndimage.distance_transform_edt(~inner) <= radius) & padded)[pad:-pad, pad:-pad]
    return opened


def _closed(near: Bool[Array, "h w"], far: Bool[Array, "h w"]) -> Bool[Array, "h w"]:
    """Near seeds with what they enclose: an areola, a shade. Not what something far is seen through."""
    labels, count = ndimage.label(ndimage.binary_fill_holes(near) & ~near)
    through = np.bincount(labels[far], minlength=count + 1) > 0
    through[0] = True
    closed: Bool[Array, "h w"] = near | ~through[labels]
    return closed


def _from_outside(backdrop: Bool[Array, "h w"], far: Bool[Array, "h w"]) -> Bool[Array, "h w"]:
    """Parts that reach the frame or hold far seeds. An areola does neither."""
    labels, count = ndimage.label(backdrop)
    reaching = np.bincount(labels[far], minlength=count + 1) > 0
    for edge in (labels[0], labels[-1], labels[:, 0], labels[:, -1]):
        reaching[edge] = True
    reaching[0] = False
    found: Bool[Array, "h w"] = reaching[labels]
    return found


def _parts_with(subject: Bool[Array, "h w"], near: Bool[Array, "h w"]) -> Bool[Array, "h w"]:
    """The parts that hold seeds."""
    labels, count = ndimage.label(subject)
    sizes = np.bincount(labels[near], minlength=count + 1)
    sizes[0] = 0
    found: Bool[Array, "h w"] = (sizes >= SMALLEST_PART * sizes.max())[labels]
    return found
