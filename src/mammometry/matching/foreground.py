"""Which pixels show the subject: a smooth, sub-pixel coverage map of each photograph.

Skin and plaster are pale in red light and the backdrop is darker. First a global threshold between the two, lowered to
just above the brightest backdrop, tells them apart; then each pixel near the contour is compared with the backdrop and
the subject *beside it*, in linear light, so that neither a shaded flank nor a bright patch of the backdrop moves the
silhouette.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy import ndimage

from mammometry.errors import ImageError, MatchingError
from mammometry.geometry.arrays import Array, Bool, Float32, Float64, read_only
from mammometry.photograph import Photograph

_RED = 0
_REFERENCE_DIAGONAL_PX = 1353.0  # of the 1126 × 750 images on which the widths below were measured
_GUARD_PX = 3.0  # nearer to the contour than this, pixels are mixed (blur, resampling)
_NEIGHBOURHOOD_PX = 5.0  # Gaussian σ over which backdrop and subject are averaged beside the contour
_FEATHER_PX = 4.0  # the coverage is measured this far on either side of the contour, and 0 or 1 beyond
_COARSE_STEP = 2.0  # pixels a block for what needs no sub-pixel position
_GROWTH_ROUNDS = 4
_DISTINCT_HUE = 0.05  # difference of red / (red + green + blue), encoded; skin against grey: about .1


@dataclass(frozen=True, slots=True, kw_only=True)
class ForegroundSettings:
    """How the subject is told from the background."""

    mode: Literal["auto", "all"] = "auto"
    """auto: a pale subject before a darker background. all: every pixel may be surface (cluttered scenes); the
    photograph then says nothing about silhouettes. A mask that is given overrules both."""
    contour_level: float = 0.4
    """Coverage at which the silhouette lies, 0…1. A rim is turned away from the light and darker than the skin beside
    it: .5 lay .1 to .3 px inside the true one in eight views of three subjects, .4 within .1 px."""
    background_margin: float = 1.15
    """A pixel may be subject where its (sRGB-encoded) red exceeds the brightest backdrop this many times."""
    smallest_part: float = 0.002
    """Parts smaller than this share of the largest are specks and not subject."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Foreground:
    """Share of each pixel that the subject covers, in the original, distorted photograph."""

    camera: str
    coverage: Float32[Array, "h w"]
    """0 background … 1 subject; smooth near the contour, so that its `contour_level` is a sub-pixel silhouette."""
    contour_level: float
    """Coverage on the silhouette."""
    everything: bool
    """True: no silhouette is known, every pixel may be surface; nothing may be carved with it."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "coverage", read_only(self.coverage))

    @property
    def mask(self) -> Bool[Array, "h w"]:
        """Pixels whose centre lies inside the silhouette."""
        return self.coverage >= self.contour_level


def estimate_foreground(
    photograph: Photograph,
    camera_name: str,
    settings: ForegroundSettings = ForegroundSettings(),
    *,
    given: Bool[Array, "h w"] | None = None,
) -> Foreground:
    """Find the subject in a photograph, or take the mask that is given.

    Args:
        photograph: the capture.
        camera_name: whose it is.
        settings: mode and levels.
        given: the subject's pixels, drawn or segmented elsewhere; overrules the mode.

    Raises:
        ImageError: the given mask has another size than the photograph.
        MatchingError: nothing stands out from the backdrop.
    """
    if given is not None:
        return _from_mask(photograph, camera_name, given)
    if settings.mode == "all":
        whole = np.ones(photograph.pixels.shape[:2], dtype=np.float32)
        return Foreground(camera=camera_name, coverage=whole, contour_level=settings.contour_level, everything=True)
    unit = max(1.0, float(np.hypot(*photograph.size_wh)) / _REFERENCE_DIAGONAL_PX)
    step = round(_COARSE_STEP * unit)
    small = _block_means(photograph.encoded(), step)
    subject = _segment(small, unit / step, settings, photograph.name)
    part = _surroundings(subject, step, photograph.pixels.shape[:2], round(8 * _GUARD_PX * unit))
    red = photograph.pixels[part] if photograph.pixels.ndim == 2 else photograph.pixels[part][..., _RED]
    linear = Photograph(name=photograph.name, pixels=np.ascontiguousarray(red)).linear()
    enlarged = np.repeat(np.repeat(subject, step, axis=0), step, axis=1)
    coverage = np.zeros(photograph.pixels.shape[:2], dtype=np.float32)
    coverage[part] = _without_specks(_local_coverage(linear, enlarged[part], unit), settings)
    return Foreground(camera=camera_name, coverage=coverage, contour_level=settings.contour_level, everything=False)


def _block_means(values: Float32[Array, "h w *channels"], step: int) -> Float32[Array, "H W *channels"]:
    """Means over blocks of step × step pixels; the last ones repeat the border."""
    pad = [(0, -values.shape[axis] % step) for axis in (0, 1)] + [(0, 0)] * (values.ndim - 2)
    values = np.pad(values, pad, mode="edge")
    shape = (values.shape[0] // step, step, values.shape[1] // step, step, *values.shape[2:])
    return values.reshape(shape).mean(axis=(1, 3), dtype=np.float32)


def _surroundings(
    subject: Bool[Array, "H W"], step: int, shape_hw: tuple[int, ...], margin: int
) -> tuple[slice, slice]:
    """Rows and columns, full size, of the blocks that hold the subject, and a margin."""
    found = [np.nonzero(subject.any(axis=axis))[0] for axis in (1, 0)]
    rows, columns = (
        slice(max(int(f[0]) * step - margin, 0), min((int(f[-1]) + 1) * step + margin, size))
        for f, size in zip(found, shape_hw, strict=True)
    )
    return rows, columns


def _from_mask(photograph: Photograph, camera_name: str, given: Bool[Array, "h w"]) -> Foreground:
    if given.shape != photograph.pixels.shape[:2] or not given.any():
        raise ImageError(
            photograph.name,
            found=f"a mask of {given.shape[1]} × {given.shape[0]} pixels with {np.count_nonzero(given)} of them set",
            expected=f"{photograph.size_wh[0]} × {photograph.size_wh[1]} pixels as in the photograph, some of them set",
            remedy="Draw the mask on the photograph itself, at its own size",
        )
    coverage = ndimage.gaussian_filter(given.astype(np.float32), 1.0, mode="nearest")
    return Foreground(camera=camera_name, coverage=coverage, contour_level=0.5, everything=False)


def _segment(
    encoded: Float32[Array, "h w *channels"], unit: float, settings: ForegroundSettings, name: str
) -> Bool[Array, "h w"]:
    """Subject by hysteresis: brighter than Otsu's threshold, or brighter than all backdrop and joined to such."""
    red = encoded if encoded.ndim == 2 else encoded[..., _RED]
    red = ndimage.gaussian_filter(red, 0.7 * unit, mode="nearest")
    threshold = _otsu(red)
    core = _large_parts(red > threshold, settings.smallest_part)
    contrast = float(red[core].mean() / max(float(red[~core].mean()), 1e-6)) if core.any() and not core.all() else 0.0
    if not 0.002 < core.mean() < 0.98 or contrast < 1.5:
        raise MatchingError(
            name,
            found=f"no subject: the brighter part is {100 * core.mean():.1f} % of the picture and "
            f"{contrast:.1f} times as bright as the rest",
            expected="a pale subject before a darker background",
            remedy="Give a mask for this photograph, or set matching.foreground.mode to all",
        )
    coloured = _coloured_like(encoded, core, unit)
    subject = core
    for _ in range(_GROWTH_ROUNDS):
        # Backdrop well away from what is subject so far and of another colour: a shaded flank must not raise the level.
        backdrop = ~ndimage.binary_dilation(subject, iterations=round(8 * unit)) & ~coloured
        if backdrop.mean() < 0.002:
            break
        level = min(threshold, settings.background_margin * float(np.quantile(red[backdrop], 0.999)))
        grown = ndimage.binary_propagation(core, mask=core | ((red > level) & (coloured | ~coloured.any())))
        if np.count_nonzero(grown) == np.count_nonzero(subject):
            break
        subject = grown
    filled: Bool[Array, "h w"] = ndimage.binary_fill_holes(subject)
    return filled


