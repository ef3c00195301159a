"""Time, memory and surface error from photographs to a mesh: ours and SGBM with TSDF fusion.

    python -m benchmarks.speed.peers --out build/peers [--scale 1] [SESSION …]

Renders a plaster and a torso, with their true cameras for a calibration, unless such sessions are given. Each maker
works in a process of its own, after a small session has loaded what it needs; no pictures are drawn. The peer
rectifies and matches with OpenCV (SGBM, 3-way, within ±`--reach` mm of where the cameras' axes meet), fuses the depths
in a volume of truncated signed distances (compiled here, dense) and takes scikit-image's marching cubes. It looks for
no subject and closes nothing. Errors are those of the true skin that a pair sees.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
from numba import njit

import mammometry as mm
from benchmarks.accuracy.surface import judge
from benchmarks.speed.reference import beside
from benchmarks.speed.whole_job import make_session, memory_mb
from mammometry.geometry.camera import Camera, Rig
from mammometry.geometry.mesh import TriangleMesh
from mammometry.io.truth import read_truth
from mammometry.study.rays import RayScene, seen_by_pairs

_WARM = 0.1
_SUBJECTS = ("plaster_5", "torso_3")
_VOXEL_MM, _TRUNCATION_VOXELS = 0.5, 5.0
_MOST_VOXELS = 100_000_000  # larger volumes get larger voxels
_BLOCK_PX = 5
_DISCONTINUOUS_MM = 400.0  # data further from the axes' meeting are no subject
_LOOK_S = 0.1
_EVERY = 5  # of the true vertices that are judged


def ours(session: Path, reach_mm: float) -> TriangleMesh:
    """Match and surface, no pictures drawn."""
    job = mm.open_session(session)
    job.ensure("surface", drawn=False)
    return job.surface().textured.mesh


def sgbm_tsdf(session: Path, reach_mm: float) -> TriangleMesh:
    """Rectify, match, fuse and mesh."""
    from skimage.measure import marching_cubes

    job = mm.open_session(session)
    rig, photographs = job.calibrate().rig, job.inputs.photographs
    middle = _where_axes_meet(rig)
    views = []
    for pair in rig.pairs:
        size_wh = tuple(np.maximum(pair.left.size_wh, pair.right.size_wh).tolist())
        turn, ideal = _rectified(pair.left, pair.right, size_wh, middle)
        pictures = [
            cv2.remap(photographs[camera.name].pixels, *_maps(camera, turn, matrix, size_wh), cv2.INTER_LINEAR)
            for camera, matrix in zip((pair.left, pair.right), ideal, strict=True)
        ]
        depth = _depth(pictures, pair.left, pair.right, ideal, turn @ (middle - pair.left.centre_world), reach_mm)
        views.append((depth, ideal[0], turn, np.array(pair.left.centre_world)))
    points = np.concatenate([_points(*view) for view in views])
    points = points[np.linalg.norm(points - middle, axis=1) < _DISCONTINUOUS_MM]
    low, high = np.percentile(points, (0.5, 99.5), axis=0) + np.array([[-10.0], [10.0]])
    voxel = max(_VOXEL_MM, float(np.prod(high - low) / _MOST_VOXELS) ** (1 / 3))
    shape = tuple(int(side) for side in np.ceil((high - low) / voxel))
    total, weight = np.zeros(shape, dtype=np.float32), np.zeros(shape, dtype=np.float32)
    for depth, matrix, turn, centre in views:
        _fuse(total, weight, low, voxel, _TRUNCATION_VOXELS * voxel, depth, matrix, turn, centre)
    seen = weight > 0
    field = np.where(seen, total / np.maximum(weight, 1), 1.0)
    vertices, faces, _, _ = marching_cubes(field, 0.0, mask=seen)  # type: ignore[no-untyped-call]
    return TriangleMesh(vertices=low + (vertices + 0.5) * voxel, faces=faces.astype(np.int32))


def _where_axes_meet(rig: Rig) -> np.ndarray:
    """The point nearest to the axes of all cameras, world, mm."""
    across = [np.eye(3) - np.outer(camera.axis_world, camera.axis_world) for camera in rig.cameras.values()]
    seen = [part @ camera.centre_world for part, camera in zip(across, rig.cameras.values(), strict=True)]
    return np.linalg.solve(sum(across), sum(seen))


def _rectified(
    left: Camera, right: Camera, size_wh: tuple[int, int], middle: np.ndarray
) -> tuple[np.ndarray, list[np.ndarray]]:
    """Common rotation of two cameras, and pinholes that have the middle in their pictures' middle."""
    x = right.centre_world - left.centre_world
    x = x / np.linalg.norm(x)
    y = np.cross(left.axis_world + right.axis_world, x)
    y = y / np.linalg.norm(y)
    turn = np.stack([x, y, np.cross(x, y)])
    matrices = []
    for camera in (left, right):
        at = turn @ (middle - camera.centre_world)
        focal = float(left.matrix[0, 0])
        centre = (np.array(size_wh) - 1) / 2 - focal * at[:2] / at[2]
        matrices.append(np.array([[focal, 0.0, centre[0]], [0.0, focal, centre[1]], [0.0, 0.0, 1.0]]))
    matrices[1][1, 2] = matrices[0][1, 2]
    return turn, matrices


