"""Surface errors against the true mesh, with true cameras: `python -m benchmarks.accuracy.surface CAPTURES`.

CAPTURES is a folder laid out as ../shared/data/rendered, or a session of `mammometry simulate`. Judged at the
truth's vertices that at least one pair sees, weighted by their area: distance to our mesh, exact, unaligned; positive
where ours lies outside. Truth is read here and nowhere in the product.
"""

from __future__ import annotations

import argparse
import json
import resource
import time
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.rendered import subjects as all_subjects
from mammometry.geometry.arrays import Array
from mammometry.geometry.camera import Rig
from mammometry.geometry.mesh import TriangleMesh
from mammometry.io.images import read_photograph
from mammometry.io.meshes import read_ply
from mammometry.io.truth import read_true_cameras
from mammometry.matching.foreground import Foreground, estimate_foreground
from mammometry.matching.match import match
from mammometry.matching.rectify import rectify
from mammometry.matching.settings import MatchSettings
from mammometry.study.accuracy import compare_surfaces
from mammometry.study.rays import RayScene, seen_by_pairs
from mammometry.surface.crossing import crossing_faces
from mammometry.surface.dents import remove_dents
from mammometry.surface.extract import extract
from mammometry.surface.range_image import RangeImage, triangulate
from mammometry.surface.repair import Provenance, repair
from mammometry.surface.settings import SurfaceSettings


@dataclass(frozen=True)
class Capture:
    """Where a subject's photographs, the cameras that took them, and its true surface lie."""

    name: str
    photographs: Path
    cameras: Path
    truth: Path
    pair_names: Mapping[str, tuple[str, str]]


def captures_in(folder: Path, names: list[str]) -> list[Capture]:
    """The subjects of a renderer's captures, or the one of a session."""
    manifest = folder / "session.toml"
    if manifest.is_file():
        pairs = tomllib.loads(manifest.read_text())["rig"]["pairs"]
        pair_names = {pair["name"]: (pair["left"], pair["right"]) for pair in pairs}
        return [Capture(folder.name, folder / "capture", folder / "truth", folder / "truth", pair_names)]
    described = json.loads((folder / "session.json").read_text())
    pair_names = {name: (left, right) for name, (left, right) in described["pairs"].items()}
    return [
        Capture(name, folder / name / "capture", folder / "truth", folder / name / "truth", pair_names)
        for name in names or all_subjects(folder)
    ]


def range_images(capture: Capture) -> tuple[Rig, list[RangeImage], dict[str, Foreground]]:
    """Match every pair of a capture with the true cameras."""
    rig = Rig(name="true", cameras=read_true_cameras(capture.cameras), pair_names=capture.pair_names)
    settings = MatchSettings()
    files = {path.stem: path for path in capture.photographs.iterdir()}
    photographs = {name: read_photograph(files[name], name) for name in rig.cameras}
    foregrounds = {name: estimate_foreground(shot, name, settings.foreground) for name, shot in photographs.items()}
    images = []
    for pair in rig.pairs:
        left, right = pair.left.name, pair.right.name
        rectified = rectify(
            pair, photographs[left], photographs[right], foregrounds[left], foregrounds[right], settings.rectify
        )
        images.append(triangulate(match(rectified, settings)))
    return rig, images, foregrounds


def judge(mesh: TriangleMesh, truth: TriangleMesh, seen: Array) -> dict[str, float]:
    """Mean, RMS, 95 %, bias and completeness over the true surface seen by at least one pair, mm and %."""
    found = compare_surfaces(mesh, truth, at=seen)
    return {
        "mean_mm": found.mean_mm,
        "rms_mm": found.rms_mm,
        "p95_mm": found.p95_mm,
        "bias_mm": found.bias_mm,
        "complete_percent": found.complete_percent,
        "dv_cc": found.volume_bias_cc,
    }


def measure(captures: Path, names: list[str], settings: SurfaceSettings, every: int) -> list[dict[str, Any]]:
    """Figures of the first and of the repaired surface, one row each."""
    rows = []
    for capture in captures_in(captures, names):
        rig, images, foregrounds = range_images(capture)
        started, cpu = time.perf_counter(), time.process_time()
        valid = remove_dents(images, None, settings.dents)
        first = extract(valid.range_images, foregrounds, rig, settings.extract)
        first_done = time.perf_counter() - started
        repaired = repair(first, valid, settings.repair)
        repaired_done = time.perf_counter() - started
        common = {"cpu_seconds": time.process_time() - cpu, "vertices": len(first.vertices)}
        truth = read_ply(capture.truth / "mesh.ply")[0]
        looked_at, by_pair = seen_by_pairs(RayScene(truth), rig, every=every)
        seen = looked_at[np.any(list(by_pair.values()), axis=0)]
        for name, mesh, seconds in (
            ("first", first, first_done),
            ("repaired", repaired.mesh, repaired_done),
        ):
            rows.append(
                {
                    "subject": capture.name,
                    "surface": name,
                    **judge(mesh, truth, seen),
                    "euler": mesh.euler_number(),
                    "watertight": mesh.is_watertight(),
                    "components": mesh.components()[0],
                    "measured_percent": float(100 * (repaired.provenance == Provenance.MEASURED).mean()),
                    "crossings": len(crossing_faces(mesh)),
                    "seconds": seconds,
                    "peak_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
                    **common,
                }
            )
    return rows


COLUMNS = {
    "mean_mm": ("mean mm", ".3f"),
    "rms_mm": ("RMS", ".3f"),
    "p95_mm": ("95 %", ".3f"),
    "bias_mm": ("bias", "+.3f"),
    "complete_percent": ("complete %", ".2f"),
    "dv_cc": ("dV cc", "+.2f"),
    "crossings": ("crossings", "d"),
    "euler": ("Euler", "d"),
    "watertight": ("watertight", ""),
    "components": ("parts", "d"),
    "vertices": ("vertices", ",d"),
    "cpu_seconds": ("processor s", ".1f"),
    "peak_mb": ("peak MB", ".0f"),
}


def table(rows: list[dict[str, Any]]) -> str:
    """Markdown."""
    head = ["subject", "surface", *(title for title, _ in COLUMNS.values())]
    lines = [head, ["---"] * len(head)]
    lines += [
        [row["subject"], row["surface"], *(format(row[key], form) for key, (_, form) in COLUMNS.items())]
        for row in rows
    ]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def main() -> None:
    """Print the table; write JSON where asked."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("captures", type=Path, help="captures of the independent renderer, or a simulated session")
    parser.add_argument("--subject", action="append", default=[], help="one subject; may be repeated; default: all")
    parser.add_argument("--rule", choices=["default", "nearest", "furthest"], default="default")
    parser.add_argument("--cube-mm", type=float, default=0.5)
    parser.add_argument("--every", type=int, default=3, help="judge every n-th true vertex")
    parser.add_argument("--json", type=Path, help="write the figures there")
    arguments = parser.parse_args()
    settings = SurfaceSettings()
    chosen = replace(settings.extract, rule=arguments.rule, cube_mm=arguments.cube_mm)
    rows = measure(arguments.captures, arguments.subject, replace(settings, extract=chosen), arguments.every)
    if arguments.json:
        arguments.json.write_text(json.dumps(rows, indent=1))
    print(table(rows))


if __name__ == "__main__":
    main()
