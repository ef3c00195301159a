"""Pictures of what a refused run has found so far."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

import numpy as np

from mammometry.base.notices.words import NAMES
from mammometry.base.photograph import Photograph
from mammometry.calibration.detection.detect import Observations
from mammometry.geometry import TriangleMesh
from mammometry.geometry.arrays import Array, Bool, Float64
from mammometry.job.inputs import FinishedSurface
from mammometry.measure.boundary.boundary import Boundary
from mammometry.report.figures import canvas
from mammometry.report.figures.canvas import PanelSheet
from mammometry.report.figures.measure import curve
from mammometry.report.figures.shading import ShadedMesh, picture_wh, standard_views, views_of
from mammometry.report.figures.surface import show
from mammometry.surface.texture.unmeasured import WORDS, shown_colours

_PHOTOGRAPH_PX = 290  # width of a panel, px; appearance only
_TARGETS = 12  # number of views of the target that are shown; more would be too small
_VIEW_PX = 470  # size of a view, px; appearance only


def photographs_seen(
    photographs: Mapping[str, Photograph], blocks: Mapping[str, Bool[Array, "h w"]] | None = None
) -> bytes:
    """The photographs with their cameras' names, and the outlines that were found.

    Args:
        photographs: camera → photograph.
        blocks: camera → blocks that show the subject. None: it was not searched yet.
    """
    small = {camera: canvas.reduced(photographs[camera], _PHOTOGRAPH_PX) for camera in photographs}
    columns, rows = canvas.grid(len(small))
    sheet = PanelSheet(columns, rows, canvas.fitting([picture.shape for picture in small.values()], _PHOTOGRAPH_PX))
    for index, (camera, pixels) in enumerate(small.items()):
        axes = sheet.panel(index, camera)
        axes.imshow(pixels, interpolation="antialiased")
        if blocks is not None and camera in blocks:
            down, across = (
                np.linspace(0, size - 1, count)
                for size, count in zip(pixels.shape[:2], blocks[camera].shape, strict=True)
            )
            axes.contour(across, down, blocks[camera], levels=[0.5], colors=canvas.ORANGE, linewidths=1.1)
        elif blocks is not None:
            canvas.note(axes, "no outline: everything was matched")
    text = "With the outlines of the subject: only their inside is matched."
    return sheet.png("The photographs", "As they were brought." if blocks is None else text)


def targets_seen(
    photographs: Mapping[tuple[str, str], Photograph],
    looked: Mapping[str, Observations],
    suspects: Collection[tuple[str, str]] = (),
) -> bytes:
    """Photographs of the target with the points that were found on it.

    Shows suspects, if there are any, or else those with the fewest points first.

    Args:
        photographs: (pose, camera) → photograph. Those shown are read, one at a time.
        looked: pose → what was found in it.
        suspects: (pose, camera) of the photographs that contradict the others.
    """
    points = {
        (detection.pose, detection.camera): detection.uv for part in looked.values() for detection in part.detections
    }
    keys = [key for key in photographs if key in suspects or (not suspects and key[0] in looked)]
    shown = sorted(keys, key=lambda key: (len(points.get(key, ())), key))[:_TARGETS]
    small = []
    for key in shown:
        photograph = photographs[key]
        small.append((photograph.size_wh, canvas.reduced(photograph, _PHOTOGRAPH_PX)))
    columns, rows = canvas.grid(len(small))
    sheet = PanelSheet(columns, rows, canvas.fitting([picture.shape for _, picture in small], _PHOTOGRAPH_PX))
    for index, (key, (size_wh, pixels)) in enumerate(zip(shown, small, strict=True)):
        uv = points.get(key)
        seen = "no target found" if uv is None else f"{len(uv)} points"
        axes = sheet.panel(index, f"{key[1]}, pose {key[0]}: {seen}")
        axes.imshow(pixels, extent=canvas.pixel_extent(size_wh), interpolation="antialiased", aspect="auto")
        if uv is not None:
            axes.plot(*uv.T, ".", color=canvas.SKY, markersize=2.2)
    title = "The photographs that the others contradict" if suspects else "The target"
    part = "" if len(shown) == len(keys) else f" The {len(shown)} of {len(keys)} photographs with the fewest."
    return sheet.png(title, f"The points that were found on the target.{part}")


def surface_seen(
    finished: FinishedSurface, frame: Float64[Array, "3 3"], boundaries: Sequence[Boundary], *, of_patient: bool
) -> bytes:
    """The surface in standard views, with the curves found before the refusal.

    Args:
        finished: the repaired surface in its colours, world frame, mm.
        frame: right, up and towards the viewer of the front view, as rows, world frame.
        boundaries: boundaries on the surface. Empty if none was found.
        of_patient: whether the sides are a patient's own.
    """
    repaired = finished.repaired
    views = standard_views(repaired.mesh, frame, of_patient=of_patient)
    sheet = PanelSheet(2, 2, picture_wh(views[0], _VIEW_PX), header=26 if boundaries else 0)
    if boundaries:
        sheet.legend([(canvas.CYCLE[k], f"boundary, {NAMES[boundary.name]}") for k, boundary in enumerate(boundaries)])
    scene, colours = ShadedMesh(repaired.mesh), shown_colours(finished.textured.colours, repaired)
    for index, view in enumerate(views):
        axes = sheet.panel(index, view.name)
        show(axes, scene.render(view, size_px=_VIEW_PX, colours=colours, lit=False), view)
        for k, boundary in enumerate(boundaries):
            curve(axes, scene, view, boundary.points_world, canvas.CYCLE[k], size_px=_VIEW_PX)
    found = "A curve is dashed where it is hidden" if boundaries else "No boundary was found on it"
    return sheet.png("The surface", f"Standard views, all at one scale. {found}. {WORDS}.")


def directions_seen(mesh: TriangleMesh, fronts: Mapping[str, Float64[Array, "3 3"]]) -> bytes:
    """A scan seen from each side that may be its front.

    Args:
        mesh: the scan, mm.
        fronts: option that selects the side → right, up and towards the viewer, as rows.
    """
    views = views_of(mesh, dict(fronts))
    columns, rows = canvas.grid(len(views))
    sheet, scene = PanelSheet(columns, rows, picture_wh(views[0], _VIEW_PX)), ShadedMesh(mesh)
    for index, view in enumerate(views):
        show(sheet.panel(index, view.name), scene.render(view, size_px=_VIEW_PX), view)
    text = "Measure again with the option above the picture that shows the patient upright and from the front."
    return sheet.png("Which side is the front", text)
