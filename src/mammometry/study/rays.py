"""Ray casting on a true mesh: which of its points the cameras see."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from mammometry.base.value import value
from mammometry.geometry import Array, Bool, Camera, Float64, Int64, Rig, TriangleMesh

_AT_ONCE = 1_000_000  # rays per call, to limit memory
_SEEN_MM = 0.3  # largest distance between a visible point and the hit of its ray
SEEN_INCIDENCE_DEG = 75.0
"""Largest angle of incidence of skin that counts as visible, degrees."""


@value(eq=False)
class RayHits:
    """First hits of rays."""

    range_mm: Float64[Array, "*n"]
    """Distance from the ray's origin, mm; NaN without a hit."""
    cosine: Float64[Array, "*n"]
    """Cosine of the angle of incidence: 1 if the surface faces the origin, negative from inside; NaN without a hit."""

    @property
    def hit(self) -> Bool[Array, "*n"]:
        """Mask of the rays with a hit."""
        return np.isfinite(self.range_mm)


class RayScene:
    """A mesh prepared for ray casting with embree. Distances have double precision."""

    def __init__(self, mesh: TriangleMesh) -> None:
        from embreex import rtcore_scene
        from embreex.mesh_construction import TriangleMesh as EmbreeMesh

        self.mesh = mesh
        self._centre = mesh.vertices.mean(axis=0)
        self._embree: Any = rtcore_scene.EmbreeScene()
        EmbreeMesh(self._embree, (mesh.vertices - self._centre).astype(np.float32)[mesh.faces])
        vectors = mesh.face_vectors()
        length = np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-30)
        self._normals = vectors / length
        self._heights = np.einsum("ij,ij->i", mesh.vertices[mesh.faces[:, 0]], self._normals)

    def cast(self, origin: Float64[Array, 3], directions: Float64[Array, "*n 3"]) -> RayHits:
        """First hits of rays from one point, mesh frame, mm.

        Args:
            origin: origin of all rays.
            directions: unit vectors. Rays of NaN have no hit.
        """
        shape = directions.shape[:-1]
        flat = directions.reshape(-1, 3)
        ranges, cosines = np.full(len(flat), np.nan), np.full(len(flat), np.nan)
        possible = np.flatnonzero(np.isfinite(flat).all(axis=1))
        start = (origin - self._centre).astype(np.float32)
        for first in range(0, len(possible), _AT_ONCE):
            index = possible[first : first + _AT_ONCE]
            rays = flat[index]
            faces = self._embree.run(np.tile(start, (len(rays), 1)), rays.astype(np.float32))
            met = faces >= 0
            normals = self._normals[faces[met]]
            towards = np.einsum("ij,ij->i", rays[met], normals)
            with np.errstate(divide="ignore", invalid="ignore"):
                ranges[index[met]] = (self._heights[faces[met]] - normals @ origin) / towards
            cosines[index[met]] = -towards
        return RayHits(range_mm=ranges.reshape(shape), cosine=cosines.reshape(shape))

    def hides(self, origin: Float64[Array, 3], points: Float64[Array, "n 3"]) -> Bool[Array, " n"]:
        """Mask of the mesh's own points that it hides, even if a ray passes between two triangles there."""
        offsets = points - origin
        distance = np.linalg.norm(offsets, axis=-1)
        return self.cast(origin, offsets / distance[:, None]).range_mm < distance - _SEEN_MM

    def seen_from(self, origin: Float64[Array, 3], points: Float64[Array, "*n 3"]) -> RayHits:
        """Hits of rays towards given points. Hidden points and NaN have no hit."""
        offsets = points - origin
        distance = np.linalg.norm(offsets, axis=-1)
        with np.errstate(divide="ignore", invalid="ignore"):
            hits = self.cast(origin, offsets / distance[..., None])
            seen = np.abs(hits.range_mm - distance) < _SEEN_MM
        return RayHits(range_mm=np.where(seen, hits.range_mm, np.nan), cosine=np.where(seen, hits.cosine, np.nan))


def pixel_grid(camera: Camera, step: int = 1) -> Float64[Array, "h w 2"]:
    """`uv` of every `step`-th pixel in every `step`-th row."""
    width, height = camera.size_wh
    u, v = np.meshgrid(np.arange(0, width, step, dtype=np.float64), np.arange(0, height, step, dtype=np.float64))
    return np.stack([u, v], axis=-1)


def inside(camera: Camera, uv: Float64[Array, "*n 2"]) -> Bool[Array, "*n"]:
    """Mask of the positions inside the image. False for NaN."""
    with np.errstate(invalid="ignore"):
        return np.all((uv >= 0) & (uv <= np.array(camera.size_wh) - 1), axis=-1)


def seen_by_pairs(scene: RayScene, rig: Rig, *, every: int = 1) -> tuple[Int64[Array, " k"], Mapping[str, Array]]:
    """Indices of the tested vertices, and pair → whether both cameras see each at less than 75°.

    Args:
        scene: the true surface.
        rig: the true cameras, in the scene's frame.
        every: test only every n-th vertex.
    """
    chosen = np.arange(0, len(scene.mesh.vertices), every, dtype=np.int64)
    points = scene.mesh.vertices[chosen]
    normals = scene.mesh.vertex_normals()[chosen]
    by_camera = {}
    for name, camera in rig.cameras.items():
        offsets = camera.centre_world - points
        cosine = np.einsum("ij,ij->i", offsets, normals) / np.linalg.norm(offsets, axis=1)
        seen = (cosine > np.cos(np.radians(SEEN_INCIDENCE_DEG))) & inside(camera, camera.project(points))
        seen[seen] = ~scene.hides(camera.centre_world, points[seen])
        by_camera[name] = seen
    return chosen, {name: by_camera[left] & by_camera[right] for name, (left, right) in rig.pair_names.items()}
