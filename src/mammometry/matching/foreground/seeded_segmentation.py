"""Subject against background, from seeds whose depth is known.

If coarse stereo of the whole photographs shows what is near and far, brightness is not needed. The seeds give the
colours of both sides. Areas that are too smooth or dark for stereo join the seeds whose colours they have, and the
border is where the image changes most (watershed; Meyer and Beucher 1990).
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

# Unless another source is stated, chosen on the simulated captures of docs/decisions/0028.
_FATTENED = 4.0  # reduced pixels by which coarse stereo may extend a depth across a border
_SHARE_BINS, _LIGHT_BINS = 48, 24  # bins of red's and green's share of all light, and of light
_SURE = 4.0  # ratio of a colour's frequencies on the two sides above which it belongs to one of them
_SEEN = 1e-5  # frequency below which a colour is too rare for a decision
_CLEAR_PX = 12.0  # pixels of the reference size: closer to near seeds, colour alone does not mark background
_SPECK_PX = 3.0  # half the smallest width of an area that becomes a marker by colour
_TELLING = 0.5  # least share of near seeds with a distinct colour; below it, colour is not used
_PRUNINGS = 2  # rounds in which seeds of the other side's colour are removed
SMALLEST_PART = 0.02  # relative to the largest part: smaller ones are random
# Shares above which depth contradicts the subject found by brightness: of the near seeds that this omits, of it that is
# far, and of it that neither depth nor colour connects to the seeds.
_MISSED, _BEHIND, _BEYOND = 0.04, 0.02, 0.04
_FAR_END = 0.04, 0.15  # largest shares of the bright subject for an arm's end: its far parts, and their loss
_LONG_END, _NECK = 0.3, 0.25  # the same loss if at most this share of its border touches the rest
_CUT_OFF = 0.9  # share of a separated part's blocks that have the subject's chromaticity
_AROUND, _WITHIN = 1.5, 0.95  # near area over the bright subject's, and its share within: it is on a support


@value(eq=False)
class DepthSeeds:
    """Certainly near and certainly far blocks of one photograph."""

    camera: str
    step: int
    """Pixels of the photograph per block."""
    near: Bool[Array, "h w"]
    """Blocks in the working volume."""
    far: Bool[Array, "h w"]
    """Blocks behind it."""


def laid_out(seeds: DepthSeeds, shape: tuple[int, int], step: int) -> tuple[Bool[Array, "H W"], Bool[Array, "H W"]]:
    """Near and far for blocks of another size, without borders where depth may extend too far."""
    places = [((np.arange(size) + 0.5) * step / seeds.step).astype(np.intp) for size in shape]
    made = []
    for mask in (seeds.near, seeds.far):
        # Beyond the frame the seeds continue: no border there.
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
    """The subject's blocks by brightness, or by depth if the two contradict each other.

    Args:
        encoded: means over blocks of sRGB-encoded values, 0…1; one channel or three.
        bright: the subject by brightness and colour alone (`segment.segment`). None if nothing stands out.
        seeds: those of each pair of the camera, possibly none.
        step: pixels per block.
        unit: blocks per pixel of the reference size.

    Returns:
        `bright` itself if the seeds do not contradict it or are not sufficient; None if they contradict it and nothing
        in the image is certainly background.
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
        far &= ~bright  # the subject's own far end, such as an extended arm, is not background
        found = segment_by_depth(encoded, near, far, unit) or found
    behind = np.count_nonzero(found.far & bright) / size
    other = _unlike_the_rest(encoded, found.near, bright)
    missed = np.count_nonzero(found.near & ~bright & ~other) / np.count_nonzero(found.near)
    cut_off = _cut_off(encoded, bright, found, far)
    # Depth is uncertain in a border of a few blocks, which is a large share of a small subject.
    beyond = np.count_nonzero(_solid(bright & ~found.subject & ~cut_off, unit)) / size
    if missed <= _MISSED and behind <= _BEHIND and beyond <= _BEYOND:
        return bright
    around = (
        np.count_nonzero(found.subject) > _AROUND * size and np.count_nonzero(bright & found.subject) > _WITHIN * size
    )
    if around:  # the subject's support is as near as it: only brightness separates them
        return bright
    if other.any():
        found = segment_by_depth(encoded, near & ~other, far | other, unit) or found
    return found.subject | cut_off if found.bounded else None


def _by_a_neck(bright: Bool[Array, "h w"], kept: Bool[Array, "h w"], far: Bool[Array, "h w"]) -> bool:
    """Whether only a small share of the far part's border is connected to the rest, as for an arm.

    An object behind the body borders on it everywhere.
    """
    lost = bright & ~kept
    labels, count = ndimage.label(lost)
    rim = lost & ~ndimage.binary_erosion(lost, border_value=1)  # beyond the frame the subject continues
    joined = lost & ndimage.binary_dilation(bright & kept)
    numbers = np.arange(1, count + 1)
    taken = ndimage.sum_labels(far, labels, numbers) > 0
    rims, joints = (ndimage.sum_labels(mask, labels, numbers) for mask in (rim, joined))
    return bool(np.all(joints[taken] <= _NECK * rims[taken]))


