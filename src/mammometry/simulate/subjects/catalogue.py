"""Subjects by name: plaster models, torsos, plain solids, and anybody's mesh."""

from __future__ import annotations

from pathlib import Path

from mammometry.simulate.subjects.plaster import TABLE_1_WATER_CC, PlasterShape, plaster, plaster_shape
from mammometry.simulate.subjects.shapes import cylinder, plate, sphere
from mammometry.simulate.subjects.solid import Breast, Solid, rig_from_solid
from mammometry.simulate.subjects.torso import BreastShape, TorsoShape, torso, torso_shape
from mammometry.simulate.subjects.user_mesh import MeshFile, names_a_mesh, read_user_mesh

__all__ = [
    "TABLE_1_WATER_CC",
    "Breast",
    "BreastShape",
    "MeshFile",
    "PlasterShape",
    "Solid",
    "TorsoShape",
    "cylinder",
    "make_subject",
    "plaster",
    "plaster_shape",
    "plate",
    "rig_from_solid",
    "sphere",
    "torso",
    "torso_shape",
]

CHOICES = "plaster, plaster_1 … plaster_9, torso, torso_1, torso_2 …, sphere, cylinder, plate, or a PLY, OBJ or STL"
"""What a subject may be called."""


def make_subject(name: str, seed: int, *, edge_mm: float = 0.7, mesh_file: MeshFile | None = None) -> Solid:
    """Make a subject by name.

    Args:
        name: ``plaster``, ``plaster_1`` … ``plaster_9``, ``torso``, ``torso_1`` …, ``sphere``, ``cylinder``, ``plate``,
            or the path of a mesh.
        seed: of a drawn shape.
        edge_mm: about the longest edges wanted.
        mesh_file: how to read a mesh; its unit has no default.

    Raises:
        ValueError: there is no subject of that name.
        SessionError: a mesh that cannot be used, or of which the unit is not told.
    """
    family = name.split("_")[0]
    if names_a_mesh(name):
        return read_user_mesh(Path(name), mesh_file or MeshFile(), edge_mm=edge_mm)
    if name == "sphere":
        return sphere(edge_mm=edge_mm)
    if name == "cylinder":
        return cylinder(edge_mm=edge_mm)
    if name == "plate":
        return plate()
    if family == "torso":
        shape = torso_shape(name, seed)
        return torso(shape, name=name, seed=seed, edge_mm=edge_mm)
    if family == "plaster":
        return plaster(plaster_shape(name, seed), name=name, seed=seed, edge_mm=edge_mm)
    raise ValueError(f"{name!r}, but subjects are {CHOICES}")
