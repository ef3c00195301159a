"""The paper's Fig. 5: one range image, many decompositions."""

from __future__ import annotations

import numpy as np

from mammometry.geometry.arrays import Array, Bool, Float64, UInt8
from mammometry.report.figures.drawing import canvas
from mammometry.report.figures.drawing.canvas import Sheet
from mammometry.surface.ranges.dents import DentGrid
from mammometry.surface.ranges.visibility import Label

_PANEL_PX = 210  # width of a panel, px; chosen by eye
_GREYS = {Label.BEHIND: 0.95, Label.OUTSIDE: 0.78, Label.IN_FRONT: 0.60, Label.OVERLAPPING: 0.38}
_MEANINGS = {
    Label.BEHIND: "behind (visible)",
    Label.OUTSIDE: "not seen by the other",
    Label.IN_FRONT: "in front (invisible)",
    Label.OVERLAPPING: "overlapping",
}


def draw_dent_grid(grid: DentGrid) -> Sheet:
    """Draw angle thresholds as rows and ε as columns (Fig. 5).

    Greys are the paper's. Removed data are black.
    """
    rows, columns = np.flatnonzero(grid.valid.any(axis=1)), np.flatnonzero(grid.valid.any(axis=0))
    window = (slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)) if len(rows) else (slice(None),) * 2
    shape = grid.valid[window].shape
    sheet = Sheet(len(grid.epsilons_mm), len(grid.angles_deg), canvas.fitting([shape], _PANEL_PX), header=26)
    entries = [(canvas.hexadecimal((grey,) * 3), _MEANINGS[label]) for label, grey in _GREYS.items()]
    sheet.legend([*entries, ("#000000", "removed"), (canvas.hexadecimal(canvas.MISSING), "no datum")])
    count = max(int(grid.valid.sum()), 1)
    for row, angle in enumerate(grid.angles_deg):
        for column, epsilon in enumerate(grid.epsilons_mm):
            axes = sheet.panel(row * len(grid.epsilons_mm) + column, f"{angle:g}°, ε = {epsilon:g} mm")
            kept = grid.kept[row, column]
            axes.imshow(
                _picture(grid.labels[column][window], grid.valid[window], kept[window]), interpolation="nearest"
            )
            canvas.note(axes, f"{100 * (1 - kept.sum() / count):.0f} % removed")
    return sheet


def _picture(
    labels: UInt8[Array, "h w"], valid: Bool[Array, "h w"], kept: Bool[Array, "h w"]
) -> Float64[Array, "h2 w2 3"]:
    labels, valid, kept = (canvas.thinned(array, 640) for array in (labels, valid, kept))
    grey = np.zeros(labels.shape)
    for label, value in _GREYS.items():
        grey[labels == label] = value
    grey[~kept] = 0.0
    return np.where(valid[..., None], grey[..., None], np.array(canvas.MISSING))
