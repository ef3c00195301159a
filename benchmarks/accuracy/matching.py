"""Disparity errors against ray-cast truth, with true or estimated cameras.

    python -m benchmarks.accuracy.matching CAPTURES [--cameras estimated] [--subject torso] [--pair floor]

CAPTURES is a folder laid out as ../shared/data/rendered, or a session of `mammometry simulate`. A pixel counts when
its true surface point is seen by both cameras inside both frames, more than 5 px from any occluding edge in either
rectified picture, and by both at less than 70° of incidence; "rim" is all that both see within 8 px of an edge. With
`--cameras estimated` the pairs are rectified by what the capture's own calibration photographs give; what is true of a
photograph's pixel does not depend on that, so the matcher's error stays apart from the calibration's, and nothing has
to be aligned. The bias of the ranges holds both. Truth is read here and nowhere in the product.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.pairs import Case, calibrated, captures, cases
from mammometry.matching.dense.match import match
from mammometry.matching.settings import MatchSettings
from mammometry.study.accuracy_matching import judge_disparity, judge_range, judge_silhouette
from mammometry.surface.ranges.range_image import triangulate
from mammometry.surface.settings import TriangulateSettings

_EVERY_PIXEL = TriangulateSettings(spacing_mm=1e-3)


def measure(
    folder: Path, subjects: list[str], pairs: list[str], settings: MatchSettings, *, estimated: bool = False
) -> list[dict[str, Any]]:
    """One row a subject and pair."""
    with tempfile.TemporaryDirectory() as scratch:
        found = captures(folder, subjects, Path(scratch))
        rig = calibrated(found[0].session) if estimated else None  # all subjects are photographed by one rig
        return [
            {"subject": capture.name, "pair": case.pair.name, **_row(case, settings)}
            for capture in found
            for case in cases(capture, pairs, settings, rig)
        ]


def _row(case: Case, settings: MatchSettings) -> dict[str, Any]:
    begun = time.process_time()
    found = match(case.pair, settings)
    seconds = time.process_time() - begun
    judged = judge_disparity(case.truth, found)
    ranges = judge_range(case.truth, triangulate(found, _EVERY_PIXEL))
    if judged is None or ranges is None:
        raise SystemExit(f"{case.pair.name}: nothing was matched")
    cameras = (case.true_cameras.left, case.true_cameras.right)
    silhouettes = (judge_silhouette(case.scene, *each) for each in zip(cameras, case.foregrounds, strict=True))
    outlines = [outline for outline in silhouettes if outline is not None]
    return {
        **asdict(judged),
        "range_bias_mm": ranges.bias_mm,
        "silhouette_mean_px": float(np.mean([outline.mean_px for outline in outlines])) if outlines else None,
        "silhouette_p95_px": max((outline.p95_px for outline in outlines), default=None),
        "prepare_seconds": case.prepare_seconds,
        "match_cpu_seconds": seconds,
    }


COLUMNS = {
    "median_px": ("median px", ".3f"),
    "p95_px": ("95 % px", ".3f"),
    "beyond_1_px_percent": ("> 1 px %", ".2f"),
    "complete_percent": ("complete %", ".1f"),
    "depth_bias_mm": ("bias mm", "+.3f"),
    "range_bias_mm": ("range bias mm", "+.3f"),
    "near_edge_median_px": ("< 20 px of edge", ".3f"),
    "rim_bias_mm": ("rim mm", "+.3f"),
    "error_over_sigma": ("error / σ", ".2f"),
    "silhouette_mean_px": ("outline px", "+.2f"),
    "silhouette_p95_px": ("outline 95 %", ".2f"),
    "match_cpu_seconds": ("match CPU s", ".1f"),
}


def table(rows: list[dict[str, Any]]) -> str:
    """Markdown."""
    head = ["subject", "pair", *(title for title, _ in COLUMNS.values())]
    lines, columns = [head, ["---"] * len(head)], COLUMNS.items()
    lines += [
        [
            row["subject"],
            row["pair"],
            *("–" if row[key] is None else format(row[key], form) for key, (_, form) in columns),
        ]
        for row in rows
    ]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def main() -> None:
    """Print the table; write JSON where asked."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("captures", type=Path)
    parser.add_argument("--cameras", choices=("true", "estimated"), default="true")
    parser.add_argument("--subject", action="append", default=[], help="one subject; may be repeated; default: all")
    parser.add_argument("--pair", action="append", default=[], help="one pair; may be repeated; default: all")
    parser.add_argument("--json", type=Path, help="write the figures there")
    arguments = parser.parse_args()
    estimated = arguments.cameras == "estimated"
    rows = measure(
        arguments.captures, arguments.subject, arguments.pair, MatchSettings(resolution="full"), estimated=estimated
    )
    if arguments.json:
        arguments.json.write_text(json.dumps(rows, indent=1))
    print(table(rows))


if __name__ == "__main__":
    main()
