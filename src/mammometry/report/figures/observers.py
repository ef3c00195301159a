"""Pictures of studies: curves by several people, Bland–Altman plots, two methods."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mammometry.geometry.arrays import Array
from mammometry.report.figures import canvas
from mammometry.report.figures.canvas import PanelSheet
from mammometry.report.figures.measure import curve
from mammometry.report.figures.shading import ShadedMesh, picture_wh, standard_views
from mammometry.report.figures.surface import show
from mammometry.study.agreement import Agreement, IntervalEstimate, PairedMeasurements
from mammometry.study.observers import WHOLE, Apart, DrawnSurface, ObservedCurve, ObserverStudy

_VIEW_PX = 380  # longer side of a view; appearance only
_PLOT = (560, 300)  # size of a plot, px; appearance only
_ROOM = (70, 46)  # space for its labels, px; appearance only
_LINE = 1.0  # width of a curve, points; appearance only
_BAR = 0.38  # width of a bar, relative to the space of a region


def curves_on(surface: DrawnSurface, observers: Sequence[str]) -> bytes:
    """All curves on a surface, in one colour per person."""
    views = [view for view in standard_views(surface.mesh, surface.frame, of_patient=True) if "below" not in view.name]
    sheet = PanelSheet(len(views), 1, picture_wh(views[0], _VIEW_PX), header=26)
    colours = _colours(observers)
    names = {name for name, _ in surface.curves}
    sheet.legend([(colours[name], name) for name in observers if name in names])
    scene = ShadedMesh(surface.mesh)
    for index, view in enumerate(views):
        axes = sheet.panel(index, view.name)
        show(axes, scene.render(view, size_px=_VIEW_PX), view)
        for name, points in surface.curves:
            curve(axes, scene, view, points, colours[name], size_px=_VIEW_PX, width=_LINE)
    return sheet.png(
        f"Drawings on {surface.name}",
        "Every curve drawn on this surface, one colour per person, dashed where hidden.",
    )


def volumes(drawings: Sequence[ObservedCurve], study: ObserverStudy) -> bytes:
    """Volume of each drawing, minus the mean of its breast."""
    sheet = PanelSheet(1, 1, _PLOT, axes_room=_ROOM, header=26)
    colours = _colours(study.observers)
    sheet.legend([(colours[name], name) for name in study.observers])
    axes = sheet.panel(0, plain=False)
    for place, breast in enumerate(study.breasts):
        own = [drawing for drawing in drawings if drawing.breast == breast]
        mean = float(np.mean([drawing.volume_cc for drawing in own]))
        for drawing in own:
            beside = (study.observers.index(drawing.observer) + 1) / (len(study.observers) + 1) - 0.5
            axes.plot(
                place + 0.6 * beside, drawing.volume_cc - mean, "o", color=colours[drawing.observer], markersize=5
            )
    for scatter, style in ((study.within, ":"), (study.between, "--")):
        if scatter is not None:
            for sign in (-1, 1):
                axes.axhline(sign * scatter.sem.value, color=canvas.FAINT, linewidth=1.0, linestyle=style)
    axes.axhline(0, color=canvas.FAINT, linewidth=0.8)
    axes.set(xlim=(-0.6, len(study.breasts) - 0.4), ylabel="volume less the breast's mean, cc")
    axes.set_xticks(range(len(study.breasts)), study.breasts)
    return sheet.png(
        "Volumes",
        "The volume of each drawing, minus the mean of all drawings of that breast. Dotted: plus and "
        "minus one standard error of measurement of one person who draws again. Dashed: of different people.",
    )


def regions(study: ObserverStudy) -> bytes:
    """Mean distance between curves by region."""
    sheet = PanelSheet(1, 1, _PLOT, axes_room=_ROOM, header=26)
    shown = [
        (apart, colour, words)
        for apart, colour, words in (
            (study.apart_within, canvas.SKY, "two curves of one person"),
            (study.apart_between, canvas.BLUE, "curves of two persons"),
        )
        if apart
    ]
    sheet.legend([(colour, words) for _, colour, words in shown])
    axes = sheet.panel(0, plain=False)
    names = tuple(dict.fromkeys(region for apart, _, _ in shown for region in apart))
    for number, (apart, colour, _) in enumerate(shown):
        at = np.arange(len(names)) + _BAR * (number - (len(shown) - 1) / 2)
        means = [_of(apart.get(name), "mean_mm") for name in names]
        highest = [_of(apart.get(name), "q95_mm") for name in names]
        axes.bar(at, means, _BAR, color=colour)
        axes.vlines(at, means, highest, color=canvas.INK, linewidth=1.0)
    axes.set_xticks(np.arange(len(names)), names)
    axes.set(ylabel="distance between two curves, mm")
    return sheet.png(
        "Where the curves differ",
        "Distance from one curve to another of the same breast: its mean by region, and the thin line up to "
        f"what 95 % are less than. The last is the {WHOLE}.",
    )


def _of(apart: Apart | None, name: str) -> float:
    return float("nan") if apart is None else float(getattr(apart, name))


def _colours(observers: Sequence[str]) -> dict[str, str]:
    return {name: canvas.CYCLE[number % len(canvas.CYCLE)] for number, name in enumerate(observers)}


_PANEL = (560, 360)  # size of the plot, px; appearance only


def bland_altman(data: PairedMeasurements, figures: Agreement) -> bytes:
    """Bland–Altman plot: differences against means.

    It shows the bias, the limits of agreement, their 95 % intervals, and the proportional bias.
    """
    sheet = PanelSheet(1, 1, _PANEL, axes_room=_ROOM, header=26)
    sheet.legend(
        [(canvas.BLUE, "bias"), (canvas.VERMILION, "limits of agreement"), (canvas.GREEN, "proportional bias")]
    )
    axes = sheet.panel(0, plain=False)
    low, high = _stretched(data.means, 0.04)
    levels: tuple[tuple[IntervalEstimate, str, str], ...] = (
        (figures.mean_difference, canvas.BLUE, "bias"),
        (figures.lower_limit, canvas.VERMILION, "−1.96 SD"),
        (figures.upper_limit, canvas.VERMILION, "+1.96 SD"),
    )
    for estimate, colour, _ in levels:
        axes.axhspan(*estimate.interval, color=colour, alpha=0.12, linewidth=0)
        axes.axhline(estimate.value, color=colour, linewidth=1.3)
    axes.axhline(0, color=canvas.FAINT, linewidth=0.8, linestyle=":")
    ends = np.array([low, high])
    trend = figures.trend
    if np.isfinite(trend.slope.value):
        axes.plot(ends, trend.intercept + trend.slope.value * ends, color=canvas.GREEN, linewidth=1.3, linestyle="--")
    axes.plot(data.means, data.differences, "o", color=canvas.INK, markersize=5)
    unit = f", {data.unit}" if data.unit else ""
    shown = [data.differences, *(np.array(estimate.interval) for estimate, _, _ in levels)]
    axes.set(
        xlim=(low, high),
        ylim=_stretched(np.concatenate(shown), 0.06),
        xlabel=f"mean of {data.reference_name} and {data.measured_name}{unit}",
        ylabel=f"{data.measured_name} − {data.reference_name}{unit}",
    )
    for estimate, colour, text in levels:
        label = f"{text} {estimate.value:+.2f} ".replace("-", "−")
        outline = canvas.stroke("white", 2.5)
        axes.text(high, estimate.value, label, color=colour, ha="right", va="bottom", fontsize=8, path_effects=outline)
    return sheet.png(
        "Bland–Altman plot",
        "Difference of the two methods over their mean. Lines: the mean difference (bias) and the limits "
        "between which 95 % of differences are expected. Bands: their 95 % confidence intervals. Dashed: "
        "regression of the differences on the means.",
    )


def scatter(data: PairedMeasurements) -> bytes:
    """One method against the other, with the line of identity."""
    sheet = PanelSheet(1, 1, (400, 400), axes_room=_ROOM, header=26)
    sheet.legend([(canvas.FAINT, "equality"), (canvas.BLUE, "pairs")])
    axes = sheet.panel(0, plain=False)
    limits = _stretched(np.concatenate([data.reference, data.measured]), 0.05)
    axes.plot(limits, limits, color=canvas.FAINT, linewidth=1.0)
    axes.plot(data.reference, data.measured, "o", color=canvas.BLUE, markersize=5)
    unit = f", {data.unit}" if data.unit else ""
    axes.set(
        xlim=limits,
        ylim=limits,
        aspect="equal",
        xlabel=f"{data.reference_name}{unit}",
        ylabel=f"{data.measured_name}{unit}",
    )
    return sheet.png(
        "One method against the other", "One point per pair of measurements. On the line both methods give the same."
    )


def _stretched(values: Array, share: float) -> tuple[float, float]:
    """Range of the values with some space at both ends. Its ends are never equal."""
    low, high = float(values.min()), float(values.max())
    room = share * (high - low) or max(abs(high), 1.0) * share
    return low - room, high + room
