"""The user's mesh file as a subject: PLY, OBJ or STL in a stated unit."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from mammometry.base.errors import SessionError
from mammometry.base.units import UNIT_NAMES
from mammometry.geometry.arrays import Array, Float64, Int32
from mammometry.geometry.mesh import TriangleMesh, edge_table, split_edges
from mammometry.geometry.mesh_files.mesh_file import read_mesh_file
from mammometry.simulate.subjects.registry import SubjectRequest, add_subject
from mammometry.simulate.subjects.solid import SubjectSolid, rounded_mesh

MESH_SUFFIXES = (".ply", ".obj", ".stl")
_SMALLEST_MM, _LARGEST_MM = 5.0, 3000.0  # range of the longest side of a subject that fits a rig
_FACES_AT_MOST = 1_500_000  # limit for splitting long edges, because light is computed at every vertex


@dataclass(frozen=True, slots=True, kw_only=True)
class MeshFile:
    """Unit and orientation of a mesh file."""

    mm_per_unit: float | None = None
    """Millimetres per unit of the file. There is no default, because such files do not state it."""
    turn_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Rotations about x, then y, then z, after which y is up and z points out of the front."""


def names_a_mesh(name: str) -> bool:
    """Whether a subject's name is that of a mesh file."""
    return Path(name).suffix.lower() in MESH_SUFFIXES


def read_user_mesh(path: Path, how: MeshFile, *, edge_mm: float = 0.7) -> SubjectSolid:
    """Read a mesh as a subject.

    Colours and texture of the file are ignored. A closed mesh has a volume; its faces are reversed if they point
    inwards. An open mesh is accepted, too. Its truth is a surface without volume, and it is oriented so that most of it
    faces forwards. Long edges are split without changing the shape, so that light is computed densely.

    Args:
        path: a PLY, OBJ or STL file.
        how: unit and orientation.
        edge_mm: edges longer than three times this are split.

    Raises:
        SessionError: no unit is given, the file cannot be read or has no triangles, or the mesh is too small or too
            large.
    """
    if how.mm_per_unit is None:
        raise _refused(path, "no unit", "the unit of its coordinates", f"Add --units {UNIT_NAMES}, or --subject-scale")
    if not (math.isfinite(how.mm_per_unit) and how.mm_per_unit > 0):
        raise _refused(path, f"a scale of {how.mm_per_unit}", "millimetres to one unit, above 0", "Correct the scale")
    content = read_mesh_file(path)
    faces = content.faces
    vertices = Rotation.from_euler("xyz", how.turn_deg, degrees=True).apply(content.points * how.mm_per_unit)
    extent = float(np.ptp(vertices, axis=0).max())
    if not _SMALLEST_MM <= extent <= _LARGEST_MM:
        raise _refused(
            path,
            f"a mesh {extent:.3g} mm long",
            f"one of {_SMALLEST_MM:g} to {_LARGEST_MM:g} mm",
            "Check --units or --subject-scale",
        )
    vertices = vertices - 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))
    mesh = TriangleMesh(vertices=vertices, faces=faces)
    closed = mesh.is_watertight()
    inwards = mesh.volume_mm3() < 0 if closed else mesh.face_vectors().sum(axis=0)[2] < 0
    if inwards:
        faces = faces[:, ::-1].copy()
    vertices, faces = _finer(vertices, faces, 3.0 * edge_mm)
    return SubjectSolid(
        name=path.stem,
        subject_kind="model" if closed else "surface",
        mesh=rounded_mesh(vertices, faces),
        back_vertices=0,
        areola=np.zeros(len(vertices), dtype=np.float32),
        base_boundary=None,
        facts={"kind": "mesh", "file": path.name, "closed": closed, "mm_per_unit": how.mm_per_unit},
    )


@add_subject("user-mesh", has=names_a_mesh, choices="a PLY, OBJ or STL file")
def _user_mesh(wanted: SubjectRequest) -> SubjectSolid:
    return read_user_mesh(Path(wanted.name), wanted.mesh_file or MeshFile(), edge_mm=wanted.edge_mm)


def _finer(vertices: Array, faces: Array, longest_mm: float) -> tuple[Float64[Array, "n 3"], Int32[Array, "m 3"]]:
    """Split long edges at their midpoints, up to a number of faces."""
    while len(faces) < _FACES_AT_MOST:
        edges, of_face = edge_table(faces)
        split = np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1) > longest_mm
        if not split.any():
            break
        middle = vertices[edges[split]].mean(axis=1)
        faces = split_edges(faces, of_face, split, len(vertices))
        vertices = np.concatenate([vertices, middle])
    return vertices, faces


def _refused(path: Path, found: str, expected: str, remedy: str) -> SessionError:
    return SessionError(str(path), found=found, expected=expected, remedy=remedy)
