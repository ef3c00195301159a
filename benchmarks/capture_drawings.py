"""Drawings of docs/how-to/capture.md: the wiring, and the strip of counting lamps.

python -m benchmarks.capture_drawings docs/how-to/pictures
"""

from __future__ import annotations

import sys
from pathlib import Path

from mammometry.calibration.targets.lamps import LAMPS
from mammometry.simulate.rigs.targets import BOARD

_STYLE = (
    "text{font:14px sans-serif;fill:#1c2330}.s{font-size:12px}"
    "rect,circle,path{stroke:#1c2330;stroke-width:1.5;fill:#fff}"
    ".w{stroke:#a3140d;stroke-width:2.5;fill:none}.u{stroke:#0b5cad;stroke-width:1.5;fill:none;stroke-dasharray:5 4}"
    ".on{fill:#ffd34d}.board{fill:#eef0f3}"
)


def drawings() -> dict[str, str]:
    """Name → SVG."""
    return {"capture-wiring.svg": _wiring(), "counting-lamps.svg": _lamps()}


def _svg(width: int, height: int, title: str, parts: list[str]) -> str:
    body = "\n".join(parts)
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" role="img"><title>{title}</title>\n'
        f'<rect width="{width}" height="{height}" style="stroke:none"/><style>{_STYLE}</style>\n{body}\n</svg>\n'
    )


def _box(x: int, y: int, width: int, height: int, *lines: str) -> str:
    middle_x, middle_y = x + width / 2, y + height / 2 + 5 - 8.5 * (len(lines) - 1)
    words = "".join(
        f'<text x="{middle_x:g}" y="{middle_y + 17 * i:g}" text-anchor="middle">{line}</text>'
        for i, line in enumerate(lines)
    )
    return f'<rect x="{x}" y="{y}" width="{width}" height="{height}" rx="6"/>{words}'


def _wiring() -> str:
    """One pulse to all, through a splitter with one opto-coupler a camera."""
    parts = [
        _box(20, 140, 130, 60, "Button or", "foot switch"),
        _box(200, 130, 170, 80, "Splitter", "one opto-coupler", "a camera, 5 V"),
        '<path class="w" d="M150 170H200"/>',
    ]
    for row in range(4):
        y = 20 + 80 * row
        parts += [
            _box(470, y, 190, 50, f"Camera {2 * row + 1}, {2 * row + 2}", "Line1 or release socket"),
            f'<path class="w" d="M370 170C420 170 420 {y + 18} 470 {y + 18}"/>',
            f'<path class="u" d="M660 {y + 25}C710 {y + 25} 710 190 750 190"/>',
        ]
    parts += [
        _box(750, 150, 130, 80, "Computer", "settings and", "pictures alone"),
        _box(200, 290, 170, 60, "Flashes", "last output"),
        '<path class="w" d="M285 210V290"/>',
        '<path class="w" d="M200 385H240"/><text class="s" x="250" y="390">wire: the pulse</text>',
        '<path class="u" d="M400 385H440"/>'
        '<text class="s" x="450" y="390">USB or network: settings and download</text>',
    ]
    return _svg(900, 410, "One pulse goes to all cameras by wire; USB or network carries settings and pictures", parts)


def _lamps() -> str:
    """The board's lower part with the strip, to scale: 2 units a millimetre."""
    scale, top = 2.0, 40.0
    (left, _), (right, bottom) = BOARD.extent_mm
    places = LAMPS.places_mm(BOARD)
    shown_mm = 50.0

    def x(mm: float) -> float:
        return 60 + scale * (mm - left)

    def y(mm: float) -> float:
        return top + scale * (mm - (bottom - shown_mm))

    parts = [
        f'<rect class="board" x="{x(left):g}" y="{top:g}" '
        f'width="{scale * (right - left):g}" height="{scale * shown_mm:g}"/>'
    ]
    side = BOARD.square_mm
    for row in range(2):
        for column in range(BOARD.squares[0]):
            if (row + column) % 2:
                parts.append(
                    f'<rect x="{x(left + side * column):g}" y="{y(bottom - side * (row + 1)):g}" '
                    f'width="{scale * side:g}" height="{scale * side:g}" style="fill:#1c2330"/>'
                )
    first, last = places[0], places[-1]
    parts.append(
        f'<rect x="{x(first[0] - 12):g}" y="{y(first[1] - 9):g}" width="{scale * (last[0] - first[0] + 24):g}" '
        f'height="{scale * 18:g}" style="fill:#444b57"/>'
    )
    for number, (px, py, _) in enumerate(places):
        reference = number in (0, len(places) - 1)
        name = "on" if reference else str(LAMPS.bits - number)
        parts.append(
            f'<circle {"class=" + chr(34) + "on" + chr(34) if reference else ""} cx="{x(px):g}" cy="{y(py):g}" '
            f'r="{scale * LAMPS.lamp_mm / 2:g}"/>'
            f'<text class="s" x="{x(px):g}" y="{y(py) + 34:g}" text-anchor="middle">{name}</text>'
        )
    below = y(first[1]) + 60
    parts += [
        f'<text x="60" y="26">Lower edge of the board ({BOARD.squares[0]} × {BOARD.squares[1]} squares '
        f"of {side:g} mm), and the strip below it</text>",
        f'<text class="s" x="60" y="{below:g}">Lamps {LAMPS.lamp_mm:g} mm wide, {LAMPS.pitch_mm:g} mm apart, '
        f"{LAMPS.below_mm:g} mm below the edge of the pattern, in the plane of the print, black around them.</text>",
        f'<text class="s" x="60" y="{below + 20:g}">Bit {LAMPS.bits - 1} (slowest) is on the left, bit 0 on the right; '
        f"both ends are always on. A count lasts {LAMPS.tick_ms:g} ms, all of them {LAMPS.period_ms:g} ms.</text>",
    ]
    return _svg(820, int(below + 40), "Strip of counting lamps below the calibration board", parts)


if __name__ == "__main__":
    for name, text in drawings().items():
        (Path(sys.argv[1]) / name).write_text(text, encoding="utf-8")
