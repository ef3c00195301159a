"""Drawing of a session's products, with their inputs, state and duration."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from typing import Any

from mammometry.job.graph import Plan
from mammometry.job.products import STAGES, Definition, Family
from mammometry.report.figures.canvas import INK

_BOX_WH, _ROW, _COLUMN, _LEFT, _TOP = (156, 38), 58, 172, 96, 16  # px; appearance only
_FILLS = {"current": "#dff0e4", "stale": "#fdf0c4", "damaged": "#f8d7d0", "absent": "#ffffff"}
_WORST = tuple(reversed(_FILLS))  # a group of products has the state of its worst product
_STYLE = (
    f"text{{font:12px sans-serif;fill:{INK}}}.s{{font-size:10.5px;fill:#5b6573}}.g{{font-size:14px}}"
    f"rect{{stroke:{INK};stroke-width:1}}.u{{stroke-dasharray:4 3;stroke:#7d8794}}"
    ".e{fill:none;stroke:#9aa3af;stroke-width:1.3}.b{fill:#f5f6f8;stroke:none}.t{fill:#0072b2;stroke:none}"
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Known:
    """State of a product in a results folder."""

    state: str
    """current, stale, damaged or absent."""
    seconds: float | None
    """Time for making it, s. None if it was not made."""


def product_graph(plan: Plan, known: Mapping[str, Known], subject: str | None = None) -> str:
    """Draw all products of a session as SVG. Lines that follow from other lines are left out.

    Args:
        plan: plan of the session.
        known: ``stage/product`` → its state and time. Empty: they are not shown.
        subject: identifier to store in the drawing, if any.
    """
    parents = _parents(plan)
    rows = _rows(parents)
    reduced = _reduced(parents)
    places = _places(rows, reduced)
    longest = max((about.seconds or 0.0 for about in known.values()), default=0.0)
    width = _LEFT + round(max(x for x, _ in places.values())) + _BOX_WH[0] // 2 + 16
    height = _TOP + _ROW * len(rows)
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" role="img">'
        f"<title>{escape(' '.join(filter(None, ('Results', subject))))}</title>\n<style>{_STYLE}</style>\n"
        f'<rect width="{width}" height="{height}" style="fill:#fff;stroke:none"/>\n'
        + "".join(_bands(rows, width))
        + "".join(_lines(places, reduced))
        + "".join(_box(definition, parents[definition], plan, known, longest, at) for definition, at in places.items())
        + "</svg>\n"
    )


Graph = Mapping[Definition[Any], Sequence[Definition[Any]]]


def _parents(plan: Plan) -> Graph:
    """Definition → those that its products are made from."""
    definitions = {product: known for known, products in plan.bound.items() for product in products.values()}
    parents: dict[Definition[Any], list[Definition[Any]]] = {}
    for definition, products in plan.bound.items():
        if products:
            made_from = (definitions[parent] for product in products.values() for parent in product.made_from)
            parents[definition] = list(dict.fromkeys(made_from))
    return {
        definition: parents[definition] for definition in sorted(parents, key=lambda known: STAGES.index(known.stage))
    }


def _reduced(parents: Graph) -> Graph:
    """The graph without lines that follow from longer paths (transitive reduction)."""
    above: dict[Definition[Any], set[Definition[Any]]] = {}

    def ancestors(definition: Definition[Any]) -> set[Definition[Any]]:
        if definition not in above:
            above[definition] = {name for parent in parents[definition] for name in (parent, *ancestors(parent))}
        return above[definition]

    return {
        child: [parent for parent in direct if not any(parent in ancestors(other) for other in direct)]
        for child, direct in parents.items()
    }


def _rows(parents: Graph) -> list[list[Definition[Any]]]:
    """Products in rows: by stage, and within a stage by the longest path to them."""
    depth: dict[Definition[Any], int] = {}
    for definition in parents:
        inside = [depth[parent] for parent in parents[definition] if parent.stage == definition.stage]
        depth[definition] = 1 + max(inside, default=0)
    rows: dict[tuple[int, int], list[Definition[Any]]] = {}
    for definition in parents:
        rows.setdefault((STAGES.index(definition.stage), depth[definition]), []).append(definition)
    return [rows[key] for key in sorted(rows)]


def _places(rows: Sequence[Sequence[Definition[Any]]], parents: Graph) -> dict[Definition[Any], tuple[float, float]]:
    """Centre of each box, px. Boxes are below those they are made from, as far as there is room."""
    columns = max(map(len, rows))
    places: dict[Definition[Any], tuple[float, float]] = {}
    for number, row in enumerate(rows):
        wanted = {
            definition: sum(above) / len(above) if (above := [places[parent][0] for parent in parents[definition]])
            else (columns - 1) / 2
            for definition in row
        }  # fmt: skip
        taken = -1.0
        for place, definition in enumerate(sorted(row, key=lambda known: wanted[known])):
            latest = columns - (len(row) - place)  # leaves room for those after it
            taken = min(max(wanted[definition], taken + 1), latest)
            places[definition] = (taken, number)
    return {
        definition: (_LEFT + _COLUMN * column + _BOX_WH[0] / 2, _TOP + _ROW * row + _BOX_WH[1] / 2)
        for definition, (column, row) in places.items()
    }


def _bands(rows: Sequence[Sequence[Definition[Any]]], width: int) -> list[str]:
    """A coloured band and a name for each stage."""
    bands = []
    for number, stage in enumerate(STAGES):
        own = [row for row, definitions in enumerate(rows) if definitions[0].stage == stage]
        if own:
            y, tall = _TOP + _ROW * own[0] - 9, _ROW * len(own) - 2
            shade = f'<rect class="b" x="0" y="{y}" width="{width}" height="{tall}"/>' if number % 2 == 0 else ""
            bands.append(f'{shade}<text class="g" x="12" y="{y + 24}">{stage}</text>\n')
    return bands


def _lines(places: Mapping[Definition[Any], tuple[float, float]], parents: Graph) -> Iterator[str]:
    """Lines from boxes down to others. Lines that pass rows go through the nearest gaps between boxes."""
    taken: list[float] = []
    for child, above in parents.items():
        for parent in above:
            (x0, y0), (x1, y1) = places[parent], places[child]
            passed = [x for x, y in places.values() if y0 < y < y1]
            way = _way(x0, x1, passed, taken) if passed else x1
            if passed:
                taken.append(way)
            top, bottom, gap = y0 + _BOX_WH[1] / 2, y1 - _BOX_WH[1] / 2, _ROW - _BOX_WH[1]
            yield (
                f'<path class="e" d="M{x0:.0f} {top:.0f}C{x0:.0f} {top + gap * 0.8:.0f} {way:.0f} '
                f"{top + gap * 0.2:.0f} {way:.0f} {top + gap:.0f}V{bottom - gap:.0f}"
                f'C{way:.0f} {bottom - gap * 0.2:.0f} {x1:.0f} {bottom - gap * 0.8:.0f} {x1:.0f} {bottom:.0f}"/>\n'
                if passed
                else f'<path class="e" d="M{x0:.0f} {top:.0f}C{x0:.0f} {bottom:.0f} {x1:.0f} {top:.0f} '
                f'{x1:.0f} {bottom:.0f}"/>\n'
            )


def _way(x0: float, x1: float, boxes: Sequence[float], taken: Sequence[float]) -> float:
    """Position at which a line can pass the boxes of some rows with the least detour."""
    aside = [_BOX_WH[0] / 2 + 7 * (1 + number) for number in range(len(taken) + 1)]
    ways = [x0, x1, *(box + sign * step for box in boxes for step in aside for sign in (-1, 1))]
    free = [
        way
        for way in ways
        if all(abs(way - box) > _BOX_WH[0] / 2 + 5 for box in boxes) and all(abs(way - other) > 5 for other in taken)
    ]
    return min(free, key=lambda way: abs(way - x0) + abs(way - x1))


def _box(
    definition: Definition[Any],
    parents: Sequence[Definition[Any]],
    plan: Plan,
    known: Mapping[str, Known],
    longest: float,
    middle: tuple[float, float],
) -> str:
    products = plan.bound[definition]
    (wide, tall), (x, y) = _BOX_WH, (middle[0] - _BOX_WH[0] / 2, middle[1] - _BOX_WH[1] / 2)
    keys = [f"{product.key.stage}/{product.key.product}" for product in products.values() if product.is_stored]
    about = [known.get(key, Known(state="absent", seconds=None)) for key in keys] if known else []
    state = min((product.state for product in about), key=_WORST.index, default="absent")
    seconds = sum(product.seconds or 0.0 for product in about)
    words = "not stored" if not keys else state if state == "absent" else f"{state}, {seconds:.1f} s"
    shown = f'<text class="s" x="{middle[0]}" y="{y + 29}" text-anchor="middle">{words}</text>'
    below = shown if known or not keys else ""
    name = _name(definition) + (f" × {len(products)}" if isinstance(definition, Family) else "")
    bar = f'<rect class="t" x="{x}" y="{y + tall - 3}" width="{wide * seconds / (longest or 1.0):.1f}" height="3"/>'
    summary = (definition.function.__doc__ or "").strip().partition("\n")[0]
    made_from = f" Made from: {', '.join(map(_name, parents))}." if parents else ""
    place = f" In results/{definition.stage}/{definition.name.format(item='…')}." if keys else ""
    dashed = ' class="u"' if not keys else ""
    return (
        f"<g><title>{escape(summary + made_from + place)}</title>"
        f'<rect{dashed} x="{x}" y="{y}" width="{wide}" height="{tall}" rx="5" fill="{_FILLS[state]}"/>'
        f"{bar if seconds else ''}"
        f'<text x="{middle[0]}" y="{y + (16 if below else 23)}" text-anchor="middle">{escape(name)}</text>{below}</g>\n'
    )


def _name(definition: Definition[Any]) -> str:
    return definition.function.__name__.replace("_", " ")
