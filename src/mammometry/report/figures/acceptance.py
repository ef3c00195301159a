"""Pictures of an acceptance test: positions, coloured deviations, control chart."""

from __future__ import annotations

import datetime
from collections.abc import Collection, Sequence
from typing import Any

import numpy as np

from mammometry.geometry.arrays import Array, Float64
from mammometry.report.figures import canvas
from mammometry.report.figures.canvas import PanelSheet
from mammometry.study.acceptance.artefacts import POSITIONS, QUANTITIES, TITLES, VOLUME_MM, Kind, Position
from mammometry.study.acceptance.evaluate import PositionResult
from mammometry.study.acceptance.patches import ArtefactPatch, PlanePatch, SpherePatch
from mammometry.study.acceptance.tables import QUANTITY_WORDS, PastTest, unit_of

_PANEL = (190, 170)  # size of the panel of one position, px; layout only
_COLUMNS = 5  # positions in a row
_DEPTH = np.array([-0.32, -0.22])  # oblique projection: shift to the right and up for each mm towards the device
_POINTS = 6000  # most points of a surface that are drawn
_DOT = 2.2  # area of a point, points²; layout only
_LEAST_SCALE_MM = 0.1  # least end of the colour scale: a shift of the skin by this changes a breast of 400 cc by 2 cc
_CHART = (330, 190)  # size of the chart of one quantity, px; layout only
_ROOM = (64, 40)  # space for its labels, px; layout only


def positions(kind: Kind, measured: Collection[str] = ()) -> bytes:
    """All positions of an artefact in the working volume. Measured ones are green.

    Args:
        kind: kind of the artefact.
        measured: names of measured positions.
    """
    places = POSITIONS[kind]
    columns, rows = canvas.grid(len(places), _COLUMNS)
    sheet = PanelSheet(columns, rows, _PANEL, header=26)
    legend = [(canvas.FAINT, "working volume, the device in front")]
    legend += [(canvas.GREEN, "measured"), (canvas.VERMILION, "missing")] if measured else []
    sheet.legend(legend)
    for index, place in enumerate(places):
        axes = sheet.panel(index, place.name)
        colour = canvas.BLUE if not measured else canvas.GREEN if place.name in measured else canvas.VERMILION
        _draw_position(axes, kind, place, colour)
    words = ", ".join(f"{place.name} {place.words}" for place in places)
    return sheet.png(f"{TITLES[kind]}: positions", f"Left and right as seen from the device: {words}.")


