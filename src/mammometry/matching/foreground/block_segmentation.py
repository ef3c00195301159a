"""Subject against background, block by block.

By brightness first, then by colour where the two differ in it. Skin and plaster are pale in red light and the backdrop
is darker: a global threshold between the two finds the subject's core. From it the subject grows into what is brighter
than all backdrop and, where colour tells the two apart, into what has the subject's colour however little light it
gets: a shaded flank, the fold below a breast, before a room that is brighter than they are. What is thin (strands of
hair, a leak into clutter) is cut off again.
"""

import numpy as np
from scipy import ndimage

from mammometry.geometry.arrays import Array, Bool, Float32

BACKGROUND_MARGIN = 1.15
"""Factor by which a subject pixel's red (sRGB-encoded) exceeds the brightest backdrop. A pixel with the subject's
colour also counts, in pictures where colour separates the two."""

# Where no other source is named: chosen by eye on the captures of docs/decisions/0020.
_RED = 0  # the channel in which skin and plaster are palest
_SMALLEST_PART = 0.002  # of the largest part's area: smaller ones are specks and not subject
_GROWTH_ROUNDS = 4  # at most; two are usual
_FEWEST = 0.002  # of the picture, for a core or a backdrop to be one
_LEAST_CONTRAST = 1.5  # of the core's red over the rest's
_TWO_THINGS, _TWO_CLASSES = 1.8, 0.83  # ratio of means and share of variance between; one subject: 1.4, .76 at most
_BINS, _BIN_SPREAD = 96, 1.2  # of chromaticity along red and green, σ of the counts' blur in bins
CHROMATICITY = ((0.15, 0.65), (0.15, 0.55))  # of red and of green in all light, encoded: what skin and rooms show
_RARE = 0.01  # of the commonest colour's frequency: no colour of the subject
_ALIKE, _UNLIKE = 0.6, 0.35  # share of the core, and at most of the backdrop, that must have the subject's colour
DARKEST = 0.25  # of the subject's median light (red + green + blue, encoded): darker, colour is noise
_THIN_PX = 1.6  # half the width of what is cut off, pixels of the reference size
_INLAY, _SET_IN = 0.05, 0.4  # of the subject's area, at most; of an inlay's border that the subject makes, at least
_LARGE_HOLE = 0.004  # of the subject: smaller ones are always its own
_LIKE_BACKDROP = 0.15  # relative difference in red below which a large hole shows the backdrop


def segment(encoded: Float32[Array, "h w channels"], unit: float) -> Bool[Array, "h w"] | None:
    """The subject's blocks, or None where nothing stands out.

    Args:
        encoded: means over blocks of sRGB-encoded values, 0…1; one channel or three.
        unit: blocks to a pixel of the reference size.
    """
    red = ndimage.gaussian_filter(encoded[..., _RED], 0.7 * unit, mode="nearest")
    threshold = _otsu(red)
    core = large_parts(red > threshold, _SMALLEST_PART)
    if core.any():
        brighter = _otsu(red[core])
        if _apart(red[core], brighter):  # a dark subject on a board that is itself paler than the dark around it
            threshold = brighter
            core = large_parts(red > threshold, _SMALLEST_PART)
    if not _FEWEST < core.mean() < 1 - 10 * _FEWEST:
        return None
    if red[core].mean() < _LEAST_CONTRAST * max(float(red[~core].mean()), 1e-6):
        return None
    light = ndimage.gaussian_filter(encoded, (unit, unit, 0), mode="nearest")
    coloured = _coloured_like(light, core, unit)
    if coloured is not None:
        core = _with_inlays(large_parts(core & coloured, _SMALLEST_PART), core)
        total = light.sum(axis=2)
        coloured &= total > DARKEST * np.median(total[core])
    subject = core
    for _ in range(_GROWTH_ROUNDS):
        # Well away from what is subject so far, and of another colour: a shaded flank must not raise the level.
        backdrop = ~_widened(subject, 8 * unit)
        if coloured is not None:
            backdrop &= ~coloured
        if backdrop.mean() < _FEWEST:
            break
        level = BACKGROUND_MARGIN * float(np.quantile(red[backdrop], 0.999))
        # Before a backdrop that is nowhere as bright as the core, light alone is proof; elsewhere colour must be.
        like = coloured if coloured is not None and level > threshold else red > min(level, threshold)
        grown = ndimage.binary_propagation(core, mask=like if coloured is None else like | coloured)
        if np.count_nonzero(grown) == np.count_nonzero(subject):
            break
        subject = grown
    filled = _filled(_without_thin(subject, core, unit), red, backdrop)
    found = large_parts(filled, _SMALLEST_PART)
    return found if found.any() else None


