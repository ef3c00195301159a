"""Pictures of the surface: range images, dents, meshes, provenance, distance from the true surface."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from mammometry.geometry import Array, Float32, Float64, Rig, TriangleMesh, UInt8
from mammometry.report.figures import canvas
from mammometry.report.figures.canvas import PanelSheet
from mammometry.report.figures.catalogue import preview
from mammometry.report.figures.shading import ShadedMesh, ViewDirection, front_frame, picture_wh, standard_views
from mammometry.report.figures.stage_results import SurfaceResult
from mammometry.study.accuracy import ErrorMap
from mammometry.study.tables import thousands
from mammometry.surface.repair.repair import Provenance, RepairedSurface
from mammometry.surface.texture.unmeasured import WORDS, shown_colours

_PANEL_PX = 290  # width of a panel, px; appearance only

PROVENANCE_COLOURS: Mapping[Provenance, tuple[str, str]] = {
    Provenance.MEASURED: (canvas.BLUE, "measured: by at least one pair"),
    Provenance.REPAIRED: (canvas.SKY, "repaired: beside it"),
    Provenance.BRIDGED: (canvas.ORANGE, "bridged: closed over a gap"),
    Provenance.INVENTED: (canvas.GREY, "invented: no pair measured it"),
}


@preview("range", stage="surface", place=1, photographs=False, on_paper=True)
def range_images(result: SurfaceResult) -> bytes:
    """Each pair's range image in grey as in Fig. 1 of the paper, darker where nearer."""
    ranges = result.ranges
    low, high = canvas.robust_range(np.concatenate([range_image.ranges_mm for range_image in ranges]), 0.002)
    sheet = _map_sheet([range_image.size_wh[::-1] for range_image in ranges], bars=True)
    drawn: Any = None
    for index, range_image in enumerate(ranges):
        axes = sheet.panel(index, f"{range_image.name}: {thousands(len(range_image.ranges_mm))} points")
        drawn = axes.imshow(
            canvas.with_gaps(range_image.range_mm, range_image.valid),
            extent=canvas.pixel_extent(range_image.size_wh),
            cmap=canvas.colour_map("gray"),
            vmin=low,
            vmax=high,
            interpolation="nearest",
        )
        canvas.note(axes, f"median σ {range_image.sigma_median_mm or 0.0:.2f} mm")
    for row in range(sheet.rows):
        sheet.bar(row, drawn, "distance to the camera, mm")
    return sheet.png(
        "Range images", "Distance from the left camera to the surface, darker where nearer. Pale blue: no data."
    )


@preview("dents", stage="surface", place=2, photographs=False, on_paper=True)
def dents(result: SurfaceResult) -> bytes:
    """Range data that were kept, and those that were removed as dents."""
    sheet = _map_sheet([range_image.size_wh[::-1] for range_image in result.ranges], header=26)
    kept_colour, dropped_colour = canvas.rgb(canvas.BLUE), canvas.rgb(canvas.ORANGE)
    sheet.legend([(canvas.BLUE, "kept"), (canvas.ORANGE, "dropped"), (canvas.hexadecimal(canvas.MISSING), "no data")])
    for index, range_image in enumerate(result.ranges):
        share = 1 - range_image.kept_count / max(len(range_image.ranges_mm), 1)
        axes = sheet.panel(index, f"{range_image.name}: {100 * share:.1f} % dropped")
        picture = np.full((*range_image.valid.shape, 3), 1.0)
        picture[:] = canvas.MISSING
        picture[range_image.valid] = dropped_colour
        # Data are paler the closer they are to grazing, because that is what the rule tests.
        angle = np.nan_to_num(range_image.angles_rad, nan=0.0)[..., None]
        picture = np.where(
            range_image.kept[..., None], kept_colour + (1 - kept_colour) * np.clip(angle / np.pi, 0, 0.6), picture
        )
        axes.imshow(picture, extent=canvas.pixel_extent(range_image.size_wh), interpolation="nearest")
    return sheet.png(
        "Decomposition and dents",
        "Range data that other views contradict, or that were seen at grazing angles, are dropped before the "
        "views are merged. Paler blue: more turned away from the camera.",
    )


