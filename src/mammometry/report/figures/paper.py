"""Figures 1 to 7 of the paper, drawn from any session, for print.

Text and lines are vectors. Pictures have 300 dpi.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mammometry.base.errors import SessionError
from mammometry.geometry import Array, Bool, Float64, TriangleMesh, UInt8
from mammometry.job.graph import Plan
from mammometry.job.stages import calibrate, match, surface
from mammometry.report.figures import canvas
from mammometry.report.figures.canvas import PanelSheet
from mammometry.report.figures.catalogue import Source, find_paper_figure, paper_figure
from mammometry.report.figures.matching import resampled
from mammometry.report.figures.shading import (
    ShadedMesh,
    ViewDirection,
    front_frame,
    join_segments,
    picture_wh,
    section,
    views_of,
)
from mammometry.report.figures.surface import show
from mammometry.surface.ranges.dents import DentGrid
from mammometry.surface.ranges.range_image import RangeImage
from mammometry.surface.ranges.visibility import Label

OF_SURFACE = ("7",)
"""Figures that need only the finished surface, so that a scan has them, too."""
FORMATS = (".pdf", ".svg", ".png")
_PANEL_PX = 250  # width of a panel, px; appearance only
_PRINT_PX = 900
"""Longer side of a picture inside a figure: 300 dpi on 75 mm."""
_SLAB_MM = 0.6  # half thickness of the section: points within this distance of it are drawn; appearance only
_ARROW_MM = 40.0  # length of the arrows towards the cameras; appearance only


def write_figure(number: int, source: Source, path: Path, subject: str | None = None) -> None:
    """Draw one of the paper's figures from a session and write it. Replaces an earlier one.

    Args:
        number: 1 to 7.
        source: the session's plan, inputs and settings.
        path: .pdf, .svg or .png.
        subject: identifier to store in the file, if any.

    Raises:
        SettingsError: the paper has no such figure.
        SessionError: figures 3 and 5 compare two pairs, and the session has one.
        StorageError: the existing file is not from this program, or the file cannot be written.
    """
    from mammometry.io.outputs import write_output

    write_output(path, find_paper_figure(number)(source).printed(path.suffix[1:], subject), command="figure")


@paper_figure(1)
def stereo_and_matching(source: Source) -> PanelSheet:
    """Fig. 1: stereo pair, disparities, confidence and range image, one row per pair."""
    plan, inputs, _ = source
    rig = plan[calibrate.cameras]().rig
    disparities = {pair: product() for pair, product in plan[match.disparity].items()}
    sheet = PanelSheet(
        6, len(disparities), canvas.fitting([disparity.valid.shape for disparity in disparities.values()], _PANEL_PX)
    )
    for row, (pair, disparity) in enumerate(disparities.items()):
        ranged = plan[surface.range_image][pair]()
        for side, (name, ideal) in enumerate(zip(rig.pair_names[pair], (disparity.left, disparity.right), strict=True)):
            axes = sheet.panel(6 * row + side, f"{pair}: {('left', 'right')[side]} picture")
            axes.imshow(resampled(inputs.photographs[name], rig.cameras[name], ideal, _PRINT_PX))
        maps = (
            ("d_H", disparity.pair_px * disparity.d_h_px, disparity.valid),
            ("d_V", disparity.pair_px * disparity.d_v_px, disparity.valid),
            ("confidence c", disparity.confidence, disparity.valid),
            ("range image", ranged.range_mm, ranged.valid),
        )
        for column, (title, values, valid) in enumerate(maps, start=2):
            low, high = canvas.robust_range(values[valid], 0.005)
            unit = {"d_H": " px", "d_V": " px", "range image": " mm"}.get(title, "")
            axes = sheet.panel(6 * row + column, f"{title}, {low:.3g} to {high:.3g}{unit}".replace("-", "−"))
            small = canvas.with_gaps(canvas.thinned(values, _PRINT_PX), canvas.thinned(valid, _PRINT_PX))
            axes.imshow(small, cmap=canvas.colour_map("gray"), vmin=low, vmax=high, interpolation="nearest")
    return sheet


@paper_figure(2)
def meshes_of_each_pair(source: Source) -> PanelSheet:
    """Fig. 2: mesh of each range image, with dents at depth discontinuities."""
    from mammometry.surface.fusion.fuse import extract_open

    plan, *_ = source
    images = [product() for product in plan[surface.range_image].values()]
    meshes = [extract_open([image]) for image in images]
    views = [_side(mesh, image) for mesh, image in zip(meshes, images, strict=True)]
    columns, rows = canvas.grid(len(meshes))
    sheet = PanelSheet(columns, rows, (_PANEL_PX, _PANEL_PX))
    for index, (mesh, image, view) in enumerate(zip(meshes, images, views, strict=True)):
        axes = sheet.panel(index, image.name)
        show(axes, ShadedMesh(mesh).render(view, size_px=_PRINT_PX), view)
    return sheet


@paper_figure(3)
def depth_discontinuity(source: Source) -> PanelSheet:
    """Fig. 3: section through two range images at a place where they disagree.

    It shows the directions to both perspective centres.
    """
    plan, _, _ = source
    rig = plan[calibrate.cameras]().rig
    images = _at_least_two(plan, 3)
    valid = {image.name: image for image in plan[surface.valid_patches]().range_images}
    repaired = plan[surface.repaired]().mesh
    frame = front_frame(rig)
    dropped = {image.name: image.valid & ~valid[image.name].valid for image in images}
    a, b, *_ = sorted(images, key=lambda image: -int(dropped[image.name].sum()))
    lost = a.points_world()[dropped[a.name]]
    middle = np.median(lost, axis=0) if len(lost) else repaired.vertices.mean(axis=0)
    sheet = PanelSheet(1, 1, (620, 420), axes_room=(64, 42), header=26)
    sheet.legend(
        [
            (canvas.BLUE, f"{a.name}, kept"),
            (canvas.SKY, f"{a.name}, dented"),
            (canvas.GREEN, f"{b.name}, kept"),
            (canvas.YELLOW, f"{b.name}, dented"),
            (canvas.INK, "repaired surface"),
        ]
    )
    axes = sheet.panel(0, "section across", plain=False)
    segments, _ = section(repaired, middle, frame[1])
    for line in join_segments(segments):
        axes.plot(*((line - middle) @ frame[[0, 2]].T).T, color=canvas.INK, linewidth=1.2)
    for image, kept, dented in ((a, canvas.BLUE, canvas.SKY), (b, canvas.GREEN, canvas.YELLOW)):
        for mask, colour in ((valid[image.name].valid, kept), (dropped[image.name], dented)):
            points = image.points_world()[mask] - middle
            near = points[np.abs(points @ frame[1]) < _SLAB_MM]
            axes.plot(near @ frame[0], near @ frame[2], ".", color=colour, markersize=2.2)
        towards = image.camera.centre_world - middle
        flat = np.array([towards @ frame[0], towards @ frame[2]])
        tip = flat / np.linalg.norm(flat) * _ARROW_MM
        axes.update_datalim([tip])
        axes.annotate(
            "", xy=tuple(tip), xytext=(0.0, 0.0), arrowprops={"arrowstyle": "->", "color": kept, "linewidth": 1.0}
        )
        axes.text(tip[0], tip[1], f" to {image.name}", fontsize=8, color=canvas.INK)
    axes.autoscale_view()
    axes.set(xlabel="across, mm", ylabel="towards the cameras, mm", aspect="equal")
    return sheet


@paper_figure(4)
def range_images(source: Source) -> PanelSheet:
    """Fig. 4: all range images at one scale, darker where nearer."""
    plan, _, _ = source
    images = [product() for product in plan[surface.range_image].values()]
    low, high = canvas.robust_range(np.concatenate([image.range_mm[image.valid] for image in images]), 0.002)
    columns, rows = canvas.grid(len(images))
    sheet = PanelSheet(columns, rows, canvas.fitting([image.valid.shape for image in images], _PANEL_PX), bars=True)
    drawn = None
    for index, image in enumerate(images):
        axes = sheet.panel(index, image.name)
        small = canvas.with_gaps(canvas.thinned(image.range_mm, _PRINT_PX), canvas.thinned(image.valid, _PRINT_PX))
        drawn = axes.imshow(small, cmap=canvas.colour_map("gray"), vmin=low, vmax=high, interpolation="nearest")
    for row in range(sheet.rows):
        sheet.bar(row, drawn, "distance to the camera, mm")
    return sheet


@paper_figure(5)
def decompositions(source: Source) -> PanelSheet:
    """Fig. 5: one range image decomposed against another.

    It is shown for several tolerances ε and threshold angles.
    """
    from mammometry.surface.ranges.dents import dent_grid

    plan, _, _ = source
    return draw_dent_grid(dent_grid(_at_least_two(plan, 5)))


@paper_figure(6)
def first_surface(source: Source) -> PanelSheet:
    """Fig. 6: the first surface, before the elastic repair."""
    plan, _, _ = source
    return _surface(plan, plan[surface.initial_surface]())


@paper_figure(7)
def repaired_surface(source: Source) -> PanelSheet:
    """Fig. 7: the surface after the elastic repair."""
    plan, _, _ = source
    return _surface(plan, plan[surface.repaired]().mesh)


def _at_least_two(plan: Plan, number: int) -> list[RangeImage]:
    images = [product() for product in plan[surface.range_image].values()]
    if len(images) < 2:
        remedy = "Draw it from a session of a rig with more pairs"
        expected = "two pairs, whose range images are compared"
        raise SessionError(
            f"figure {number}", found=f"one pair of cameras, {images[0].name}", expected=expected, remedy=remedy
        )
    return images


def _surface(plan: Plan, mesh: TriangleMesh) -> PanelSheet:
    cameras = plan.value(calibrate.cameras) or plan[surface.corrected_cameras]()  # a scan has only the viewer's camera
    frame = front_frame(cameras.rig)
    half = np.sqrt(0.5)
    turns = {
        "front": np.eye(3),
        "45° from the side": np.array([[half, 0, half], [0, 1, 0], [-half, 0, half]]),
        "45° from below": np.array([[1, 0, 0], [0, half, half], [0, -half, half]]),
    }
    views = views_of(mesh, {name: turn @ frame for name, turn in turns.items()})
    sheet = PanelSheet(3, 1, picture_wh(views[0], _PANEL_PX))
    scene = ShadedMesh(mesh)
    for index, view in enumerate(views):
        show(sheet.panel(index, view.name), scene.render(view, size_px=_PRINT_PX), view)
    return sheet


def _side(mesh: TriangleMesh, image: RangeImage) -> ViewDirection:
    """View of a pair's mesh at 50° to its camera's axis, which shows dents."""
    rows = image.camera.camera_from_world.rotation
    frame = np.stack([rows[0], -rows[1], -rows[2]])
    turn = np.radians(50.0)
    sideways = np.array([[np.cos(turn), 0, np.sin(turn)], [0, 1, 0], [-np.sin(turn), 0, np.cos(turn)]])
    return views_of(mesh, {image.name: sideways @ frame})[0]


_DENT_PANEL_PX = 210  # width of a panel, px; appearance only
_GREYS = {Label.BEHIND: 0.95, Label.OUTSIDE: 0.78, Label.IN_FRONT: 0.60, Label.OVERLAPPING: 0.38}
_MEANINGS = {
    Label.BEHIND: "behind (visible)",
    Label.OUTSIDE: "not seen by the other",
    Label.IN_FRONT: "in front (invisible)",
    Label.OVERLAPPING: "overlapping",
}


def draw_dent_grid(grid: DentGrid) -> PanelSheet:
    """Draw threshold angles as rows and ε as columns (Fig. 5).

    The greys are those of the paper. Removed data are black.
    """
    rows, columns = np.flatnonzero(grid.valid.any(axis=1)), np.flatnonzero(grid.valid.any(axis=0))
    window = (slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)) if len(rows) else (slice(None),) * 2
    shape = grid.valid[window].shape
    sheet = PanelSheet(len(grid.epsilons_mm), len(grid.angles_deg), canvas.fitting([shape], _DENT_PANEL_PX), header=26)
    entries = [(canvas.hexadecimal((grey,) * 3), _MEANINGS[label]) for label, grey in _GREYS.items()]
    sheet.legend([*entries, ("#000000", "removed"), (canvas.hexadecimal(canvas.MISSING), "no datum")])
    count = max(int(grid.valid.sum()), 1)
    for row, angle in enumerate(grid.angles_deg):
        for column, epsilon in enumerate(grid.epsilons_mm):
            axes = sheet.panel(row * len(grid.epsilons_mm) + column, f"{angle:g}°, ε = {epsilon:g} mm")
            kept = grid.kept[row, column]
            axes.imshow(
                _picture(grid.labels[column][window], grid.valid[window], kept[window]), interpolation="nearest"
            )
            canvas.note(axes, f"{100 * (1 - kept.sum() / count):.0f} % removed")
    return sheet


def _picture(
    labels: UInt8[Array, "h w"], valid: Bool[Array, "h w"], kept: Bool[Array, "h w"]
) -> Float64[Array, "h2 w2 3"]:
    labels, valid, kept = (canvas.thinned(array, 640) for array in (labels, valid, kept))
    grey = np.zeros(labels.shape)
    for label, value in _GREYS.items():
        grey[labels == label] = value
    grey[~kept] = 0.0
    return np.where(valid[..., None], grey[..., None], np.array(canvas.MISSING))
