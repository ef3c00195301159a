"""Seconds and memory from eight photographs and their cameras to a mesh, ours beside SGBM with TSDF fusion.

    pip install -e '.[benchmark]'
    python -m benchmarks.speed.peers --out build/peers [SESSION …]

Renders a plaster and a torso at full size, with their true cameras for a calibration, unless sessions are given. Each
maker works in a process of its own; ours after a small session has loaded the kernels. The peer rectifies with OpenCV,
matches with its SGBM (3-way, within ±`--reach` mm of where the cameras' axes meet) and fuses the depths in Open3D's
TSDF. It finds no subject and closes nothing: what it sees, it keeps. OpenMVS is in no package that pip or apt installs.
"""

from __future__ import annotations

import argparse
import json
import resource
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np

import mammometry as mm
from benchmarks.speed.reference import beside
from benchmarks.speed.whole_job import make_session
from mammometry.geometry.camera import Camera, Rig

_WARM = 0.1
_SUBJECTS = ("plaster_5", "torso_3")
_VOXEL_MM, _TRUNCATION_MM = 0.5, 2.5
_BLOCK_PX = 5


def ours(session: Path, reach_mm: float) -> dict[str, float]:
    """Match and surface, no pictures drawn."""
    shutil.rmtree(session / "results", ignore_errors=True)
    job = mm.open_session(session)
    job.calibrate()
    with _timed() as row:
        job.ensure("surface", drawn=False)
    return row | {"faces": float(len(job.surface().textured.mesh.faces))}


def sgbm_tsdf(session: Path, reach_mm: float) -> dict[str, float]:
    """Rectify, match, fuse and mesh."""
    import open3d as o3d

    job = mm.open_session(session)
    rig, photographs = job.calibrate().rig, job.inputs.photographs
    middle = _where_axes_meet(rig)
    with _timed() as row:
        volume = o3d.pipelines.integration.ScalableTSDFVolume(
            voxel_length=_VOXEL_MM,
            sdf_trunc=_TRUNCATION_MM,
            color_type=o3d.pipelines.integration.TSDFVolumeColorType.RGB8,
        )
        for pair in rig.pairs:
            turn, ideal = _rectified(pair.left, pair.right, middle)
            pictures = [
                cv2.remap(photographs[camera.name].pixels, *_maps(camera, turn, matrix), cv2.INTER_LINEAR)
                for camera, matrix in zip((pair.left, pair.right), ideal, strict=True)
            ]
            depth = _depth(pictures, pair.left, pair.right, ideal, turn @ (middle - pair.left.centre_world), reach_mm)
            height, width = depth.shape
            placed = np.eye(4)
            placed[:3, :3], placed[:3, 3] = turn, -turn @ pair.left.centre_world
            left = ideal[0]
            volume.integrate(
                o3d.geometry.RGBDImage.create_from_color_and_depth(
                    o3d.geometry.Image(pictures[0]),
                    o3d.geometry.Image(depth),
                    depth_scale=1.0,
                    depth_trunc=1e6,
                    convert_rgb_to_intensity=False,
                ),
                o3d.camera.PinholeCameraIntrinsic(width, height, left[0, 0], left[1, 1], left[0, 2], left[1, 2]),
                placed,
            )
        mesh = volume.extract_triangle_mesh()
    return row | {"faces": float(len(mesh.triangles))}


def _where_axes_meet(rig: Rig) -> np.ndarray:
    """The point nearest to the axes of all cameras, world, mm."""
    across = [np.eye(3) - np.outer(camera.axis_world, camera.axis_world) for camera in rig.cameras.values()]
    seen = [part @ camera.centre_world for part, camera in zip(across, rig.cameras.values(), strict=True)]
    return np.linalg.solve(sum(across), sum(seen))


def _rectified(left: Camera, right: Camera, middle: np.ndarray) -> tuple[np.ndarray, list[np.ndarray]]:
    """Common rotation of two cameras, and pinholes that have the middle in their pictures' middle."""
    x = right.centre_world - left.centre_world
    x /= np.linalg.norm(x)
    y = np.cross(left.axis_world + right.axis_world, x)
    y /= np.linalg.norm(y)
    turn = np.stack([x, y, np.cross(x, y)])
    matrices = []
    for camera in (left, right):
        at = turn @ (middle - camera.centre_world)
        focal = float(left.matrix[0, 0])
        centre = (np.array(camera.size_wh) - 1) / 2 - focal * at[:2] / at[2]
        matrices.append(np.array([[focal, 0.0, centre[0]], [0.0, focal, centre[1]], [0.0, 0.0, 1.0]]))
    matrices[1][1, 2] = matrices[0][1, 2]
    return turn, matrices


def _maps(camera: Camera, turn: np.ndarray, matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    from_camera = turn @ camera.camera_from_world.rotation.T
    return cv2.initUndistortRectifyMap(
        camera.matrix, camera.distortion, from_camera, matrix, camera.size_wh, cv2.CV_32FC1
    )


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
        disp12MaxDiff=1,
        uniquenessRatio=10,
        speckleWindowSize=200,
        speckleRange=2,
        mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY,
    )
    grey = [cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY) for picture in pictures]
    disparity = matcher.compute(*grey).astype(np.float32) / 16.0
    with np.errstate(divide="ignore"):
        return np.where(disparity >= lowest, scaled / (disparity - shift), 0.0).astype(np.float32)


class _timed:
    """Seconds and peak memory of a block, in a table that is complete after it."""

    def __enter__(self) -> dict[str, float]:
        self._wall, self._processor, self._row = time.monotonic(), time.process_time(), dict[str, float]()
        return self._row

    def __exit__(self, *error: object) -> None:
        self._row["wall_s"] = time.monotonic() - self._wall
        self._row["processor_s"] = time.process_time() - self._processor
        self._row["peak_mb"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


_MAKERS: dict[str, Callable[[Path, float], dict[str, float]]] = {"ours": ours, "SGBM + TSDF": sgbm_tsdf}


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
        if maker == "ours":
            ours(Path(warm), arguments.reach)
        print(json.dumps(_MAKERS[maker](Path(session), arguments.reach)))
        return
    warm = make_session(arguments.out / "warm", _WARM, _SUBJECTS[0])
    sessions = arguments.sessions or [
        make_session(arguments.out / f"{name}_{arguments.scale:g}", arguments.scale, name) for name in _SUBJECTS
    ]
    print("| session | | wall s | processor s | references | peak MB | faces |\n" + "| --- " * 7 + "|")
    for session in sessions:
        for maker in _MAKERS:
            command = [sys.executable, "-m", "benchmarks.speed.peers", "--reach", str(arguments.reach), "--work", maker]
            with beside() as reference:
                done = subprocess.run([*command, str(warm), str(session)], capture_output=True, text=True, check=False)
            if done.returncode:
                raise SystemExit(done.stderr.strip() or done.stdout.strip())
            row = json.loads(done.stdout.splitlines()[-1])
            figures = (
                f"{row['wall_s']:.1f} | {row['processor_s']:.1f} | {row['processor_s'] / reference.processor_s:.1f}"
            )
            print(f"| {session.name} | {maker} | {figures} | {row['peak_mb']:.0f} | {row['faces']:.0f} |", flush=True)


if __name__ == "__main__":
    main()
