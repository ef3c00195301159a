"""Pictures of the matching: silhouettes, rectified pairs, disparities, confidence."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from mammometry.base.photograph import Photograph
from mammometry.geometry import Array, Camera, Float32, UInt8
from mammometry.matching.dense.match import DisparityMap
from mammometry.report.figures import canvas
from mammometry.report.figures.canvas import PanelSheet
from mammometry.report.figures.catalogue import preview
from mammometry.report.figures.stage_results import MatchingResult
from mammometry.report.figures.thinning import source_grid

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_PANEL_PX = 290  # width of a panel, px; appearance only
_MAP_PX = 640  # longer side of a map, px: more than its panel shows
_EPIPOLAR_LINES = 9  # number of lines in each picture; appearance only


@preview("foreground", stage="match", place=1, photographs=True)
def foreground(result: MatchingResult) -> bytes:
    """Each photograph with the subject's silhouette."""
    from skimage.measure import find_contours

    foregrounds = result.foregrounds
    shapes = [known.coverage.shape for known in foregrounds.values()]
    columns, rows = canvas.grid(len(foregrounds))
    sheet = PanelSheet(columns, rows, canvas.fitting(shapes, _PANEL_PX))
    for index, (camera, known) in enumerate(foregrounds.items()):
        height, width = known.coverage.shape
        axes = sheet.panel(index, camera)
        axes.imshow(
            canvas.reduced(result.photographs[camera], _PANEL_PX),
            extent=canvas.pixel_extent((width, height)),
            interpolation="antialiased",
        )
        if known.everything:
            canvas.note(axes, "no silhouette: every pixel counts")
            continue
        padded = np.pad(known.coverage, 1)
        for line in find_contours(padded, known.contour_level):  # type: ignore[no-untyped-call]
            axes.plot(line[:, 1] - 1, line[:, 0] - 1, color=canvas.ORANGE, linewidth=1.1)
        axes.set(xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5))
        canvas.note(axes, f"subject {100 * float(known.mask.mean()):.0f} % of the picture")
    return sheet.png("Foreground", "The subject's silhouette in each photograph. Only its inside is matched.")


@preview("rectified", stage="match", place=2, photographs=True, on_paper=True)
def rectified(result: MatchingResult) -> bytes:
    """Both matched pictures of each pair, with lines of corresponding points."""
    rig, disparities = result.rig, result.disparities
    columns, rows = canvas.grid(2 * len(disparities))
    panel = canvas.fitting([disparity.valid.shape for disparity in disparities.values()], _PANEL_PX)
    sheet = PanelSheet(columns, rows, panel)
    for number, (pair, disparity) in enumerate(disparities.items()):
        for side, (name, ideal) in enumerate(zip(rig.pair_names[pair], (disparity.left, disparity.right), strict=True)):
            axes = sheet.panel(2 * number + side, f"{pair}: {name}")
            picture = resampled(result.photographs[name], rig.cameras[name], ideal, 2 * _PANEL_PX)
            axes.imshow(picture, extent=canvas.pixel_extent(ideal.size_wh), interpolation="antialiased")
            height = ideal.size_wh[1]
            for line, row in enumerate(np.linspace(0, height - 1, _EPIPOLAR_LINES + 2)[1:-1]):
                axes.axhline(row, color=(canvas.SKY, canvas.YELLOW)[line % 2], linewidth=0.7)
    return sheet.png(
        "Rectified pairs",
        "The pictures as matched. With a correct calibration, points on a line in the left picture are on the "
        "same line in the right one.",
    )


@preview("disparity", stage="match", place=3, photographs=False, on_paper=True)
def disparity(result: MatchingResult) -> bytes:
    """Disparities of each pair, and the matched share of the silhouette."""
    disparities, shares = result.disparities, result.shares
    vertical = np.concatenate([np.abs(one_map.d_v_px[one_map.valid]).ravel() for one_map in disparities.values()])
    limit = max(float(np.quantile(vertical, 0.98)) if len(vertical) else 0.0, 0.05)
    return _two_maps(
        disparities,
        (lambda one_map: one_map.d_h_px, "d_H, px", "cividis", None),
        (lambda one_map: one_map.d_v_px, "d_V, px", "PuOr", (-limit, limit)),
        ("d_H", "d_V"),
        (
            lambda one_map: (
                f"matched {100 * shares[one_map.name]:.0f} % of the left silhouette"
                if one_map.name in shares
                else "no silhouette: everything was matched"
            ),
            lambda one_map: f"RMS {_rms(one_map.d_v_px[one_map.valid]):.3f} px",
        ),
        "Disparity",
        "Horizontal disparity d_H = u_left − u_right, which gives the depth, and vertical disparity d_V, "
        "which is near zero if the calibration is correct. Pale blue: no match.",
    )


