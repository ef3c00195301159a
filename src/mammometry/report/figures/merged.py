"""Picture of several scans merged into one: the skin that each of them shows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mammometry.report.figures import canvas
from mammometry.report.figures.canvas import PanelSheet
from mammometry.report.figures.catalogue import preview
from mammometry.report.figures.shading import picture_wh, standard_views
from mammometry.report.figures.stage_results import MeasureResult
from mammometry.report.figures.surface import show

_PANEL_PX = 470  # size of a view, px; appearance only
_BELOW_RAD = np.deg2rad(-50.0)  # direction of the view from below, which shows the fold
_SEVERAL = canvas.GREY


@preview("merged", stage="measure", place=9, photographs=False)
def merged(result: MeasureResult) -> bytes | None:
    """Skin of each scan in its own colour, from the front and from below. None for a single scan."""
    if result.sources is None:
        return None
    right, up, ahead = result.frame
    below = np.stack(
        [
            right,
            np.cos(_BELOW_RAD) * up - np.sin(_BELOW_RAD) * ahead,
            np.cos(_BELOW_RAD) * ahead + np.sin(_BELOW_RAD) * up,
        ]
    )
    mesh = result.textured.mesh
    front = standard_views(mesh, result.frame, of_patient=result.body is not None)[0]
    views = front, replace(front, view_from_world=below)
    count = int(result.sources.max()).bit_length()
    bits = 1 << np.arange(count)
    single = [(canvas.CYCLE[k], f"scan {k + 1} alone") for k in range(count)]
    colours = np.tile(np.array(canvas.rgb(_SEVERAL), dtype=np.float32), (len(mesh.vertices), 1))
    for bit, (colour, _) in zip(bits, single, strict=True):
        colours[result.sources == bit] = canvas.rgb(colour)
    sheet = PanelSheet(2, 1, picture_wh(views[0], _PANEL_PX), header=26)
    sheet.legend([*single, (_SEVERAL, "several scans")])
    for index, (view, name) in enumerate(zip(views, ("front", "from below"), strict=True)):
        show(sheet.panel(index, name), result.scene.render(view, size_px=_PANEL_PX, colours=colours), view)
    return sheet.png(
        "The merged scans",
        "Each scan's skin, aligned with the first one. Grey: shown by several scans, and averaged.",
    )
