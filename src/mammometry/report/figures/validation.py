"""Picture of a validation: volumes by all definitions against the reference."""

from __future__ import annotations

import numpy as np

from mammometry.report.figures import canvas
from mammometry.report.figures.canvas import PanelSheet
from mammometry.study.validation.study import ValidationStudy

_PANEL = (620, 420)  # size of the plot, px; the pages' width
_ROOM = (70, 46)  # space for its labels, px
_MARKS = ("o", "s", "^", "D", "v", "P", "X", "*")  # of the definitions, since colours alone do not suffice
_MARGIN = 0.06  # margin around the points, as a share of their range


def definitions_side_by_side(found: ValidationStudy) -> bytes:
    """Each definition's volumes against the reference, with the line of identity and Deming's lines."""
    shown = found.definitions[: len(_MARKS)]
    sheet = PanelSheet(1, 1, _PANEL, axes_room=_ROOM, header=26)
    colours = {one.definition: canvas.CYCLE[place % len(canvas.CYCLE)] for place, one in enumerate(shown)}
    sheet.legend([(canvas.FAINT, "equality"), *((colours[one.definition], one.definition) for one in shown)])
    axes = sheet.panel(0, plain=False)
    values = np.concatenate([array for one in shown for array in (one.data.reference, one.data.measured)])
    room = _MARGIN * float(np.ptp(values)) or 1.0
    ends = np.array([float(values.min()) - room, float(values.max()) + room])
    axes.plot(ends, ends, color=canvas.FAINT, linewidth=1.0)
    for mark, one in zip(_MARKS, shown, strict=False):
        colour = colours[one.definition]
        axes.plot(one.data.reference, one.data.measured, mark, color=colour, markersize=5)
        if np.isfinite(one.deming.slope.value):
            line = one.deming.intercept.value + one.deming.slope.value * ends
            axes.plot(ends, line, color=colour, linewidth=1.0, linestyle="--")
    axes.set(xlim=ends, ylim=ends, xlabel="truth, cc", ylabel="measured, cc")
    return sheet.png(
        "All definitions against the truth",
        "One mark per breast and definition of the volume. On the grey line the measured volume equals the truth. "
        "Dashed: Deming's lines.",
    )
