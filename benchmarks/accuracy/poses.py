"""Volumes of pitched bodies, from the file's axes and from the body's own frame.

    python -m benchmarks.accuracy.poses --bodies ../shared/data/scans --names body_3 body_4 body_6

The body's own frame and its front are found in turn (docs/decisions/0053). The product does not use it.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path
from unittest.mock import patch

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.accuracy.scans import measured
from mammometry.geometry import Float64, TriangleMesh
from mammometry.geometry.arrays import Array
from mammometry.geometry.mesh_files.ply import write_ply
from mammometry.io.meshes.foreign import read_foreign
from mammometry.measure import scanned
from mammometry.measure.scan_front import front_of_body
from mammometry.measure.scan_repair import RepairedScan
from mammometry.measure.trunk.body import find_body

_PITCHES_DEG = (0.0, 40.0, -40.0)
_ROUNDS = 3  # frames of body_3 differ by less than 0.2° after the second, from five poses
_by_axes = scanned.frame_from_axes


def settled_frame(mesh: TriangleMesh, head: str | None = None, ahead: str | None = None) -> Float64[Array, "3 3"]:
    """The body's own frame and its front, each found from the other, from the file's axes on.

    Raises:
        MeasureError: no front, or no trunk on it.
    """
    frame = _by_axes(mesh, head, ahead)
    scan = RepairedScan(mesh=mesh, invented=np.zeros(len(mesh.vertices), dtype=bool), notices=())
    for _ in range(_ROUNDS):
        front = front_of_body(scan, frame)
        frame = find_body(scanned.as_scanned(front.mesh, front.invented), frame, stated=True).frame
    return frame


def main() -> None:
    """Turn, measure in both frames, print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--bodies", type=Path, required=True, help="folder of the shared bodies")
    parser.add_argument("--names", nargs="*", default=["body_3", "body_4", "body_6"])
    arguments = parser.parse_args()
    print("| body | pitch | frame | cc |\n| --- | --- | --- | --- |")
    for name in arguments.names:
        mesh = read_foreign(arguments.bodies / f"{name}_clean.ply", "mm").mesh
        for pitch_deg in _PITCHES_DEG:
            turn = Rotation.from_euler("x", pitch_deg, degrees=True).as_matrix()
            pitched = TriangleMesh(vertices=mesh.vertices @ turn.T, faces=mesh.faces)
            for which, frame_of in (("file's axes", _by_axes), ("body's own", settled_frame)):
                with (
                    tempfile.TemporaryDirectory(prefix="mammometry-poses-") as folder,
                    patch.object(scanned, "frame_from_axes", frame_of),
                ):
                    path = Path(folder) / "scan.ply"
                    write_ply(path, pitched, {}, comments=())
                    row = measured(path, report=False)
                volumes = ", ".join(f"{side} {own['volume_cc']:.1f}" for side, own in row["sides"].items())
                print(f"| {name} | {pitch_deg:.0f}° | {which} | {volumes or row['refused'][:150]} |", flush=True)


if __name__ == "__main__":
    main()
