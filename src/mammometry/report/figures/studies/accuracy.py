"""Picture of a measured surface's distance from the true one."""

from __future__ import annotations

from typing import Any

import numpy as np

from mammometry.geometry.arrays import Array, Float32, Float64
from mammometry.geometry.camera import Rig
from mammometry.geometry.mesh import TriangleMesh
from mammometry.report.figures.drawing import canvas
from mammometry.report.figures.drawing.canvas import Caption, Sheet
from mammometry.report.figures.drawing.shading import Scene, front_frame, picture_wh, standard_views
from mammometry.report.figures.surface import show
from mammometry.study.accuracy import ErrorMap

_PANEL_PX = 330  # width of a panel, px; chosen by eye
_VIEW_PX = 600  # size at which a view is rendered, px; chosen by eye
_MAP = "RdBu_r"
"""Diverging colours that all common kinds of colour vision distinguish (ColorBrewer): blue inside, red outside."""
_NOT_JUDGED = canvas.rgb("#b9b39b")
_LEAST_MM = 0.05  # least end of the scale, mm: about the noise of the surface; chosen by eye


def error_map(
    rig: Rig,
    mesh: TriangleMesh,
    errors: ErrorMap,
    *,
    patient_left_world: Float64[Array, 3] | None = None,
    title: str = "Distance from the true surface",
) -> bytes:
    """Measured surface in four views, coloured by signed distance from the truth.

    Args:
        rig: for the directions to look from.
        mesh: the measured surface, world frame, mm.
        errors: its vertices' errors.
        patient_left_world: direction towards the patient's left, where both breasts are known.
        title: of the picture.
    """
    frame = front_frame(rig, patient_left_world=patient_left_world)
    views = standard_views(mesh, frame, of_patient=patient_left_world is not None)
    sizes = np.abs(errors.signed_mm[errors.judged])
    limit_mm = canvas.rounded_up(max(float(np.quantile(sizes, 0.98)) if len(sizes) else 0.0, _LEAST_MM))
    scale = _scale(limit_mm)
    colours: Float32[Array, "n 3"] = np.asarray(scale.to_rgba(np.nan_to_num(errors.signed_mm)))[:, :3].astype(
        np.float32
    )
    colours[~errors.judged] = _NOT_JUDGED
    scene = Scene(mesh)
    sheet = Sheet(2, 2, picture_wh(views[0], _PANEL_PX), bars=True, header=26)
    sheet.legend(
        [
            (canvas.hexadecimal(scale.to_rgba(0.8 * limit_mm)[:3]), "outside the true surface"),
            (canvas.hexadecimal(scale.to_rgba(-0.8 * limit_mm)[:3]), "inside"),
            (canvas.hexadecimal(tuple(_NOT_JUDGED)), "not judged: seen by no pair"),
        ]
    )
    for index, view in enumerate(views):
        show(sheet.panel(index, view.name), scene.render(view, size_px=_VIEW_PX, colours=colours), view)
    for row in range(2):
        sheet.bar(row, scale, "distance from the true surface, mm", extend="both")
    return sheet.png(
        Caption(
            title=title,
            text="Signed distance of the measured surface from the true one, mm: red lies outside, blue inside. The "
            f"scale ends at ±{limit_mm:g} mm, which includes 98 % of the judged surface. Sand: not judged, no pair "
            "sees it.",
        )
    )


def _scale(limit_mm: float) -> Any:
    import matplotlib as mpl

    return mpl.cm.ScalarMappable(norm=mpl.colors.Normalize(-limit_mm, limit_mm), cmap=_MAP)
