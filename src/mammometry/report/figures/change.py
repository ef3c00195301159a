"""Pictures of one patient at two dates, with the trunks aligned."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mammometry.base.notices.words import NAMES
from mammometry.geometry import Array, Float64, Transform, TriangleMesh
from mammometry.measure.change import Change
from mammometry.measure.volume.measurement import VolumeMeasurement
from mammometry.report.figures import canvas
from mammometry.report.figures.canvas import PanelSheet
from mammometry.report.figures.measure import curve
from mammometry.report.figures.shading import ShadedMesh, join_segments, picture_wh, section, views_of
from mammometry.report.figures.surface import show
from mammometry.surface.repair.repair import RepairedSurface
from mammometry.surface.texture.texture import TexturedMesh
from mammometry.surface.texture.unmeasured import WORDS, shown_colours

_PANEL_PX = 330  # width of a panel, px; appearance only
_VIEW_PX = 560  # size at which a view is rendered, px; appearance only
_LEAST_MM = 2.0  # least end of the scale, mm; appearance only
_TURN_DEG = 45.0  # rotation of the oblique views; appearance only
_ROOM_MM = 40.0  # margin around the breasts, mm; appearance only
BEFORE_LINE, AFTER_LINE = canvas.BLUE, canvas.VERMILION


def limit_mm(change: Change) -> float:
    """Round end of the change map's scale, mm.

    Two and a half times the breasts' RMS change, at least 2 mm.
    """
    return canvas.rounded_up(max(2.5 * max(breast.rms_mm for breast in change.breasts), _LEAST_MM))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Dated:
    """A whole surface at one of two dates, for the viewer."""

    name: str
    title: str
    repaired: RepairedSurface
    """World frame of the earlier date, mm."""
    textured: TexturedMesh
    """Its colours."""
    measurements: Sequence[VolumeMeasurement]
    """World frame of its own date."""
    world_from_own: Transform
    """Transform from its own world frame to that of the earlier date."""
    change_mm: Float64[Array, " n"] | None = None
    """For each vertex of the later date, its distance in front of the earlier skin, mm."""


def change_map(frame: Float64[Array, "3 3"], dates: tuple[Dated, Dated], change: Change) -> bytes:
    """Both dates in colour, and the later one coloured by the change, from three directions.

    Args:
        frame: rows right, up and towards the viewer of the front view, world frame of the earlier date.
        dates: the earlier one first.
        change: change between the dates.
    """
    turns = {"front": 0.0, "from the patient's right": _TURN_DEG, "from the patient's left": -_TURN_DEG}
    frames = {name: _turned(angle) @ frame for name, angle in turns.items()}
    views = views_of(_around_breasts(dates), frames, margin=1.0)
    limit = limit_mm(change)
    scale = canvas.diverging_scale(limit)
    sheet = PanelSheet(3, 3, picture_wh(views[0], _PANEL_PX), bars=True, header=26)
    sheet.legend(
        [
            (canvas.DIVERGING[-2], "more than before"),
            (canvas.DIVERGING[1], "less"),
            (canvas.DIVERGING_MISSING, "not seen at both dates"),
        ]
    )
    for row, date in enumerate((*dates, dates[1])):
        scene = ShadedMesh(date.repaired.mesh)
        mapped = row == 2
        photographed = shown_colours(date.textured.colours, date.repaired)
        colours = canvas.coloured(change.after_mm, scale) if mapped else photographed
        for column, view in enumerate(views):
            axes = sheet.panel(3 * row + column, f"{'Change' if mapped else date.title}, {view.name}")
            show(axes, scene.render(view, size_px=_VIEW_PX, colours=colours, lit=0.5 if mapped else 0.0), view)
            axes.set(xlim=view.extent_mm[:2], ylim=view.extent_mm[2:])
            for measured in date.measurements:
                boundary = date.world_from_own.apply(measured.boundary_world)
                curve(axes, scene, view, boundary, canvas.INK, size_px=_VIEW_PX)
    sheet.bar(2, scale, "later skin in front of the earlier, mm", extend="both")
    return sheet.png(
        "Both dates, and the change",
        "The later trunk was aligned with the earlier one without breasts and arms. All views have the same "
        "scale and place. Below: the later skin is in front of the earlier one (orange) or behind it (blue). The "
        f"scale ends at ±{limit:g} mm. Colours on arms, shoulders and belly come from the pose and are no change. "
        f"{WORDS}.",
    )


def change_sections(frame: Float64[Array, "3 3"], dates: tuple[Dated, Dated], change: Change) -> bytes:
    """Sections through the breasts with both dates in one drawing.

    A horizontal section goes through both breasts, and a vertical one through each.

    Args:
        frame: rows right, up and towards the viewer of the front view, world frame of the earlier date.
        dates: the earlier one first.
        change: change between the dates.
    """
    middles = {breast.name: breast.before.boundary_world.mean(axis=0) for breast in change.breasts}
    centre = np.mean(list(middles.values()), axis=0)
    cuts = [("level, seen from above", 1, (0, 2), centre)]
    cuts += [(f"upright, {NAMES[name]}", 0, (2, 1), middle) for name, middle in middles.items()]
    labels = {0: "to the patient's left, mm", 1: "up, mm", 2: "towards the cameras, mm"}
    near = _around_breasts(dates).vertices
    reach = float(np.abs((near - centre) @ frame.T).max()) * 1.02
    sheet = PanelSheet(len(cuts), 1, (330, 330), axes_room=(56, 42), header=26)
    sheet.legend([(BEFORE_LINE, dates[0].title), (AFTER_LINE, dates[1].title)])
    for index, (title, normal, (across, upwards), place) in enumerate(cuts):
        axes = sheet.panel(index, title, plain=False)
        for date, colour in zip(dates, (BEFORE_LINE, AFTER_LINE), strict=True):
            segments, _ = section(date.repaired.mesh, place, frame[normal])
            drawn = ((segments - place) @ frame.T)[..., [across, upwards]]
            for line in join_segments(drawn):
                axes.plot(*line.T, color=colour, linewidth=1.5, solid_capstyle="round")
        axes.set(xlim=(-reach, reach), ylim=(-reach, reach), xlabel=labels[across], ylabel=labels[upwards])
    return sheet.png(
        "Sections through both dates",
        "Cuts at the same places of the trunk, through the middles of the earlier boundaries.",
    )


def _around_breasts(dates: Sequence[Dated]) -> TriangleMesh:
    """Both dates' skin in and near the boundaries, to which views are fitted."""
    edges = np.concatenate(
        [date.world_from_own.apply(measurement.closed.vertices) for date in dates for measurement in date.measurements]
    )
    low, high = edges.min(axis=0) - _ROOM_MM, edges.max(axis=0) + _ROOM_MM
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)]) * (high - low) + low
    return TriangleMesh(vertices=corners, faces=np.empty((0, 3), dtype=np.int32))


def _turned(angle_deg: float) -> Any:
    """Rotate the view's frame about its upward axis. A positive angle moves the viewer to the left."""
    sine, cosine = np.sin(np.deg2rad(angle_deg)), np.cos(np.deg2rad(angle_deg))
    return np.array([[cosine, 0.0, sine], [0.0, 1.0, 0.0], [-sine, 0.0, cosine]])
