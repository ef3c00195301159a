"""Picture of left against mirrored right: where each breast is fuller."""

from __future__ import annotations

import numpy as np

from mammometry.geometry.mesh import TriangleMesh
from mammometry.measure.shape.symmetry import Symmetry
from mammometry.measure.volume.measurement import VolumeMeasurement
from mammometry.report.figures.catalogue import preview
from mammometry.report.figures.drawing import canvas
from mammometry.report.figures.drawing.canvas import Caption, Sheet
from mammometry.report.figures.drawing.shading import Scene, picture_wh, views_of
from mammometry.report.figures.drawing.sides import NAMES, wall_faces
from mammometry.report.figures.measure import curve
from mammometry.report.figures.stage_results import MeasureResult
from mammometry.report.figures.surface import show

_PANEL_PX = 300  # width of a panel, px; chosen by eye
_VIEW_PX = 520  # size at which a view is rendered, px; chosen by eye
_LEAST_MM = 1.0  # least end of the scale, mm; chosen by eye
_TURN_DEG = 50.0  # of the view from the outside; chosen by eye


@preview("symmetry", stage="measure", place=2, photographs=False)
def symmetry_map(result: MeasureResult) -> bytes | None:
    """Left and mirrored right breast, coloured by which is fuller. Both are seen from the same directions."""
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
    views = views_of(skins[0][1], frames, margin=1.12)  # both lie on one another: the same views for both
    sheet = Sheet(4, 1, picture_wh(views[0], _PANEL_PX), bars=True, header=26)
    sheet.legend(
        [
            (canvas.DIVERGING[-2], "fuller than the other one"),
            (canvas.DIVERGING[1], "less full"),
            (canvas.DIVERGING_MISSING, "no counterpart"),
        ]
    )
    for side, (title, skin, out_mm, boundary) in enumerate(skins):
        scene = Scene(skin)
        colours = canvas.coloured(out_mm, scale)
        for column, view in enumerate(views):
            axes = sheet.panel(2 * column + side, f"{title}, {view.name}")
            show(axes, scene.render(view, size_px=_VIEW_PX, colours=colours, lit=0.5), view)
            curve(axes, scene, view, boundary, canvas.INK, size_px=_VIEW_PX)
    moved_mm = float(np.linalg.norm(symmetry.shift_mm))
    sheet.bar(0, scale, "in front of the other one, mm", extend="both")
    return sheet.png(
        Caption(
            title="Symmetry",
            text=f"The {NAMES['left']} and the mirrored right one, laid onto one another. Orange: fuller than the "
            f"other breast, blue: less full. The difference is {symmetry.rms_mm:.1f} mm RMS. The scale ends at "
            f"±{limit_mm:g} mm. The mirrored right breast was moved by {moved_mm:.0f} mm and turned by "
            f"{symmetry.turn_deg:.0f}°, so the map does not show their difference in place.",
        )
    )


def reach_mm(symmetry: Symmetry) -> float:
    """A round end for the scale of a symmetry's map, mm.

    98 % of both breasts lie within it. At least a millimetre.
    """
    every_mm = np.concatenate([symmetry.left_mm, symmetry.right_mm])
    known_mm = np.abs(every_mm[np.isfinite(every_mm)])
    return canvas.rounded_up(max(float(np.quantile(known_mm, 0.98)) if len(known_mm) else 0.0, _LEAST_MM))


def _skin(measured: VolumeMeasurement) -> TriangleMesh:
    """The closed solid without its wall. All its vertices stay, so that values keep their places."""
    return TriangleMesh(vertices=measured.closed.vertices, faces=measured.closed.faces[~wall_faces(measured)])
