"""A subject: a closed body with colours and known facts.

Frame of a solid: x right as seen by the front camera (a patient's left), y up, z forward out of the back, mm. Vertices
are rounded to float32 before the volume is computed, so that the rendered solid, the mesh on disk and the volume in the
truth are identical.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import field, replace

import numpy as np

from mammometry.base.value import value
from mammometry.geometry import Array, Float32, Float64, Int32, Transform, TriangleMesh


def waves(points: Array, rng: np.random.Generator, *, shortest_mm: float, longest_mm: float) -> Float64[Array, " n"]:
    """Sum of some plane waves in random directions, with about unit amplitude."""
    total = np.zeros(len(points))
    count = 10
    for _ in range(count):
        direction = rng.normal(size=3)
        direction /= np.linalg.norm(direction)
        length = math.exp(rng.uniform(math.log(shortest_mm), math.log(longest_mm)))
        total += np.sin(points @ direction * (2 * math.pi / length) + rng.uniform(0.0, 2 * math.pi))
    return total * math.sqrt(2.0 / count)


def smoothstep(low: float, high: float, value: Array) -> Array:
    """Smooth transition from 0 at `low` to 1 at `high`, with zero slope at both. `low` may be larger."""
    t = np.clip((value - low) / (high - low), 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


def sagged(height: Array, sag: float) -> Array:
    """Share of a breast's fall by share of its height: the same for a `sag` of 1, otherwise larger."""
    return height if sag == 1.0 else 1.0 - np.clip(1.0 - height, 0.0, None) ** sag


@value(eq=False)
class Breast:
    """A torso's breast: its skin and boundary."""

    skin_faces: Int32[Array, " f"]
    """Faces of the solid's mesh inside the boundary, by index."""
    boundary: Int32[Array, " b"]
    """Vertices of the solid's mesh in order around the breast, where skin and chest wall meet."""


@value(eq=False)
class SubjectSolid:
    """A body, closed unless its facts say otherwise."""

    name: str
    subject_kind: str
    """As in the manifest: "model" has a base, "torso" two breasts, "surface" none of these."""
    mesh: TriangleMesh
    """Solid's frame, mm. Coordinates are float32 numbers."""
    back_vertices: int
    """Number of the vertices on the back, without the rim. They come last."""
    areola: Float32[Array, " n"]
    """Share of areola colour at each vertex, 0…1."""
    base_boundary: Float64[Array, "b 3"] | None
    """Closed curve between front and back, in order, solid's frame, mm. None if there is no base."""
    facts: Mapping[str, object]
    """Further facts for the truth file."""
    wall_vertices: Float64[Array, "n 3"] | None = None
    """A torso's vertices without breasts, solid's frame, mm. Vertices elsewhere are the same."""
    breasts: Mapping[str, Breast] = field(default_factory=dict)
    """"left" and "right", the patient's own."""
    landmarks: Mapping[str, Float64[Array, "k 3"]] = field(default_factory=dict)
    """Name → point on the skin, or points along a line, solid's frame, mm."""
    tint: Float32[Array, "n 3"] | None = None
    """Factors on the skin's colour at each vertex, RGB: scars, tattoos, a flap's paddle. None without marks."""
    lean_rad: float = math.radians(45.0)
    """Forward lean of the subject."""
    middle: Float64[Array, 3] | None = None
    """Point that is placed at the rig's centre. None: the centre of the bounding box."""

    @property
    def volume_cc(self) -> float:
        """Volume of the mesh, cc. Exact if it is closed."""
        return self.mesh.volume_mm3() / 1000.0

    @property
    def volumes_cc(self) -> dict[str, float]:
        """Name → exact volume, cc. Each breast of a torso, or the "model". Empty if the mesh is open."""
        if self.breasts:
            return {name: self.closed_breast(name).volume_mm3() / 1000.0 for name in self.breasts}
        return {"model": self.volume_cc} if self.mesh.is_watertight() else {}

    def chest_wall(self, name: str) -> TriangleMesh:
        """The skin with the breast inside its boundary removed: an open mesh that faces outwards."""
        body = TriangleMesh(vertices=self._wall(), faces=self.mesh.faces)
        return body.submesh(self.breasts[name].skin_faces)

    def closed_breast(self, name: str) -> TriangleMesh:
        """The closed solid between a breast's skin and its chest wall."""
        breast, count = self.breasts[name], len(self.mesh.vertices)
        skin = self.mesh.faces[breast.skin_faces]
        behind = np.arange(count, 2 * count, dtype=np.int32)
        behind[breast.boundary] = breast.boundary
        both = TriangleMesh(
            vertices=np.concatenate([self.mesh.vertices, self._wall()]),
            faces=np.concatenate([skin, behind[skin[:, ::-1]]]),
        )
        return both.submesh(np.arange(len(both.faces)))

    def placed(self, rig_from_solid: Transform) -> SubjectSolid:
        """The solid in the rig's frame, with coordinates rounded to float32 again."""
        return replace(
            self,
            mesh=TriangleMesh(vertices=_rounded(rig_from_solid.apply(self.mesh.vertices)), faces=self.mesh.faces),
            base_boundary=None if self.base_boundary is None else rig_from_solid.apply(self.base_boundary),
            wall_vertices=None if self.wall_vertices is None else _rounded(rig_from_solid.apply(self.wall_vertices)),
            landmarks={name: rig_from_solid.apply(points) for name, points in self.landmarks.items()},
            middle=None if self.middle is None else rig_from_solid.apply(self.middle[None])[0],
        )

    def _wall(self) -> Float64[Array, "n 3"]:
        if self.wall_vertices is None:
            raise ValueError(f"{self.name} has no chest wall")
        return self.wall_vertices


def rig_from_solid(solid: SubjectSolid, seed: int) -> Transform:
    """Pose of a solid in the rig, leaning forward over the floor pair, with small random errors."""
    rng = np.random.default_rng([seed, 73])
    turn = Transform.from_rotation_vector(
        np.array([solid.lean_rad, 0.0, 0.0]) + np.radians(rng.normal(0.0, 2.0, 3)), np.zeros(3)
    )
    if solid.middle is None:
        turned = turn.rotate(solid.mesh.vertices)
        middle = 0.5 * (turned.min(axis=0) + turned.max(axis=0))
    else:
        middle = turn.rotate(solid.middle[None])[0]
    return Transform(rotation=turn.rotation.copy(), translation_mm=rng.uniform(-6.0, 6.0, 3) - middle)


def rounded_mesh(vertices: Array, faces: Array) -> TriangleMesh:
    """A mesh with float32 coordinates."""
    return TriangleMesh(vertices=_rounded(vertices), faces=faces.astype(np.int32))


def _rounded(points: Array) -> Float64[Array, "n 3"]:
    return points.astype(np.float32).astype(np.float64)
