"""Pictures of the measurement: boundary, chest wall, sections, comparison of left and right."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from mammometry.base.notices.words import NAMES
from mammometry.geometry import Array, Float64, TriangleMesh, bounds
from mammometry.measure.boundary.breasts import NoBreast
from mammometry.measure.shape.symmetry import Symmetry
from mammometry.measure.volume.measurement import VolumeMeasurement
from mammometry.report.figures import canvas
from mammometry.report.figures.canvas import PanelSheet
from mammometry.report.figures.catalogue import preview
from mammometry.report.figures.shading import (
    ShadedMesh,
    ViewDirection,
    even_curve,
    join_segments,
    picture_wh,
    section,
    views_of,
    visible,
    wall_faces,
)
from mammometry.report.figures.stage_results import MeasureResult
from mammometry.report.figures.surface import show
from mammometry.surface.texture.unmeasured import WORDS, shown_colours

_PANEL_PX = 330  # width of a panel, px; appearance only
_OVERVIEW_PX = 470  # size of an overview's view, px; appearance only
_FRONT_PX, _OBLIQUE_PX = 860, 560  # longer sides of the first page's pictures, px: about 190 dpi there
_AROUND, _ABOVE = 1.6, 2.0  # side of the picture, relative to width and height of all boundaries; appearance only
_LEAST_MM = 200.0  # least side of such a picture; appearance only
_SKIN = (0.90, 0.78, 0.70)  # colour, red green blue, 0 to 1; appearance only
_WALL = (0.45, 0.66, 0.84)  # colour, red green blue, 0 to 1; appearance only
_MIRRORED, _NONE = canvas.SKY, canvas.VERMILION  # colours of a mirrored curve, and of a side without a breast
_WALL_LINE = canvas.BLUE
_SKIN_LINE = canvas.VERMILION


@preview("overview", stage="measure", place=1, photographs=False)
def overview(result: MeasureResult) -> bytes | None:
    """The whole surface with each breast's boundary, in standard views."""
    measurements, painted = result.measurements, result.textured
    if not (measurements or result.absent):
        return None
    evidence = {
        boundary.name: boundary.evidence_world for boundary in result.boundaries if len(boundary.evidence_world)
    }
    views = result.views
    sheet = PanelSheet(2, 2, picture_wh(views[0], _OVERVIEW_PX), header=26)
    entries = [(canvas.CYCLE[k], f"boundary, {NAMES[measured.name]}") for k, measured in enumerate(measurements)]
    mirrored = [deficit for deficit in result.lacking if deficit.curves == 1]
    entries += [(_MIRRORED, f"the same, mirrored to the {deficit.name}") for deficit in mirrored]
    entries += [(_NONE, f"{side.name} side: {_not(side)}") for side in result.absent]
    sheet.legend([*entries, *([(canvas.SKY, "rim seen in the photographs")] if evidence else [])])
    scene = result.scene
    colours = painted.colours if result.repaired is None else shown_colours(painted.colours, result.repaired)
    for index, view in enumerate(views):
        axes = sheet.panel(index, view.name)
        show(axes, scene.render(view, size_px=_OVERVIEW_PX, colours=colours, lit=False), view)
        for k, measured in enumerate(measurements):
            seen = np.asarray(evidence.get(measured.name, np.empty((0, 3))))
            if len(seen):
                near = seen[visible(seen, view, scene.cast(view, 2 * _OVERVIEW_PX), slack_mm=4.0)]
                axes.plot(*view.project(near)[:, :2].T, ".", color=canvas.SKY, markersize=1.5)
            curve(axes, scene, view, measured.boundary_world, canvas.CYCLE[k], size_px=_OVERVIEW_PX)
        for deficit in mirrored:
            curve(axes, scene, view, deficit.boundary_world, _MIRRORED, size_px=_OVERVIEW_PX)
        for side in result.absent:
            place = side.place_world[None]
            if visible(place, view, scene.cast(view, 2 * _OVERVIEW_PX), slack_mm=4.0)[0]:
                axes.plot(*view.project(place)[0, :2], "x", color=_NONE, markersize=9, markeredgewidth=2.2)
    absent = "".join(
        f" The cross marks the highest place of the {side.name} side: {_not(side)}." for side in result.absent
    )
    return sheet.png(
        "The surface and the boundary",
        "Standard views in photographic colours, all at one scale. The volume was measured within the "
        f"boundary, which is dashed where it is hidden. {WORDS}.{absent}",
    )


