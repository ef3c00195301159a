"""Disparity errors against ray-cast truth, with true cameras: `python -m benchmarks.accuracy.matching CAPTURES`.

CAPTURES is a folder laid out as ../shared/data/rendered. A pixel counts when its true surface point is seen by both
cameras inside both frames, more than 5 px from any occluding edge in either rectified picture, and by both at less than
70° of incidence. Truth is read here and nowhere in the product.
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from mammometry.geometry.camera import StereoPair
from mammometry.io.images import read_photograph
from mammometry.io.meshes import read_ply
from mammometry.io.truth import read_true_cameras
from mammometry.matching.foreground import estimate_foreground
from mammometry.matching.match import match
from mammometry.matching.rectify import rectify
from mammometry.matching.settings import MatchSettings
from mammometry.study.accuracy_matching import judge_disparity, judge_silhouette, true_disparity
from mammometry.study.rays import RayScene


def measure(captures: Path, subjects: list[str], pairs: list[str], settings: MatchSettings) -> list[dict[str, Any]]:
    """One row a subject and pair."""
    described = json.loads((captures / "session.json").read_text())
    cameras = read_true_cameras(captures / "truth")
    rows: list[dict[str, Any]] = []
    for subject in subjects or described["subjects"]:
        scene = RayScene(read_ply(captures / subject / "truth" / "mesh.ply")[0])
        for name in pairs or described["pairs"]:
            pair = StereoPair(
                name=name, left=cameras[described["pairs"][name][0]], right=cameras[described["pairs"][name][1]]
            )
            begun = time.perf_counter()
            photographs = [
                read_photograph(
                    captures / subject / "capture" / f"{camera.name}.{described['image_format']}", camera.name
                )
                for camera in (pair.left, pair.right)
            ]
            foregrounds = [
                estimate_foreground(photograph, photograph.name, settings.foreground) for photograph in photographs
            ]
            rectified = rectify(pair, *photographs, *foregrounds, settings.rectify)
            prepared = time.perf_counter()
            found = match(rectified, settings)
            ended = time.perf_counter()
            truth = true_disparity(scene, pair, pair, rectified.left, rectified.right)
            judged = judge_disparity(truth, found)
            if judged is None:
                raise SystemExit(f"{subject}, {name}: nothing was matched")
            silhouettes = (
                judge_silhouette(scene, camera, foreground)
                for camera, foreground in zip((pair.left, pair.right), foregrounds, strict=True)
            )
            outlines = [outline for outline in silhouettes if outline is not None]
            rows.append(
                {
                    "subject": subject,
                    "pair": name,
                    **asdict(judged),
                    "silhouette_mean_px": float(np.mean([outline.mean_px for outline in outlines])),
                    "silhouette_p95_px": float(np.max([outline.p95_px for outline in outlines])),
                    "prepare_seconds": prepared - begun,
                    "match_seconds": ended - prepared,
                }
            )
    return rows


COLUMNS = {
    "median_px": ("median px", ".3f"),
    "p95_px": ("95 % px", ".3f"),
    "beyond_1_px_percent": ("> 1 px %", ".2f"),
    "complete_percent": ("complete %", ".1f"),
    "depth_bias_mm": ("bias mm", "+.3f"),
    "near_edge_median_px": ("< 20 px of edge", ".3f"),
    "error_over_sigma": ("error / σ", ".2f"),
    "silhouette_mean_px": ("outline px", "+.2f"),
    "silhouette_p95_px": ("outline 95 %", ".2f"),
    "match_seconds": ("match s", ".1f"),
}


def table(rows: list[dict[str, Any]]) -> str:
    """Markdown."""
    head = ["subject", "pair", *(title for title, _ in COLUMNS.values())]
    lines = [head, ["---"] * len(head)]
    lines += [
        [row["subject"], row["pair"], *(format(row[key], form) for key, (_, form) in COLUMNS.items())] for row in rows
    ]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def main() -> None:
    """Print the table; write JSON where asked."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("captures", type=Path)
    parser.add_argument("--subject", action="append", default=[], help="one subject; may be repeated; default: all")
    parser.add_argument("--pair", action="append", default=[], help="one pair; may be repeated; default: all")
    parser.add_argument("--json", type=Path, help="write the figures there")
    arguments = parser.parse_args()
    rows = measure(arguments.captures, arguments.subject, arguments.pair, MatchSettings())
    if arguments.json:
        arguments.json.write_text(json.dumps(rows, indent=1))
    print(table(rows))


if __name__ == "__main__":
    main()