def _coloured_like(
    light: Float32[Array, "h w channels"], core: Bool[Array, "h w"], unit: float
) -> Bool[Array, "h w"] | None:
    """Blocks whose chromaticity is commoner in the core than around. None where colour does not tell."""
    away = ~_widened(core, 8 * unit)
    if light.shape[2] == 1 or away.mean() < _FEWEST:
        return None
    total = np.maximum(light.sum(axis=2), 1e-3)
    bins = []
    for channel, (low, high) in enumerate(CHROMATICITY):
        share = (light[..., channel] / total - low) / (high - low)
        bins.append(np.clip((share * _BINS).astype(np.int64), 0, _BINS - 1))
    index = bins[0] * _BINS + bins[1]

    def frequency(where: Bool[Array, "h w"]) -> Array:
        counts = np.bincount(index[where], minlength=_BINS**2).reshape(_BINS, _BINS)
        return ndimage.gaussian_filter(counts / counts.sum(), _BIN_SPREAD, mode="constant")

    subject, rest = frequency(core), frequency(away)
    # The colours around the commonest one; those set apart from it are another thing's, or an inlay's.
    hills, count = ndimage.label((subject > rest) & (subject > _RARE * subject.max()))
    if count == 0:
        return None
    commonest = 1 + np.argmax(ndimage.sum_labels(subject, hills, np.arange(1, count + 1)))
    known: Bool[Array, "h w"] = (hills == commonest).ravel()[index]
    return known if known[core].mean() > _ALIKE and known[away].mean() < _UNLIKE else None


def _with_inlays(core: Bool[Array, "h w"], bright: Bool[Array, "h w"]) -> Bool[Array, "h w"]:
    """The core with small bright patches set in it.

    They are of other colour: an areola on the outline is no backdrop. One that the core encloses would be filled as a
    hole; one that the outline cuts has the core on a part of its border only, and as background would carve the breast
    away. What merely stands beside the subject has less.
    """
    labels, _ = ndimage.label(bright & ~core)
    sizes = np.bincount(labels.ravel())
    shares = np.zeros(len(sizes))
    for label, box in enumerate(ndimage.find_objects(labels), start=1):
        if sizes[label] <= _INLAY * np.count_nonzero(core):
            window = tuple(slice(max(side.start - 1, 0), side.stop + 1) for side in box)
            patch = labels[window] == label
            shares[label] = core[window][ndimage.binary_dilation(patch) & ~patch].mean()
    return core | (shares >= _SET_IN)[labels]


def _without_thin(subject: Bool[Array, "h w"], core: Bool[Array, "h w"], unit: float) -> Bool[Array, "h w"]:
    """The subject without strands and leaks: what an opening leaves and is joined to the core."""
    radius = _THIN_PX * unit
    # Beyond the frame the subject goes on: what it crops is not thin.
    pad = int(np.ceil(radius)) + 2
    padded = np.pad(subject, pad, mode="edge")
    depth = ndimage.distance_transform_edt(padded)
    opened = _widened(depth > radius, radius) & padded
    opened = opened[pad:-pad, pad:-pad]
    kept: Bool[Array, "h w"] = ndimage.binary_propagation(opened & core, mask=opened)
    return kept


def _filled(
    subject: Bool[Array, "h w"], red: Float32[Array, "h w"], backdrop: Bool[Array, "h w"]
) -> Bool[Array, "h w"]:
    """The subject with its holes filled, except those that show the backdrop."""
    holes = ndimage.binary_fill_holes(subject) & ~subject
    labels, _ = ndimage.label(holes)
    filled = subject | holes
    if not backdrop.any():
        return filled
    behind = float(np.median(red[backdrop]))
    sizes = np.bincount(labels.ravel())
    for label in np.nonzero(sizes[1:] > _LARGE_HOLE * np.count_nonzero(subject))[0] + 1:
        hole = labels == label
        if abs(float(np.median(red[hole])) - behind) < _LIKE_BACKDROP * behind:
            filled &= ~hole
    return filled


def _otsu(values: Float32[Array, "h w"]) -> float:
    """Threshold between two classes of largest variance between them (Otsu 1979)."""
    counts, edges = np.histogram(values, bins=256)
    centres = (edges[1:] + edges[:-1]) / 2
    below = np.cumsum(counts)[:-1].astype(np.float64)
    above = counts.sum() - below
    total = np.cumsum(counts * centres)
    mean_below = total[:-1] / np.maximum(below, 1)
    mean_above = (total[-1] - total[:-1]) / np.maximum(above, 1)
    return float(edges[1 + int(np.argmax(below * above * (mean_above - mean_below) ** 2))])


def _apart(values: Float32[Array, " n"], threshold: float) -> bool:
    """Whether a threshold parts two things: means far apart, with hardly any scatter within."""
    above = values > threshold
    share = float(above.mean())
    if not _FEWEST < share < 1 - _FEWEST:
        return False
    high, low = float(values[above].mean()), float(values[~above].mean())
    between = share * (1 - share) * (high - low) ** 2
    return high > _TWO_THINGS * low and between > _TWO_CLASSES * float(values.var())


def _widened(mask: Bool[Array, "h w"], distance: float) -> Bool[Array, "h w"]:
    """Blocks not farther than a distance from the mask."""
    if not mask.any():
        return mask
    near: Bool[Array, "h w"] = ndimage.distance_transform_edt(~mask) <= distance
    return near


def large_parts(mask: Bool[Array, "h w"], least: float) -> Bool[Array, "h w"]:
    """The connected parts of at least such a share of the largest one."""
    labels, count = ndimage.label(mask)
    if count == 0:
        return mask
    sizes = np.bincount(labels.ravel())
    sizes[0] = 0
    keep: Bool[Array, "h w"] = (sizes >= least * sizes.max())[labels]
    return keep