def _cut_off(
    encoded: Float32[Array, "h w channels"], bright: Bool[Array, "h w"], found: ByDepth, far: Bool[Array, "h w"]
) -> Bool[Array, "h w"]:
    """Bright parts of the subject that something in front, such as a rail, separates from the seeded part.

    They have the subject's chromaticity, and no depth contradicts them.
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
    """Near seeds with a chromaticity unlike the subject's, such as a rail in front of it, or trousers.

    Brightness does not include them. Empty if brightness omits most seeds.
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
    """Seeds of the subject whose colour is not more frequent elsewhere."""
    far: Bool[Array, "h w"]
    """Seeds of the background whose colour is not more frequent among the near ones."""
    bounded: bool
    """Whether anything is certainly background. If not, the subject's border is uncertain."""


def segment_by_depth(
    encoded: Float32[Array, "h w channels"], near: Bool[Array, "h w"], far: Bool[Array, "h w"], unit: float
) -> ByDepth | None:
    """Grow the subject's blocks from seeds. None if these have no distinct colour.

    Args:
        encoded: means over blocks of sRGB-encoded values, 0…1; one channel or three.
        near: blocks of the subject, at least some.
        far: blocks of the background, possibly none.
        unit: blocks per pixel of the reference size.
    """
    light = ndimage.gaussian_filter(encoded, (0.7 * unit, 0.7 * unit, 0), mode="nearest")
    colours = _Colours(light, near)
    measured = np.count_nonzero(near)
    for _ in range(_PRUNINGS):  # seeds across a border have the other side's colour
        near, far = near & (colours.ratio(near, ~near) > 1), far & (colours.ratio(near, far) < 1)
        if np.count_nonzero(near) < _TELLING * measured:
            return None
    near, far = _solid(near, unit), _solid(far, unit)
    if not near.any():
        return None
    near = _closed(near, far)
    ratio = colours.ratio(near, ~near)
    # The subject also occurs elsewhere, in other light: only another chromaticity makes a block background.
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
    """Each block's colour, and ratios of its frequencies."""

    def __init__(self, light: Float32[Array, "h w channels"], near: Bool[Array, "h w"]) -> None:
        total = np.maximum(light.sum(axis=2), 1e-3)
        self.dark = total < DARKEST * np.median(total[near])
        """Blocks whose chromaticity is noise."""
        self.places = [_binned(total / light.shape[2], _LIGHT_BINS)]
        if light.shape[2] > 1:
            shares = [(light[..., c] / total - low) / (high - low) for c, (low, high) in enumerate(CHROMATICITY)]
            self.places += [_binned(share, _SHARE_BINS) for share in shares]

    def ratio(
        self, here: Bool[Array, "h w"], there: Bool[Array, "h w"], *, by_light: bool = True
    ) -> Float32[Array, "h w"]:
        """Ratio of the frequency of each block's colour in `here` to that in `there`.

        Without `by_light`, by chromaticity alone if there is enough light; 1 where there is no chromaticity.
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
    """Grow both sides' markers until they meet, where the image changes most."""
    steepest = np.zeros(light.shape[:2], dtype=np.float32)
    for channel in range(light.shape[2]):
        along = [ndimage.sobel(light[..., channel], axis=axis) for axis in (0, 1)]
        steepest = np.maximum(steepest, np.hypot(*along))
    found: Int32[Array, "h w"] = watershed(steepest, markers)  # type: ignore[no-untyped-call]
    return found


def _solid(mask: Bool[Array, "h w"], unit: float) -> Bool[Array, "h w"]:
    """Keep the parts of a mask that are wide enough for a marker."""
    radius = _SPECK_PX * unit
    pad = int(np.ceil(radius)) + 1
    padded = np.pad(mask, pad, mode="edge")
    inner = ndimage.distance_transform_edt(padded) > radius
    opened: Bool[Array, "h w"] = ((ndimage.distance_transform_edt(~inner) <= radius) & padded)[pad:-pad, pad:-pad]
    return opened


def _closed(near: Bool[Array, "h w"], far: Bool[Array, "h w"]) -> Bool[Array, "h w"]:
    """Near seeds with the areas that they enclose, unless they contain far seeds."""
    labels, count = ndimage.label(ndimage.binary_fill_holes(near) & ~near)
    through = np.bincount(labels[far], minlength=count + 1) > 0
    through[0] = True
    closed: Bool[Array, "h w"] = near | ~through[labels]
    return closed


def _from_outside(backdrop: Bool[Array, "h w"], far: Bool[Array, "h w"]) -> Bool[Array, "h w"]:
    """Parts of the backdrop that reach the frame or contain far seeds. An areola does neither."""
    labels, count = ndimage.label(backdrop)
    reaching = np.bincount(labels[far], minlength=count + 1) > 0
    for edge in (labels[0], labels[-1], labels[:, 0], labels[:, -1]):
        reaching[edge] = True
    reaching[0] = False
    found: Bool[Array, "h w"] = reaching[labels]
    return found


def _parts_with(subject: Bool[Array, "h w"], near: Bool[Array, "h w"]) -> Bool[Array, "h w"]:
    """The parts that contain seeds."""
    labels, count = ndimage.label(subject)
    sizes = np.bincount(labels[near], minlength=count + 1)
    sizes[0] = 0
    found: Bool[Array, "h w"] = (sizes >= SMALLEST_PART * sizes.max())[labels]
    return found
