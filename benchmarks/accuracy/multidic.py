"""The real two-camera capture of MultiDIC: resection, target, and the speckled cylinder in every pair.

    python -m benchmarks.accuracy.multidic ../shared/data/multidic/sample_data --out build/multidic

Makes the five sessions of `examples/multidic`, runs them, and prints what the cylinder's known geometry says of them.
`--one-lens` prints instead what the telephone's calibration (`walk.stations`) finds of each camera from its photographs
of a checkerboard, from all of them and from every other one.
The photographs are in the repository MultiDIC/MultiDIC on GitHub, folder sample_data, at commit c14a135; their checksum
tells whether they are the same.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import runpy
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.io import loadmat
from scipy.optimize import least_squares

import mammometry as mm
from mammometry.calibration.detection.detect import Observations
from mammometry.calibration.targets.table import target_from_table
from mammometry.geometry.arrays import Array, Float64
from mammometry.geometry.camera import Rig
from mammometry.io.photographs.images import read_photograph
from mammometry.surface.ranges.range_image import RangeImage, triangulate
from mammometry.walk.stations import TELEPHONE, find_boards, stations_of

ROOT = Path(__file__).resolve().parents[2]
PUBLISHED_SHA256 = "f2d59951511bc227219b70075843e8ffaa5d41b50e8a5201251bfa2fa65e1eea"
"""Of the names and digests of all JPEG files, in the order of their names (`photographs_sha256`)."""
SETTINGS = "matching.foreground.mode=all"  # a cluttered laboratory: no backdrop tells the subject apart


@dataclass(frozen=True)
class Cylinder:
    """A circular cylinder fitted to points."""

    radius_mm: float
    rms_mm: float
    """Of the distances of all points kept from the surface."""
    kept: float
    """Share of the points within five robust standard deviations."""


def fit_cylinder(points: Float64[Array, "n 3"], axis_guess: Array, radius_guess_mm: float) -> Cylinder:
    """Fit a cylinder by orthogonal distance; points beyond five robust standard deviations are left out and counted."""
    centre = points.mean(axis=0)
    axis_guess = axis_guess / np.linalg.norm(axis_guess)
    first = np.cross(axis_guess, np.eye(3)[np.abs(axis_guess).argmin()])
    frame = np.stack([first / np.linalg.norm(first), np.cross(axis_guess, first / np.linalg.norm(first)), axis_guess])
    local = (points - centre) @ frame.T

    def distances(parameters: Array, on: Float64[Array, "n 3"]) -> Float64[Array, " n"]:
        x, y, tilt_x, tilt_y, radius = parameters
        axis = np.array([tilt_x, tilt_y, 1.0])
        offset = np.cross(on - np.array([x, y, 0.0]), axis / np.linalg.norm(axis))
        return np.linalg.norm(offset, axis=1) - radius

    # The visible front of a tube bulges towards the cameras: its axis lies about one radius behind its mean point.
    starts = [
        np.array([radius_guess_mm * np.cos(angle), radius_guess_mm * np.sin(angle), 0, 0, radius_guess_mm])
        for angle in np.arange(8) * np.pi / 4
    ]
    sparse = local[:: max(1, len(local) // 20_000)]
    best = min((least_squares(distances, start, args=(sparse,)) for start in starts), key=lambda found: found.cost)
    keep = np.ones(len(local), dtype=bool)
    for _ in range(5):
        fitted = local[keep]
        best = least_squares(distances, best.x, args=(fitted[:: max(1, len(fitted) // 50_000)],))
        error = distances(best.x, local)
        keep = np.abs(error - np.median(error[keep])) < 5 * 1.4826 * np.median(np.abs(error[keep]))
    return Cylinder(
        radius_mm=float(best.x[4]), rms_mm=float(np.sqrt(np.mean(error[keep] ** 2))), kept=float(keep.mean())
    )


def target_error_mm(observations: Observations, rig: Rig) -> float:
    """RMS distance of the target's points, triangulated from both cameras, from where they were printed."""
    seen = {detection.camera: detection for detection in observations.detections}
    left, right = (seen[name] for name in rig.pair_names["front"])
    common, in_left, in_right = np.intersect1d(left.ids, right.ids, return_indices=True)
    pair = rig.pair("front")
    rays = [pair.left.rays_world(left.uv[in_left]), pair.right.rays_world(right.uv[in_right])]
    projectors = [np.eye(3) - ray[:, :, None] * ray[:, None, :] for ray in rays]
    centres = [pair.left.centre_world, pair.right.centre_world]
    normal = projectors[0] + projectors[1]
    right_side = projectors[0] @ centres[0] + projectors[1] @ centres[1]
    points = np.linalg.solve(normal, right_side[..., None])[..., 0]
    return float(np.sqrt(np.mean(np.sum((points - observations.target.points_target[common]) ** 2, axis=1))))