def _coloured_like(
    encoded: Float32[Array, "h w *channels"], core: Bool[Array, "h w"], unit: float
) -> Bool[Array, "h w"]:
    """Pixels whose hue is nearer to the core's than to the backdrop's; none where the two hues are alike."""
    nowhere = np.zeros(core.shape, dtype=bool)
    if encoded.ndim == 2:
        return nowhere
    total = ndimage.gaussian_filter(encoded.sum(axis=2), 2 * unit, mode="nearest")
    share = ndimage.gaussian_filter(encoded[..., _RED], 2 * unit, mode="nearest") / np.maximum(total, 1e-3)
    subject, backdrop = np.median(share[core]), np.median(share[~core])
    return share > (subject + backdrop) / 2 if subject - backdrop > _DISTINCT_HUE else nowhere


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


def _large_parts(mask: Bool[Array, "h w"], smallest: float) -> Bool[Array, "h w"]:
    """The connected parts not smaller than the given share of the largest."""
    labels, count = ndimage.label(mask)
    if count == 0:
        return mask
    sizes = np.bincount(labels.ravel())
    sizes[0] = 0
    keep: Bool[Array, "h w"] = (sizes >= max(smallest * sizes.max(), 1))[labels]
    return keep


def _local_coverage(red: Float32[Array, "h w"], subject: Bool[Array, "h w"], unit: float) -> Float32[Array, "h w"]:
    """(I − backdrop) / (subject − backdrop) in linear light, both averaged beside the contour; 0…1."""
    inside = ndimage.distance_transform_edt(subject).astype(np.float32)
    # Beyond the picture's frame the subject goes on: no contour along the frame.
    outside = ndimage.distance_transform_edt(~subject).astype(np.float32)
    guard, feather = _GUARD_PX * unit, _FEATHER_PX * unit
    bright = _beside(red, (inside > guard) & (inside < 4 * guard), unit)
    dark = _beside(red, (outside > guard) & (outside < 4 * guard), unit)
    smooth = ndimage.gaussian_filter(red, 0.5 * unit, mode="nearest")
    share = (smooth - dark) / np.maximum(bright - dark, 1e-4)
    surely = np.clip((inside - 0.5 * guard) / feather, 0, 1)
    hardly = np.clip((outside - 0.5 * guard) / feather, 0, 1)
    return np.clip(np.maximum(np.minimum(share, 1 - hardly), surely), 0, 1).astype(np.float32)


