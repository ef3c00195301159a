"""A calibration target as a PDF at true scale, with a ruler to test the printer's scale."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from mammometry.base.errors import SettingsError
from mammometry.calibration.targets.card_field import field_sheet
from mammometry.calibration.targets.sheet import PrintedSheet
from mammometry.calibration.targets.target import Target
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

Corner: TypeAlias = tuple[float, float]

_RULER_MM = 100.0
"""Length at which a school ruler shows a scale error of half a percent."""
_FOOT_MM = 16.0
"""Height of ruler and caption below the board, for 6-point text."""
_CAPTION_UP_MM = 8.0
"""Height of the caption above the lower margin, clear of the ruler's ticks."""
_CUT_MM = 4.0
"""Length of a cutting mark."""
_CARD_GAP_MM, _CARD_LINE_MM, _CARD_CORNER_MM, _CARD_TEXT_MM = 2.5, 12.0, 6.0, 9.0
"""Field for a card: distance of its lines from the card's edges, which are measured up to 2 mm outside; length of the
lines beside the card and below it; height of the text above the lower edge, where the card covers it."""
_FONT_POINTS = 6
"""Size of the text."""
_TRUETYPE = 42
"""matplotlib's number for embedded TrueType fonts."""
_LEAST_SPECKLED_MM = (150.0, 200.0)  # smallest page of speckles: half of A4
_MANY_DISCS = 1000  # number of discs above which a page is compressed: speckles take several MB
_SPECKLE_PITCH = 1.35  # distance of neighbouring speckles, in diameters: 40 % of the paper is dark
_SPECKLE_SHIFT, _SPECKLE_SIZE = 0.16, 0.25
"""Largest shift of a speckle, in pitches, and largest relative change of its diameter. None touch."""
_MM_PER_INCH = 25.4  # by definition; matplotlib sizes pages in inches


def target_pdf(target: Target, *, page: str = "fit", margin_mm: float = 10.0, card_field: bool = False) -> bytes:
    """Draw a board at true scale. Returns the content of a PDF file.

    Args:
        target: of any printed kind: a board, or the sheet to wrap around a dotted cylinder.
        page: a name of `PAGES_MM`, in landscape if that fits better, or ``fit`` for a page of the board's size plus
            margins.
        margin_mm: white border; detectors need it, and printers cannot print to the edge.
        card_field: whether to draw the telephone board's field for a bank card.

    Raises:
        SettingsError: the page is unknown, the board does not fit, or the target is not printed.
        SessionError: unknown marker dictionary.
    """
    sheet = target.sheet()
    width_mm, height_mm = (float(side) for side in sheet.extent_mm[1] - sheet.extent_mm[0])
    needed_mm = (max(width_mm, _RULER_MM) + 2 * margin_mm, height_mm + 2 * margin_mm + _FOOT_MM)
    page_mm = _page(page, needed_mm)
    left_mm, top_mm = (page_mm[0] - width_mm) / 2, (page_mm[1] - _FOOT_MM - height_mm) / 2
    field = field_sheet() if card_field else None
    return _draw(sheet, target.caption(), page_mm, (left_mm, top_mm), margin_mm, field)


def speckle_pdf(*, page: str = "A4", dot_mm: float = 1.5, margin_mm: float = 10.0, seed: int = 1) -> bytes:
    """Draw a page of speckles, which cameras without a projector can measure. Returns a PDF file.

    Args:
        page: a name of `PAGES_MM`, upright.
        dot_mm: mean diameter of a speckle: three to five pixels of the cameras.
        margin_mm: white border, which printers cannot print.
        seed: seed of their random positions.

    Raises:
        SettingsError: the page is unknown.
    """
    width_mm, height_mm = _page(page, _LEAST_SPECKLED_MM)
    sheet = speckles((width_mm - 2 * margin_mm, height_mm - 2 * margin_mm - _FOOT_MM), dot_mm, seed)
    caption = f"speckles of {dot_mm:g} mm on average, for a plane or a ball"
    return _draw(sheet, caption, (width_mm, height_mm), (margin_mm, margin_mm), margin_mm)