def _draw_position(axes: Any, kind: Kind, place: Position, colour: str) -> None:
    width, height, depth = VOLUME_MM
    corners = np.array([(x, y, z) for z in (-0.5, 0.5) for y in (-0.5, 0.5) for x in (-0.5, 0.5)]) * VOLUME_MM
    for a in range(8):
        for bit in (1, 2, 4):
            if not a & bit:
                _line(axes, corners[[a, a | bit]], canvas.FAINT, 0.6)
    centre = np.array(place.centre) * VOLUME_MM
    axis = np.array(place.axis)
    size = 0.13 * height
    if kind == "bar":
        ends = [centre - 0.36 * width * axis, centre + 0.36 * width * axis]
        _line(axes, np.array(ends), colour, 2.5)
        for end in ends:
            _disc(axes, end, size / 2, colour)
    elif kind == "plane":
        right = np.cross([0.0, 1.0, 0.0], axis)
        up = np.cross(axis, right)
        sides = 0.27 * width * right, 0.2 * height * up
        square = [centre + a * sides[0] + b * sides[1] for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
        axes.fill(*_flat(np.array(square)).T, color=colour, alpha=0.65, linewidth=0)
    else:
        _line(axes, np.array([centre, [centre[0], -height / 2, centre[2]]]), canvas.FAINT, 0.6)
        _disc(axes, centre, size, colour)
    reach = 0.5 * np.array([width, height]) + np.abs(_DEPTH) * depth / 2
    axes.set(xlim=(-1.05 * reach[0], 1.05 * reach[0]), ylim=(-1.05 * reach[1], 1.05 * reach[1]), aspect="equal")


def _flat(points: Float64[Array, "n 3"]) -> Float64[Array, "n 2"]:
    return np.asarray(points[:, :2] + points[:, 2:] * _DEPTH)


def _line(axes: Any, points: Float64[Array, "n 3"], colour: str, width: float) -> None:
    axes.plot(*_flat(points).T, color=colour, linewidth=width, solid_capstyle="round")


def _disc(axes: Any, centre: Float64[Array, 3], radius: float, colour: str) -> None:
    from matplotlib.patches import Circle

    axes.add_patch(Circle(tuple(_flat(centre[None])[0]), radius, color=colour, linewidth=0))


def deviations(kind: Kind, results: Sequence[PositionResult]) -> bytes:
    """Deviations of all measured surfaces of an artefact from their fits, one panel per position.

    Args:
        kind: sphere, bar or plane.
        results: results of this artefact.
    """
    columns, rows = canvas.grid(len(results), _COLUMNS)
    sheet = PanelSheet(columns, rows, _PANEL, bars=True)
    found = np.concatenate([patch.deviations_mm for result in results for patch in result.patches])
    scale = canvas.diverging_scale(canvas.rounded_up(max(float(np.quantile(np.abs(found), 0.99)), _LEAST_SCALE_MM)))
    for index, result in enumerate(results):
        axes = sheet.panel(index, f"position {result.position}")
        flat = [_seen_from_front(patch) for patch in result.patches]
        gap = 0.0
        for patch, points in zip(result.patches, flat, strict=True):
            step = max(1, len(points) // _POINTS)
            low, high = points.min(axis=0), points.max(axis=0)
            colours = canvas.coloured(patch.deviations_mm[::step], scale)
            x, y = (points[::step] - [low[0] - gap, (low[1] + high[1]) / 2]).T
            axes.scatter(x, y, s=_DOT, c=colours, linewidths=0)
            gap += 1.15 * (high[0] - low[0])
        axes.set_aspect("equal", adjustable="datalim")
    for row in range(rows):
        sheet.bar(row, scale, "deviation, mm")
    return sheet.png(
        f"{TITLES[kind]}: deviations",
        "Distance of the measured surface from its own fit, as seen from the device. Orange lies outside or in front, "
        "blue inside or behind.",
    )


def _seen_from_front(patch: ArtefactPatch) -> Float64[Array, "n 2"]:
    """Points seen along the mean normal of the surface, mm."""
    match patch:
        case SpherePatch():
            towards = (patch.weights[:, None] * (patch.points - patch.fit.centre)).sum(axis=0)
        case PlanePatch():
            towards = patch.fit.normal
        case _:
            raise TypeError(type(patch))
    towards = towards / np.linalg.norm(towards)
    up = np.array([0.0, 1.0, 0.0]) if abs(towards[1]) < 0.9 else np.array([0.0, 0.0, 1.0])
    right = np.cross(up, towards)
    right /= np.linalg.norm(right)
    points = patch.points - patch.points.mean(axis=0)
    return np.asarray(points @ np.stack([right, np.cross(towards, right)]).T)


def control_chart(history: Sequence[PastTest]) -> bytes:
    """Largest errors of all tests of a device over the date, with uncertainty and limit."""
    names = [
        (kind, quantity)
        for kind, quantities in QUANTITIES.items()
        for quantity in quantities
        if any(f"{kind}/{quantity}" in past.worst for past in history)
    ]
    columns = min(2, len(names))
    sheet = PanelSheet(columns, -(-len(names) // columns), _CHART, axes_room=_ROOM, header=26)
    sheet.legend([(canvas.BLUE, "error ± 95 %"), (canvas.VERMILION, "limit")])
    first, last = (edge(past.date for past in history) for edge in (min, max))
    room = datetime.timedelta(days=max(3, (last - first).days // 12))
    for index, (kind, quantity) in enumerate(names):
        axes = sheet.panel(index, f"{TITLES[kind]}: {QUANTITY_WORDS[quantity]}", plain=False)
        name = f"{kind}/{quantity}"
        tests = [(past.date, *past.worst[name]) for past in history if name in past.worst]
        dates, errors, expanded, limits = (list(column) for column in zip(*tests, strict=True))
        for sign in (-1, 1) if quantity not in ("form", "flatness") else (1,):
            axes.plot([first - room, *dates, last + room], sign * np.array([limits[0], *limits, limits[-1]]),
                      color=canvas.VERMILION, linewidth=1.2, drawstyle="steps-mid")  # fmt: skip
        axes.errorbar(dates, errors, yerr=expanded, fmt="o", color=canvas.BLUE, markersize=4, capsize=2, linewidth=1)
        axes.axhline(0, color=canvas.FAINT, linewidth=0.8)
        axes.set(xlim=(first - room, last + room), ylabel=unit_of(quantity))
        _date_ticks(axes, sorted(set(dates)))
    return sheet.png(
        "Control chart",
        "The worst error of each test of this device, with its expanded uncertainty (95 %), and the limit.",
    )


def _date_ticks(axes: Any, dates: Sequence[datetime.date]) -> None:
    """At most four dates, including the first and the last."""
    places = sorted({round(place) for place in np.linspace(0, len(dates) - 1, min(4, len(dates)))})
    axes.set_xticks([dates[place] for place in places], [dates[place].isoformat() for place in places])