def _maps(
    camera: Camera, turn: np.ndarray, matrix: np.ndarray, size_wh: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray]:
    """Places in the photograph of each pixel of the rectified picture."""
    width, height = size_wh
    column, row = np.meshgrid(np.arange(width), np.arange(height))
    rays = np.stack([column, row, np.ones_like(row)], axis=-1).reshape(-1, 3) @ np.linalg.inv(matrix).T @ turn
    uv = camera.project(camera.centre_world + 1000.0 * rays).reshape(height, width, 2).astype(np.float32)
    return uv[..., 0], uv[..., 1]


def _depth(
    pictures: list[np.ndarray], left: Camera, right: Camera, ideal: list[np.ndarray], at: np.ndarray, reach_mm: float
) -> np.ndarray:
    """Depth in the left rectified picture, mm; 0 where nothing was matched."""
    scaled = ideal[0][0, 0] * float(np.linalg.norm(right.centre_world - left.centre_world))
    shift = ideal[0][0, 2] - ideal[1][0, 2]
    lowest = int(np.floor(scaled / (at[2] + reach_mm) + shift))
    count = 16 * int(np.ceil((scaled / (at[2] - reach_mm) + shift - lowest) / 16))
    matcher = cv2.StereoSGBM.create(
        minDisparity=lowest,
        numDisparities=count,
        blockSize=_BLOCK_PX,
        P1=8 * _BLOCK_PX**2,
        P2=32 * _BLOCK_PX**2,
        uniquenessRatio=10,
        speckleWindowSize=200,
        speckleRange=2,
        mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY,
    )
    grey = [cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY) if picture.ndim == 3 else picture for picture in pictures]
    disparity = matcher.compute(*grey).astype(np.float32) / 16.0
    with np.errstate(divide="ignore"):
        return np.where(disparity >= lowest, scaled / (disparity - shift), 0.0).astype(np.float32)


def _points(depth: np.ndarray, matrix: np.ndarray, turn: np.ndarray, centre: np.ndarray) -> np.ndarray:
    """Some points of a depth picture, world, mm."""
    row, column = (each[::101] for each in np.nonzero(depth))
    rays = np.stack([column, row, np.ones(len(row))], axis=1) @ np.linalg.inv(matrix).T
    return centre + (rays * depth[row, column, None]) @ turn


@njit(cache=True, nogil=True)
def _fuse(
    total: np.ndarray,
    weight: np.ndarray,
    low: np.ndarray,
    voxel: float,
    truncation: float,
    depth: np.ndarray,
    matrix: np.ndarray,
    turn: np.ndarray,
    centre: np.ndarray,
) -> None:
    """Add a view to the means of truncated signed distances, positive before the surface."""
    for i in range(total.shape[0]):
        x = low[0] + (i + 0.5) * voxel - centre[0]
        for j in range(total.shape[1]):
            y = low[1] + (j + 0.5) * voxel - centre[1]
            for k in range(total.shape[2]):
                z = low[2] + (k + 0.5) * voxel - centre[2]
                away = turn[2, 0] * x + turn[2, 1] * y + turn[2, 2] * z
                if away <= 0.0:
                    continue
                u = matrix[0, 0] * (turn[0, 0] * x + turn[0, 1] * y + turn[0, 2] * z) / away + matrix[0, 2]
                v = matrix[1, 1] * (turn[1, 0] * x + turn[1, 1] * y + turn[1, 2] * z) / away + matrix[1, 2]
                if not (u >= 0.0 and v >= 0.0 and u < depth.shape[1] - 0.5 and v < depth.shape[0] - 0.5):
                    continue
                found = depth[int(v + 0.5), int(u + 0.5)]
                before = found - away
                if found > 0.0 and before > -truncation:
                    total[i, j, k] += min(before / truncation, 1.0)
                    weight[i, j, k] += 1.0


