"""Artefacts of an acceptance test, as a device with known errors measures them."""

from __future__ import annotations

import numpy as np

from mammometry.base.value import value
from mammometry.geometry.arrays import Array, Float64
from mammometry.geometry.mesh import TriangleMesh, joined
from mammometry.simulate.subjects.shapes import plate, sphere
from mammometry.study.acceptance.artefacts import VOLUME_MM, Artefact, Bar, Cast, Plane, Position, Sphere

_EDGE_MM = 2.0  # of triangles, as of a rig's surfaces
_SEEN = -0.2  # least cosine between the skin's normal and the direction to the device, of what cameras around it see
_ROD_MM = 8.0  # radius of a bar's rod
_PLATE_MM = (240.0, 180.0)  # sides of a plane: a sheet of A4 with margins
_WAVES = 64  # cosines of which errors are made that neighbouring points share


DEMO_DEVICE = """\
format = 1
[device]
name = "Virtual device"
person = "demo"
date = 2026-11-29
software = "drawn surfaces with errors"
units = "mm"
[sphere]
diameter_mm = 145.0
diameter_std_mm = 0.02
form_std_mm = 0.02
source = "drawn"
[bar]
distance_mm = 300.0
distance_std_mm = 0.03
diameter_mm = 60.0
diameter_std_mm = 0.02
source = "drawn"
[plane]
flatness_std_mm = 0.02
source = "drawn"
[cast]
volume_cc = 400.0
volume_std_cc = 0.5
source = "drawn"
"""
"""Description of the demo's test."""


@value
class DeviceErrors:
    """Errors of a virtual device."""

    scale: float = 0.0
    """Relative error of all lengths."""
    noise_mm: float = 0.0
    """Standard deviation along the normal, independent from point to point."""
    shared_mm: float = 0.0
    """The same of errors that neighbouring points share."""
    shared_over_mm: float = 8.0
    """Distance over which they are alike."""


def artefact_mesh(artefact: Artefact, position: Position, *, edge_mm: float = _EDGE_MM) -> TriangleMesh:
    """Exact surface of an artefact at a position, as far as the device sees it. A cast is whole.

    Frame: right, up and towards the device, origin in the middle of the working volume, mm.
    """
    centre = np.array(position.centre) * VOLUME_MM
    match artefact:
        case Sphere():
            return _seen(_ball(artefact.diameter_mm, centre, edge_mm))
        case Bar():
            axis = np.array(position.axis) / np.linalg.norm(position.axis)
            ends = [centre + side * artefact.distance_mm / 2 * axis for side in (-1, 1)]
            balls = [_seen(_ball(artefact.diameter_mm, end, min(edge_mm, artefact.diameter_mm / 30))) for end in ends]
            return joined([*balls, _seen(_rod(ends[0], ends[1], artefact.diameter_mm / 2, edge_mm))])
        case Plane():
            turn = _turned(np.array(position.axis))
            flat = plate(*_PLATE_MM, edge_mm=edge_mm).mesh
            face = flat.submesh(flat.faces_within(flat.vertices[:, 2] > 0))
            return TriangleMesh(vertices=face.vertices @ turn.T + centre, faces=face.faces)
        case Cast():
            whole = _ball(2 * (3000 * artefact.volume_cc / (4 * np.pi)) ** (1 / 3), np.zeros(3), edge_mm)
            exact = (1000 * artefact.volume_cc / whole.volume_mm3()) ** (1 / 3)
            return TriangleMesh(vertices=whole.vertices * exact + centre, faces=whole.faces)


def measured_mesh(mesh: TriangleMesh, errors: DeviceErrors, rng: np.random.Generator) -> TriangleMesh:
    """A mesh as a device with these errors gives it."""
    offsets = errors.noise_mm * rng.normal(size=len(mesh.vertices))
    offsets += errors.shared_mm * shared_errors(mesh.vertices, errors.shared_over_mm, rng)
    vertices = mesh.vertices + offsets[:, None] * mesh.vertex_normals()
    return TriangleMesh(vertices=(1.0 + errors.scale) * vertices, faces=mesh.faces)


def shared_errors(points: Float64[Array, "n 3"], alike_mm: float, rng: np.random.Generator) -> Float64[Array, " n"]:
    """Random numbers of unit variance whose correlation falls with distance as a Gaussian."""
    waves = rng.normal(0.0, 1.0 / alike_mm, (3, _WAVES))
    return np.asarray(np.sqrt(2.0 / _WAVES) * np.cos(points @ waves + rng.uniform(0, 2 * np.pi, _WAVES)).sum(axis=1))


def _ball(diameter_mm: float, centre: Float64[Array, 3], edge_mm: float) -> TriangleMesh:
    mesh = sphere(diameter_mm / 2, edge_mm=edge_mm).mesh
    return TriangleMesh(vertices=mesh.vertices + centre, faces=mesh.faces)


def _rod(start: Float64[Array, 3], stop: Float64[Array, 3], within_mm: float, edge_mm: float) -> TriangleMesh:
    """Round rod between two balls, without lids."""
    axis = (stop - start) / np.linalg.norm(stop - start)
    turn = _turned(axis)
    around = max(8, int(2 * np.pi * _ROD_MM / edge_mm))
    length = float(np.linalg.norm(stop - start)) - 1.9 * within_mm
    along = max(2, int(length / edge_mm))
    angle = np.arange(around) * (2 * np.pi / around)
    ring = np.stack([_ROD_MM * np.cos(angle), _ROD_MM * np.sin(angle), np.zeros(around)], axis=1)
    places = np.linspace(-length / 2, length / 2, along + 1)
    points = (ring[None] + places[:, None, None] * np.array([0.0, 0.0, 1.0])).reshape(-1, 3)
    row, column = (grid.ravel() for grid in np.meshgrid(np.arange(along), np.arange(around), indexing="ij"))
    a, b = row * around + column, row * around + (column + 1) % around
    faces = np.concatenate([np.stack([a, b, b + around], axis=1), np.stack([a, b + around, a + around], axis=1)])
    return TriangleMesh(vertices=points @ turn.T + (start + stop) / 2, faces=faces.astype(np.int32))


def _turned(axis: Float64[Array, 3]) -> Float64[Array, "3 3"]:
    """Rotation that turns the z axis into this direction."""
    z = axis / np.linalg.norm(axis)
    x = np.cross(np.eye(3)[np.argmin(np.abs(z))], z)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z], axis=1)


def _seen(mesh: TriangleMesh) -> TriangleMesh:
    """Faces that look towards the device, or a little away from it."""
    vectors = mesh.face_vectors()
    return mesh.submesh(vectors[:, 2] > _SEEN * np.linalg.norm(vectors, axis=1))


DEMO_ERRORS = DeviceErrors(scale=0.0003, noise_mm=0.03, shared_mm=0.03)
"""Errors of the demo's device, about those of a calibrated rig."""
