"""Surface errors against the true mesh, with true cameras: `python -m benchmarks.accuracy.surface CAPTURES`.

CAPTURES is a folder laid out as ../shared/data/rendered. Judged at the truth's vertices that at least one pair sees,
weighted by their area: distance to our mesh, exact, unaligned; positive where ours lies outside. Truth is read here and
nowhere in the product.
"""

from __future__ import annotations

import argparse
import json
import resource
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from benchmarks.accuracy.matching import read_cameras
from benchmarks.rendered import subjects as all_subjects
from mammometry.geometry.camera import Rig
from mammometry.geometry.mesh import TriangleMesh
from mammometry.geometry.nearest import closest_on_mesh
from mammometry.io.images import read_photograph
from mammometry.matching.foreground import Foreground, estimate_foreground
from mammometry.matching.match import match
from mammometry.matching.rectify import rectify
from mammometry.matching.settings import MatchSettings
from mammometry.surface.decompose import decompose
from mammometry.surface.dents import remove_dents
from mammometry.surface.extract import extract
from mammometry.surface.range_image import RangeImage, triangulate
from mammometry.surface.repair import Provenance, repair
from mammometry.surface.settings import SurfaceSettings

COMPLETE_MM = 0.5


def range_images(captures: Path, subject: str) -> tuple[Rig, list[RangeImage], dict[str, Foreground]]:
    """Match every pair of a capture with the true cameras."""
    described = json.loads((captures / "session.json").read_text())
    rig = Rig(
        name="rendered",
        cameras=read_cameras(captures),
        pair_names={name: (left, right) for name, (left, right) in described["pairs"].items()},
    )
    settings = MatchSettings()
    suffix = described["image_format"]
    folder = captures / subject / "capture"
    photographs = {name: read_photograph(folder / f"{name}.{suffix}", name) for name in rig.cameras}
    foregrounds = {name: estimate_foreground(shot, name, settings.foreground) for name, shot in photographs.items()}
    images = []
    for pair in rig.pairs:
        left, right = pair.left.name, pair.right.name
        rectified = rectify(
            pair, photographs[left], photographs[right], foregrounds[left], foregrounds[right], settings.rectify
        )
        images.append(triangulate(match(rectified, settings)))
    return rig, images, foregrounds


def judge(mesh: TriangleMesh, truth_folder: Path, every: int) -> dict[str, float]:
    """Mean, RMS, 95 %, bias and completeness over the true surface seen by at least one pair, mm and %."""
    truth = trimesh.load(truth_folder / "mesh.ply", process=False)
    seen = np.load(truth_folder / "visibility.npz")["pair_bits"] > 0
    area = np.bincount(truth.faces.ravel(), np.repeat(truth.area_faces / 3, 3), minlength=len(truth.vertices))
    chosen = np.flatnonzero(seen)[::every]
    points, weight = np.asarray(truth.vertices[chosen], dtype=np.float64), area[chosen] / area[chosen].sum()
    found = closest_on_mesh(points, mesh)
    outwards = np.einsum("ij,ij->i", found.points - points, truth.vertex_normals[chosen])
    distance = found.distances_mm
    signed = np.where(outwards > 0, distance, -distance)
    order = np.argsort(distance)
    return {
        "mean_mm": float(weight @ distance),
        "rms_mm": float(np.sqrt(weight @ distance**2)),
        "p95_mm": float(distance[order][np.searchsorted(np.cumsum(weight[order]), 0.95)]),
        "bias_mm": float(weight @ signed),
        "complete_percent": float(100 * weight @ (distance <= COMPLETE_MM)),
        "dv_cc": float(weight @ signed * area[seen].sum() / 1000),
    }


def measure(captures: Path, names: list[str], settings: SurfaceSettings, every: int) -> list[dict[str, Any]]:
    """Figures of the first and of the repaired surface, one row each."""
    rows = []
    for subject in names or all_subjects(captures):
        rig, images, foregrounds = range_images(captures, subject)
        started, cpu = time.perf_counter(), time.process_time()
        valid = remove_dents(images, decompose(images, settings.decompose), settings.dents)
        first = extract(valid.range_images, foregrounds, rig, settings.extract)
        first_done = time.perf_counter() - started
        repaired = repair(first, valid, settings.repair)
        common = {"cpu_seconds": time.process_time() - cpu, "vertices": len(first.vertices)}
        for name, mesh, seconds in (
            ("first", first, first_done),
            ("repaired", repaired.mesh, time.perf_counter() - started),
        ):
            rows.append(
                {
                    "subject": subject,
                    "surface": name,
                    **judge(mesh, captures / subject / "truth", every),
                    "euler": mesh.euler_number(),
                    "watertight": mesh.is_watertight(),
                    "components": mesh.components()[0],
                    "measured_percent": float(100 * (repaired.provenance == Provenance.MEASURED).mean()),
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
    "euler": ("Euler", "d"),
    "watertight": ("watertight", ""),
    "components": ("parts", "d"),
    "vertices": ("vertices", ",d"),
    "seconds": ("s", ".1f"),
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
    parser.add_argument("captures", type=Path)
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
