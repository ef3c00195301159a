"""How long it takes to read calibration photographs and measure their corners, and how well it does.

    python -m benchmarks.speed.detection [--images 6] [--scale 1.0] [--threads 1 2] [--folder FOLDER]
    python -m benchmarks.speed.detection --images 96 --sessions SIMULATED...

Renders ChArUco boards as the virtual reference rig sees them (JPEG, lens distortion, blur, noise), or takes the boards
of simulated sessions, then reads and detects all of them with each number of threads. Prints one JSON object: seconds,
and corners against the truth.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from benchmarks.accuracy.calibration import read_capture
from benchmarks.files import Files
from mammometry.calibration.detection.detect import Observations, detect
from mammometry.geometry.camera import Camera
from mammometry.geometry.transform import Transform
from mammometry.simulate.rendering.develop import develop
from mammometry.simulate.rendering.film import Film
from mammometry.simulate.rendering.solid_target import render_target
from mammometry.simulate.rigs.build import flashes
from mammometry.simulate.rigs.poses import draw_poses
from mammometry.simulate.rigs.rig_file import make_rig
from mammometry.simulate.rigs.targets import BOARD, sees_target

_SEED = 7


@dataclass(frozen=True)
class Boards:
    """Photographs of boards, and what is true of them; by pose and camera, rig frame, mm."""

    photographs: Files
    cameras: Mapping[tuple[str, str], Camera]
    rig_from_board: Mapping[str, Transform]

    def errors_px(self, seen: Observations) -> list[np.ndarray]:
        """Measured minus true corners, pixels, one array a view."""
        return [
            found.uv
            - self.cameras[found.pose, found.camera].project(
                self.rig_from_board[found.pose].apply(seen.target.points_target[found.ids])
            )
            for found in seen.detections
        ]


def of_sessions(folders: Sequence[Path], images: int) -> Boards:
    """The first `images` calibration photographs of simulated sessions."""
    paths: dict[tuple[str, str], Path] = {}
    cameras: dict[tuple[str, str], Camera] = {}
    placed: dict[str, Transform] = {}
    for folder in folders:
        capture = read_capture(folder)
        for (pose, name), path in capture.photographs.paths.items():
            if len(paths) < images:
                key = f"{capture.name}-{pose}"
                paths[key, name], cameras[key, name] = path, capture.true.cameras[name]
                placed[key] = capture.rig_from_board[pose]
    return Boards(photographs=Files(paths), cameras=cameras, rig_from_board=placed)


def render(folder: Path, images: int, scale: float) -> Boards:
    """Write the first `images` views of the reference rig that see the board, those there already left as they are."""
    rig = make_rig("reference", scale, _SEED)
    poses = draw_poses(rig, BOARD, max(1, -(-images // 4)), _SEED)
    views = [
        (pose, name) for name, view in rig.cameras.items() for pose, at in poses.items() if sees_target(view, at, BOARD)
    ]
    paths = {}
    for number, (pose, name) in enumerate(views[:images]):
        path = folder / f"{scale:g}-{images}-{pose}-{name}.jpg"
        if not path.exists():
            light = render_target(rig.cameras[name], poses[pose], BOARD, flashes(), background=Film().stray_light)
            pixels = develop(light, Film(), name=path.name, seed=number).pixels
            Image.fromarray(pixels).save(path, quality=95, subsampling=0)
        paths[pose, name] = path
    return Boards(
        photographs=Files(paths),
        cameras={(pose, name): rig.cameras[name] for pose, name in paths},
        rig_from_board=poses,
    )


def main() -> None:
    """Render, measure, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--images", type=int, default=6, help="photographs to render and detect")
    parser.add_argument("--scale", type=float, default=1.0, help="of 4504 × 3000 pixels")
    parser.add_argument("--threads", type=int, nargs="+", default=[1, 2], help="photographs at the same time")
    parser.add_argument("--folder", type=Path, help="where to keep the photographs; a temporary folder otherwise")
    parser.add_argument("--sessions", type=Path, nargs="+", help="simulated sessions whose boards are taken instead")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        folder = options.folder or Path(scratch)
        folder.mkdir(parents=True, exist_ok=True)
        if options.sessions:
            boards = of_sessions(options.sessions, options.images)
        else:
            boards = render(folder, options.images, options.scale)
        photographs = boards.photographs
        first = next(iter(photographs))
        detect({first: photographs[first]}, BOARD)  # compiled code is loaded
        runs = {}
        for threads in options.threads:
            wall, cpu = time.perf_counter(), time.process_time()
            seen = detect(photographs, BOARD, threads=threads)
            runs[threads] = {
                "wall_s": round(time.perf_counter() - wall, 2),
                "cpu_s": round(time.process_time() - cpu, 1),
                "cpu_s_per_image": round((time.process_time() - cpu) / len(photographs), 3),
            }
    errors = boards.errors_px(seen)
    together = np.concatenate(errors)
    print(
        json.dumps(
            {
                "images": len(photographs),
                "megapixels": round(float(np.prod(seen.sizes_wh[first[1]])) / 1e6, 2),
                "threads": runs,
                "found": len(errors),
                "corners": len(together),
                "rms_px": round(float(np.sqrt(np.square(together).mean())), 4),
                "worst_view_rms_px": round(max(float(np.sqrt(np.square(error).mean())) for error in errors), 4),
                "worst_view_bias_px": round(max(float(np.abs(error.mean(axis=0)).max()) for error in errors), 4),
            },
            indent=2,
        )
    )


if __name__ == "__main__":
    main()