@preview("front", stage="measure", place=0, photographs=False)
def front(result: MeasureResult) -> bytes | None:
    """Both breasts with their boundaries from the front."""
    return _near(result, 0, _FRONT_PX)


@preview("from_right", stage="measure", place=0, photographs=False)
def from_right(result: MeasureResult) -> bytes | None:
    """Both breasts with their boundaries, from the patient's front right."""
    return _near(result, 1, _OBLIQUE_PX)


@preview("from_left", stage="measure", place=0, photographs=False)
def from_left(result: MeasureResult) -> bytes | None:
    """Both breasts with their boundaries, from the patient's front left."""
    return _near(result, 2, _OBLIQUE_PX)


def _near(result: MeasureResult, index: int, size_px: int) -> bytes | None:
    """One standard view of the breasts alone, without frame or legend."""
    if not (result.measurements or result.absent):
        return None
    view = _close_views(result)[index]
    scene = result.scene
    painted = result.textured
    colours = painted.colours if result.repaired is None else shown_colours(painted.colours, result.repaired)
    width, height = picture_wh(view, size_px)
    sheet = PanelSheet(1, 1, (width, height), bare=True)
    axes = sheet.panel(0)
    show(axes, scene.render(view, size_px=size_px, colours=colours, lit=False), view, bar=not index)
    for k, measured in enumerate(result.measurements):
        curve(axes, scene, view, measured.boundary_world, canvas.CYCLE[k], size_px=size_px, width=2.4)
    for side in result.absent:
        place = side.place_world[None]
        if visible(place, view, scene.cast(view, 2 * size_px), slack_mm=4.0)[0]:
            axes.plot(*view.project(place)[0, :2], "x", color=_NONE, markersize=13, markeredgewidth=3)
    name = view.name[:1].upper() + view.name[1:]
    return sheet.png(name, f"The boundary is dashed where it is hidden. {WORDS}.")


def _close_views(result: MeasureResult) -> tuple[ViewDirection, ...]:
    """Front view and both oblique views, close to the breasts, at the same scale."""
    whole = result.views[:3]
    points = np.concatenate(
        [
            *(measurement.boundary_world for measurement in result.measurements),
            *(side.place_world[None] for side in result.absent),
        ]
    )
    low, high = bounds(points @ result.frame.T)
    around = max(_AROUND * float(high[0] - low[0]), _ABOVE * float(high[1] - low[1]), _LEAST_MM)
    span = min(around, whole[0].span_mm[0]), min(around, whole[0].span_mm[1])
    centre = (low + high) / 2 @ result.frame
    return tuple(replace(view, centre_world=centre, span_mm=span) for view in whole)


@preview("closed", stage="measure", place=3, photographs=False, per_breast=True)
def closed(result: MeasureResult, measured: VolumeMeasurement) -> bytes:
    """The closed solid of which the volume was computed, in three views.

    Skin and wall are shown from the front, obliquely and from behind.
    """
    frame = result.frame
    turned = _turn(np.deg2rad(70.0)) @ frame
    behind = np.stack([-frame[0], frame[1], -frame[2]])
    views = views_of(measured.closed, {"front": frame, "from the side": turned, "from behind: the wall": behind})
    sheet = PanelSheet(3, 1, picture_wh(views[0], _PANEL_PX), header=26)
    sheet.legend(
        [
            (canvas.hexadecimal(_SKIN), "skin"),
            (canvas.hexadecimal(_WALL), f"wall: {measured.wall_kind}"),
            (canvas.INK, "boundary"),
        ]
    )
    scene = ShadedMesh(measured.closed)
    colours = np.where(wall_faces(measured)[:, None], np.array(_WALL), np.array(_SKIN)).astype(np.float32)
    for index, view in enumerate(views):
        axes = sheet.panel(index, view.name)
        show(axes, scene.render(view, size_px=_PANEL_PX, face_colours=colours), view)
        curve(axes, scene, view, measured.boundary_world, canvas.INK, size_px=_PANEL_PX)
    return sheet.png(
        f"The closed solid: {NAMES[measured.name]}",
        "The volume is that of this solid, between skin and wall. "
        f"The wall is {measured.wall_definition.strip().rstrip('.')}.",
    )