@preview("confidence", stage="match", place=4, photographs=False)
def confidence(result: MatchingResult) -> bytes:
    """Correlation and expected standard deviation of each pair."""
    disparities = result.disparities
    sigma = np.concatenate([one_map.sigma_px[one_map.valid].ravel() for one_map in disparities.values()])
    high = max(float(np.quantile(sigma, 0.98)) if len(sigma) else 0.0, 0.01)
    return _two_maps(
        disparities,
        (lambda one_map: one_map.confidence, "correlation c", "viridis", (0.0, 1.0)),
        (lambda one_map: one_map.sigma_px, "σ of d_H, px", "magma_r", (0.0, high)),
        ("confidence", "expected error"),
        (
            lambda one_map: f"median {_median(one_map.confidence[one_map.valid]):.2f}",
            lambda one_map: f"median {_median(one_map.sigma_px[one_map.valid]):.3f} px",
        ),
        "Confidence",
        "Correlation of the matched windows (1: the same picture) and the standard deviation of d_H that "
        "follows from noise and texture. Pale blue: no match.",
    )


def _two_maps(
    disparities: Mapping[str, DisparityMap],
    upper: tuple[Callable[[DisparityMap], Float32[Array, "h w"]], str, str, tuple[float, float] | None],
    lower: tuple[Callable[[DisparityMap], Float32[Array, "h w"]], str, str, tuple[float, float] | None],
    names: tuple[str, str],
    remarks: tuple[Callable[[DisparityMap], str], Callable[[DisparityMap], str]],
    title: str,
    text: str,
) -> bytes:
    columns, bands = canvas.grid(len(disparities))
    sheet = PanelSheet(
        columns, 2 * bands, canvas.fitting([one_map.valid.shape for one_map in disparities.values()], 260), bars=True
    )
    for half, (values_of, label, colours, limits) in enumerate((upper, lower)):
        if limits is None:
            seen = np.concatenate([values_of(one_map)[one_map.valid] for one_map in disparities.values()])
            limits = canvas.robust_range(seen, 0.002)
        drawn: Any = None
        for index, (pair, one_map) in enumerate(disparities.items()):
            band, column = divmod(index, columns)
            axes = sheet.panel((2 * band + half) * columns + column, f"{pair}: {names[half]}")
            drawn = _map(axes, one_map, values_of(one_map), colours, limits)
            canvas.note(axes, remarks[half](one_map))
        for band in range(bands):
            sheet.bar(2 * band + half, drawn, label)
    return sheet.png(title, text)


def _map(
    axes: Axes, one_map: DisparityMap, values: Float32[Array, "h w"], colours: str, limits: tuple[float, float]
) -> Any:
    small = canvas.with_gaps(canvas.thinned(values, _MAP_PX), canvas.thinned(one_map.valid, _MAP_PX))
    height, width = one_map.valid.shape
    return axes.imshow(
        small,
        extent=canvas.pixel_extent((width, height)),
        cmap=canvas.colour_map(colours),
        vmin=limits[0],
        vmax=limits[1],
        interpolation="nearest",
    )


def resampled(photograph: Photograph, camera: Camera, ideal: Camera, longest_px: int) -> UInt8[Array, "h w 3"]:
    """A photograph as an ideal camera sees it, at preview resolution. White outside the photograph."""
    from scipy import ndimage

    _, _, source = source_grid(camera, ideal, longest_px)
    step = max(1.0, max(ideal.size_wh) / longest_px)
    small = canvas.reduced(photograph, max(1, round(camera.size_wh[0] / step)))
    factor = camera.size_wh[0] / small.shape[1]
    at = [(source[..., axis] + 0.5) / factor - 0.5 for axis in (1, 0)]
    channels = [ndimage.map_coordinates(small[..., k], at, order=1, mode="constant", cval=255) for k in range(3)]
    return np.stack(channels, axis=-1)


def _rms(values: Float32[Array, " n"]) -> float:
    return float(np.sqrt(np.mean(values.astype(np.float64) ** 2))) if len(values) else 0.0


def _median(values: Float32[Array, " n"]) -> float:
    return float(np.median(values)) if len(values) else 0.0
