"""Artefacts of an acceptance test: a ball, a bar with two balls, a plate, a cast.

Frame: right, up and towards the device, with the origin at the centre of the working volume, mm.
"""

from __future__ import annotations

import numpy as np

from mammometry.base.errors import UnknownWordError
from mammometry.geometry.arrays import Array, Float64
from mammometry.geometry.mesh import TriangleMesh, joined
from mammometry.simulate.subjects.registry import SubjectRequest, add_subject
from mammometry.simulate.subjects.shapes import plate, sphere
from mammometry.simulate.subjects.solid import SubjectSolid, rounded_mesh
from mammometry.study.acceptance.artefacts import (
    POSITIONS,
    VOLUME_MM,
    Artefact,
    Bar,
    Cast,
    Kind,
    Plane,
    Position,
    Sphere,
)

_EDGE_MM = 2.0  # edge of the triangles, similar to that of a rig's surfaces
_BALL_EDGE_MM = 1.0  # largest edge of an artefact to be photographed: error up to 0.006 mm on a ball of 60 mm
_SEEN = -0.2  # least cosine between a visible face's normal and the device's direction: its cameras are spread out
_ROD_MM = 8.0  # radius of a bar's rod, and of a ball's stem
_STEM_MM = 90.0  # length of the stem below a ball
_PLATE_MM = (240.0, 180.0)  # sides of a plane: a sheet of A4 with margins

DRAWN: dict[Kind, Artefact] = {
    "sphere": Sphere(diameter_mm=145.0, diameter_std_mm=0.02, form_std_mm=0.02, source="drawn"),
    "bar": Bar(distance_mm=300.0, distance_std_mm=0.03, diameter_mm=60.0, diameter_std_mm=0.02, source="drawn"),
    "plane": Plane(flatness_std_mm=0.02, source="drawn"),
}
"""Artefacts that a virtual rig photographs."""
_NAME = "test-"  # prefix of their names


def artefact_mesh(artefact: Artefact, position: Position, *, edge_mm: float = _EDGE_MM) -> TriangleMesh:
    """Exact surface of an artefact at a position: the part that the device sees, or all of a cast."""
    centre = np.array(position.centre) * VOLUME_MM
    match artefact:
        case Sphere():
            return _seen(_ball(artefact.diameter_mm, centre, edge_mm))
        case Bar():
            ball_edge_mm = min(edge_mm, artefact.diameter_mm / 30)
            return joined([_seen(part) for part in _bar(artefact, position, centre, ball_edge_mm, edge_mm)])
        case Plane():
            flat = _plate(position, centre, edge_mm)
            front = _turned(np.array(position.axis))[:, 2]
            vectors = flat.face_vectors()
            return flat.submesh(vectors @ front > 0.9 * np.linalg.norm(vectors, axis=1))
        case Cast():
            whole = _ball(2 * (3000 * artefact.volume_cc / (4 * np.pi)) ** (1 / 3), np.zeros(3), edge_mm)
            exact = (1000 * artefact.volume_cc / whole.volume_mm3()) ** (1 / 3)
            return TriangleMesh(vertices=whole.vertices * exact + centre, faces=whole.faces)


def _whole(artefact: Artefact, position: Position, edge_mm: float) -> TriangleMesh:
    """Complete artefact for photographs: a ball with its stem, a bar, or a plate with its back."""
    centre = np.array(position.centre) * VOLUME_MM
    match artefact:
        case Sphere():
            down = np.array([0.0, -1.0, 0.0])
            foot = centre + (artefact.diameter_mm / 2 + _STEM_MM) * down
            return joined(
                [
                    _ball(artefact.diameter_mm, centre, edge_mm),
                    _rod(centre, foot, artefact.diameter_mm / 2, 0.0, edge_mm),
                ]
            )
        case Bar():
            return joined(list(_bar(artefact, position, centre, edge_mm, edge_mm)))
        case Plane():
            return _plate(position, centre, edge_mm)
        case Cast():
            raise ValueError("a cast is a subject of its own")


def _bar(
    bar: Bar, position: Position, centre: Float64[Array, 3], ball_edge_mm: float, edge_mm: float
) -> tuple[TriangleMesh, TriangleMesh, TriangleMesh]:
    axis = np.array(position.axis) / np.linalg.norm(position.axis)
    ends = [centre + side * bar.distance_mm / 2 * axis for side in (-1, 1)]
    within_mm = bar.diameter_mm / 2
    first, second = (_ball(bar.diameter_mm, end, ball_edge_mm) for end in ends)
    return first, second, _rod(ends[0], ends[1], within_mm, within_mm, edge_mm)