@preview("repair", stage="surface", place=3, photographs=False, on_paper=True)
def repair(result: SurfaceResult) -> bytes:
    """The first mesh (above) and the repaired one (below), from the same views."""
    views = result.views
    sheet = _view_sheet(views, rows=2)
    for row, (title, drawn) in enumerate((("first mesh", ShadedMesh(result.first)), ("repaired", result.scene))):
        for column, view in enumerate(views):
            axes = sheet.panel(row * len(views) + column, f"{title}, {view.name}")
            show(axes, drawn.render(view, size_px=_PANEL_PX), view)
            if column == 0:
                canvas.note(axes, f"{thousands(len(drawn.mesh.faces))} triangles")
    return sheet.png(
        "First and repaired mesh",
        "Above: the first watertight surface (2.5 of the paper). Below: after the elastic repair (2.6.3).",
    )


@preview("provenance", stage="surface", place=4, photographs=False, on_paper=True)
def provenance(result: SurfaceResult) -> bytes:
    """Provenance of the surface, and the expected error of measured parts."""
    repaired, scene, views = result.repaired, result.scene, result.views
    sheet = _view_sheet(views, rows=2, bars=True, header=26)
    shares = provenance_shares(repaired)
    sheet.legend(
        [(colour, f"{meaning} ({100 * shares[kind]:.1f} %)") for kind, (colour, meaning) in PROVENANCE_COLOURS.items()]
    )
    palette = np.array([canvas.rgb(PROVENANCE_COLOURS[kind][0]) for kind in sorted(Provenance)], dtype=np.float32)
    kinds = palette[repaired.provenance]
    measured = np.isfinite(repaired.sigma_mm)
    high = max(float(np.quantile(repaired.sigma_mm[measured], 0.98)) if measured.any() else 0.0, 0.01)
    import matplotlib as mpl

    scaled = np.clip(np.nan_to_num(repaired.sigma_mm, nan=0.0) / high, 0, 1)
    errors = np.asarray(mpl.colormaps["magma_r"](scaled))[:, :3].astype(np.float32)
    errors[~measured] = canvas.MISSING
    for index, view in enumerate(views):
        show(sheet.panel(index, view.name), scene.render(view, size_px=_PANEL_PX, colours=kinds), view)
        axes = sheet.panel(len(views) + index, f"expected error, {view.name}")
        show(axes, scene.render(view, size_px=_PANEL_PX, colours=errors), view)
    scale = mpl.cm.ScalarMappable(norm=mpl.colors.Normalize(0, high), cmap="magma_r")
    sheet.bar(1, scale, "σ along the normal, mm")
    return sheet.png(
        "Provenance",
        "Above: origin of each part of the surface, in shares of the area. Below: expected standard "
        "deviation of the measured part. Without colour: not measured.",
    )


@preview("views", stage="surface", place=6, photographs=False)
def textured(result: SurfaceResult) -> bytes:
    """The surface with its photographic colours."""
    scene, views = result.scene, result.views
    sheet = _view_sheet(views, rows=1)
    colours = shown_colours(result.textured.colours, result.repaired)
    for index, view in enumerate(views):
        axes = sheet.panel(index, view.name)
        show(axes, scene.render(view, size_px=_PANEL_PX, colours=colours, lit=False), view)
    text = f"The surface in its photographic colours, all views at one scale. {WORDS}."
    return sheet.png("Standard views", text)


