"""Pictures of the calibration: detections, residuals, camera positions, and the later drift of a rig."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from mammometry.calibration.adjust.calibrated import Calibration
from mammometry.calibration.detection.detect import Detection
from mammometry.calibration.judge import expected_error as judge
from mammometry.calibration.judge.expected_error import middle_world
from mammometry.geometry import Array, Camera, Float64, Rig
from mammometry.report.figures import canvas
from mammometry.report.figures.canvas import PanelSheet
from mammometry.report.figures.catalogue import preview
from mammometry.report.figures.shading import front_frame
from mammometry.report.figures.stage_results import CalibrationResult
from mammometry.study.tables import thousands

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from mammometry.io.drift import DriftEntry


_PANEL_PX = 290  # width of a panel, px; appearance only
_FIELD_CELLS = (9, 6)  # columns and rows of cells, which are square on pictures of 3:2
_LEAST_IN_CELL = 3  # fewest points for a mean residual; appearance only


@preview("detections", stage="calibrate", place=2, photographs=True, on_paper=True)
def detections(result: CalibrationResult) -> bytes | None:
    """Each camera's worst view with detected points and enlarged residuals.

    One photograph per camera is read.
    """
    calibration = result.calibration
    if calibration is None:
        return None
    shown = _worst_views(calibration)
    lengths = [np.linalg.norm(residuals, axis=1) for _, residuals in shown.values()]
    typical_px = float(np.nanquantile(np.concatenate(lengths), 0.95)) if lengths else 1.0
    key_px = canvas.round_length(max(typical_px, 1e-4) * 1.5)
    columns, rows = canvas.grid(len(shown))
    sheet = PanelSheet(columns, rows, _panel_wh(calibration.rig), header=26)
    sheet.legend(
        [(canvas.SKY, "detected point"), (canvas.ORANGE, "residual, enlarged"), (canvas.VERMILION, "left out")]
    )
    for index, (camera, (detection, residuals)) in enumerate(shown.items()):
        size_wh = calibration.observations.sizes_wh[camera]
        axes = sheet.panel(index, f"{camera}, pose {detection.pose}: RMS {_rms(residuals):.3f} px")
        picture = canvas.reduced(result.photographs[detection.pose, camera], _PANEL_PX)
        axes.imshow(picture, extent=canvas.pixel_extent(size_wh), interpolation="antialiased", aspect="auto")
        enlarged = 0.06 * size_wh[0] / key_px
        used = np.isfinite(residuals).all(axis=1)
        axes.plot(*detection.uv[used].T, ".", color=canvas.SKY, markersize=2.2)
        axes.plot(*detection.uv[~used].T, "x", color=canvas.VERMILION, markersize=4)
        _arrows(axes, detection.uv[used], residuals[used] * enlarged)
        _arrow_key(axes, size_wh, enlarged, key_px)
        _fix(axes, size_wh)
    return sheet.png(
        "Detections and residuals",
        "Each camera's worst view: the detected points of the target, and their distances from the calibrated "
        "projections. The bar in each picture is the scale of the arrows.",
    )


@preview("residuals", stage="calibrate", place=3, photographs=False)
def residuals(result: CalibrationResult) -> bytes | None:
    """Scatter of all residuals, and their RMS by camera and pose."""
    calibration = result.calibration
    if calibration is None:
        return None
    seen = calibration.observations.detections
    used = [part[np.isfinite(part).all(axis=1)] for part in calibration.residuals_px]
    everything = np.concatenate(used) if used else np.empty((0, 2))
    cameras = {name: _rms_where(seen, used, camera=name) for name in calibration.observations.cameras}
    poses = {name: _rms_where(seen, used, pose=name) for name in calibration.observations.poses}
    sheet = PanelSheet(3, 1, (300, 290), axes_room=(96, 40))
    axes = sheet.panel(0, f"{thousands(len(everything))} residuals", plain=False)
    limit = 1.15 * float(np.quantile(np.abs(everything), 0.999)) if len(everything) else 1.0
    axes.hexbin(
        *everything.T, gridsize=41, extent=(-limit, limit, -limit, limit), bins="log", cmap="Blues", linewidths=0.1
    )
    angles = np.linspace(0, 2 * np.pi, 200)
    axes.plot(
        calibration.rms_px * np.cos(angles), calibration.rms_px * np.sin(angles), color=canvas.VERMILION, linewidth=1.2
    )
    canvas.note(axes, f"circle: RMS {calibration.rms_px:.3f} px")
    axes.set(xlim=(-limit, limit), ylim=(limit, -limit), xlabel="Δu, px", ylabel="Δv, px (down)")
    _bars(sheet.panel(1, "RMS of each camera", plain=False), cameras, calibration.rms_px)
    _bars(sheet.panel(2, "RMS of each pose", plain=False), poses, calibration.rms_px)
    return sheet.png(
        "Reprojection residuals",
        "Projected minus measured positions of all points that were used, and their root mean square for each "
        "camera and pose. The line marks the root mean square of all.",
    )


@preview("residual-field", stage="calibrate", place=4, photographs=False, on_paper=True)
def residual_field(result: CalibrationResult) -> bytes | None:
    """Mean residuals in cells of each camera's image, which show systematic errors."""
    from matplotlib.ticker import MaxNLocator

    calibration = result.calibration
    if calibration is None:
        return None
    cameras = calibration.observations.cameras
    fields = {name: _field(calibration, name) for name in cameras}
    lengths = np.concatenate([np.linalg.norm(mean, axis=1) for _, mean, _ in fields.values()])
    key_px = canvas.round_length(max(float(np.quantile(lengths, 0.9)), 1e-4) * 1.5) if len(lengths) else 1.0
    columns, rows = canvas.grid(len(cameras))
    sheet = PanelSheet(columns, rows, _panel_wh(calibration.rig), bars=True)
    drawn = None
    most = max([int(counts.max()) for _, _, counts in fields.values()], default=1)
    for index, (name, (centres, mean, counts)) in enumerate(fields.items()):
        size_wh = calibration.observations.sizes_wh[name]
        axes = sheet.panel(index, name)
        drawn = axes.imshow(
            counts, extent=canvas.pixel_extent(size_wh), cmap="Greys", vmin=0, vmax=1.6 * most, aspect="auto"
        )
        enlarged = 0.08 * size_wh[0] / key_px
        _arrows(axes, centres, mean * enlarged)
        _arrow_key(axes, size_wh, enlarged, key_px, dark=True)
        _fix(axes, size_wh)
    if drawn is not None:
        for row in range(rows):
            sheet.bar(
                row,
                drawn,
                "points in a cell",
                boundaries=np.linspace(0, most, 33),
                values=np.linspace(0, most, 32),
                ticks=MaxNLocator(5, integer=True),
            )
    return sheet.png(
        "Residual field and coverage",
        "Mean residual of all poses in cells of each photograph (arrows) over the number of target points "
        "seen there (grey). Arrows that follow a pattern mean a lens that the model does not describe. White "
        "corners were never tested.",
    )


