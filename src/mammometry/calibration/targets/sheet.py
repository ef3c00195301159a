"""A calibration board to print: a PDF at true scale, with a ruler to check that the printer kept it."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING

import numpy as np

from mammometry.base.errors import SettingsError
from mammometry.calibration.targets.pattern import dark_rectangles
from mammometry.calibration.targets.target import (
    CharucoTarget,
    ChessboardTarget,
    CirclesTarget,
    DottedCylinderTarget,
    Target,
)
from mammometry.geometry.arrays import Array, Float64

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.path import Path

PAGES_MM = {
    "A4": (210.0, 297.0),
    "A3": (297.0, 420.0),
    "A2": (420.0, 594.0),
    "A1": (594.0, 841.0),
    "A0": (841.0, 1189.0),
    "letter": (215.9, 279.4),
    "tabloid": (279.4, 431.8),
}
"""Pages by name: width and height upright, mm."""

_RULER_MM = 100.0
_FOOT_MM = 16.0
_SEAM_MM = 4.0
_MM_PER_INCH = 25.4


def target_pdf(target: Target, *, page: str = "fit", margin_mm: float = 10.0) -> bytes:
    """Draw a board at true scale; returns the PDF file's content.

    Args:
        target: a ChArUco board, a chessboard, a board of circles, or the sheet to wrap round a dotted cylinder.
        page: a name of `PAGES_MM`, turned sideways where that fits better, or ``fit`` for a page of the board's size
            and its margins.
        margin_mm: white around the board; detectors need it, printers cannot print to the edge.

    Raises:
        SettingsError: the page is unknown, the board does not fit on it, or the target is none to be printed.
        SessionError: no marker dictionary of the target's name.
    """
    width_mm, height_mm = _extent(target)
    needed_mm = (max(width_mm, _RULER_MM) + 2 * margin_mm, height_mm + 2 * margin_mm + _FOOT_MM)
    page_mm = _page(page, needed_mm)
    left_mm, top_mm = (page_mm[0] - width_mm) / 2, (page_mm[1] - _FOOT_MM - height_mm) / 2
    return _draw(target, page_mm, (left_mm, top_mm), margin_mm)


def _extent(target: Target) -> tuple[float, float]:
    match target:
        case CharucoTarget() | ChessboardTarget():
            return target.squares[0] * target.square_mm, target.squares[1] * target.square_mm
        case CirclesTarget():
            reach = target.points_target[:, :2].max(axis=0) + target.diameter_mm
            return float(reach[0]), float(reach[1])
        case DottedCylinderTarget():
            rows, columns = target.dots
            return columns * target.column_pitch_mm, (rows + 1.5) * target.row_pitch_mm
        case _:
            raise SettingsError(
                "target",
                found=f"a target of kind {target.kind!r}",
                expected="'charuco', 'chessboard', 'circles' or 'dotted-cylinder'",
                remedy="An object with surveyed points has to be made and measured",
            )


def _page(page: str, needed_mm: tuple[float, float]) -> tuple[float, float]:
    if page == "fit":
        return needed_mm
    upright = {name.lower(): size_mm for name, size_mm in PAGES_MM.items()}.get(page.lower())
    if upright is None:
        raise SettingsError(
            "page", found=repr(page), expected=f"'fit', {', '.join(PAGES_MM)}", remedy="Choose one of these"
        )
    for size_mm in (upright, upright[::-1]):
        if needed_mm[0] <= size_mm[0] and needed_mm[1] <= size_mm[1]:
            return size_mm
    raise SettingsError(
        f"page {page}",
        found=f"{upright[0]:g} × {upright[1]:g} mm",
        expected=f"at least {needed_mm[0]:g} × {needed_mm[1]:g} mm for this board and its margins",
        remedy="Choose a larger page, or 'fit', or smaller squares",
    )


def _draw(target: Target, page_mm: tuple[float, float], corner_mm: tuple[float, float], margin_mm: float) -> bytes:
    import matplotlib
    from matplotlib.backends.backend_pdf import FigureCanvasPdf
    from matplotlib.figure import Figure
    from matplotlib.patches import PathPatch

    with matplotlib.rc_context({"pdf.fonttype": 42, "pdf.compression": 0}):
        figure = Figure(figsize=(page_mm[0] / _MM_PER_INCH, page_mm[1] / _MM_PER_INCH), frameon=False)
        FigureCanvasPdf(figure)
        axes = figure.add_axes((0.0, 0.0, 1.0, 1.0), xlim=(0.0, page_mm[0]), ylim=(page_mm[1], 0.0))
        axes.set_axis_off()
        axes.add_patch(PathPatch(_outline(target, corner_mm), facecolor="black", edgecolor="none", linewidth=0))
        foot_mm = page_mm[1] - margin_mm
        if isinstance(target, DottedCylinderTarget):
            _seams(axes, target, corner_mm)
        _ruler(axes, (page_mm[0] - _RULER_MM) / 2, foot_mm)
        axes.text(page_mm[0] / 2, foot_mm - 8.0, _caption(target), ha="center", va="bottom", fontsize=6)
        content = io.BytesIO()
        figure.savefig(content, format="pdf", metadata={"Title": _caption(target), "CreationDate": None})
    return content.getvalue()


def _outline(target: Target, corner_mm: tuple[float, float]) -> Path:
    """All dark shapes in one path, so that viewers draw no hairlines where two of them meet."""
    from matplotlib.path import Path

    corner = np.asarray(corner_mm)
    if isinstance(target, CirclesTarget):
        radius = target.diameter_mm / 2
        centres = target.points_target[:, :2] + corner + radius
        return Path.make_compound_path(*(Path.circle((float(x), float(y)), radius) for x, y in centres))
    if not isinstance(target, CharucoTarget | ChessboardTarget | DottedCylinderTarget):
        raise ValueError(f"a target of kind {target.kind!r} has no printed shapes")
    return Path.make_compound_path(*(_rectangle(box, corner) for box in dark_rectangles(target)))


def _rectangle(box: Float64[Array, 4], corner: Float64[Array, 2]) -> Path:
    from matplotlib.path import Path

    x, y, width, height = box
    vertices = np.array([(x, y), (x + width, y), (x + width, y + height), (x, y + height), (x, y)]) + corner
    return Path(vertices, [Path.MOVETO, Path.LINETO, Path.LINETO, Path.LINETO, Path.CLOSEPOLY])


def _ruler(axes: Axes, left_mm: float, foot_mm: float) -> None:
    axes.plot([left_mm, left_mm + _RULER_MM], [foot_mm - 4.0] * 2, color="black", linewidth=0.4, solid_capstyle="butt")
    for tick in np.linspace(0.0, _RULER_MM, 11).tolist():
        length = 3.0 if tick in (0.0, 50.0, 100.0) else 1.5
        axes.plot([left_mm + tick] * 2, [foot_mm - 4.0, foot_mm - 4.0 - length], color="black", linewidth=0.2)
    text = f"{_RULER_MM:g} mm — measure it: print at 100 %, and enter the sizes that you measure"
    axes.text(left_mm + _RULER_MM / 2, foot_mm - 3.0, text, ha="center", va="top", fontsize=6)


def _seams(axes: Axes, target: DottedCylinderTarget, corner_mm: tuple[float, float]) -> None:
    """Where to cut: left and right edge of the sheet; they meet where the columns go all the way round."""
    width_mm, height_mm = _extent(target)
    for x in (corner_mm[0], corner_mm[0] + width_mm):
        for y in (corner_mm[1], corner_mm[1] + height_mm - _SEAM_MM):
            axes.plot([x, x], [y, y + _SEAM_MM], color="black", linewidth=0.1)


def _caption(target: Target) -> str:
    match target:
        case CharucoTarget():
            columns, rows = target.squares
            return (
                f"charuco, {columns} × {rows} squares of {target.square_mm:g} mm, "
                f"markers of {target.marker_mm:g} mm, {target.dictionary}"
            )
        case ChessboardTarget():
            return f"chessboard, {target.squares[0]} × {target.squares[1]} squares of {target.square_mm:g} mm"
        case CirclesTarget():
            kind = "staggered " if target.asymmetric else ""
            grid = f"{target.grid[0]} × {target.grid[1]}"
            return f"circles, {kind}{grid}, pitch {target.pitch_mm:g} mm, diameter {target.diameter_mm:g} mm"
        case DottedCylinderTarget():
            rows, columns = target.dots
            return (
                f"dotted cylinder, {rows} rows every {target.row_pitch_mm:g} mm, {columns} columns every "
                f"{target.column_pitch_mm:g} mm; labels up, round a radius of {target.radius_mm:g} mm over the paper"
            )
        case _:
            return target.kind
