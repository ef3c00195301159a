"""Calibrations against the true cameras, OpenCV's on the same photographs beside them.

    python -m benchmarks.accuracy.calibration ../shared/data/rendered
    python -m benchmarks.accuracy.calibration SIMULATED... --out build/calibration.json
    python -m benchmarks.accuracy.calibration SIMULATED --only-ours

Takes folders of the independent renderer, and sessions of `mammometry simulate`. Prints one Markdown row a method, and
the goals beside what was reached:

- corners: detected against truly projected target points, RMS, px;
- projection: calibrated against true cameras over a cube of 220 mm in the middle of the target's places, after rigid
  alignment of the whole rig, RMS, px; for each pair aligned by itself where there is no whole rig (OpenCV's);
- centres, focal length, and the worst pair's triangulation over the same cube;
- left out: residuals of poses that took no part, each in its turn, over those of the same points fitted; and how much
  of that is not due to the number of unknowns;
- memory: what the process held at most while it detected and adjusted.

OpenCV is used as its documentation shows: `CharucoDetector.detectBoard`, `calibrateCamera` per camera (k1 k2 p1 p2),
`stereoCalibrate` per pair with those lenses.
"""

from __future__ import annotations

import argparse
import json
import resource
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from benchmarks.files import Files
from mammometry.calibration.adjust.bundle import calibrate
from mammometry.calibration.detection.detect import Detection, detect
from mammometry.calibration.judge.quality import assess
from mammometry.calibration.targets.kinds.charuco import CharucoTarget, charuco_board
from mammometry.calibration.targets.table import target_from_table
from mammometry.geometry.arrays import Array, Float64
from mammometry.geometry.camera import Camera, Rig
from mammometry.geometry.transform import Transform
from mammometry.io.cameras.own import cameras_from_table
from mammometry.io.manifest import read_manifest
from mammometry.study.accuracy import compare_rigs

CUBE_MM = 220.0
_STEPS = 7


@dataclass(frozen=True)
class Capture:
    """Photographs of a board, and what is true of them; rig frame, mm."""

    name: str
    photographs: Files
    """By pose and camera, read when they are looked up."""
    target: CharucoTarget
    true: Rig
    rig_from_board: dict[str, Transform]

    @property
    def volume(self) -> Float64[Array, "n 3"]:
        """Points of a cube in the middle of the board's places."""
        middle = self.target.points_target.mean(axis=0)
        centre = np.mean([placed.apply(middle) for placed in self.rig_from_board.values()], axis=0)
        ticks = np.linspace(-CUBE_MM / 2, CUBE_MM / 2, _STEPS)
        return centre + np.stack(np.meshgrid(ticks, ticks, ticks, indexing="ij"), axis=-1).reshape(-1, 3)

    def corner_rms_px(self, detections: tuple[Detection, ...]) -> float:
        """Detected against truly projected points, RMS length, px."""
        squares = []
        for seen in detections:
            points = self.rig_from_board[seen.pose].apply(self.target.points_target[seen.ids])
            squares.append(np.sum((self.true.cameras[seen.camera].project(points) - seen.uv) ** 2, axis=1))
        return float(np.sqrt(np.mean(np.concatenate(squares))))


def read_capture(folder: Path) -> Capture:
    """Read a folder of the independent renderer, or a simulated session."""
    if (folder / "session.json").is_file():
        session_json = json.loads((folder / "session.json").read_text())
        board = session_json["targets"]["charuco"]
        table: Mapping[str, Any] = {
            "kind": "charuco",
            "squares": [board["squares_x"], board["squares_y"]],
            **{key: board[key] for key in ("square_mm", "marker_mm", "dictionary")},
        }
        pairs = {name: (left, right) for name, (left, right) in session_json["pairs"].items()}
    else:
        manifest = read_manifest(folder / "session.toml")
        table = manifest.target or {}
        pairs = {pair.name: (pair.left, pair.right) for pair in manifest.rig.pairs}
    target = target_from_table(table)
    if not isinstance(target, CharucoTarget):
        raise SystemExit(f"{folder}: a ChArUco board is needed, for OpenCV's sake")
    cameras = cameras_from_table(json.loads((folder / "truth" / "cameras.json").read_text()), "cameras.json")
    boards = json.loads((folder / "truth" / "boards.json").read_text())["rig_from_board"]
    return Capture(
        name=folder.name,
        photographs=Files(
            {
                (path.parent.name, path.stem): path
                for path in sorted((folder / "calibration").glob("*/*.*"))
                if path.suffix in (".jpg", ".png")
            }
        ),
        target=target,
        true=Rig(name=folder.name, cameras=cameras, pair_names=pairs),
        rig_from_board={pose: Transform.from_matrix(np.array(matrix)) for pose, matrix in boards.items()},
    )