@preview("expected-error", stage="calibrate", place=5, photographs=False)
def expected_error(result: CalibrationResult) -> bytes | None:
    """Each pair's expected error in the working volume, along the world's axes."""
    if result.calibration is None:
        return None
    expected = judge.expected_error(result.calibration)
    count = len(expected.std_mm)
    sheet = PanelSheet(3, count, (250, 210), axes_room=(60, 40), bars=True)
    grid = expected.volume.grid_world
    everything = np.stack(list(expected.std_mm.values())) if count else np.empty(0)
    most = float(np.nanquantile(everything, 0.95)) if np.isfinite(everything).any() else 1.0
    for row, (pair, volume) in enumerate(expected.std_mm.items()):
        drawn = None
        for column, axis in enumerate((2, 1, 0)):
            across, up = (other for other in range(3) if other != axis)
            seen = np.isfinite(volume)
            total, number = np.where(seen, volume**2, 0.0).sum(axis=axis), seen.sum(axis=axis)
            picture = np.where(number > 0, np.sqrt(total / np.maximum(number, 1)), np.nan)
            axes = sheet.panel(
                3 * row + column, f"{pair}: RMS {expected.rms_mm[pair]:.3f} mm" if not column else "", plain=False
            )
            low, high = grid[0, 0, 0], grid[-1, -1, -1]
            drawn = axes.imshow(
                picture.T,
                extent=(low[across], high[across], low[up], high[up]),
                origin="lower",
                cmap="cividis",
                vmin=0,
                vmax=most,
                aspect="auto",
                interpolation="bilinear",
            )
            axes.set(xlabel=f"{'xyz'[across]}, mm", ylabel=f"{'xyz'[up]}, mm")
            axes.grid(False)
        if drawn is not None:
            sheet.bar(row, drawn, "mm")
    return sheet.png(
        "Expected error of the calibration",
        "Standard deviation of points that each pair reconstructs, from the uncertainty of the cameras, over "
        "the working volume: RMS along the world's z, y and x. Next to the pair's name: its RMS where the target "
        "was shown. Motions of the whole change no shape and are left out. So is its scale, which is the target's.",
    )