_MAKERS: dict[str, Callable[[Path, float], TriangleMesh]] = {"ours": ours, "SGBM + TSDF": sgbm_tsdf}


def work(maker: str, warm: Path, session: Path, reach_mm: float) -> None:
    """Make one mesh in this process, and print seconds and the file that holds it."""
    _MAKERS[maker](warm, reach_mm)  # kernels are loaded, libraries imported
    wall, processor = time.monotonic(), sum(os.times()[:4])
    mesh = _MAKERS[maker](session, reach_mm)
    row: dict[str, object] = {"wall_s": time.monotonic() - wall, "processor_s": sum(os.times()[:4]) - processor}
    held = session.parent / f"{session.name}-{maker.split()[0]}.npz"
    np.savez(held, vertices=mesh.vertices, faces=mesh.faces)
    print(json.dumps(row | {"mesh": str(held)}))


def judged(session: Path, held: Path) -> dict[str, float]:
    """A mesh against the true skin that a pair sees."""
    truth = read_truth(session / "truth", mm.open_session(session).session.pair_names)
    looked_at, by_pair = seen_by_pairs(RayScene(truth.mesh), truth.rig, every=_EVERY)
    seen = looked_at[np.any(list(by_pair.values()), axis=0)]
    with np.load(held) as arrays:
        return judge(TriangleMesh(vertices=arrays["vertices"], faces=arrays["faces"]), truth.mesh, seen)


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("sessions", type=Path, nargs="*", help="with cameras.json; default: rendered ones")
    parser.add_argument("--out", type=Path, default=Path("build/peers"), help="for rendered sessions")
    parser.add_argument("--scale", type=float, default=1.0, help="of 4504 × 3000 pixels, for rendered sessions")
    parser.add_argument("--reach", type=float, default=250.0, help="of the peer's search before and behind, mm")
    parser.add_argument("--work", nargs=3, metavar=("MAKER", "WARM", "SESSION"), help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.work:
        maker, warm, session = arguments.work
        work(maker, Path(warm), Path(session), arguments.reach)
        return
    warm = make_session(arguments.out / "warm", _WARM, _SUBJECTS[0])
    sessions = arguments.sessions or [
        make_session(arguments.out / f"{name}_{arguments.scale:g}", arguments.scale, name) for name in _SUBJECTS
    ]
    print("| session | | wall s | processor s | references | peak MB | mean, 95 % mm | complete % |")
    print("| --- " * 8 + "|")
    for session in sessions:
        for maker in _MAKERS:
            for old in (warm, session):
                shutil.rmtree(old / "results", ignore_errors=True)
            command = [sys.executable, "-m", "benchmarks.speed.peers", "--reach", str(arguments.reach), "--work", maker]
            peak = 0.0
            command += [str(warm), str(session)]
            with beside() as reference, subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as made:
                while made.poll() is None:
                    peak = max(peak, memory_mb(made.pid)[0])
                    time.sleep(_LOOK_S)
                assert made.stdout is not None
                said = made.stdout.read()
            if made.returncode:
                raise SystemExit(f"{maker} ended with {made.returncode}")
            row = json.loads(said.splitlines()[-1])
            error = judged(session, Path(row["mesh"]))
            times = f"{row['wall_s']:.1f} | {row['processor_s']:.1f} | {row['processor_s'] / reference.processor_s:.1f}"
            errors = f"{error['mean_mm']:.3f}, {error['p95_mm']:.3f} | {error['complete_percent']:.1f}"
            print(f"| {session.name} | {maker} | {times} | {peak:.0f} | {errors} |", flush=True)


if __name__ == "__main__":
    main()
