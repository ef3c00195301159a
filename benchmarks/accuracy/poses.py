"""Volumes of bodies that lie differently in their files.

    python -m benchmarks.accuracy.poses --bodies ../shared/data/scans --names body_3_clean body_4_clean
    python -m benchmarks.accuracy.poses --bodies ../shared/data/scans --names body_4_clean --axes

Each pose is measured as the command does, with the front in the body's own frame (docs/decisions/0053). `--rivals`:
also with the front in the frame of the file's axes. `--axes`: the 24 ways to name a file's axes.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Iterator
from itertools import permutations, product
from pathlib import Path
from unittest.mock import patch

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.accuracy.scans import measured
from benchmarks.names import known
from mammometry.geometry import Float64, TriangleMesh
from mammometry.geometry.arrays import Array
from mammometry.geometry.mesh_files.ply import write_ply
from mammometry.io.meshes.foreign import read_foreign
from mammometry.measure import scanned
from mammometry.measure.scan_front import front_of_body
from mammometry.measure.scan_repair import RepairedScan

_PITCH_ROLL_DEG = ((0.0, 0.0), (40.0, 0.0), (-30.0, 0.0), (20.0, 30.0))
_own_front = scanned.own_front


def front_by_axes(scan: RepairedScan, frame: Float64[Array, "3 3"]) -> tuple[RepairedScan, Float64[Array, "3 3"]]:
    """The front as it is cut in the frame of the file's axes."""
    return front_of_body(scan, frame), frame


def poses(*, axes: bool) -> Iterator[tuple[str, Float64[Array, "3 3"]]]:
    """Name of each pose, and its rotation."""
    if not axes:
        for pitch, roll in _PITCH_ROLL_DEG:
            yield f"{pitch:.0f}°, {roll:.0f}°", Rotation.from_euler("zx", [roll, pitch], degrees=True).as_matrix()
        return
    for order in permutations(range(3)):
        for signs in product((1.0, -1.0), repeat=3):
            turn = np.eye(3)[list(order)] * np.array(signs)[:, None]
            if np.linalg.det(turn) > 0:
                up, ahead = (_axis_name(turn[:, column]) for column in (1, 2))
                yield f"head {up}, ahead {ahead}", turn


def _axis_name(direction: Float64[Array, 3]) -> str:
    return f"{'-' if direction.sum() < 0 else ''}{'xyz'[int(np.argmax(np.abs(direction)))]}"


def main() -> None:
    """Turn, measure, print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--bodies", type=Path, required=True, help="folder of the shared bodies")
    parser.add_argument("--names", nargs="*", default=["body_3_clean", "body_4_clean", "body_6_clean"])
    parser.add_argument("--axes", action="store_true", help="the 24 ways to name the file's axes, not pitch and roll")
    parser.add_argument("--rivals", action="store_true", help="the front by the file's axes, too")
    arguments = parser.parse_args()
    fronts = {"body's own": _own_front, "file's axes": front_by_axes}
    print("| body | pose (pitch, roll) | frame | cc |\n| --- | --- | --- | --- |")
    bodies = [path.stem for path in sorted(arguments.bodies.glob("*.ply"))]
    for name in known("bodies", arguments.names, bodies):
        mesh = read_foreign(arguments.bodies / f"{name}.ply", "m" if name.endswith("_scan") else "mm").mesh
        for pose, turn in poses(axes=arguments.axes):
            for which, front in list(fronts.items())[: 2 if arguments.rivals else 1]:
                with (
                    tempfile.TemporaryDirectory(prefix="mammometry-poses-") as folder,
                    patch.object(scanned, "own_front", front),
                ):
                    path = Path(folder) / "scan.ply"
                    write_ply(path, TriangleMesh(vertices=mesh.vertices @ turn.T, faces=mesh.faces), {}, comments=())
                    row = measured(path, report=False)
                volumes = ", ".join(f"{side} {own['volume_cc']:.1f}" for side, own in row["sides"].items())
                print(f"| {name} | {pose} | {which} | {volumes or row['refused'][:150]} |", flush=True)


if __name__ == "__main__":
    main()