@preview("rig", stage="calibrate", place=1, photographs=False)
def rig_views(result: CalibrationResult) -> bytes:
    """Cameras, pairs and target positions from the front, above and the side."""
    rig, calibration = result.rig, result.calibration
    frame = front_frame(rig)
    points = [camera.centre_world for camera in rig.cameras.values()]
    targets = []
    if calibration is not None:
        outline = calibration.target_points[_hull(calibration.target_points)]
        targets = [placed.apply(outline) for placed in calibration.world_from_target.values()]
    origin = middle_world(rig)
    centred = np.stack([*points, origin, *(corner for target in targets for corner in target)]) - origin
    reach = float(np.abs(centred @ frame.T).max()) * 1.18
    sheet = PanelSheet(3, 1, (330, 330), axes_room=(52, 40), header=26)
    colours = dict(zip(rig.pair_names, ([*canvas.CYCLE] * 8), strict=False))
    sheet.legend([(colours[name], f"pair {name}") for name in list(rig.pair_names)[:8]])
    for index, (title, axis_x, axis_y, names) in enumerate(
        (
            ("from the front", 0, 1, ("right, mm", "up, mm")),
            ("from above", 0, 2, ("right, mm", "towards the cameras, mm")),
            ("from the side", 2, 1, ("towards the cameras, mm", "up, mm")),
        )
    ):
        axes = sheet.panel(index, title, plain=False)
        for target in targets:
            closed = ((np.concatenate([target, target[:1]]) - origin) @ frame.T)[:, [axis_x, axis_y]]
            axes.plot(*closed.T, color=canvas.GREY, linewidth=0.7)
        for pair, (left, right) in rig.pair_names.items():
            ends = (np.stack([rig.cameras[name].centre_world for name in (left, right)]) - origin) @ frame.T
            axes.plot(ends[:, axis_x], ends[:, axis_y], color=colours[pair], linewidth=2.2)
            for name in (left, right):
                for line in _frustum(rig.cameras[name], 0.16 * reach):
                    drawn = (line - origin) @ frame.T
                    axes.plot(drawn[:, axis_x], drawn[:, axis_y], color=colours[pair], linewidth=0.8)
        axes.set(xlim=(-reach, reach), ylim=(-reach, reach), xlabel=names[0], ylabel=names[1])
    return sheet.png(
        "The rig",
        "Cameras (pyramids open in the viewing direction) and their pairs"
        + (", and the places where the target was held (grey)" if targets else "")
        + (". The origin is the middle of those." if targets else ". The origin is where their axes meet."),
    )


def _worst_views(calibration: Calibration) -> dict[str, tuple[Detection, Float64[Array, "n 2"]]]:
    worst: dict[str, tuple[Detection, Float64[Array, "n 2"]]] = {}
    for detection, residuals in zip(calibration.observations.detections, calibration.residuals_px, strict=True):
        before = worst.get(detection.camera)
        if np.isfinite(residuals).any() and (before is None or _rms(residuals) > _rms(before[1])):
            worst[detection.camera] = detection, residuals
    return {name: worst[name] for name in calibration.observations.cameras if name in worst}