@preview("sections", stage="measure", place=4, photographs=False, per_breast=True)
def sections(result: MeasureResult, measured: VolumeMeasurement) -> bytes:
    """A horizontal and a vertical section of the closed breast, mm."""
    frame = result.frame
    point = _middle(measured)
    on_wall = wall_faces(measured)
    cuts = [("level section, seen from above", 1, (0, 2)), ("upright section, seen from the side", 0, (2, 1))]
    across = "right, mm" if result.body is None else "towards the patient's left, mm"
    labels = {0: across, 1: "up, mm", 2: "towards the cameras, mm"}
    reach = float(np.abs((measured.closed.vertices - point) @ frame.T).max()) * 1.08
    sheet = PanelSheet(2, 1, (380, 380), axes_room=(56, 42), header=26)
    sheet.legend([(_SKIN_LINE, "skin"), (_WALL_LINE, f"wall: {measured.wall_kind}")])
    for index, (title, normal, (axis_x, axis_y)) in enumerate(cuts):
        axes = sheet.panel(index, title, plain=False)
        segments, faces = section(measured.closed, point, frame[normal])
        drawn = ((segments - point) @ frame.T)[..., [axis_x, axis_y]]
        for chosen, colour in ((~on_wall[faces], _SKIN_LINE), (on_wall[faces], _WALL_LINE)):
            for line in join_segments(drawn[chosen]):
                axes.plot(*line.T, color=colour, linewidth=1.8, solid_capstyle="round")
        axes.set(xlim=(-reach, reach), ylim=(-reach, reach), xlabel=labels[axis_x], ylabel=labels[axis_y])
    return sheet.png(
        f"Sections: {NAMES[measured.name]}",
        "Two cuts through the middle of the closed breast. The volume is between the skin and the wall.",
    )


def curve(
    axes: Any,
    scene: ShadedMesh,
    view: ViewDirection,
    points_world: Float64[Array, "n 3"],
    colour: str,
    *,
    size_px: int,
    width: float = 1.8,
) -> None:
    """Draw a closed curve into a rendered view of that size, dashed where the mesh hides it."""
    drawn = even_curve(points_world, scene.mesh)
    loop = np.concatenate([drawn, drawn[:1]])
    seen = visible(loop, view, scene.cast(view, 2 * size_px))
    x, y, _ = view.project(loop).T
    axes.plot(x, y, color=colour, linewidth=width / 2, linestyle=(0, (2, 2)), alpha=0.8)
    axes.plot(
        np.where(seen, x, np.nan), y, color=colour, linewidth=width, path_effects=canvas.stroke("white", 1.7 * width)
    )


def _not(side: NoBreast) -> str:
    return "not measured" if side.unclear else "no breast"


def _middle(measured: VolumeMeasurement) -> Float64[Array, 3]:
    """Centre of gravity of the closed solid, mm, world frame."""
    origin = measured.boundary_world.mean(axis=0)
    a, b, c = np.moveaxis(measured.closed.corners() - origin, 1, 0)
    spats = np.einsum("ij,ij->i", a, np.cross(b, c))
    return origin + (spats[:, None] * (a + b + c)).sum(axis=0) / (4 * spats.sum())