def speckled(sample_data: Path, rig: Rig, image: RangeImage) -> tuple[float, Float64[Array, "n 3"]]:
    """Share of the toolbox's own region of interest that was matched, and the points in it (world, mm)."""
    region = loadmat(sample_data / "speckledObjectImages" / "ROIMask_C_201_C_202.mat")["ROImask"].astype(bool)
    points = image.points_world()
    camera = rig.cameras["201"]
    # The region is drawn in the original left photograph: the same rays, looked up there.
    rows, columns = np.mgrid[0 : image.valid.shape[0], 0 : image.valid.shape[1]]
    rays = image.camera.rays_world(np.stack([columns, rows], axis=-1).astype(np.float64))
    uv = camera.project(camera.centre_world + 500.0 * rays)
    with np.errstate(invalid="ignore"):
        column, row = np.rint(np.nan_to_num(uv, nan=-1.0)).astype(int).transpose(2, 0, 1)
    inside = (column >= 0) & (column < region.shape[1]) & (row >= 0) & (row < region.shape[0])
    # Far outside the photograph a lens model folds back into it: only rays that come back as they went are seen.
    inside[inside] = np.sum(camera.rays_world(uv[inside]) * rays[inside], axis=-1) > 1 - 1e-9
    wanted = np.zeros_like(inside)
    wanted[inside] = region[row[inside], column[inside]]
    return float(image.valid[wanted].mean()), points[wanted & image.valid]


def photographs_sha256(sample_data: Path) -> str:
    """One checksum of all photographs and their names."""
    whole = hashlib.sha256()
    for path in sorted(sample_data.rglob("*.jpg")):
        name = path.relative_to(sample_data).as_posix().encode()
        whole.update(name + b"\0" + hashlib.sha256(path.read_bytes()).digest())
    return whole.hexdigest()


def one_lens(sample_data: Path) -> None:
    """Print focal length, residuals and bow of each camera, calibrated as the one camera of a walk."""
    board = target_from_table({"kind": "chessboard", "squares": [20, 15], "square_mm": 10.0})
    print("| camera | photographs | boards | focal length px | RMS px | bow mm |\n" + "| --- " * 6 + "|")
    for camera in ("201", "202"):
        files = sorted((sample_data / "BAcheckerboardImages" / camera).glob("*.jpg"))
        for name, chosen in (("all", files), ("even", files[::2]), ("odd", files[1::2])):
            photographs = {path.stem: read_photograph(path, path.name) for path in chosen}
            found = stations_of(find_boards(photographs, board))
            calibration = found.calibration
            focal_px = calibration.rig.cameras[TELEPHONE].matrix[0, 0]
            std_px = calibration.parameter_std[TELEPHONE]["fx_px"]
            boards = len(calibration.observations.detections)
            row = f"{boards} of {len(chosen)} | {focal_px:.1f} ± {std_px:.1f} | {calibration.rms_px:.2f}"
            print(f"| {camera} | {name} | {row} | {found.bow_mm:.2f} |", flush=True)


def main() -> None:
    """Run all five sessions and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("sample_data", type=Path)
    parser.add_argument("--out", type=Path, default=Path("build/multidic"))
    parser.add_argument("--one-lens", action="store_true", help="each camera as that of a walk")
    arguments = parser.parse_args()
    if arguments.one_lens:
        one_lens(arguments.sample_data)
        return
    same = photographs_sha256(arguments.sample_data) == PUBLISHED_SHA256
    print("photographs: " + ("as published" if same else "NOT those that the documented figures are of") + "\n")
    sys.argv = ["make_sessions.py", str(arguments.sample_data), str(arguments.out)]
    runpy.run_path(str(ROOT / "examples" / "multidic" / "make_sessions.py"), run_name="__main__")
    settings = mm.Settings().overridden([SETTINGS])
    job = mm.open_session(arguments.out / "1", settings)
    cameras = job.calibrate()
    calibration = job.calibration()
    assert calibration is not None
    record = {"resection_px": calibration.rms_px, "target_mm": target_error_mm(calibration.observations, cameras.rig)}
    print(f"resection {record['resection_px']:.3f} px, target reconstructed to {record['target_mm']:.4f} mm RMS\n")
    print("| pair | matched % | radius mm | fit RMS mm | kept % | d_V px (median, spread) |\n" + "| --- " * 6 + "|")
    pairs = []
    for number in range(1, 6):
        session = arguments.out / str(number)
        if number > 1:
            source = arguments.out / "1" / "results" / "calibrate" / "cameras.json"
            (session / "cameras.json").write_bytes(source.read_bytes())
        disparity = mm.open_session(session, settings).match()["front"]
        share, points = speckled(arguments.sample_data, cameras.rig, triangulate(disparity))
        fitted = fit_cylinder(points, np.array([0.0, 0.0, 1.0]), 57.0)
        d_v = disparity.pair_px * disparity.d_v_px[disparity.valid]
        spread = 1.4826 * float(np.median(np.abs(d_v - np.median(d_v))))
        pairs.append({"pair": number, "matched": share, **vars(fitted)})
        print(
            f"| {number} | {100 * share:.1f} | {fitted.radius_mm:.3f} | {fitted.rms_mm:.4f} | "
            f"{100 * fitted.kept:.1f} | {np.median(d_v):+.2f}, {spread:.2f} |"
        )
    (arguments.out / "multidic.json").write_text(json.dumps({**record, "pairs": pairs}, indent=1))


if __name__ == "__main__":
    main()