def speckles(size_mm: tuple[float, float], dot_mm: float, seed: int) -> PrintedSheet:
    """Discs at random positions that do not touch one another."""
    rng = np.random.default_rng(seed)
    pitch = _SPECKLE_PITCH * dot_mm
    columns, rows = (int(side / pitch) for side in size_mm)
    row, column = np.mgrid[:rows, :columns]
    places = np.stack([column + 0.5, row + 0.5], axis=-1).reshape(-1, 2)
    places += rng.uniform(-_SPECKLE_SHIFT, _SPECKLE_SHIFT, places.shape)
    largest = (1.0 - 2 * _SPECKLE_SHIFT) * pitch / 2
    radii = np.minimum(dot_mm / 2 * rng.uniform(1 - _SPECKLE_SIZE, 1 + _SPECKLE_SIZE, len(places)), largest)
    return PrintedSheet(
        extent_mm=np.array([[0.0, 0.0], [columns * pitch, rows * pitch]]),
        discs=np.column_stack([places * pitch, radii]),
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


def _draw(
    sheet: PrintedSheet,
    caption: str,
    page_mm: tuple[float, float],
    corner_mm: Corner,
    margin_mm: float,
    field: PrintedSheet | None = None,
) -> bytes:
    import matplotlib
    from matplotlib.backends.backend_pdf import FigureCanvasPdf
    from matplotlib.figure import Figure
    from matplotlib.patches import PathPatch

    packed = 6 if len(sheet.discs) > _MANY_DISCS else 0
    with matplotlib.rc_context({"pdf.fonttype": _TRUETYPE, "pdf.compression": packed}):
        figure = Figure(figsize=(page_mm[0] / _MM_PER_INCH, page_mm[1] / _MM_PER_INCH), frameon=False)
        FigureCanvasPdf(figure)
        axes = figure.add_axes((0.0, 0.0, 1.0, 1.0), xlim=(0.0, page_mm[0]), ylim=(page_mm[1], 0.0))
        axes.set_axis_off()
        # Not add_patch: it computes the extent of each curve, twelve seconds for a page of speckles.
        axes.add_artist(PathPatch(_outline(sheet, corner_mm), facecolor="black", edgecolor="none", linewidth=0))
        foot_mm = page_mm[1] - margin_mm
        if sheet.cut_at_sides:
            _cuts(axes, sheet, corner_mm)
        middle_mm = page_mm[0] / 2
        if field is not None:
            axes.add_artist(PathPatch(_field(field, corner_mm), facecolor="black", edgecolor="none", linewidth=0))
            _card_corners(axes, field, corner_mm)
            middle_mm = page_mm[0] - corner_mm[0] - _RULER_MM / 2  # next to the field
        _ruler(axes, middle_mm - _RULER_MM / 2, foot_mm)
        axes.text(middle_mm, foot_mm - _CAPTION_UP_MM, caption, ha="center", va="bottom", fontsize=_FONT_POINTS)
        content = io.BytesIO()
        figure.savefig(content, format="pdf", metadata={"Title": caption, "CreationDate": None})
    return content.getvalue()


def _outline(sheet: PrintedSheet, corner_mm: Corner) -> Path:
    """All dark shapes in one path. Otherwise viewers draw hairlines between adjacent shapes."""
    from matplotlib.path import Path

    shift = np.asarray(corner_mm) - sheet.extent_mm[0]
    return Path.make_compound_path(
        *(_rectangle(box, shift) for box in sheet.rectangles),
        *(Path.circle((float(x + shift[0]), float(y + shift[1])), float(radius)) for x, y, radius in sheet.discs),
    )


def _field(field: PrintedSheet, corner_mm: Corner) -> Path:
    """Bars of a field for a card, on the page."""
    from matplotlib.path import Path

    return Path.make_compound_path(*(_rectangle(box, np.array(corner_mm)) for box in field.rectangles))


def _card_corners(axes: Axes, field: PrintedSheet, corner_mm: Corner) -> None:
    """Draw lines next to the lower half of a card, outside it, and the field's caption."""
    (left, _), (right, bottom) = field.extent_mm + np.array(corner_mm)
    for x, side in ((left, -1.0), (right, 1.0)):
        outer = x + side * _CARD_GAP_MM
        axes.plot([outer] * 2, [bottom - _CARD_LINE_MM, bottom], color="black", linewidth=0.4)
        axes.plot([outer, outer - side * _CARD_CORNER_MM], [bottom + _CARD_GAP_MM] * 2, color="black", linewidth=0.4)
    text = "tape a bank card here, between the lines, flat: it gives the size of the print"
    axes.text((left + right) / 2, bottom - _CARD_TEXT_MM, text, ha="center", va="center", fontsize=_FONT_POINTS)


def _rectangle(box: Float64[Array, 4], shift: Float64[Array, 2]) -> Path:
    from matplotlib.path import Path

    x, y, width, height = box
    vertices = np.array([(x, y), (x + width, y), (x + width, y + height), (x, y + height), (x, y)]) + shift
    return Path(vertices, [Path.MOVETO, Path.LINETO, Path.LINETO, Path.LINETO, Path.CLOSEPOLY])


def _ruler(axes: Axes, left_mm: float, foot_mm: float) -> None:
    axes.plot([left_mm, left_mm + _RULER_MM], [foot_mm - 4.0] * 2, color="black", linewidth=0.4, solid_capstyle="butt")
    for tick in np.linspace(0.0, _RULER_MM, 11).tolist():
        length = 3.0 if tick in (0.0, 50.0, 100.0) else 1.5
        axes.plot([left_mm + tick] * 2, [foot_mm - 4.0, foot_mm - 4.0 - length], color="black", linewidth=0.2)
    text = f"{_RULER_MM:g} mm — measure it: print at 100 %, and enter the measured sizes"
    axes.text(left_mm + _RULER_MM / 2, foot_mm - 3.0, text, ha="center", va="top", fontsize=_FONT_POINTS)


def _cuts(axes: Axes, sheet: PrintedSheet, corner_mm: Corner) -> None:
    """Cutting marks at the left and right edge of the sheet, which meet if columns go all the way around."""
    width_mm, height_mm = sheet.extent_mm[1] - sheet.extent_mm[0]
    for x in (corner_mm[0], corner_mm[0] + width_mm):
        for y in (corner_mm[1], corner_mm[1] + height_mm - _CUT_MM):
            axes.plot([x, x], [y, y + _CUT_MM], color="black", linewidth=0.1)