def ours(capture: Capture) -> dict[str, Any]:
    """Our own detection and calibration, one thread of detection a core, of adjustment one."""
    begun, cpu = time.perf_counter(), time.process_time()
    observations = detect(capture.photographs, capture.target)
    detected, detected_cpu = time.perf_counter(), time.process_time()
    calibration = calibrate(observations, capture.true.pair_names, capture.name)
    done, done_cpu = time.perf_counter(), time.process_time()
    memory_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    accuracy = compare_rigs(calibration.rig, capture.true, capture.volume)
    quality = assess(calibration)
    by_pair = _by_pair(calibration.rig, capture)
    return {
        "capture": capture.name,
        "method": "mammometry",
        "corners_px": capture.corner_rms_px(observations.detections),
        "residual_px": calibration.rms_px,
        "projection_px": accuracy.projection_rms_px,
        "pair_projection_px": by_pair["projection_px"],
        "centre_mm": max(camera.centre_mm for camera in accuracy.cameras.values()),
        "focal_percent": abs(accuracy.focal_worst_percent),
        "triangulation_mm": accuracy.worst_pair[1],
        "pair_triangulation_mm": by_pair["triangulation_mm"],
        "planarity_mm": max(pair.planarity_mm or 0.0 for pair in quality.pairs),
        "scale_ppm": max((pair.scale_ppm for pair in quality.pairs), key=abs),
        "left_out_ratio": calibration.left_out.ratio if calibration.left_out else float("nan"),
        "left_out_excess": calibration.left_out.excess if calibration.left_out else float("nan"),
        "verdict": quality.verdict,
        "detect_s": detected - begun,
        "detect_cpu_s": detected_cpu - cpu,
        "adjust_s": done - detected,
        "adjust_cpu_s": done_cpu - detected_cpu,
        "memory_mb": memory_mb,
    }


def opencv(capture: Capture) -> dict[str, Any]:
    """OpenCV's detector and calibration, as its documentation shows."""
    begun, cpu = time.perf_counter(), time.process_time()
    board = charuco_board(capture.target)
    detector = cv2.aruco.CharucoDetector(board)
    seen: dict[tuple[str, str], Detection] = {}
    for (pose, camera), photograph in capture.photographs.items():
        pixels = photograph.pixels
        grey = pixels if pixels.ndim == 2 else cv2.cvtColor(pixels, cv2.COLOR_RGB2GRAY)
        corners, ids, *_ = detector.detectBoard(grey)
        if ids is not None and len(ids) >= 8:
            order = np.argsort(ids.ravel())
            seen[pose, camera] = Detection(
                camera=camera,
                pose=pose,
                ids=ids.ravel()[order].astype(np.int64),
                uv=corners.reshape(-1, 2)[order].astype(np.float64),
                covariance_px2=np.tile(np.eye(2), (len(ids), 1, 1)),
            )
    detected, detected_cpu = time.perf_counter(), time.process_time()
    table = capture.target.points_target.astype(np.float32)
    lenses: dict[str, tuple[Array, Array]] = {}
    for name, true in capture.true.cameras.items():
        views = [view for view in seen.values() if view.camera == name]
        _, matrix, lens, *_ = cv2.calibrateCamera(
            [table[view.ids].reshape(-1, 1, 3) for view in views],
            [view.uv.astype(np.float32).reshape(-1, 1, 2) for view in views],
            true.size_wh,
            None,
            None,
            flags=cv2.CALIB_FIX_K3,
        )
        lenses[name] = matrix, lens.ravel()[:5]
    errors: dict[str, list[float]] = {"projection_px": [], "triangulation_mm": [], "centre_mm": [], "focal_percent": []}
    for pair, (left, right) in capture.true.pair_names.items():
        rig = _stereo(capture, seen, lenses, pair, left, right)
        accuracy = compare_rigs(rig, _pair_of(capture.true, pair), capture.volume)
        errors["projection_px"].append(accuracy.projection_rms_px)
        errors["triangulation_mm"].append(accuracy.worst_pair[1])
        errors["centre_mm"] += [camera.centre_mm for camera in accuracy.cameras.values()]
        errors["focal_percent"].append(abs(accuracy.focal_worst_percent))
    done, done_cpu = time.perf_counter(), time.process_time()
    return {
        "capture": capture.name,
        "method": "OpenCV",
        "corners_px": capture.corner_rms_px(tuple(seen.values())),
        "pair_projection_px": max(errors["projection_px"]),
        "centre_mm": max(errors["centre_mm"]),
        "focal_percent": max(errors["focal_percent"]),
        "pair_triangulation_mm": max(errors["triangulation_mm"]),
        "detect_s": detected - begun,
        "detect_cpu_s": detected_cpu - cpu,
        "adjust_s": done - detected,
        "adjust_cpu_s": done_cpu - detected_cpu,
    }


