"""Sheet of panels laid out in pixels, and written as a PNG with a caption. Texts cannot overlap."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from PIL import Image

from mammometry.base.photograph import Photograph
from mammometry.geometry.arrays import Array, Bool, Float32, Float64, UInt8

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

INK = "#1d2530"
FAINT = "#6b7683"
MISSING = (0.86, 0.90, 0.95)
"""Colour of missing data in maps: pale blue, which no map uses for values."""
BLUE, ORANGE, GREEN, VERMILION, PURPLE, SKY, YELLOW, GREY = (
    "#0072b2",
    "#e69f00",
    "#009e73",
    "#d55e00",
    "#cc79a7",
    "#56b4e9",
    "#f0e442",
    "#9aa3ad",
)
"""Okabe and Ito's colours, which people with the common kinds of colour blindness can distinguish."""
CYCLE = (BLUE, ORANGE, GREEN, PURPLE, VERMILION, SKY, "#7f6000", "#333333")
DIVERGING = ("#08407e", "#2a78b5", "#7ab3d8", "#c9dfec", "#f4f3f0", "#f6d3ae", "#e79b56", "#c65f14", "#7f3507")
"""Blue for below, orange for above, and near white for zero. The same as in the viewer (colours.ts)."""
DIVERGING_MISSING = "#9a9a9a"

_DPI = 100  # with this, one point of text is 1.4 px
_MARGIN = 14  # margin around a sheet, px; appearance only
_GAP = 12  # space between panels, px; appearance only
_TITLE = 24  # height of a panel's title, px; appearance only
_BAR = 84  # width of a colour bar with its labels, px; appearance only
_TEXT_PT = 8.5  # size of text, points; appearance only


@dataclass(frozen=True, slots=True, kw_only=True)
class Caption:
    """Title and caption of a picture, stored in the PNG itself."""

    title: str
    text: str


