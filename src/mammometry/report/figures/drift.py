"""Picture of a rig's drift: every check since it was calibrated."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from mammometry.report.figures.drawing import canvas
from mammometry.report.figures.drawing.canvas import Caption, Sheet

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from mammometry.io.drift import Entry

_COLOURS = {"unmoved": canvas.BLUE, "moved": canvas.ORANGE, "refuse": canvas.VERMILION}
_MOST_LABELS = 8  # checks whose dates fit below the plot


def drift(entries: Sequence[Entry], limit_mm: float) -> bytes:
    """Camera displacement in each check, and the resulting measurement errors.

    Args:
        entries: the history, the oldest first; at least one.
        limit_mm: displacement of measured points from which on the calibration must not be used.
    """
    cameras = list(dict.fromkeys(name for entry in entries for name in entry.cameras))
    colours = [*canvas.CYCLE] * (1 + len(cameras) // len(canvas.CYCLE))
    sheet = Sheet(2, 1, (430, 280), axes_room=(52, 52), header=26)
    sheet.legend(list(zip(colours, cameras, strict=False)))
    axes = sheet.panel(0, "Target displaced in each camera's picture", plain=False)
    for colour, name in zip(colours, cameras, strict=False):
        seen = [(i, entry.cameras[name]) for i, entry in enumerate(entries) if name in entry.cameras]
        axes.plot([i for i, _ in seen], [check.shift_px for _, check in seen], "-", color=colour, linewidth=1.1)
        for moved, marker in ((False, "o"), (True, "s")):
            chosen = [(i, check.shift_px) for i, check in seen if check.moved == moved]
            axes.plot(
                [i for i, _ in chosen],
                [px for _, px in chosen],
                marker,
                color=colour,
                markersize=7 if moved else 3.5,
                markeredgecolor=canvas.INK if moved else colour,
            )
    axes.set(ylabel="RMS, px", ylim=(0, None))
    _checks(axes, entries)
    axes = sheet.panel(1, "Measured points displaced, worst pair", plain=False)
    axes.bar(
        range(len(entries)),
        [entry.effect_mm for entry in entries],
        color=[_COLOURS.get(entry.verdict, canvas.GREY) for entry in entries],
        width=0.6,
    )
    axes.axhline(limit_mm, color=canvas.VERMILION, linewidth=1.2)
    canvas.note(axes, f"line: limit {limit_mm:g} mm")
    axes.set(ylabel="RMS, mm", ylim=(0, 1.15 * max(limit_mm, *(entry.effect_mm for entry in entries))))
    _checks(axes, entries)
    return sheet.png(
        Caption(
            title="Drift of the rig",
            text="Every check of the rig against its calibration. Left: how far the target lies in each camera's "
            "picture from where the cameras that did not move see it (squares: cameras that moved). Right: the error "
            "of points that the worst pair measures. Dashed lines: new calibrations.",
        )
    )


def _checks(axes: Axes, entries: Sequence[Entry]) -> None:
    """An axis of checks by date, with lines at new calibrations."""
    every = max(1, -(-len(entries) // _MOST_LABELS))
    shown = range(0, len(entries), every)
    axes.set_xticks(list(shown), [entries[i].when[:10] for i in shown], rotation=25, ha="right")
    axes.set(xlim=(-0.6, len(entries) - 0.4))
    axes.grid(False, axis="x")
    for i in range(1, len(entries)):
        if entries[i].calibration != entries[i - 1].calibration:
            axes.axvline(i - 0.5, color=canvas.GREY, linewidth=1.0, linestyle="--")
