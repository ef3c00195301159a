"""Pictures of repeated captures: differences of two captures, components of variance."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from mammometry.report.figures import canvas
from mammometry.report.figures.canvas import PanelSheet
from mammometry.study.repeatability.design import SUBJECT, Reading
from mammometry.study.repeatability.study import RepeatabilityStudy

_PANEL = (620, 340)  # size of a plot, px; the pages' width
_ROOM = (70, 46)  # space for its labels, px
_NAMES_ROOM = 170  # space for the names of effects, px: the longest is "side × repositioning"
_ROW = 34  # height of an effect, px
_MOST_NAMES = 8  # most names in a legend; colours repeat after that


def capture_differences(readings: Sequence[Reading], found: RepeatabilityStudy) -> bytes:
    """Bland–Altman plot of each capture against the previous one."""
    pairs: list[tuple[str, float, float]] = []
    cells: dict[tuple[str, ...], list[Reading]] = {}
    for one in readings:
        cells.setdefault(one.cell, []).append(one)
    for own in cells.values():
        for first, second in itertools.pairwise(own):
            who = " ".join(filter(None, (one_of(second), second.device)))
            mean = (first.volume_cc + second.volume_cc) / 2
            pairs.append((who, mean, second.volume_cc - first.volume_cc))
    names = tuple(dict.fromkeys(who for who, *_ in pairs))
    sheet = PanelSheet(1, 1, _PANEL, axes_room=_ROOM, header=26)
    colours = {name: canvas.CYCLE[place % len(canvas.CYCLE)] for place, name in enumerate(names)}
    sheet.legend([*((colours[name], name) for name in names[:_MOST_NAMES] if name), (canvas.VERMILION, "± SDC")])
    axes = sheet.panel(0, plain=False)
    narrowest = found.repetitions[0]
    for sign in (-1, 1):
        bounds = sorted(sign * bound for bound in narrowest.detectable_cc.interval)
        axes.axhspan(*bounds, color=canvas.VERMILION, alpha=0.12, linewidth=0)
        axes.axhline(sign * narrowest.detectable_cc.value, color=canvas.VERMILION, linewidth=1.3)
    axes.axhline(0, color=canvas.FAINT, linewidth=0.8)
    for who, mean, difference in pairs:
        axes.plot(mean, difference, "o", color=colours[who], markersize=4)
    axes.set(xlabel="mean of two captures, cc", ylabel="capture less the one before, cc")
    return sheet.png(
        "Two captures of one breast",
        "Difference of each capture from the one before, over their mean; one colour per person and device. Lines: "
        "plus and minus the smallest detectable change, between which 95 % of differences are expected. Bands: "
        "its 95 % interval.",
    )


def one_of(reading: Reading) -> str:
    """Name of the person who captured or read."""
    return reading.rater or reading.reader


def variances(found: RepeatabilityStudy) -> bytes:
    """Standard deviation of each effect that contributes to the error, with its interval."""
    shown = [one for one in found.components if one.name not in SUBJECT]
    sheet = PanelSheet(1, 1, (_PANEL[0] - _NAMES_ROOM, max(_ROW * len(shown), 60)), axes_room=(_NAMES_ROOM, _ROOM[1]))
    axes = sheet.panel(0, plain=False)
    at = np.arange(len(shown))[::-1]
    axes.barh(at, [one.sd_cc.value for one in shown], 0.55, color=canvas.SKY)
    most = 3.0 * max((one.sd_cc.value for one in shown), default=1.0) or 1.0
    axes.hlines(at, [one.sd_cc.interval[0] for one in shown], [min(one.sd_cc.interval[1], most) for one in shown],
                color=canvas.INK, linewidth=1.2)  # fmt: skip
    axes.set_yticks(at, [one.name for one in shown])
    axes.set(xlim=(0, most), ylim=(-0.6, len(shown) - 0.4), xlabel="standard deviation, cc")
    return sheet.png(
        "What the scatter consists of",
        "Standard deviation of each effect, and its 95 % interval as a line, cut off at the right edge. Squares add "
        "up: an effect of half the size adds a quarter of the variance.",
    )
