"""What stands in front of the cameras: one mesh with all that the shading needs at each vertex.

Light is baked once a scene: how much of each flash and of the surroundings every vertex sees does not depend on the
camera. Flashes are soft boxes, so shadows have soft rims.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from embreex.mesh_construction import TriangleMesh as EmbreeMesh
from embreex.rtcore_scene import EmbreeScene

from mammometry.geometry.arrays import Array, Float32, Float64, Int32, read_only
from mammometry.geometry.mesh import TriangleMesh
from mammometry.geometry.transform import Transform
from mammometry.simulate.phantom import Solid

_SOFT_BOX_RADIUS_MM = 90.0
_SOFT_BOX_SAMPLES = 4
_SKY_SAMPLES = 10
_LIFT_MM = 0.05
_BACKDROP_MM = (270.0, 290.0)
_BACKDROP_STEP_MM = 3.0
BACKDROP_GAP_MM = 0.8
"""Distance of the board behind a flat back."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Scene:
    """A subject, perhaps on a backdrop, lit; rig frame, mm."""

    mesh: TriangleMesh
    """Subject first, backdrop after it."""
    subject_faces: int
    """Faces of the subject."""
    subject_vertices: int
    """Vertices of the subject."""
    vertices: Float32[Array, "n 3"]
    """The mesh's, as the rays see them."""
    attributes: Float32[Array, "n a"]
    """Per vertex: normal (3), areola, share of the surroundings seen, share of each light seen."""
    lights: Float64[Array, "l 4"]
    """Position, mm, and irradiance × mm² at distance 1."""
    rays: EmbreeScene
    """Finds the first face along a ray."""

    def __post_init__(self) -> None:
        for name in ("vertices", "attributes", "lights"):
            object.__setattr__(self, name, read_only(getattr(self, name)))

    @property
    def subject(self) -> TriangleMesh:
        """The subject's closed mesh."""
        return TriangleMesh(
            vertices=self.mesh.vertices[: self.subject_vertices], faces=self.mesh.faces[: self.subject_faces]
        )


def light_scene(solid: Solid, rig_from_solid: Transform, lights: Float64[Array, "l 4"], *, backdrop: bool) -> Scene:
    """Put a solid into the rig, with a dark board behind its back if asked for, and bake the light.

    Args:
        solid: the subject.
        rig_from_solid: where it stands. The mesh in the rig's frame is rounded to float32, as the rays see it.
        lights: position, rig frame, mm, and irradiance × mm² at distance 1.
        backdrop: whether a dark board of 270 × 290 mm stands 0.8 mm behind the lowest point of the solid's back.
    """
    placed = rig_from_solid.apply(solid.mesh.vertices).astype(np.float32)
    normals = _smooth_normals(solid, rig_from_solid)
    faces, areola = solid.mesh.faces, solid.areola
    subject_faces = len(faces)
    if backdrop:
        board, board_faces = _backdrop(float(solid.mesh.vertices[:, 2].min()) - BACKDROP_GAP_MM)
        middle = 0.5 * (solid.mesh.vertices.min(axis=0) + solid.mesh.vertices.max(axis=0))
        board[:, :2] += middle[:2]
        faces = np.concatenate([faces, board_faces + len(placed)])
        areola = np.concatenate([areola, np.zeros(len(board), dtype=np.float32)])
        towards = rig_from_solid.rotate(np.array([[0.0, 0.0, 1.0]]))
        normals = np.concatenate([normals, np.repeat(towards, len(board), axis=0)])
        placed = np.concatenate([placed, rig_from_solid.apply(board).astype(np.float32)])
    mesh = TriangleMesh(vertices=placed.astype(np.float64), faces=faces.astype(np.int32))
    rays = EmbreeScene()
    EmbreeMesh(rays, placed, mesh.faces)
    hidden = np.zeros(len(placed), dtype=bool)
    if solid.back_vertices:
        end = len(solid.mesh.vertices)
        hidden[end - solid.back_vertices : end] = True
    seen = _visibility(rays, mesh.vertices, normals, lights, hidden)
    attributes = np.column_stack([normals, areola, seen]).astype(np.float32)
    return Scene(
        mesh=mesh,
        subject_faces=subject_faces,
        subject_vertices=len(solid.mesh.vertices),
        vertices=placed,
        attributes=attributes,
        lights=lights,
        rays=rays,
    )


