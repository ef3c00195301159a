"""Bland and Altman's plot, and one method against the other."""

from __future__ import annotations

import numpy as np

from mammometry.geometry.arrays import Array
from mammometry.report.figures.drawing import canvas
from mammometry.report.figures.drawing.canvas import Caption, Sheet
from mammometry.study.agreement import Agreement, Estimate, PairedMeasurements

_PANEL = (560, 360)  # size of the plot, px; chosen by eye
_ROOM = (70, 46)  # for the labels beside and below a plot, px; chosen by eye


def bland_altman(data: PairedMeasurements, found: Agreement) -> bytes:
    """Bland–Altman plot: differences over means.

    It shows bias, limits of agreement, their 95 % intervals and the proportional bias.
    """
    sheet = Sheet(1, 1, _PANEL, axes_room=_ROOM, header=26)
    sheet.legend(
        [(canvas.BLUE, "bias"), (canvas.VERMILION, "limits of agreement"), (canvas.GREEN, "proportional bias")]
    )
    axes = sheet.panel(0, plain=False)
    low, high = _stretched(data.means, 0.04)
    levels: tuple[tuple[Estimate, str, str], ...] = (
        (found.mean_difference, canvas.BLUE, "bias"),
        (found.lower_limit, canvas.VERMILION, "−1.96 SD"),
        (found.upper_limit, canvas.VERMILION, "+1.96 SD"),
    )
    for estimate, colour, _ in levels:
        axes.axhspan(*estimate.interval, color=colour, alpha=0.12, linewidth=0)
        axes.axhline(estimate.value, color=colour, linewidth=1.3)
    axes.axhline(0, color=canvas.FAINT, linewidth=0.8, linestyle=":")
    ends = np.array([low, high])
    trend = found.trend
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
        Caption(
            title="Bland–Altman plot",
            text="Difference of the two methods over their mean. Lines: the mean difference (bias) and the limits "
            "between which 95 % of differences are expected. Bands: their 95 % confidence intervals. Dashed: "
            "regression of the differences on the means.",
        )
    )


def scatter(data: PairedMeasurements) -> bytes:
    """One method against the other, with the line of equality."""
    sheet = Sheet(1, 1, (400, 400), axes_room=_ROOM, header=26)
    sheet.legend([(canvas.FAINT, "equality"), (canvas.BLUE, "subjects")])
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
        Caption(
            title="One method against the other", text="One point per subject. On the line both methods give the same."
        )
    )


def _stretched(values: Array, share: float) -> tuple[float, float]:
    """Range of the values with some room at either end. Never of zero width."""
    low, high = float(values.min()), float(values.max())
    room = share * (high - low) or max(abs(high), 1.0) * share
    return low - room, high + room