def _beside(values: Float32[Array, "h w"], where: Bool[Array, "h w"], unit: float) -> Float32[Array, "h w"]:
    """Average of the chosen pixels around each pixel, wider where there are none near; smooth, so computed coarsely."""
    step = round(_COARSE_STEP * unit)
    share = _block_means(where.astype(np.float32), step)
    total = _block_means(np.where(where, values, np.float32(0)), step)
    mean = np.full(share.shape, values[where].mean() if where.any() else 0.0, dtype=np.float32)
    for widening in (8.0, 2.0, 1.0):
        sigma = _NEIGHBOURHOOD_PX * unit * widening / step
        weight = ndimage.gaussian_filter(share, sigma, mode="constant", truncate=3)
        around = ndimage.gaussian_filter(total, sigma, mode="constant", truncate=3)
        enough = weight > 0.02
        mean[enough] = around[enough] / weight[enough]
    # Bilinear between the blocks' centres.
    rows, columns = ((np.arange(size) + 0.5) / step - 0.5 for size in values.shape)
    return _interpolate(_interpolate(mean, rows).T, columns).T


def _interpolate(values: Float32[Array, "h w"], positions: Float64[Array, " n"]) -> Float32[Array, "n w"]:
    """Rows of an image at fractional positions, linear, held at the borders."""
    positions = np.clip(positions, 0, values.shape[0] - 1)
    low = np.minimum(positions.astype(np.int64), max(values.shape[0] - 2, 0))
    high = np.minimum(low + 1, values.shape[0] - 1)
    fraction = (positions - low).astype(np.float32)[:, None]
    return (1 - fraction) * values[low] + fraction * values[high]


def _without_specks(coverage: Float32[Array, "h w"], settings: ForegroundSettings) -> Float32[Array, "h w"]:
    """Coverage with small parts removed and holes filled, so that the contour is the subject's outline alone."""
    mask = coverage >= settings.contour_level
    whole = ndimage.binary_fill_holes(_large_parts(mask, settings.smallest_part))
    near = ndimage.binary_dilation(whole, iterations=3)
    coverage = np.where(near, coverage, 0)
    return np.where(whole & ~mask, np.float32(1.0), coverage).astype(np.float32)