def _smooth_normals(solid: Solid, rig_from_solid: Transform) -> Float64[Array, "n 3"]:
    """Normals for shading: the rim belongs to the front, which is what is seen of it."""
    mesh = solid.mesh
    normals = mesh.vertex_normals()
    if solid.back_vertices:
        first = len(mesh.vertices) - solid.back_vertices
        front = mesh.faces[(mesh.faces < first).all(axis=1)]
        normals[:first] = TriangleMesh(vertices=mesh.vertices[:first], faces=front).vertex_normals()
    return rig_from_solid.rotate(normals)


def _backdrop(z: float) -> tuple[Float64[Array, "n 3"], Int32[Array, "m 3"]]:
    """A board in the plane z, around the z axis, fine enough to carry shadows."""
    columns, rows = (math.ceil(side / _BACKDROP_STEP_MM) for side in _BACKDROP_MM)
    x, y = np.meshgrid(
        np.linspace(-0.5, 0.5, columns + 1) * _BACKDROP_MM[0], np.linspace(-0.5, 0.5, rows + 1) * _BACKDROP_MM[1]
    )
    row, column = (grid.ravel() for grid in np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij"))
    a = row * (columns + 1) + column
    b, c, d = a + 1, a + columns + 1, a + columns + 2
    faces = np.concatenate([np.stack([a, b, d], axis=1), np.stack([a, d, c], axis=1)])
    return np.stack([x.ravel(), y.ravel(), np.full(x.size, z)], axis=1), faces.astype(np.int32)


def _visibility(
    rays: EmbreeScene,
    vertices: Float64[Array, "n 3"],
    normals: Float64[Array, "n 3"],
    lights: Float64[Array, "l 4"],
    hidden: Array,
) -> Float32[Array, "n s"]:
    """Share of the surroundings, then of each light's disc, that every vertex sees; 0 where it is never seen itself."""
    seen = np.zeros((len(vertices), 1 + len(lights)), dtype=np.float32)
    shown = np.flatnonzero(~hidden)
    origins = (vertices + _LIFT_MM * normals)[shown].astype(np.float32)
    sky = _fibonacci_sphere(_SKY_SAMPLES)
    weight = np.zeros(len(shown))
    open_sky = np.zeros(len(shown))
    for direction in sky:
        cosine = normals[shown] @ direction
        ahead = np.flatnonzero(cosine > 0)
        free = _free(rays, origins[ahead], np.broadcast_to(direction.astype(np.float32), (len(ahead), 3)))
        weight[ahead] += cosine[ahead]
        open_sky[ahead] += cosine[ahead] * free
    seen[shown, 0] = open_sky / np.maximum(weight, 1e-9)
    for k, light in enumerate(lights):
        for target in _soft_box(light[:3]):
            towards = target - vertices[shown]
            ahead = np.flatnonzero(np.einsum("ij,ij->i", towards, normals[shown]) > -0.1 * np.linalg.norm(target))
            free = _free(rays, origins[ahead], towards[ahead].astype(np.float32))
            seen[shown[ahead], 1 + k] += free.astype(np.float32) / _SOFT_BOX_SAMPLES
    return seen


def _free(rays: EmbreeScene, origins: Array, directions: Array) -> Array:
    """Whether nothing stands in the way of each ray."""
    if not len(origins):
        return np.zeros(0, dtype=bool)
    return rays.run(origins, np.ascontiguousarray(directions), query="OCCLUDED") == -1


def _soft_box(position: Float64[Array, 3]) -> Float64[Array, "s 3"]:
    """Points on the disc of a flash that faces the middle of the rig."""
    axis = position / np.linalg.norm(position)
    a = np.cross(axis, [1.0, 0.0, 0.0] if abs(axis[0]) < 0.8 else [0.0, 1.0, 0.0])
    a /= np.linalg.norm(a)
    b = np.cross(axis, a)
    angle = (np.arange(_SOFT_BOX_SAMPLES) + 0.5) * (2 * math.pi / _SOFT_BOX_SAMPLES)
    return position + _SOFT_BOX_RADIUS_MM * math.sqrt(0.5) * (np.cos(angle)[:, None] * a + np.sin(angle)[:, None] * b)


def _fibonacci_sphere(count: int) -> Float64[Array, "n 3"]:
    """Directions spread evenly over the sphere."""
    index = np.arange(2 * count) + 0.5
    z = 1.0 - index / count
    azimuth = index * math.pi * (3.0 - math.sqrt(5.0))
    ring = np.sqrt(1.0 - z * z)
    return np.stack([ring * np.cos(azimuth), ring * np.sin(azimuth), z], axis=1)
