"""The truth of a virtual session: files that no command but ``mammometry evaluate`` reads."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from mammometry.calibration.target import Target
from mammometry.geometry.camera import Rig
from mammometry.geometry.mesh import TriangleMesh
from mammometry.geometry.transform import Transform
from mammometry.simulate.phantom import Solid
from mammometry.simulate.targets import described


def write_truth(
    folder: Path,
    *,
    rig: Rig,
    target: Target,
    rig_from_board: Mapping[str, Transform],
    solid: Solid,
    rig_from_solid: Transform,
    subject: TriangleMesh,
    seed: int,
    scale: float,
) -> None:
    """Write cameras.json, boards.json, mesh.ply, boundary_base.xyz and truth.json; rig frame, mm.

    Args:
        folder: to make.
        rig: the true cameras.
        target: the board.
        rig_from_board: pose → where the board was.
        solid: the subject, in its own frame.
        rig_from_solid: where it stood.
        subject: its mesh as it stood and was rendered: the one whose volume is the truth.
        seed: that all was drawn with.
        scale: of the pictures.
    """
    folder.mkdir()
    first = next(iter(rig_from_board))
    cameras = {
        name: {
            "K": camera.matrix.tolist(),
            "dist": camera.distortion.tolist(),
            "R": camera.camera_from_world.rotation.tolist(),
            "t": camera.camera_from_world.translation_mm.tolist(),
            "image_size": list(camera.size_wh),
            "centre": camera.centre_world.tolist(),
        }
        for name, camera in rig.cameras.items()
    }
    _write_json(
        folder / "cameras.json",
        {
            "convention": "OpenCV: x_cam = R x_rig + t; dist = k1,k2,p1,p2,k3; pixel centres at integers; mm",
            "seed": seed,
            "scale": scale,
            "rig_from_board0": rig_from_board[first].matrix.tolist(),
            "cameras": cameras,
        },
    )
    _write_json(
        folder / "boards.json",
        {
            "frame": "rig_from_board 4x4, mm",
            "board0": f"pose {first}",
            "target": described(target),
            "rig_from_board": {pose: placed.matrix.tolist() for pose, placed in rig_from_board.items()},
        },
    )
    _write_ply(folder / "mesh.ply", subject)
    facts = dict(solid.facts)
    nipple = facts.pop("nipple_solid", None)
    if nipple is not None:
        facts["nipple_rig"] = rig_from_solid.apply(np.array(nipple)).tolist()
    if solid.base_boundary is not None:
        boundary = "\n".join(
            " ".join(f"{value:.4f}" for value in point) for point in rig_from_solid.apply(solid.base_boundary)
        )
        (folder / "boundary_base.xyz").write_text(f"# closed polyline, rig frame, mm\n{boundary}\n", encoding="utf-8")
    volumes_cc = {"model": subject.volume_mm3() / 1000.0}
    _write_json(
        folder / "truth.json",
        {
            "subject": solid.name,
            **facts,
            "frame": "rig, mm",
            "volume_cc": volumes_cc["model"],
            "volumes_cc": volumes_cc,
            "rig_from_solid": rig_from_solid.matrix.tolist(),
            "vertices": len(subject.vertices),
            "faces": len(subject.faces),
            "area_mm2": subject.area_mm2(),
            "seed": seed,
            "scale": scale,
        },
    )


def _write_json(path: Path, value: object) -> None:
    path.write_text(json.dumps(value, indent=1) + "\n", encoding="utf-8")


def _write_ply(path: Path, mesh: TriangleMesh) -> None:
    """Binary PLY in float32, which the vertices are rounded to already."""
    header = (
        "ply\nformat binary_little_endian 1.0\ncomment mm, rig frame\n"
        f"element vertex {len(mesh.vertices)}\nproperty float x\nproperty float y\nproperty float z\n"
        f"element face {len(mesh.faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    faces = np.empty(len(mesh.faces), dtype=[("n", "u1"), ("v", "<i4", 3)])
    faces["n"] = 3
    faces["v"] = mesh.faces
    with path.open("wb") as file:
        file.write(header.encode("ascii"))
        file.write(mesh.vertices.astype("<f4").tobytes())
        file.write(faces.tobytes())
