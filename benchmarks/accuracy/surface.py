"""Surface errors against the true mesh, with true or estimated cameras.

    python -m benchmarks.accuracy.surface CAPTURES [--cameras estimated] [--subject torso]

CAPTURES is a folder laid out as ../shared/data/rendered, or a session of `mammometry simulate`. Judged at the
truth's vertices that at least one pair sees, weighted by their area: distance to our mesh, exact, unaligned; positive
where ours lies outside. With `--cameras estimated` everything is made by what the capture's own calibration photographs
give, and the mesh is brought into the truth's frame by the true place of the target that is the world: no fit of
surfaces or cameras, so that all of the calibration's error is in the figures. Truth is read here and nowhere in the
product.
"""

from __future__ import annotations

import argparse
import json
import resource
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.pairs import Capture, captures
from mammometry.api.job import open_session
from mammometry.geometry.arrays import Array
from mammometry.geometry.camera import Rig
from mammometry.geometry.mesh import TriangleMesh
from mammometry.geometry.transform import Transform
from mammometry.io.images import read_photograph
from mammometry.io.truth import read_truth
from mammometry.matching.coarse_depth import seeds_of_cameras
from mammometry.matching.foreground import Foreground, estimate_foreground
from mammometry.matching.match import match
from mammometry.matching.rectify import rectify
from mammometry.matching.settings import MatchSettings
from mammometry.settings import Settings
from mammometry.study.accuracy import compare_surfaces
from mammometry.study.rays import RayScene, seen_by_pairs
from mammometry.study.truth import Truth
from mammometry.surface.crossing import crossing_faces
from mammometry.surface.dents import remove_dents
from mammometry.surface.extract import extract
from mammometry.surface.range_image import RangeImage, triangulate
from mammometry.surface.repair import Provenance, repair
from mammometry.surface.settings import SurfaceSettings


def cameras_of(
    capture: Capture, truth: Truth, *, estimated: bool, settings: Settings = Settings()
) -> tuple[Rig, Transform]:
    """The cameras to measure with, and the truth's frame from theirs."""
    if not estimated:
        return truth.rig, Transform.identity()
    calibration = open_session(capture.session, settings).calibration()
    if calibration is None:
        raise SystemExit(f"{capture.name}: its cameras came ready-made")
    for pose, world_from_target in calibration.world_from_target.items():
        if np.allclose(world_from_target.matrix, np.eye(4), atol=1e-9):
            return calibration.rig, truth.rig_from_target[pose]
    raise SystemExit(f"{capture.name}: no target is the world")


def range_images(capture: Capture, rig: Rig) -> tuple[list[RangeImage], dict[str, Foreground]]:
    """Match every pair of a capture."""
    settings = MatchSettings()
    files = {path.stem: path for path in (capture.session / "capture").iterdir()}
    photographs = {name: read_photograph(files[name], name) for name in rig.cameras}
    seeds = seeds_of_cameras(rig, photographs)
    foregrounds = {
        name: estimate_foreground(shot, name, settings.foreground, seeds=seeds[name])
        for name, shot in photographs.items()
    }
    images = []
    for pair in rig.pairs:
        left, right = pair.left.name, pair.right.name
        rectified = rectify(
            pair, photographs[left], photographs[right], foregrounds[left], foregrounds[right], settings.rectify
        )
        images.append(triangulate(match(rectified, settings)))
    return images, foregrounds


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


def measure(
    folder: Path, names: list[str], settings: SurfaceSettings, every: int, *, estimated: bool
) -> list[dict[str, Any]]:
    """Figures of the first and of the repaired surface, one row each."""
    with tempfile.TemporaryDirectory() as scratch:
        rows = []
        for capture in captures(folder, names, Path(scratch)):
            rows += _rows(capture, settings, every, estimated=estimated)
        return rows


def _rows(capture: Capture, settings: SurfaceSettings, every: int, *, estimated: bool) -> list[dict[str, Any]]:
    job = open_session(capture.session)
    truth = read_truth(capture.truth, job.session.pair_names)
    rig, truth_from_world = cameras_of(capture, truth, estimated=estimated)
    images, foregrounds = range_images(capture, rig)
    started, cpu = time.perf_counter(), time.process_time()
    valid = remove_dents(images, None, settings.dents)
    first = extract(valid.range_images, foregrounds, rig, settings.extract.of(job.inputs.subject_kind))
    first_done = time.perf_counter() - started
    repaired = repair(first, valid, settings.repair)
    repaired_done = time.perf_counter() - started
    common = {"cpu_seconds": time.process_time() - cpu, "vertices": len(first.vertices)}
    looked_at, by_pair = seen_by_pairs(RayScene(truth.mesh), truth.rig, every=every)
    seen = looked_at[np.any(list(by_pair.values()), axis=0)]
    return [
        {
            "subject": capture.name,
            "surface": name,
            **judge(mesh.transformed(truth_from_world), truth.mesh, seen),
            "euler": mesh.euler_number(),
            "watertight": mesh.is_watertight(),
            "components": mesh.components()[0],
            "measured_percent": float(100 * (repaired.provenance == Provenance.MEASURED).mean()),
            "crossings": len(crossing_faces(mesh)),
            "seconds": seconds,
            "peak_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
            **common,
        }
        for name, mesh, seconds in (("first", first, first_done), ("repaired", repaired.mesh, repaired_done))
    ]


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
    parser.add_argument("--cameras", choices=["true", "estimated"], default="true")
    parser.add_argument("--rule", choices=["default", "nearest", "furthest"], default="default")
    parser.add_argument("--cube-mm", type=float, default=0.0, help="0: as the product chooses")
    parser.add_argument("--every", type=int, default=3, help="judge every n-th true vertex")
    parser.add_argument("--json", type=Path, help="write the figures there")
    arguments = parser.parse_args()
    settings = SurfaceSettings()
    chosen = replace(settings.extract, rule=arguments.rule, cube_mm=arguments.cube_mm)
    settings, estimated = replace(settings, extract=chosen), arguments.cameras == "estimated"
    rows = measure(arguments.captures, arguments.subject, settings, arguments.every, estimated=estimated)
    if arguments.json:
        arguments.json.write_text(json.dumps(rows, indent=1))
    print(table(rows))


if __name__ == "__main__":
    main()