def _field(
    calibration: Calibration, camera: str
) -> tuple[Float64[Array, "k 2"], Float64[Array, "k 2"], Float64[Array, "rows columns"]]:
    """Cell centres, mean residuals in cells with enough points, and points per cell."""
    parts = [
        (detection.uv, residuals)
        for detection, residuals in zip(calibration.observations.detections, calibration.residuals_px, strict=True)
        if detection.camera == camera
    ]
    uv, values = (np.concatenate(side) for side in zip(*parts, strict=True))
    used = np.isfinite(values).all(axis=1)
    uv, values = uv[used], values[used]
    columns, rows = _FIELD_CELLS
    size = np.array(calibration.observations.sizes_wh[camera], dtype=np.float64)
    cell = np.clip(((uv + 0.5) / size * (columns, rows)).astype(np.int64), 0, (columns - 1, rows - 1))
    number = cell[:, 1] * columns + cell[:, 0]
    counts = np.bincount(number, minlength=columns * rows).astype(np.float64)
    sums = np.stack([np.bincount(number, values[:, axis], minlength=columns * rows) for axis in (0, 1)], axis=1)
    enough = np.flatnonzero(counts >= _LEAST_IN_CELL)
    centres = (np.stack([enough % columns, enough // columns], axis=1) + 0.5) / (columns, rows) * size - 0.5
    return centres, sums[enough] / counts[enough, None], counts.reshape(rows, columns)


def _rms(residuals: Float64[Array, "n 2"]) -> float:
    lengths = np.sum(residuals**2, axis=1)
    return float(np.sqrt(np.nanmean(lengths))) if np.isfinite(lengths).any() else 0.0


def _rms_where(
    seen: tuple[Detection, ...],
    used: list[Float64[Array, "_ 2"]],
    *,
    camera: str | None = None,
    pose: str | None = None,
) -> float:
    chosen = [
        residuals
        for detection, residuals in zip(seen, used, strict=True)
        if camera in (None, detection.camera) and pose in (None, detection.pose)
    ]
    return _rms(np.concatenate(chosen)) if chosen else 0.0


def _bars(axes: Axes, values: Mapping[str, float], overall: float) -> None:
    names = list(values)
    axes.barh(range(len(names)), list(values.values()), color=canvas.BLUE, height=0.7)
    axes.axvline(overall, color=canvas.VERMILION, linewidth=1.2)
    every = max(1, -(-len(names) // 24))
    axes.set_yticks(range(0, len(names), every), [name[:16] for name in names[::every]])
    axes.set(ylim=(len(names) - 0.4, -0.6), xlabel="RMS, px", xlim=(0, None))
    axes.locator_params(axis="x", nbins=4)
    axes.xaxis.set_major_formatter("{x:g}")
    axes.locator_params(axis="x", nbins=5)
    axes.grid(False, axis="y")


def _arrows(axes: Axes, uv: Float64[Array, "n 2"], steps: Float64[Array, "n 2"]) -> None:
    axes.quiver(
        *uv.T, *steps.T, angles="xy", scale_units="xy", scale=1, color=canvas.ORANGE, width=0.0045, headwidth=3.2
    )


def _arrow_key(axes: Axes, size_wh: tuple[int, int], enlarged: float, key_px: float, *, dark: bool = False) -> None:
    x, y = 0.03 * size_wh[0], 0.955 * size_wh[1]
    ink, outline = (canvas.INK, "white") if dark else ("white", canvas.INK)
    axes.plot([x, x + key_px * enlarged], [y, y], color=ink, linewidth=2, path_effects=canvas.stroke(outline, 3.5))
    axes.text(
        x,
        y - 0.02 * size_wh[1],
        f"{key_px:g} px",
        color=ink,
        fontsize=8,
        va="bottom",
        path_effects=canvas.stroke(outline, 2),
    )


def _fix(axes: Axes, size_wh: tuple[int, int]) -> None:
    left, right, bottom, top = canvas.pixel_extent(size_wh)
    axes.set(xlim=(left, right), ylim=(bottom, top))


def _panel_wh(rig: Rig) -> tuple[int, int]:
    ratio = max(camera.size_wh[1] / camera.size_wh[0] for camera in rig.cameras.values())
    return (_PANEL_PX, round(_PANEL_PX * ratio)) if ratio <= 1 else (round(_PANEL_PX / ratio), _PANEL_PX)


def _frustum(camera: Camera, length_mm: float) -> list[Float64[Array, "n 3"]]:
    width, height = camera.size_wh
    corners = np.array([(0, 0), (width, 0), (width, height), (0, height)], dtype=np.float64) - 0.5
    centre = camera.centre_world
    rim = centre + camera.rays_world(corners) * length_mm
    return [np.concatenate([rim, rim[:1]]), *(np.stack([centre, corner]) for corner in rim)]


def _hull(points: Float64[Array, "n 3"]) -> Array:
    """Indices of the points on the target's outline.

    The outline is the convex hull of a flat target, or of a round one seen along its axis.
    """
    from scipy.spatial import ConvexHull, QhullError

    centred = points - points.mean(axis=0)
    axes = np.linalg.svd(centred, full_matrices=False)[2][:2]
    try:
        return ConvexHull(centred @ axes.T).vertices
    except QhullError:
        return np.arange(len(points))


_COLOURS = {"unmoved": canvas.BLUE, "moved": canvas.ORANGE, "refuse": canvas.VERMILION}
_MOST_LABELS = 8  # most checks whose dates fit below the plot


def drift(entries: Sequence[DriftEntry], limit_mm: float) -> bytes:
    """Camera displacement in each check, and the resulting measurement errors.

    Args:
        entries: the history, oldest first, at least one entry.
        limit_mm: displacement of measured points above which the calibration must not be used.
    """
    cameras = list(dict.fromkeys(name for entry in entries for name in entry.cameras))
    colours = [*canvas.CYCLE] * (1 + len(cameras) // len(canvas.CYCLE))
    sheet = PanelSheet(2, 1, (430, 280), axes_room=(52, 52), header=26)
    sheet.legend(list(zip(colours, cameras, strict=False)))
    axes = sheet.panel(0, "Target displaced in each camera's picture", plain=False)
    for colour, name in zip(colours, cameras, strict=False):
        seen = [(i, entry.cameras[name]) for i, entry in enumerate(entries) if name in entry.cameras]
        axes.plot([i for i, _ in seen], [check.shift_px for _, check in seen], "-", color=colour, linewidth=1.1)
        for moved, marker in ((False, "o"), (True, "s")):
            chosen = [(i, check.shift_px) for i, check in seen if check.moved == moved]
            axes.plot(
                [i for i, _ in chosen],
                [px for _, px in chosen],
                marker,
                color=colour,
                markersize=7 if moved else 3.5,
                markeredgecolor=canvas.INK if moved else colour,
            )
    axes.set(ylabel="RMS, px", ylim=(0, None))
    _checks(axes, entries)
    axes = sheet.panel(1, "Measured points displaced, worst pair", plain=False)
    axes.bar(
        range(len(entries)),
        [entry.effect_mm for entry in entries],
        color=[_COLOURS.get(entry.verdict, canvas.GREY) for entry in entries],
        width=0.6,
    )
    axes.axhline(limit_mm, color=canvas.VERMILION, linewidth=1.2)
    canvas.note(axes, f"line: limit {limit_mm:g} mm")
    axes.set(ylabel="RMS, mm", ylim=(0, 1.15 * max(limit_mm, *(entry.effect_mm for entry in entries))))
    _checks(axes, entries)
    return sheet.png(
        "Drift of the rig",
        "Every check of the rig against its calibration. Left: how far the target lies in each camera's "
        "picture from where the cameras that did not move see it (squares: cameras that moved). Right: the error "
        "of points that the worst pair measures. Dashed lines: new calibrations.",
    )


def _checks(axes: Axes, entries: Sequence[DriftEntry]) -> None:
    """Label an axis with the dates of checks, and draw lines at new calibrations."""
    every = max(1, -(-len(entries) // _MOST_LABELS))
    shown = range(0, len(entries), every)
    axes.set_xticks(list(shown), [entries[i].when[:10] for i in shown], rotation=25, ha="right")
    axes.set(xlim=(-0.6, len(entries) - 0.4))
    axes.grid(False, axis="x")
    for i in range(1, len(entries)):
        if entries[i].calibration != entries[i - 1].calibration:
            axes.axvline(i - 0.5, color=canvas.GREY, linewidth=1.0, linestyle="--")
