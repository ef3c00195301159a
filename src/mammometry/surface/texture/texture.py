"""Photographic colour of each vertex, from the photographs that see it best. No volume depends on it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from mammometry.base.machine.cores import in_bands
from mammometry.base.photograph import Photograph
from mammometry.base.progress import Progress, no_progress
from mammometry.base.value import value
from mammometry.geometry.arrays import Array, Bool, Float32, Float64, Int64, Integer, UInt8, read_only
from mammometry.geometry.camera import Camera, Rig
from mammometry.geometry.mesh import TriangleMesh
from mammometry.geometry.mesh_kernels import nearest_faces
from mammometry.surface.fusion.camera_records import view_row
from mammometry.surface.texture import texture_kernels

SHARPNESS = 6.0
"""Power of the cosine of incidence in a photograph's weight. High values use only the best view of each vertex."""
CLEARANCE_MM = 0.7
"""Least distance in front of a vertex from which the surface hides it from a camera, mm: more than a cube's edge."""
_LEAST_COSINE = 0.1  # 84° from the normal: at larger angles a photograph shows nothing of the skin
_LEAST_COMMON = 200  # fewest common vertices for levelling two photographs; appearance only
_LEAST_BRIGHT = 0.02  # share of full scale: darker values are noise, with random ratios; appearance only
UNSEEN = 128
"""Mid grey, sRGB, where no camera sees the surface."""
_SHADOW_MM = 0.5  # side on the skin of the pixels used for occlusion: about a cube's edge
_LEVELLED = 20_000  # most vertices for the ratio of two photographs: its median is accurate to a thousandth


@value(eq=False)
class TexturedMesh:
    """A mesh with a colour per vertex."""

    mesh: TriangleMesh
    """World frame, mm."""
    colours: UInt8[Array, "n 3"]
    """sRGB-encoded colour of each vertex. Mid grey where no camera sees it."""

    def __post_init__(self) -> None:
        if len(self.colours) != len(self.mesh.vertices):
            raise ValueError(f"{len(self.mesh.vertices)} vertices but {len(self.colours)} colours")


def paint(
    mesh: TriangleMesh, photographs: Mapping[str, Photograph], rig: Rig, *, progress: Progress = no_progress
) -> TexturedMesh:
    """Colour of every vertex from the photographs that see it best (paper 2.1).

    A photograph counts if it faces the vertex and nothing is in between, with the weight cosⁿ(incidence)/distance².
    Photographs are first levelled: one gain per camera and channel, from vertices that two of them see well.
    """
    _, weights, samples = view_samples(mesh, photographs, rig, progress=progress)
    total = weights.sum(axis=0)
    colours = np.where(total[:, None] > 0, np.clip(blended(weights, samples), 0.0, 1.0) * 255.0, UNSEEN)
    progress(1.0)
    return TexturedMesh(mesh=mesh, colours=np.rint(colours).astype(np.uint8))


def blended(weights: Float32[Array, "k n"], samples: Float32[Array, "k n 3"]) -> Float32[Array, "n 3"]:
    """Weighted mean over the photographs. Black if none counts."""
    total = np.maximum(weights.sum(axis=0), np.float32(1e-12))
    mean: Float32[Array, "n 3"] = np.einsum("kn,knc->nc", weights, samples) / total[:, None]
    return mean


def view_samples(
    mesh: TriangleMesh, photographs: Mapping[str, Photograph], rig: Rig, *, progress: Progress = no_progress
) -> tuple[Float32[Array, "k 3"], Float32[Array, "k n"], Float32[Array, "k n 3"]]:
    """Gain of each photograph, and its weight and levelled colour at every vertex.

    Weight 0: the photograph does not see the vertex. Photographs without a camera in the rig are left out.
    """
    names = [name for name in photographs if name in rig.cameras]
    normals = mesh.vertex_normals()
    n = len(mesh.vertices)
    weights = np.zeros((len(names), n), dtype=np.float32)
    samples = np.zeros((len(names), n, 3), dtype=np.float32)
    for k, (name, photograph) in enumerate(zip(names, read_ahead(photographs, names), strict=True)):
        camera = rig.cameras[name]
        weights[k], places = _facing(mesh, normals, camera)
        weights[k, _hidden(mesh, camera, places, weights[k] > 0)] = 0.0
        seen = np.flatnonzero(weights[k])
        samples[k, seen] = picture_of(photograph).colours_at(places[seen, :2])
        progress(0.9 * (k + 1) / len(names))
    gains = _gains(samples, weights)
    samples *= gains[:, None, :]
    return gains, weights, samples