@preview("convergence", stage="surface", place=5, photographs=False)
def convergence(result: SurfaceResult) -> bytes:
    """Displacement of the vertices in each round of the repair."""
    repaired = result.repaired
    sheet = PanelSheet(1, 1, (420, 220), axes_room=(64, 42))
    axes = sheet.panel(0, "elastic repair", plain=False)
    rounds = np.arange(1, len(repaired.convergence) + 1)
    axes.plot(rounds, repaired.convergence, "o-", color=canvas.BLUE, linewidth=1.4, markersize=5)
    for number, moved in zip(rounds, repaired.convergence, strict=True):
        axes.annotate(
            f"{moved:.3g}", (number, moved), xytext=(6, 5), textcoords="offset points", fontsize=8, color=canvas.INK
        )
    high = float(repaired.convergence.max(initial=0.0))
    axes.set(
        xlim=(0.7, len(rounds) + 0.5),
        ylim=(0, 1.2 * high or 1.0),
        xlabel="round",
        ylabel="RMS movement, mm",
        xticks=rounds,
    )
    return sheet.png("Convergence", "Root mean square movement of all vertices in each round of the elastic repair.")


def provenance_shares(repaired: RepairedSurface) -> dict[Provenance, float]:
    """Share of the surface's area with each provenance. A third of a face counts for each of its corners."""
    areas = np.linalg.norm(repaired.mesh.face_vectors(), axis=1)
    weights = np.bincount(
        repaired.provenance[repaired.mesh.faces].ravel(), np.repeat(areas / 3, 3), minlength=len(Provenance)
    )
    return {kind: float(weights[kind] / max(areas.sum(), 1e-12)) for kind in Provenance}


def show(axes: Any, picture: UInt8[Array, "h w 4"], view: ViewDirection, *, bar: bool = True) -> None:
    """Draw a rendered mesh into a panel with mm axes and a scale bar."""
    axes.set_axis_off()
    axes.imshow(picture, extent=view.extent_mm, interpolation="antialiased")
    axes.set(xlim=view.extent_mm[:2], ylim=view.extent_mm[2:])
    if bar:
        canvas.scale_bar(axes, view.extent_mm)


def _view_sheet(views: Sequence[ViewDirection], *, rows: int, bars: bool = False, header: int = 0) -> PanelSheet:
    return PanelSheet(len(views), rows, picture_wh(views[0], _PANEL_PX), bars=bars, header=header)


def _map_sheet(shapes: Sequence[tuple[int, ...]], *, bars: bool = False, header: int = 0) -> PanelSheet:
    columns, rows = canvas.grid(len(shapes))
    return PanelSheet(columns, rows, canvas.fitting(shapes, 270), bars=bars, header=header)


_ERROR_PANEL_PX = 330  # width of a panel, px; appearance only
_VIEW_PX = 600  # size at which a view is rendered, px; appearance only
_MAP = "RdBu_r"
"""Diverging colours that people with common colour blindness can distinguish (ColorBrewer): blue inside, red
outside."""
_NOT_JUDGED = canvas.rgb("#b9b39b")
_LEAST_MM = 0.05  # least end of the scale, mm: about the noise of the surface; appearance only


def error_map(
    rig: Rig,
    mesh: TriangleMesh,
    errors: ErrorMap,
    *,
    patient_left_world: Float64[Array, 3] | None = None,
    title: str = "Distance from the true surface",
) -> bytes:
    """The measured surface in four views, coloured by its signed distance from the true one.

    Args:
        rig: rig from which the viewing directions are derived.
        mesh: the measured surface, world frame, mm.
        errors: errors of its vertices.
        patient_left_world: direction towards the patient's left, if both breasts are known.
        title: title of the picture.
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
    scene = ShadedMesh(mesh)
    sheet = PanelSheet(2, 2, picture_wh(views[0], _ERROR_PANEL_PX), bars=True, header=26)
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
        title,
        "Signed distance of the measured surface from the true one, mm: red is outside, blue inside. The "
        f"scale ends at ±{limit_mm:g} mm, which includes 98 % of the judged surface. Sand: not judged, no pair "
        "sees it.",
    )


def _scale(limit_mm: float) -> Any:
    import matplotlib as mpl

    return mpl.cm.ScalarMappable(norm=mpl.colors.Normalize(-limit_mm, limit_mm), cmap=_MAP)