def _ball(diameter_mm: float, centre: Float64[Array, 3], edge_mm: float) -> TriangleMesh:
    mesh = sphere(diameter_mm / 2, edge_mm=edge_mm).mesh
    return TriangleMesh(vertices=mesh.vertices + centre, faces=mesh.faces)


def _plate(position: Position, centre: Float64[Array, 3], edge_mm: float) -> TriangleMesh:
    mesh = plate(*_PLATE_MM, edge_mm=edge_mm).mesh
    turn = _turned(np.array(position.axis))
    return TriangleMesh(vertices=mesh.vertices @ turn.T + centre, faces=mesh.faces)


def _rod(
    start: Float64[Array, 3], stop: Float64[Array, 3], from_mm: float, to_mm: float, edge_mm: float
) -> TriangleMesh:
    """Open round rod, from 0.95 `from_mm` after the start to 0.95 `to_mm` before the end."""
    axis = (stop - start) / np.linalg.norm(stop - start)
    turn = _turned(axis)
    around = max(8, int(2 * np.pi * _ROD_MM / edge_mm))
    first, last = 0.95 * from_mm, float(np.linalg.norm(stop - start)) - 0.95 * to_mm
    along = max(2, int((last - first) / edge_mm))
    angle = np.arange(around) * (2 * np.pi / around)
    ring = np.stack([_ROD_MM * np.cos(angle), _ROD_MM * np.sin(angle), np.zeros(around)], axis=1)
    places = np.linspace(first, last, along + 1)
    points = (ring[None] + places[:, None, None] * np.array([0.0, 0.0, 1.0])).reshape(-1, 3)
    row, column = (grid.ravel() for grid in np.meshgrid(np.arange(along), np.arange(around), indexing="ij"))
    a, b = row * around + column, row * around + (column + 1) % around
    faces = np.concatenate([np.stack([a, b, b + around], axis=1), np.stack([a, b + around, a + around], axis=1)])
    return TriangleMesh(vertices=points @ turn.T + start, faces=faces.astype(np.int32))


def _turned(axis: Float64[Array, 3]) -> Float64[Array, "3 3"]:
    """Rotation that takes the z axis to this direction."""
    z = axis / np.linalg.norm(axis)
    x = np.cross(np.eye(3)[np.argmin(np.abs(z))], z)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z], axis=1)


def _seen(mesh: TriangleMesh) -> TriangleMesh:
    """Faces that face the device, or slightly away from it."""
    vectors = mesh.face_vectors()
    return mesh.submesh(vectors[:, 2] > _SEEN * np.linalg.norm(vectors, axis=1))


@add_subject(
    "acceptance-test",
    has=lambda name: name.startswith(_NAME),
    choices=f"{', '.join(_NAME + kind for kind in DRAWN)} and the number of a position, as in {_NAME}bar_3",
)
def _artefact(wanted: SubjectRequest) -> SubjectSolid:
    kind, _, number = wanted.name.removeprefix(_NAME).partition("_")
    artefact = next((drawn for name, drawn in DRAWN.items() if name == kind), None)
    place = next((place for name in DRAWN if name == kind for place in POSITIONS[name] if place.name == number), None)
    if artefact is None or place is None:
        choices = ", ".join(f"{_NAME}{name}_1 to {_NAME}{name}_{len(POSITIONS[name])}" for name in DRAWN)
        raise UnknownWordError(f"artefacts at positions are {choices}", f"{wanted.name!r}")
    mesh = _whole(artefact, place, min(wanted.edge_mm, _BALL_EDGE_MM))
    return SubjectSolid(
        name=wanted.name,
        subject_kind="surface",
        mesh=rounded_mesh(mesh.vertices, mesh.faces),
        back_vertices=0,
        areola=np.zeros(len(mesh.vertices), dtype=np.float32),
        base_boundary=None,
        facts={"kind": wanted.name.partition("_")[0], "position": place.words, **_sizes(artefact)},
        middle=np.zeros(3),
    )


def _sizes(artefact: Artefact) -> dict[str, object]:
    """Sizes of an artefact for the truth."""
    match artefact:
        case Sphere():
            return {"diameter_mm": artefact.diameter_mm}
        case Bar():
            return {"diameter_mm": artefact.diameter_mm, "distance_mm": artefact.distance_mm}
        case _:
            return {"sides_mm": list(_PLATE_MM)}
