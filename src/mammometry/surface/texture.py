"""Photographic colour of each vertex, from its best photographs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from mammometry.base.photograph import Photograph
from mammometry.base.progress import Progress, no_progress
from mammometry.geometry.arrays import Array, Bool, Float32, Float64, Int64, UInt8, read_only
from mammometry.geometry.camera import Rig
from mammometry.geometry.mesh import TriangleMesh
from mammometry.surface.settings import TextureSettings

_LEAST_COSINE = 0.1  # 84° off the normal: a photograph shows nothing of skin seen more obliquely
_LEAST_COMMON = 200  # vertices that two photographs both see before they are levelled; chosen by eye
_LEAST_BRIGHT = 0.02  # of full scale: darker values are noise, whose ratio says nothing; chosen by eye
_UNSEEN = 128.0  # mid grey, sRGB


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TexturedMesh:
    """A mesh with a colour per vertex."""

    mesh: TriangleMesh
    """World frame, mm."""
    colours: UInt8[Array, "n 3"]
    """sRGB-encoded colour of each vertex. Mid grey where no camera sees it."""

    def __post_init__(self) -> None:
        if len(self.colours) != len(self.mesh.vertices):
            raise ValueError(f"{len(self.mesh.vertices)} vertices but {len(self.colours)} colours")
        object.__setattr__(self, "colours", read_only(self.colours))


def paint(
    mesh: TriangleMesh,
    photographs: Mapping[str, Photograph],
    rig: Rig,
    settings: TextureSettings = TextureSettings(),
    *,
    progress: Progress = no_progress,
) -> TexturedMesh:
    """Colour every vertex from the photographs that see it best.

    Paper 2.1: photographic texture. A photograph counts where it faces the vertex, nothing stands between, and with
    the weight cosⁿ(incidence)/distance². Photographs are first levelled to one another: one gain per camera and
    channel, from the vertices that two of them see well. The world frame is the mesh's.
    """
    _, weights, samples = view_samples(mesh, photographs, rig, settings, progress=progress)
    total = weights.sum(axis=0)
    colours = np.where(total[:, None] > 0, np.clip(blended(weights, samples), 0.0, 1.0) * 255.0, _UNSEEN)
    progress(1.0)
    return TexturedMesh(mesh=mesh, colours=np.rint(colours).astype(np.uint8))


def blended(weights: Float32[Array, "k n"], samples: Float32[Array, "k n 3"]) -> Float32[Array, "n 3"]:
    """Weighted mean over the photographs. Black where none counts."""
    total = np.maximum(weights.sum(axis=0), np.float32(1e-12))
    mean: Float32[Array, "n 3"] = np.einsum("kn,knc->nc", weights, samples) / total[:, None]
    return mean


def view_samples(
    mesh: TriangleMesh,
    photographs: Mapping[str, Photograph],
    rig: Rig,
    settings: TextureSettings,
    *,
    progress: Progress = no_progress,
) -> tuple[Float32[Array, "k 3"], Float32[Array, "k n"], Float32[Array, "k n 3"]]:
    """Gain of each photograph, and its weight and colour at every vertex.

    Colours are levelled. Weight 0: the photograph does not see the vertex. The photographs in their order, but for
    those of no camera of the rig.
    """
    names = [name for name in photographs if name in rig.cameras]
    normals = mesh.vertex_normals()
    n = len(mesh.vertices)
    weights = np.zeros((len(names), n), dtype=np.float32)
    samples = np.zeros((len(names), n, 3), dtype=np.float32)
    shadow = _ShadowCaster(mesh)
    for k, (name, photograph) in enumerate(zip(names, read_ahead(photographs, names), strict=True)):
        camera, pixels = rig.cameras[name], rgb(photograph)
        towards = camera.centre_world - mesh.vertices
        distance = np.linalg.norm(towards, axis=1)
        cosine = np.einsum("ij,ij->i", normals, towards) / distance
        index = np.flatnonzero(cosine > _LEAST_COSINE)
        u, v = camera.project(mesh.vertices[index]).T
        height, width = camera.shape_hw
        with np.errstate(invalid="ignore"):
            inside = (u >= 0) & (v >= 0) & (u <= width - 1) & (v <= height - 1)
        index, at = index[inside], np.stack([v[inside], u[inside]])
        lit = shadow.reaches(index, normals[index], camera.centre_world, settings.clearance_mm)
        index, at = index[lit], at[:, lit]
        weights[k, index] = cosine[index] ** settings.sharpness * (1000.0 / distance[index]) ** 2
        for channel in range(3):
            samples[k, index, channel] = ndimage.map_coordinates(pixels[..., channel], at, order=1, mode="nearest")
        progress(0.9 * (k + 1) / len(names))
    gains = _gains(samples, weights)
    samples *= gains[:, None, :]
    return gains, weights, samples


def read_ahead(photographs: Mapping[str, Photograph], names: Sequence[str]) -> Iterator[Photograph]:
    """The photographs one by one.

    While one is worked on, the next is read.
    """
    with ThreadPoolExecutor(1) as reader:
        waiting = [reader.submit(photographs.__getitem__, name) for name in names[:1]]
        for following in [*names[1:], None]:
            photograph = waiting.pop().result()
            if following is not None:
                waiting.append(reader.submit(photographs.__getitem__, following))
            yield photograph


def rgb(photograph: Photograph) -> Float32[Array, "h w 3"]:
    """Values as recorded, 0…1, three channels."""
    pixels = photograph.encoded()
    return np.repeat(pixels[..., None], 3, axis=2) if pixels.ndim == 2 else pixels


class _ShadowCaster:
    """Whether something of the mesh stands between its vertices and a point."""

    def __init__(self, mesh: TriangleMesh) -> None:
        from embreex import rtcore_scene
        from embreex.mesh_construction import TriangleMesh as EmbreeMesh

        self._middle = mesh.vertices.mean(axis=0)
        self._vertices = mesh.vertices - self._middle  # Embree computes in float32
        self._scene = rtcore_scene.EmbreeScene()
        self._mesh = EmbreeMesh(self._scene, self._vertices.astype(np.float32), np.array(mesh.faces, dtype=np.int32))

    def reaches(
        self, index: Int64[Array, " k"], normals: Float64[Array, "k 3"], viewpoint: Float64[Array, 3], clearance: float
    ) -> Bool[Array, " k"]:
        """Which of the vertices see `viewpoint`, starting `clearance` mm off the surface."""
        if not len(index):
            return np.zeros(0, dtype=bool)
        origins = self._vertices[index] + clearance * normals
        directions = viewpoint - self._middle - origins
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        hits = self._scene.run(origins.astype(np.float32), directions.astype(np.float32), query="OCCLUDED")
        return np.asarray(hits) < 0


def _gains(samples: Float32[Array, "k n 3"], weights: Float32[Array, "k n"]) -> Float32[Array, "k 3"]:
    """Gain per camera and channel that makes the cameras agree.

    Where two see the same vertices. The mean gain is 1. Least squares on the logarithms of the median ratios, each
    pair weighted by the number of common vertices.
    """
    count = len(samples)
    usable = (weights > 0) & (samples.min(axis=2) > _LEAST_BRIGHT)
    rows, ratios = [], []
    for a in range(count):
        for b in range(a + 1, count):
            common = np.flatnonzero(usable[a] & usable[b])
            if len(common) < _LEAST_COMMON:
                continue
            strength = np.sqrt(len(common))
            row = np.zeros(count)
            row[a], row[b] = strength, -strength
            rows.append(row)
            ratios.append(strength * np.median(np.log(samples[b][common] / samples[a][common]), axis=0))
    if not rows:
        return np.ones((count, 3), dtype=np.float32)
    rows.append(np.ones(count))
    ratios.append(np.zeros(3))
    logs = np.linalg.lstsq(np.array(rows), np.array(ratios), rcond=None)[0]
    return np.exp(logs).astype(np.float32)
