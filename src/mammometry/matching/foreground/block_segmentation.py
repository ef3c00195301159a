"""Subject against background, block by block, by brightness and colour.

Skin and plaster are pale in red light and the background is darker: a global threshold finds the subject's core. From
it the subject grows into blocks brighter than all background and, if colour separates the two, into blocks of the
subject's colour, however dark: a shaded flank, the fold below a breast, in front of a brighter room. Thin parts
(strands of hair, leaks into clutter) are removed again.
"""

import numpy as np
from scipy import ndimage

from mammometry.geometry.arrays import Array, Bool, Float32

BACKGROUND_MARGIN = 1.15
"""Factor by which a subject pixel's red (sRGB-encoded) exceeds the brightest background. Pixels of the subject's colour
also count if colour separates the two."""

# Unless another source is stated, chosen on the captures of docs/decisions/0020.
_RED = 0  # channel in which skin and plaster are palest
_SMALLEST_PART = 0.002  # smallest part, relative to the largest one's area: smaller ones are random
_GROWTH_ROUNDS = 4  # most rounds; two are usual
_FEWEST = 0.002  # smallest share of the image for a core or a background
_LEAST_CONTRAST = 1.5  # smallest ratio of the core's red to the rest's
_TWO_THINGS, _TWO_CLASSES = 1.8, 0.83  # least ratio of means, share of variance between; one subject: at most 1.4, 0.76
_BINS, _BIN_SPREAD = 96, 1.2  # bins of chromaticity along red and green, and σ of the histogram's blur in bins
CHROMATICITY = ((0.15, 0.65), (0.15, 0.55))  # range of red's and green's share of all light, encoded, in skin and rooms
_RARE = 0.01  # least frequency relative to the commonest colour's: rarer colours are not the subject's
_ALIKE, _UNLIKE = 0.6, 0.35  # smallest share of the core, and largest of the background, with the subject's colour
DARKEST = 0.25  # least light relative to the subject's median (red + green + blue, encoded): darker colours are noise
_THIN_PX = 1.6  # half the width of parts that are removed, pixels of the reference size
_INLAY, _SET_IN = 0.05, 0.4  # largest inlay relative to the subject, and smallest share of its border on the subject
_LARGE_HOLE = 0.004  # smallest large hole, relative to the subject's area: smaller ones are always filled
_LIKE_BACKDROP = 0.15  # relative difference in red below which a large hole shows the background


def segment(encoded: Float32[Array, "h w channels"], unit: float) -> Bool[Array, "h w"] | None:
    """The subject's blocks. None if nothing stands out.

    Args:
        encoded: means over blocks of sRGB-encoded values, 0…1; one channel or three.
        unit: blocks per pixel of the reference size.
    """
    red = ndimage.gaussian_filter(encoded[..., _RED], 0.7 * unit, mode="nearest")
    threshold = _otsu(red)
    core = large_parts(red > threshold, _SMALLEST_PART)
    if core.any():
        brighter = _otsu(red[core])
        if _apart(red[core], brighter):  # a dark subject on a board that is paler than its surroundings
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
        # Far from the subject found so far, and of another colour: a shaded flank must not raise the threshold.
        backdrop = ~_widened(subject, 8 * unit)
        if coloured is not None:
            backdrop &= ~coloured
        if backdrop.mean() < _FEWEST:
            break
        level = BACKGROUND_MARGIN * float(np.quantile(red[backdrop], 0.999))
        # If the background is nowhere as bright as the core, brightness is enough; otherwise the colour must match.
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
    """Blocks whose chromaticity is commoner in the core than around it. None if colour is no help."""
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
    # Colours around the commonest one; separate ones belong to another object or an inlay.
    hills, count = ndimage.label((subject > rest) & (subject > _RARE * subject.max()))
    if count == 0:
        return None
    commonest = 1 + np.argmax(ndimage.sum_labels(subject, hills, np.arange(1, count + 1)))
    known: Bool[Array, "h w"] = (hills == commonest).ravel()[index]
    return known if known[core].mean() > _ALIKE and known[away].mean() < _UNLIKE else None


def _with_inlays(core: Bool[Array, "h w"], bright: Bool[Array, "h w"]) -> Bool[Array, "h w"]:
    """The core with small bright inlays of another colour, such as an areola on the outline.

    An inlay inside the core would be filled as a hole. An inlay on the outline borders on the core only in part. If it
    counted as background, it would carve the breast away. Objects next to the subject share less of their border.
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
    """The subject without strands and leaks: the parts of its opening that are connected to the core."""
    radius = _THIN_PX * unit
    # Beyond the frame the subject continues: parts cut by the frame are not thin.
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
    """The subject with its holes filled, except those that show the background."""
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
    """Threshold with the largest variance between two classes (Otsu 1979)."""
    counts, edges = np.histogram(values, bins=256)
    centres = (edges[1:] + edges[:-1]) / 2
    below = np.cumsum(counts)[:-1].astype(np.float64)
    above = counts.sum() - below
    total = np.cumsum(counts * centres)
    mean_below = total[:-1] / np.maximum(below, 1)
    mean_above = (total[-1] - total[:-1]) / np.maximum(above, 1)
    return float(edges[1 + int(np.argmax(below * above * (mean_above - mean_below) ** 2))])


def _apart(values: Float32[Array, " n"], threshold: float) -> bool:
    """Whether a threshold separates two objects: means far apart, with little scatter within each."""
    above = values > threshold
    share = float(above.mean())
    if not _FEWEST < share < 1 - _FEWEST:
        return False
    high, low = float(values[above].mean()), float(values[~above].mean())
    between = share * (1 - share) * (high - low) ** 2
    return high > _TWO_THINGS * low and between > _TWO_CLASSES * float(values.var())


def _widened(mask: Bool[Array, "h w"], distance: float) -> Bool[Array, "h w"]:
    """Blocks within a distance of the mask."""
    if not mask.any():
        return mask
    near: Bool[Array, "h w"] = ndimage.distance_transform_edt(~mask) <= distance
    return near


def large_parts(mask: Bool[Array, "h w"], least: float) -> Bool[Array, "h w"]:
    """Connected parts with at least this share of the largest one's area."""
    labels, count = ndimage.label(mask)
    if count == 0:
        return mask
    sizes = np.bincount(labels.ravel())
    sizes[0] = 0
    keep: Bool[Array, "h w"] = (sizes >= least * sizes.max())[labels]
    return keep