def read_ahead(photographs: Mapping[str, Photograph], names: Sequence[str]) -> Iterator[Photograph]:
    """The photographs one by one. The next one is read in the meantime."""
    with ThreadPoolExecutor(1) as reader:
        waiting = [reader.submit(photographs.__getitem__, name) for name in names[:1]]
        for following in [*names[1:], None]:
            photograph = waiting.pop().result()
            if following is not None:
                waiting.append(reader.submit(photographs.__getitem__, following))
            yield photograph


def _facing(
    mesh: TriangleMesh, normals: Float64[Array, "n 3"], camera: Camera
) -> tuple[Float32[Array, " n"], Float64[Array, "n 3"]]:
    """Weight of a photograph at every vertex, and the vertex's position in it (`texture_kernels.facing`)."""
    row = view_row(camera, camera.shape_hw, 0)

    def of(band: slice) -> tuple[Float32[Array, " k"], Float64[Array, "k 3"]]:
        return texture_kernels.facing(
            np.array(mesh.vertices[band]), normals[band], row, camera.centre_world, _LEAST_COSINE, SHARPNESS
        )

    weights, places = zip(*in_bands(of, len(normals)), strict=True)
    return np.concatenate(weights), np.concatenate(places)


def _hidden(
    mesh: TriangleMesh, camera: Camera, places: Float64[Array, "n 3"], shown: Bool[Array, " n"]
) -> Int64[Array, " k"]:
    """Indices of the `shown` vertices that the mesh hides from the camera."""
    index = np.flatnonzero(shown)
    if not len(index):
        return index
    step = max(1, round(_SHADOW_MM * camera.matrix[0, 0] * float(np.median(places[index, 2]))))
    width, height = (-(-side // step) for side in camera.size_wh)
    inside = places[:, 0] >= 0
    a, b, c = mesh.faces.T
    corners = places.copy()
    corners[:, :2] = (corners[:, :2] + 0.5) / step - 0.5
    faces = read_only(mesh.faces[inside[a] & inside[b] & inside[c]])
    _, _, inverse_depths = nearest_faces(corners, faces, height, width)
    return index[texture_kernels.hidden(corners[index], inverse_depths, CLEARANCE_MM)]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PhotographLevels:
    """A photograph's levels as recorded, and the level that counts as 1."""

    levels: Integer[Array, "h w c"]
    full_scale: float

    def colours_at(self, uv: Float64[Array, "n 2"]) -> Float32[Array, "n 3"]:
        """Colours at positions in pixels, 0…1, linear between pixels."""

        def of(band: slice) -> Float32[Array, "k 3"]:
            return texture_kernels.colours_at(self.levels, self.full_scale, uv[band])

        return np.concatenate(in_bands(of, len(uv)))


def picture_of(photograph: Photograph) -> PhotographLevels:
    """A photograph as recorded, with one or three channels."""
    pixels = photograph.pixels
    return PhotographLevels(
        levels=pixels[..., None] if pixels.ndim == 2 else pixels, full_scale=float(np.iinfo(pixels.dtype).max)
    )


def _gains(samples: Float32[Array, "k n 3"], weights: Float32[Array, "k n"]) -> Float32[Array, "k 3"]:
    """Gain per camera and channel that makes cameras agree at common vertices, with a mean of 1.

    Least squares on the logarithms of the median ratios, weighted by the number of common vertices.
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
            common = common[:: max(1, len(common) // _LEVELLED)]
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