def _stereo(
    capture: Capture,
    seen: Mapping[tuple[str, str], Detection],
    lenses: Mapping[str, tuple[Array, Array]],
    pair: str,
    left: str,
    right: str,
) -> Rig:
    table = capture.target.points_target.astype(np.float32)
    points, at_left, at_right = [], [], []
    for pose in sorted({pose for pose, _ in seen}):
        if (pose, left) in seen and (pose, right) in seen:
            one, other = seen[pose, left], seen[pose, right]
            ids, i, j = np.intersect1d(one.ids, other.ids, return_indices=True)
            if len(ids) >= 6:
                points.append(table[ids].reshape(-1, 1, 3))
                at_left.append(one.uv[i].astype(np.float32).reshape(-1, 1, 2))
                at_right.append(other.uv[j].astype(np.float32).reshape(-1, 1, 2))
    size = capture.true.cameras[left].size_wh
    _, *_, rotation, translation, _, _ = cv2.stereoCalibrate(
        points, at_left, at_right, *lenses[left], *lenses[right], size, flags=cv2.CALIB_FIX_INTRINSIC
    )
    poses = {
        left: Transform.identity(),
        right: Transform(rotation=np.asarray(rotation, float), translation_mm=np.asarray(translation, float).ravel()),
    }
    cameras = {
        name: Camera(
            name=name,
            size_wh=capture.true.cameras[name].size_wh,
            matrix=np.asarray(lenses[name][0], float),
            distortion=np.asarray(lenses[name][1], float),
            camera_from_world=pose,
        )
        for name, pose in poses.items()
    }
    return Rig(name="opencv", cameras=cameras, pair_names={pair: (left, right)})


def _pair_of(rig: Rig, pair: str) -> Rig:
    names = rig.pair_names[pair]
    return Rig(name=pair, cameras={name: rig.cameras[name] for name in names}, pair_names={pair: names})


def _by_pair(rig: Rig, capture: Capture) -> dict[str, float]:
    """The worst pair, each aligned by itself: what can be compared with calibrations of single pairs."""
    found = [
        compare_rigs(_pair_of(rig, pair), _pair_of(capture.true, pair), capture.volume)
        for pair in capture.true.pair_names
    ]
    return {
        "projection_px": max(each.projection_rms_px for each in found),
        "triangulation_mm": max(each.worst_pair[1] for each in found),
    }


COLUMNS = {
    "capture": ("capture", ""),
    "method": ("method", ""),
    "corners_px": ("corners px", ".4f"),
    "projection_px": ("projection px", ".4f"),
    "pair_projection_px": ("by pair", ".4f"),
    "centre_mm": ("centres mm", ".3f"),
    "focal_percent": ("focal %", ".4f"),
    "triangulation_mm": ("triangulation mm", ".4f"),
    "pair_triangulation_mm": ("by pair", ".4f"),
    "planarity_mm": ("flatness mm", ".3f"),
    "scale_ppm": ("scale ppm", "+.0f"),
    "left_out_ratio": ("left out", ".3f"),
    "left_out_excess": ("beyond unknowns", ".3f"),
    "verdict": ("verdict", ""),
    "detect_cpu_s": ("detection, CPU s", ".1f"),
    "adjust_cpu_s": ("adjustment, CPU s", ".2f"),
    "memory_mb": ("memory MB", ".0f"),
}

GOALS = {
    "corners_px": 0.03,
    "projection_px": 0.01,
    "centre_mm": 0.07,
    "focal_percent": 0.01,
    "triangulation_mm": 0.01,
    "planarity_mm": 0.05,
    "left_out_ratio": 1.05,
}
"""What a calibration by at least ten poses is to reach on virtual captures, at any size; largest values."""


def as_markdown(rows: list[dict[str, Any]]) -> str:
    """The table that docs/calibration.md shows."""
    lines = [f"| {' | '.join(title for title, _ in COLUMNS.values())} |", "| --- " * len(COLUMNS) + "|"]
    for row in rows:
        cells = [format(row[key], form) if key in row else "–" for key, (_, form) in COLUMNS.items()]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def goals_as_markdown(rows: list[dict[str, Any]]) -> str:
    """Our figures beside the goals, those that are missed in bold."""
    own = [row for row in rows if row["method"] == "mammometry"]
    lines = [f"| | goal | {' | '.join(row['capture'] for row in own)} |", "| --- " * (len(own) + 2) + "|"]
    for key, most in GOALS.items():
        title, form = COLUMNS[key]
        cells = [f"{row[key]:{form}}" if row[key] <= most else f"**{row[key]:{form}}**" for row in own]
        lines.append(f"| {title} | ≤ {most:g} | {' | '.join(cells)} |")
    return "\n".join(lines)


def main() -> None:
    """Run all captures and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("captures", type=Path, nargs="+")
    parser.add_argument("--out", type=Path, help="also write the rows as JSON")
    parser.add_argument("--only-ours", action="store_true", help="leave OpenCV out, which takes its time at full size")
    arguments = parser.parse_args()
    rows = []
    for folder in arguments.captures:
        capture = read_capture(folder)
        for method in (ours,) if arguments.only_ours else (ours, opencv):
            rows.append(method(capture))
            print(f"{capture.name}: {method.__name__} done", file=sys.stderr, flush=True)
    print(as_markdown(rows), goals_as_markdown(rows), sep="\n\n")
    if arguments.out:
        arguments.out.parent.mkdir(parents=True, exist_ok=True)
        arguments.out.write_text(json.dumps(rows, indent=1) + "\n")


if __name__ == "__main__":
    main()