def _turn(angle_rad: float) -> Float64[Array, "3 3"]:
    """Rotate the view's frame about its upward axis. A positive angle moves the viewer to the right."""
    sine, cosine = np.sin(angle_rad), np.cos(angle_rad)
    return np.array([[cosine, 0.0, -sine], [0.0, 1.0, 0.0], [sine, 0.0, cosine]])


_SYMMETRY_PANEL_PX = 300  # width of a panel, px; appearance only
_VIEW_PX = 520  # size at which a view is rendered, px; appearance only
_LEAST_DIFFERENCE_MM = 1.0  # least end of the scale, mm; appearance only
_TURN_DEG = 50.0  # rotation of the view from the outside; appearance only


@preview("symmetry", stage="measure", place=2, photographs=False)
def symmetry_map(result: MeasureResult) -> bytes | None:
    """Left and mirrored right breast from the same directions, coloured by which of the two is fuller."""
    symmetry = result.symmetry
    if symmetry is None:
        return None
    sides = {measured.name: measured for measured in result.measurements}
    frame = result.frame
    angle = np.deg2rad(_TURN_DEG)
    outwards = np.array([[np.cos(angle), 0, -np.sin(angle)], [0, 1, 0], [np.sin(angle), 0, np.cos(angle)]])
    frames = {"front": frame, "from the outside": outwards @ frame}
    limit_mm = reach_mm(symmetry)
    scale = canvas.diverging_scale(limit_mm)
    left, right = sides["left"], sides["right"]
    edge = symmetry.mirrored(right.boundary_world)
    skins = (
        ("left breast", _skin(left), symmetry.left_mm, left.boundary_world),
        ("right breast, mirrored", _skin(right).mapped(symmetry.mirrored).turned_over(), symmetry.right_mm, edge),
    )
    views = views_of(skins[0][1], frames, margin=1.12)  # the breasts are aligned, so the same views fit both
    sheet = PanelSheet(4, 1, picture_wh(views[0], _SYMMETRY_PANEL_PX), bars=True, header=26)
    sheet.legend(
        [
            (canvas.DIVERGING[-2], "fuller than the other one"),
            (canvas.DIVERGING[1], "less full"),
            (canvas.DIVERGING_MISSING, "no counterpart"),
        ]
    )
    for side, (title, skin, out_mm, boundary) in enumerate(skins):
        scene = ShadedMesh(skin)
        colours = canvas.coloured(out_mm, scale)
        for column, view in enumerate(views):
            axes = sheet.panel(2 * column + side, f"{title}, {view.name}")
            show(axes, scene.render(view, size_px=_VIEW_PX, colours=colours, lit=0.5), view)
            curve(axes, scene, view, boundary, canvas.INK, size_px=_VIEW_PX)
    moved_mm = float(np.linalg.norm(symmetry.shift_mm))
    sheet.bar(0, scale, "in front of the other one, mm", extend="both")
    return sheet.png(
        "Symmetry",
        f"The {NAMES['left']} and the mirrored right one, aligned with each other. Orange: fuller than the "
        f"other breast, blue: less full. The difference is {symmetry.rms_mm:.1f} mm RMS. The scale ends at "
        f"±{limit_mm:g} mm. The mirrored right breast was moved by {moved_mm:.0f} mm and turned by "
        f"{symmetry.turn_deg:.0f}°, so the map does not show their difference in place.",
    )


def reach_mm(symmetry: Symmetry) -> float:
    """Round end of the scale of a symmetry map, mm.

    98 % of both breasts are within it. It is at least 1 mm.
    """
    every_mm = np.concatenate([symmetry.left_mm, symmetry.right_mm])
    known_mm = np.abs(every_mm[np.isfinite(every_mm)])
    return canvas.rounded_up(max(float(np.quantile(known_mm, 0.98)) if len(known_mm) else 0.0, _LEAST_DIFFERENCE_MM))


def _skin(measured: VolumeMeasurement) -> TriangleMesh:
    """The closed solid without its wall. All vertices are kept, so that values keep their indices."""
    return TriangleMesh(vertices=measured.closed.vertices, faces=measured.closed.faces[~wall_faces(measured)])
