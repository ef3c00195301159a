"""Inputs of a job on a mesh, with their digests."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

from mammometry.geometry import Array, Float64, TriangleMesh
from mammometry.io.drawn import (
    BOUNDARIES,
    LANDMARK_FILE,
    DrawnBoundaries,
    boundaries_digest,
    landmarks_digest,
    read_table,
)
from mammometry.io.meshes.foreign import read_foreign
from mammometry.io.meshes.measured import MeshFiles
from mammometry.job.inputs import Inputs, SubjectKind

_FRONT_VERSION = "front 2"  # raised when another front is cut from the same mesh


def inputs_of(
    files: MeshFiles, kind: SubjectKind, drawn: DrawnBoundaries, places: dict[str, Float64[Array, "k 3"]]
) -> Inputs:
    """Inputs of the measurement: drawings on the mesh, in mm, and its description."""
    back: TriangleMesh | None = None if files.back is None else read_foreign(files.back, files.units).mesh
    return Inputs(
        rig_name="none",
        pair_names={},
        subject_kind=kind,
        photographs={},
        target=None,
        calibration_photographs={},
        boundaries=drawn.curves,
        automatic=drawn.automatic,
        removed=drawn.removed,
        head_stated=files.head is not None,
        attributions=drawn.attributions,
        landmarks=places,
        wall=back,
        scale_std=files.scale_std,
        digests={
            "mesh": _digest(
                files.mesh,
                files.units,
                files.largest,
                files.automatic,
                files.head,
                files.ahead,
                *(_digest(path) for path in files.also),
                *([_FRONT_VERSION] if files.automatic or files.head is not None else []),
            ),
            "subject": kind,
            "boundaries": boundaries_digest(drawn),
            "landmarks": landmarks_digest(places),
            "wall": _digest(files.back, files.units),
        },
    )


def copies_of(files: MeshFiles, drawn: DrawnBoundaries) -> dict[str, str]:
    """Name → drawing that was given, in mm."""
    copies = {} if files.landmarks is None else {LANDMARK_FILE: files.landmarks.read_text(encoding="utf-8")}
    if files.boundary is not None:
        table = read_table(files.boundary, "boundaries")
        for name, curve in drawn.curves.items():
            table["boundaries"][name]["points"] = curve.tolist()
        copies[BOUNDARIES] = json.dumps(table, indent=1, ensure_ascii=False) + "\n"
    return copies


def _digest(path: Path | None, *options: object) -> str:
    content = b"" if path is None else path.read_bytes()
    return hashlib.sha256(repr(options).encode() + content).hexdigest()
