"""How long it takes to read calibration photographs and measure their corners, and how well it does.

    python -m benchmarks.speed.detection [--images 6] [--scale 1.0] [--threads 1 2] [--folder FOLDER]

Renders ChArUco boards as the virtual reference rig sees them (JPEG, lens distortion, blur, noise), then reads and
detects all of them with each number of threads. Prints one JSON object: seconds, and corners against the truth.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
from PIL import Image

from mammometry.calibration.detect import DetectSettings, Observations, detect
from mammometry.geometry.camera import Rig
from mammometry.geometry.transform import Transform
from mammometry.io.images import read_photograph
from mammometry.photograph import Photograph
from mammometry.simulate.film import Film, develop
from mammometry.simulate.poses import draw_poses
from mammometry.simulate.rig import flashes, reference_rig
from mammometry.simulate.solid_target import render_target
from mammometry.simulate.targets import BOARD, sees_target

_SEED = 7


class _Files(Mapping[tuple[str, str], Photograph]):
    """Photographs that are read when they are looked up, as a session's are."""

    def __init__(self, paths: Mapping[tuple[str, str], Path]) -> None:
        self._paths = dict(paths)

    def __getitem__(self, key: tuple[str, str]) -> Photograph:
        return read_photograph(self._paths[key], self._paths[key].name)

    def __iter__(self) -> Iterator[tuple[str, str]]:
        return iter(self._paths)

    def __len__(self) -> int:
        return len(self._paths)


def render(folder: Path, images: int, scale: float) -> tuple[Rig, dict[str, Transform], _Files]:
    """Write the first `images` views of the reference rig that see the board, those there already left as they are."""
    rig = reference_rig(scale, _SEED)
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
    return rig, poses, _Files(paths)


def errors_px(seen: Observations, rig: Rig, poses: Mapping[str, Transform]) -> list[np.ndarray]:
    """Measured minus true corners, pixels, one array a view."""
    points = BOARD.points_target
    return [
        found.uv - rig.cameras[found.camera].project(poses[found.pose].apply(points[found.ids]))
        for found in seen.detections
    ]


def main() -> None:
    """Render, measure, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--images", type=int, default=6, help="photographs to render and detect")
    parser.add_argument("--scale", type=float, default=1.0, help="of 4504 × 3000 pixels")
    parser.add_argument("--threads", type=int, nargs="+", default=[1, 2], help="photographs at the same time")
    parser.add_argument("--folder", type=Path, help="where to keep the photographs; a temporary folder otherwise")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        folder = options.folder or Path(scratch)
        folder.mkdir(parents=True, exist_ok=True)
        rig, poses, photographs = render(folder, options.images, options.scale)
        first = next(iter(photographs))
        detect({first: photographs[first]}, BOARD)  # compiled code is loaded
        runs = {}
        for threads in options.threads:
            wall, cpu = time.perf_counter(), time.process_time()
            seen = detect(photographs, BOARD, DetectSettings(threads=threads))
            runs[threads] = {
                "wall_s": round(time.perf_counter() - wall, 2),
                "cpu_s_per_image": round((time.process_time() - cpu) / len(photographs), 3),
            }
    errors = errors_px(seen, rig, poses)
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
