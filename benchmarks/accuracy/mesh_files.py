"""How many mesh files are read right, refused by name, or read wrong, by which program.

    python -m benchmarks.accuracy.mesh_files [--drawn 1000] [--usdz]

The files are those of tests/brought: a GLB for each part that readers overlook, GLBs drawn by chance, each change of a
PLY, an OBJ or an STL that must not change its numbers, and twins in every unit. Their true volume is known. Trimesh,
which version 1.0 read GLB with, is compared on GLB. ``--usdz`` adds USDZ: each starts a process.
"""

from __future__ import annotations

import argparse
import io
import re
import tempfile
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from random import Random

import numpy as np
import trimesh
from tests.brought.containers import GLBS, USDZS, Container, random_glb
from tests.brought.test_format_changes import EVERY, outcome

from mammometry.base.errors import MammometryError
from mammometry.io.meshes.foreign import read_foreign

_SAME = 2e-3  # relative difference of a volume that is right: positions in 16 bits lose half of it
_MESHES = ("ply", "obj", "stl")


def _read_cc(path: Path) -> float:
    return read_foreign(path).mesh.volume_mm3() / 1000


def _trimesh_cc(path: Path) -> float:
    scene = trimesh.load_scene(io.BytesIO(path.read_bytes()), file_type="glb", process=False)
    return float(scene.to_mesh().volume) * 1e6


def _verdict(path: Path, container: Container, read: Callable[[Path], float]) -> str:
    try:
        found = read(path)
    except MammometryError as error:
        named = re.search(container.refused or "(?!)", str(error)) or (
            not container.volume_cc and "no triangles" in str(error)
        )
        return "refused by name" if named else "refused without the cause"
    except Exception:  # trimesh raises anything
        return "refused without the cause"
    return "right" if abs(found - container.volume_cc) <= _SAME * container.volume_cc else "wrong"


def _print(what: str, verdicts: Counter[str]) -> None:
    parts = [f"{count} {verdict}" for verdict, count in sorted(verdicts.items())]
    print(f"{what}: {verdicts.total()} files: {', '.join(parts)}", flush=True)


def main() -> None:
    """Print the counts."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--drawn", type=int, default=1000, help="GLBs drawn by chance")
    parser.add_argument("--usdz", action="store_true", help="USDZ as well")
    given = parser.parse_args()
    np.seterr(all="ignore")
    drawn = [Container(f"drawn {seed}", lambda: b"", random_glb(seed)[1]) for seed in range(given.drawn)]
    with tempfile.TemporaryDirectory(prefix="mammometry-") as place:
        folder = Path(place)
        path = folder / "a.glb"
        for program, read in (("mammometry", _read_cc), ("trimesh", _trimesh_cc)):
            by_part: Counter[str] = Counter()
            for container in GLBS:
                path.write_bytes(container.make())
                by_part[_verdict(path, container, read)] += 1
            _print(f"GLB by part, {program}", by_part)
            by_chance: Counter[str] = Counter()
            for seed, container in enumerate(drawn):
                path.write_bytes(random_glb(seed)[0])
                by_chance[_verdict(path, container, read)] += 1
            _print(f"GLB drawn by chance, {program}", by_chance)
        if given.usdz:
            by_part = Counter()
            for container in USDZS:
                (folder / "a.usdz").write_bytes(container.make())
                by_part[_verdict(folder / "a.usdz", container, _read_cc)] += 1
            _print("USDZ by part, mammometry", by_part)
        changed: Counter[str] = Counter()
        for number, (subject, changes) in enumerate(EVERY):
            if subject.name.split("-")[0] in _MESHES:
                wrong = outcome(subject, changes, Random(number), folder / str(number), b"plain", "none")
                changed["wrong" if wrong else "the same numbers, or refused by name"] += 1
        _print("PLY, OBJ and STL with each change of their format, mammometry", changed)


if __name__ == "__main__":
    main()