class PanelSheet:
    """Panels of equal size in rows and columns, each with a title.

    Args:
        columns: panels side by side.
        rows: panels one above the other.
        panel_wh: width and height of a panel, pixels.
        bars: whether each row has space for a colour bar on the right.
        axes_room: space for tick labels and axis titles to the left of and below each panel, pixels.
        header: space at the top for one legend, pixels.
        bare: whether the panels fill the sheet, without a margin and without titles.
    """

    def __init__(
        self,
        columns: int,
        rows: int,
        panel_wh: tuple[int, int],
        *,
        bars: bool = False,
        axes_room: tuple[int, int] = (0, 0),
        header: int = 0,
        bare: bool = False,
    ) -> None:
        from matplotlib.figure import Figure

        self.columns, self.rows = columns, rows
        self._panel = panel_wh
        self._room = axes_room
        self._bars = bars
        self._header = header
        self._margin, self._title = (0, 0) if bare else (_MARGIN, _TITLE)
        width, height = panel_wh
        self._step = width + axes_room[0] + _GAP, height + axes_room[1] + self._title + _GAP
        self.width = 2 * self._margin + columns * self._step[0] - _GAP + (_BAR if bars else 0)
        self.height = 2 * self._margin + rows * self._step[1] - _GAP + header
        self.figure: Figure = Figure(figsize=(self.width / _DPI, self.height / _DPI), dpi=_DPI, facecolor="white")

    def panel(self, index: int, title: str = "", *, plain: bool = True) -> Axes:
        """Axes of a panel. Panels are counted row by row from the upper left.

        With `plain`, they have a thin frame and no ticks.
        """
        row, column = divmod(index, self.columns)
        left = self._margin + column * self._step[0] + self._room[0]
        top = self._margin + self._header + row * self._step[1] + self._title
        axes: Axes = self.figure.add_axes(self._box(left, top, *self._panel))
        if title:
            self.figure.text(
                (left - self._room[0] * (not plain)) / self.width,
                1 - (top - 7) / self.height,
                title,
                fontsize=_TEXT_PT + 0.5,
                color=INK,
                va="baseline",
                clip_on=False,
            )
        if plain:
            axes.xaxis.set_visible(False)  # invisible ticks would take most of the time for a panel
            axes.yaxis.set_visible(False)
            axes.set_anchor("NW")
            _frame(axes)
        else:
            style(axes)
        return axes

    def bar(self, row: int, mappable: Any, label: str, **options: Any) -> None:
        """Draw the colour bar of a row. Its label states quantity and unit."""
        top = self._margin + self._header + row * self._step[1] + self._title
        inset = min(18, self._panel[1] // 10)
        place = self._box(self.width - self._margin - _BAR + 10, top + inset, 12, self._panel[1] - 2 * inset)
        axes = self.figure.add_axes(place)
        bar = self.figure.colorbar(mappable, cax=axes, **options)
        bar.outline.set_linewidth(0.5)
        bar.outline.set_edgecolor(FAINT)
        axes.tick_params(labelsize=_TEXT_PT - 0.5, colors=INK, length=2.5, width=0.6)
        axes.set_ylabel(label, fontsize=_TEXT_PT, color=INK)

    def legend(self, entries: Sequence[tuple[str, str]]) -> None:
        """Draw a legend in the header, from left to right. Each entry has a colour and its meaning."""
        from matplotlib.patches import Rectangle

        x = float(self._margin)
        y = 1 - (self._margin + self._header / 2) / self.height
        for colour, meaning in entries:
            self.figure.add_artist(
                Rectangle(
                    (x / self.width, y - 5 / self.height),
                    11 / self.width,
                    11 / self.height,
                    color=colour,
                    transform=self.figure.transFigure,
                )
            )
            text = self.figure.text(
                (x + 17) / self.width, y, meaning, fontsize=_TEXT_PT, color=INK, va="center_baseline"
            )
            x += 17 + self._text_width(text) + 18

    def png(self, title: str, text: str) -> bytes:
        """Write the sheet as a PNG with its title and caption."""
        from matplotlib.backends.backend_agg import FigureCanvasAgg

        canvas: Any = FigureCanvasAgg(self.figure)
        canvas.draw()
        return encode(np.asarray(canvas.buffer_rgba())[..., :3], Caption(title=title, text=text))

    def printed(self, form: str, subject: str | None = None) -> bytes:
        """Write the sheet for print: ``pdf``, ``svg`` or ``png``.

        In ``pdf`` and ``svg``, lines and text are vectors. ``png`` has 300 dpi. The subject's identifier, if there is
        one, is stored in the file's metadata.
        """
        buffer = io.BytesIO()
        constant: dict[str, dict[str, Any]] = {"pdf": {"CreationDate": None}, "svg": {"Date": None}, "png": {}}
        described = {} if subject is None else {"Description" if form == "svg" else "Subject": subject}
        self.figure.savefig(buffer, format=form, dpi=300, metadata={**constant[form], **described})
        return buffer.getvalue()

    def _box(self, left: float, top: float, width: float, height: float) -> tuple[float, float, float, float]:
        return left / self.width, 1 - (top + height) / self.height, width / self.width, height / self.height

    def _text_width(self, text: Any) -> float:
        from matplotlib.backends.backend_agg import FigureCanvasAgg

        canvas: Any = FigureCanvasAgg(self.figure)
        return float(text.get_window_extent(canvas.get_renderer()).width)


def style(axes: Axes) -> None:
    """Style an ordinary plot: thin frame, small text, faint grid."""
    axes.tick_params(labelsize=_TEXT_PT - 0.5, colors=INK, length=2.5, width=0.6)
    _frame(axes)
    axes.grid(True, color="#e4e8ed", linewidth=0.6)
    axes.set_axisbelow(True)
    axes.xaxis.label.set(fontsize=_TEXT_PT, color=INK)
    axes.yaxis.label.set(fontsize=_TEXT_PT, color=INK)


def _frame(axes: Axes) -> None:
    for spine in axes.spines.values():
        spine.set_linewidth(0.6)
        spine.set_color(FAINT)


def scale_bar(axes: Axes, extent_mm: tuple[float, float, float, float]) -> None:
    """Draw a scale bar of round length in a panel's lower left. The panel's units are mm."""
    left, right, bottom, top = extent_mm
    length = round_length((right - left) * 0.3)
    x, y = left + 0.03 * (right - left), bottom + 0.035 * (top - bottom)
    outline = stroke("white", 2.5)
    axes.plot([x, x + length], [y, y], color=INK, linewidth=2, solid_capstyle="butt", path_effects=stroke("white", 4))
    axes.text(
        x,
        y + 0.015 * (top - bottom),
        f"{length:g} mm" if length < 1000 else f"{length / 1000:g} m",
        fontsize=_TEXT_PT,
        color=INK,
        va="bottom",
        path_effects=outline,
    )


def note(axes: Axes, text: str) -> None:
    """Write a short remark on a pale background in the upper left."""
    axes.text(
        0.02,
        0.975,
        text,
        transform=axes.transAxes,
        fontsize=_TEXT_PT - 0.5,
        color=INK,
        va="top",
        bbox={"boxstyle": "round,pad=0.25", "facecolor": "white", "alpha": 0.82, "edgecolor": "none"},
    )


def stroke(colour: str, width: float) -> list[Any]:
    """Outline for lines and text drawn on pictures."""
    from matplotlib.patheffects import withStroke

    return [withStroke(linewidth=width, foreground=colour)]


def round_length(length: float) -> float:
    """Largest of 1, 2, 5 × 10ⁿ that does not exceed a length."""
    power = 10.0 ** np.floor(np.log10(max(length, 1e-9)))
    return float(power * max(step for step in (1, 2, 5) if step * power <= length * (1 + 1e-9)))


def grid(count: int, most: int = 4) -> tuple[int, int]:
    """Columns and rows for `count` panels, at most `most` in a row. Rows are filled as evenly as possible."""
    rows = max(1, -(-count // most))
    return -(-count // rows), rows


def encode(pixels: UInt8[Array, "h w 3"], caption: Caption) -> bytes:
    """Encode RGB pixels as a PNG with title and description as text."""
    from PIL.PngImagePlugin import PngInfo

    info = PngInfo()
    info.add_itxt("Title", caption.title)
    info.add_itxt("Description", caption.text)
    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, format="PNG", pnginfo=info, compress_level=3)
    return buffer.getvalue()


def caption_of(png: bytes) -> Caption:
    """Read the caption of a preview. It is empty for PNGs from other programs."""
    with Image.open(io.BytesIO(png), formats=("PNG",)) as image:
        return caption_in(image)


def caption_in(image: Image.Image) -> Caption:
    """The caption of an opened preview, whose pixels are read for this."""
    text = getattr(image, "text", {})
    return Caption(title=str(text.get("Title", "")), text=str(text.get("Description", "")))


def reduced(photograph: Photograph, width_px: int) -> UInt8[Array, "h w 3"]:
    """A small RGB copy of a photograph, averaged by area.

    It has at least the given width, and at most twice that.
    """
    pixels = photograph.pixels
    if pixels.dtype == np.uint16:
        pixels = (pixels >> 8).astype(np.uint8)
    image = Image.fromarray(pixels).convert("RGB")
    factor = max(1, image.width // width_px)
    return np.asarray(image.reduce(factor) if factor > 1 else image)


def thinned(array: Array, longest_px: int) -> Array:
    """Every k-th row and column, so that no side exceeds `longest_px`."""
    step = max(1, -(-max(array.shape[:2]) // longest_px))
    return array[step // 2 :: step, step // 2 :: step]


def with_gaps(values: Float32[Array, "h w"], valid: Bool[Array, "h w"]) -> Any:
    """A map with its invalid pixels in the colour for missing data."""
    return np.ma.masked_array(values, mask=~valid)


def colour_map(name: str) -> Any:
    """A Matplotlib colour map with our colour for missing data."""
    import matplotlib as mpl

    return mpl.colormaps[name].with_extremes(bad=MISSING)


def diverging_scale(limit: float) -> Any:
    """The viewer's diverging colours as a Matplotlib scale.

    Blue below zero, near white at zero, orange above, and grey for missing values.
    """
    import matplotlib as mpl

    colours = mpl.colors.LinearSegmentedColormap.from_list("blue-orange", DIVERGING)
    return mpl.cm.ScalarMappable(
        norm=mpl.colors.Normalize(-limit, limit), cmap=colours.with_extremes(bad=DIVERGING_MISSING)
    )


def coloured(values: Float64[Array, " n"], scale: Any) -> Float32[Array, "n 3"]:
    """Each value's colour on the scale, 0…1. NaN has the colour for missing values."""
    colours: Float32[Array, "n 3"] = np.asarray(scale.to_rgba(np.ma.masked_invalid(values)))[:, :3].astype(np.float32)
    return colours


def rounded_up(value: float) -> float:
    """Round up to the end of a scale: 1, 1.5, 2, 3, 5 or 7 × 10ⁿ."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(next(step * power for step in (1, 1.5, 2, 3, 5, 7, 10) if step * power >= value * (1 - 1e-9)))


def pixel_extent(size_wh: tuple[int, int]) -> tuple[float, float, float, float]:
    """Extent of a picture in its own pixels, row 0 at the top. Pixel centres are at integers."""
    return -0.5, size_wh[0] - 0.5, size_wh[1] - 0.5, -0.5


def robust_range(values: Float64[Array, " n"] | Float32[Array, " n"], share: float = 0.01) -> tuple[float, float]:
    """Limits that exclude `share` of the values at both ends. Never equal."""
    if not len(values):
        return 0.0, 1.0
    low, high = (float(limit) for limit in np.quantile(values, (share, 1 - share)))
    return (low, high) if high > low else (low - 0.5, low + 0.5)


def fitting(shapes: Sequence[tuple[int, ...]], width_px: int) -> tuple[int, int]:
    """A panel size that fits pictures of these (rows, columns).

    The width is given. The height is limited for upright pictures.
    """
    ratio = max((shape[0] / shape[1] for shape in shapes), default=1.0)
    if ratio <= 1.25:
        return width_px, max(40, round(width_px * ratio))
    return round(1.25 * width_px / ratio), round(1.25 * width_px)


def rgb(colour: str) -> Float64[Array, 3]:
    """Red, green and blue, 0…1, of ``#rrggbb``."""
    return np.array([int(colour[place : place + 2], 16) / 255 for place in (1, 3, 5)])


def hexadecimal(colour: Sequence[float]) -> str:
    """``#rrggbb`` of red, green and blue, 0…1."""
    return "#" + "".join(f"{round(255 * value):02x}" for value in colour)
