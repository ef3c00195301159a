"""Surface errors against the true mesh, with true or estimated cameras.

    python -m benchmarks.accuracy.surface CAPTURES [--cameras estimated] [--subject torso]
    python -m benchmarks.accuracy.surface CAPTURES --cameras estimated --cube-mm 0.5 0.7 --volumes

CAPTURES is a folder laid out as ../shared/data/rendered, or a session of `mammometry simulate`. Judged at the
truth's vertices that at least one pair sees, weighted by their area: distance to our mesh, exact, unaligned; positive
where ours lies outside. With `--cameras estimated` everything is made by what the capture's own calibration photographs
give, and the mesh is brought into the truth's frame by the true place of the target that is the world: no fit of
surfaces or cameras, so that all of the calibration's error is in the figures. Truth is read here and nowhere in the
product. Each width of the cubes has a process of its own. `--volumes` goes on to the volumes: a copy of the session is
calibrated and matched, then surface and measurement are timed, no pictures drawn.
"""

from __future__ import annotations

import argparse
import json
import resource
import shutil
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.pairs import Capture, captures, foregrounds_of
from benchmarks.speed.reference import beside
from mammometry.api.job import open_session
from mammometry.geometry.arrays import Array
from mammometry.geometry.camera import Rig
from mammometry.geometry.mesh import TriangleMesh
from mammometry.geometry.transform import Transform
from mammometry.io.photographs.images import read_photograph
from mammometry.io.truth import read_truth
from mammometry.matching.dense.match import match
from mammometry.matching.foreground.foreground import Foreground
from mammometry.matching.rectify import rectify
from mammometry.matching.settings import MatchSettings
from mammometry.settings import Settings
from mammometry.study.accuracy import compare_surfaces
from mammometry.study.evaluation import Truth
from mammometry.study.rays import RayScene, seen_by_pairs
from mammometry.surface.fusion.fuse import extract
from mammometry.surface.ranges.dents import remove_dents
from mammometry.surface.ranges.range_image import RangeImage, triangulate
from mammometry.surface.repair.repair import Provenance, repair
from mammometry.surface.repair.untangle import crossing_faces
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
    foregrounds = foregrounds_of(rig, photographs, settings.foreground)
    images = []
    for pair in rig.pairs:
        left, right = pair.left.name, pair.right.name
        rectified = rectify(pair, photographs[left], photographs[right], foregrounds[left], foregrounds[right])
        images.append(triangulate(match(rectified, settings)))
    return images, foregrounds


def volumes(folder: Path, names: list[str], cube_mm: float) -> list[dict[str, Any]]:
    """Volumes by cubes of one width, and what surface and measurement took."""
    settings, rows = Settings().overridden([f"surface.extract.cube_mm={cube_mm}"]), []
    with tempfile.TemporaryDirectory() as scratch:
        for capture in captures(folder, names, Path(scratch)):
            copy = Path(scratch) / "copies" / capture.name
            shutil.copytree(capture.session, copy)
            for stage in ("surface", "measure", "report"):
                shutil.rmtree(copy / "results" / stage, ignore_errors=True)
            job = open_session(copy, settings)
            job.ensure("match", drawn=False)
            with beside() as reference:
                cpu = time.process_time()
                job.ensure("measure", drawn=False)
                cpu = time.process_time() - cpu
            true_cc = read_truth(capture.truth, job.session.pair_names).volumes_cc
            rows.append(
                {
                    "subject": capture.name,
                    "cube_mm": cube_mm,
                    "vertices": len(job.surface().textured.mesh.vertices),
                    "cpu_seconds": cpu,
                    "references": cpu / reference.processor_s,
                    "peak_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
                    "volumes_cc": {name: (found.volume_cc, true_cc[name]) for name, found in job.measure().items()},
                }
            )
    return rows


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
            "cube_mm": settings.extract.of(job.inputs.subject_kind).cube_mm,
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
    head = ["subject", "cubes mm", "surface", *(title for title, _ in COLUMNS.values())]
    lines = [head, ["---"] * len(head)]
    lines += [
        [
            row["subject"],
            f"{row['cube_mm']:g}",
            row["surface"],
            *(format(row[key], form) for key, (_, form) in COLUMNS.items()),
        ]
        for row in rows
    ]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def table_of_volumes(rows: list[dict[str, Any]]) -> str:
    """Markdown."""
    lines = ["| subject | cubes mm | vertices | processor s | references | peak MB | cc (true) |", "| --- " * 7 + "|"]
    for row in rows:
        found = ", ".join(f"{name} {cc:.1f} ({true_cc:.1f})" for name, (cc, true_cc) in row["volumes_cc"].items())
        width = f"{row['cube_mm']:g}" if row["cube_mm"] else "as chosen"
        took = f"{row['cpu_seconds']:.1f} | {row['references']:.1f} | {row['peak_mb']:.0f}"
        lines.append(f"| {row['subject']} | {width} | {row['vertices']:,d} | {took} | {found} |")
    return "\n".join(lines)


def alone(work: Callable[[], list[dict[str, Any]]]) -> list[dict[str, Any]]:
    """Do work in a process of its own, so that its memory is known."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        return pool.submit(work).result()


def main() -> None:
    """Print the table; write JSON where asked."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("captures", type=Path, help="captures of the independent renderer, or a simulated session")
    parser.add_argument("--subject", action="append", default=[], help="one subject; may be repeated; default: all")
    parser.add_argument("--cameras", choices=["true", "estimated"], default="true")
    parser.add_argument("--rule", choices=["default", "nearest", "furthest"], default="default")
    parser.add_argument("--cube-mm", type=float, nargs="+", default=[0.0], help="0: as the product chooses")
    parser.add_argument("--volumes", action="store_true", help="also measure them, and time that")
    parser.add_argument("--every", type=int, default=3, help="judge every n-th true vertex")
    parser.add_argument("--json", type=Path, help="write the figures there")
    arguments = parser.parse_args()
    chosen, estimated = (arguments.captures, arguments.subject), arguments.cameras == "estimated"
    rows, measured = [], []
    for cube_mm in arguments.cube_mm:
        default = SurfaceSettings()
        settings = replace(default, extract=replace(default.extract, rule=arguments.rule, cube_mm=cube_mm))
        rows += alone(partial(measure, *chosen, settings, arguments.every, estimated=estimated))
        measured += alone(partial(volumes, *chosen, cube_mm)) if arguments.volumes else []
    if arguments.json:
        arguments.json.write_text(json.dumps(rows + measured, indent=1))
    print(table(rows))
    if measured:
        print(f"\n{table_of_volumes(measured)}")


if __name__ == "__main__":
    main()
