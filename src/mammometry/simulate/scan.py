"""Scans of a virtual body: its front without errors, or scanned with a telephone.

They resemble scans by telephones: neighbouring pixels have common noise, folds are bridged because a pixel averages
over its surroundings, and edges seen at flat angles are ragged. Walks and light are made up; no measurement uses them.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal, TypeAlias

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree

from mammometry.base.machine.compiled import kernel
from mammometry.base.value import value
from mammometry.geometry import Array, Bool, Float32, Float64, Transform, TriangleMesh, UInt8
from mammometry.simulate.rendering.develop import srgb_encoded
from mammometry.simulate.rendering.skin import SKINS
from mammometry.simulate.rigs.poses import looking
from mammometry.simulate.subjects.solid import SubjectSolid
from mammometry.study.rays import RayScene
from mammometry.surface.fusion.marching import march

_FIELD_RAD = math.radians(50.0)  # horizontal field of view, like that of telephones' front cameras
_DISTANCE_MM = (480.0, 620.0)  # from the chest
_FRONT_DEG = (
    *((-65, 0), (-45, 0), (-22, 0), (0, 0), (22, 0), (45, 0), (65, 0)),
    *((50, -32), (18, -35), (-18, -35), (-50, -32)),
    *((-45, 28), (-15, 30), (15, 30), (45, 28)),
)  # azimuths and elevations of a walk around the front, below as well as above the breasts
_BELOW_DEG = (
    *((-78, -22), (-50, -20), (-18, -12), (18, -12), (50, -20), (78, -22)),
    *((-70, -45), (-35, -45), (0, -45), (35, -45), (70, -45)),
    *((-35, -66), (-12, -68), (12, -68), (35, -66)),
)  # of a second walk at the height of the hips, looking up
Walk: TypeAlias = Literal["front", "below"]
_WALKS: Mapping[Walk, Sequence[tuple[int, int]]] = MappingProxyType({"front": _FRONT_DEG, "below": _BELOW_DEG})
_STEP_MM = 20.0  # depth difference between neighbouring pixels above which there is an edge of the body
_BLUR_PX = 1.1  # Gaussian σ over which a pixel averages
_SHARED_PX, _SHARED = 2.5, 0.15  # Gaussian σ of the shared noise, and its share of the variance
_SLANT = (0.22, 0.12)  # cosine of incidence below which skin is lost, and standard deviation of this limit
_WANDER_PX = 9.0  # Gaussian σ over which the limit varies
_EDGE_LOST = 0.7  # share of the pixels at an edge of the body that are lost
_POSE_MM, _POSE_RAD = 0.5, 0.0008  # error of a picture's position and direction, for 1 mm of noise


@value(eq=False)
class DepthPicture:
    """One depth picture."""

    depth_mm: Float32[Array, "h w"]
    """Depth along the camera's axis, mm. NaN where nothing was measured."""
    trust: Float32[Array, "h w"]
    """Weight of each pixel: cosine of incidence."""
    camera_from_world: Transform
    """Pose of the picture, including the telephone's error."""
    focal_px: float
    """Focal length. The axis meets the picture's centre."""


def depth_pictures(
    scene: RayScene,
    target: Float64[Array, 3],
    *,
    noise_mm: float,
    width_px: int,
    rng: np.random.Generator,
    walk: Walk = "front",
) -> Iterator[DepthPicture]:
    """Yield fifteen depth pictures around a body's front, or from below.

    Args:
        scene: the body, y to the head and z ahead, mm.
        target: point at which the telephone looks, about the chest's centre.
        noise_mm: standard deviation of a pixel's depth at half a metre.
        width_px: width of a picture; its height is three quarters.
        rng: random generator of noise, positions and lost pixels.
        walk: path of the telephone.
    """
    for azimuth, elevation in _WALKS[walk]:
        a, e = np.radians(np.array([azimuth, elevation]) + rng.normal(0.0, 3.0, 2))
        away = np.array([math.sin(a) * math.cos(e), math.sin(e), math.cos(a) * math.cos(e)])
        centre = target + rng.uniform(*_DISTANCE_MM) * away
        yield _picture(scene, looking(centre, target + rng.normal(0.0, 15.0, 3)), noise_mm, width_px, rng)


def _picture(scene: RayScene, camera: Transform, noise_mm: float, width: int, rng: np.random.Generator) -> DepthPicture:
    height, focal = 3 * width // 4, width / 2 / math.tan(_FIELD_RAD / 2)
    row, column = np.mgrid[:height, :width].astype(np.float64)
    rays = np.stack([(column - (width - 1) / 2) / focal, (row - (height - 1) / 2) / focal, np.ones_like(row)], axis=-1)
    length = np.linalg.norm(rays, axis=-1)
    rays /= length[..., None]
    hits = scene.cast(-camera.rotation.T @ camera.translation_mm, rays @ camera.rotation)
    depth, cosine = hits.range_mm / length, np.nan_to_num(hits.cosine)
    depth = np.where(cosine > 0, depth, np.nan)
    seen = np.isfinite(depth)
    mean = _blurred(np.nan_to_num(depth), seen)
    low, high = (which(np.where(seen, depth, mean), 3) for which in (ndimage.minimum_filter, ndimage.maximum_filter))
    whole = ndimage.minimum_filter(seen, 3)
    edge = ~whole | (high - low > _STEP_MM)
    limit = _SLANT[0] + _SLANT[1] * _field(depth.shape, _WANDER_PX, rng)
    kept = seen & (cosine > limit) & ~(edge & (rng.random(depth.shape) < _EDGE_LOST))
    alone, shared = np.sqrt([1.0 - _SHARED, _SHARED])
    noise = alone * _field(depth.shape, 0.0, rng) + shared * _field(depth.shape, _SHARED_PX, rng)
    noise *= noise_mm * (mean / 500.0) ** 2 / np.sqrt(np.clip(cosine, 0.2, 1.0))
    measured = np.where(kept, np.where(edge, depth, mean) + noise, np.nan).astype(np.float32)
    drift = Transform.from_rotation_vector(
        noise_mm * rng.normal(0.0, _POSE_RAD, 3), noise_mm * rng.normal(0.0, _POSE_MM, 3)
    )
    return DepthPicture(
        depth_mm=measured,
        trust=np.clip(cosine, 0.0, 1.0).astype(np.float32),
        camera_from_world=drift @ camera,
        focal_px=focal,
    )


def _blurred(depth: Float64[Array, "h w"], seen: Array) -> Float64[Array, "h w"]:
    """Mean depth around each pixel, over the pixels that have a depth."""
    share = ndimage.gaussian_filter(seen.astype(np.float64), _BLUR_PX)
    return np.asarray(ndimage.gaussian_filter(depth, _BLUR_PX) / np.maximum(share, 1e-9))


def _field(shape: tuple[int, ...], alike_px: float, rng: np.random.Generator) -> Float64[Array, "h w"]:
    """Random numbers of unit variance, correlated over some pixels."""
    drawn = rng.normal(size=shape)
    if alike_px:
        drawn = ndimage.gaussian_filter(drawn, alike_px, mode="wrap")
        drawn /= drawn.std()
    return np.asarray(drawn)


_TRUNCATION_CUBES = 4.0  # as in voxel grids of telephones; ARKit's and Open3D's examples have 3 to 5
_MARGIN_CUBES = 3  # cubes around the body, so that the surface does not reach the edge of the grid
_OFF_LEVEL = 1e-3  # share of a cube by which values near 0 are moved, because marching cubes requires it
_LEAST_WEIGHT = 0.5  # least weight of a corner: about one picture at nearly normal incidence


def fuse(
    pictures: Sequence[DepthPicture], low: Float64[Array, 3], high: Float64[Array, 3], cube_mm: float
) -> TriangleMesh:
    """Largest piece of the surface from depth pictures that are fused on a grid of cubes.

    Args:
        pictures: depth pictures with the telephone's poses.
        low: lower corner of the box that is scanned, mm.
        high: its upper corner, mm.
        cube_mm: edge of a cube.
    """
    origin = low - _MARGIN_CUBES * cube_mm
    shape = tuple((np.ceil((high - origin) / cube_mm) + _MARGIN_CUBES + 1).astype(int))
    total, weight = np.zeros(shape, dtype=np.float32), np.zeros(shape, dtype=np.float32)
    for picture in pictures:
        camera = picture.camera_from_world
        matrix = np.column_stack([camera.rotation * cube_mm, camera.apply(origin[None])[0]])
        add_picture(
            total, weight, picture.depth_mm, picture.trust, np.ascontiguousarray(matrix), picture.focal_px,
            _TRUNCATION_CUBES * cube_mm,
        )  # fmt: skip
    seen = weight > _LEAST_WEIGHT
    field = np.where(seen, total / np.maximum(weight, 1e-6), np.float32(_TRUNCATION_CUBES * cube_mm))
    off = np.float32(_OFF_LEVEL * cube_mm)
    field = np.where(np.abs(field) < off, np.where(field < 0, -off, off), field)
    cells = np.ones(tuple(n - 1 for n in shape), dtype=bool)
    for corner in np.ndindex(2, 2, 2):
        cells &= seen[tuple(slice(c, n - 1 + c) for c, n in zip(corner, shape, strict=True))]
    vertices, faces = march(field, cells)
    mesh = TriangleMesh(vertices=origin + cube_mm * vertices, faces=faces)
    _, label = mesh.components()
    return mesh.submesh(label[mesh.faces[:, 0]] == np.argmax(np.bincount(label[mesh.faces[:, 0]])))


@kernel
def add_picture(
    total: Float32[Array, "x y z"],
    weight: Float32[Array, "x y z"],
    depth: Float32[Array, "h w"],
    trust: Float32[Array, "h w"],
    camera_from_grid: Float64[Array, "3 4"],
    focal_px: float,
    truncation_mm: float,
) -> None:
    """Add the truncated signed distances of a picture, weighted by its trust in each pixel.

    For each corner, the distance is the nearest pixel's depth minus the corner's, at most `truncation_mm`. Corners
    farther behind the skin are hidden and unchanged.

    Args:
        total: sum of weighted distances, mm. Changed in place.
        weight: sum of weights. Changed in place.
        depth: along the camera's axis, mm. NaN where nothing is seen.
        trust: weight of each pixel.
        camera_from_grid: camera's frame, mm, from a corner's index.
        focal_px: focal length of a camera without distortion, whose axis meets the picture's centre.
        truncation_mm: largest distance, mm.
    """
    height, width = depth.shape
    nx, ny, nz = total.shape
    middle_u, middle_v = (width - 1) / 2, (height - 1) / 2
    m = camera_from_grid
    for i in range(nx):
        for j in range(ny):
            for k in range(nz):
                z = m[2, 0] * i + m[2, 1] * j + m[2, 2] * k + m[2, 3]
                if z <= 0.0:
                    continue
                x = m[0, 0] * i + m[0, 1] * j + m[0, 2] * k + m[0, 3]
                y = m[1, 0] * i + m[1, 1] * j + m[1, 2] * k + m[1, 3]
                column = int(np.floor(focal_px * x / z + middle_u + 0.5))
                row = int(np.floor(focal_px * y / z + middle_v + 0.5))
                if row < 0 or column < 0 or row >= height or column >= width:
                    continue
                distance = depth[row, column] - z
                if not distance > -truncation_mm:  # also false for NaN, where nothing was measured
                    continue
                share = trust[row, column]
                total[i, j, k] += share * min(distance, truncation_mm)
                weight[i, j, k] += share


_LIGHT, _AMBIENT = 1.5, 0.45  # strength of the room's lamp, and share of it that comes from all directions
_LAMP = np.array([0.25, 0.55, 0.8])  # direction of the lamp: above, in front
_ASIDE_MM, _BELOW_MM, _ABOVE_MM, _BACK_MM = 235.0, 235.0, 190.0, 150.0  # scanned box around the chest's centre


@dataclass(frozen=True, slots=True, kw_only=True)
class ScanQuality:
    """Errors and resolution of a body's scan."""

    noise_mm: float
    """Standard deviation of a pixel's depth at half a metre."""
    cube_mm: float
    """Edge of the cubes of the fusion."""
    width_px: int
    """Width of a depth picture."""


QUALITIES: Mapping[str, ScanQuality] = MappingProxyType(
    {
        "fine": ScanQuality(noise_mm=0.5, cube_mm=2.0, width_px=480),
        "telephone": ScanQuality(noise_mm=1.0, cube_mm=4.0, width_px=320),
    }
)
"""Name → kind of scan. fine: a good scanner, or a new telephone at its best. telephone: an ordinary telephone."""


@value(eq=False)
class VirtualScan:
    """An open mesh and its colours, mm, in the solid's frame: y to the head, z ahead."""

    mesh: TriangleMesh
    colours: UInt8[Array, "n 3"]
    """sRGB of each vertex."""

    @property
    def ply_colours(self) -> dict[str, UInt8[Array, " n"]]:
        """Channel → value of each vertex, with the names of a PLY file."""
        return {name: np.ascontiguousarray(self.colours[:, k]) for k, name in enumerate(("red", "green", "blue"))}


def clean_front(solid: SubjectSolid) -> VirtualScan:
    """The body's own triangles in front of the edge of its back, without noise."""
    low, high = _box(solid)
    inside = np.all((solid.mesh.vertices > low) & (solid.mesh.vertices < high), axis=1)
    mesh = solid.mesh.submesh(inside[solid.mesh.faces].all(axis=1) & _faces_ahead(solid))
    _, label = mesh.components()
    mesh = mesh.submesh(label[mesh.faces[:, 0]] == np.argmax(np.bincount(label[mesh.faces[:, 0]])))
    return VirtualScan(mesh=mesh, colours=_colours(solid, mesh))


def scan(solid: SubjectSolid, quality: ScanQuality, seed: int, walk: Walk = "front") -> VirtualScan:
    """Scan a body with a virtual telephone.

    Args:
        solid: the body.
        quality: quality of the depth pictures and of their fusion.
        seed: seed of all random values. Another seed gives another scan of the same body.
        walk: ``front``: around the front. ``below``: at the height of the hips, looking up, to see the fold of a
            hanging breast.
    """
    rng = np.random.default_rng([seed, 101])
    low, high = _box(solid)
    target = np.append((low + high)[:2] / 2, high[2] - 60.0)
    pictures = list(
        depth_pictures(
            RayScene(solid.mesh), target, noise_mm=quality.noise_mm, width_px=quality.width_px, rng=rng, walk=walk
        )
    )  # fmt: skip
    shift = rng.uniform(0.0, quality.cube_mm, 3)
    mesh = fuse(pictures, low - shift, high, quality.cube_mm)
    return VirtualScan(mesh=mesh, colours=_colours(solid, mesh))


def _box(solid: SubjectSolid) -> tuple[Float64[Array, 3], Float64[Array, 3]]:
    """Lower and upper corner of the scanned box, mm.

    For a body, it contains the front with shoulders and upper arms. For other subjects, it contains everything.
    """
    vertices = solid.mesh.vertices
    if "midline" not in solid.landmarks:
        return vertices.min(axis=0), vertices.max(axis=0) + 1.0
    middle = solid.landmarks["midline"].mean(axis=0)
    low = np.array([middle[0] - _ASIDE_MM, middle[1] - _BELOW_MM, middle[2] - _BACK_MM])
    high = np.array([middle[0] + _ASIDE_MM, middle[1] + _ABOVE_MM, np.inf])
    return np.maximum(low, vertices.min(axis=0)), np.minimum(high, vertices.max(axis=0) + 1.0)


def _faces_ahead(solid: SubjectSolid) -> Bool[Array, " m"]:
    """Faces of the front: all that do not face backwards, and all of the breasts."""
    vectors = solid.mesh.face_vectors()
    length = np.maximum(np.linalg.norm(vectors, axis=1), 1e-12)
    ahead = np.asarray(vectors[:, 2] / length > -0.6)
    for breast in solid.breasts.values():
        ahead[breast.skin_faces] = True
    return ahead


def _colours(solid: SubjectSolid, mesh: TriangleMesh) -> UInt8[Array, "n 3"]:
    nearest = cKDTree(solid.mesh.vertices).query(mesh.vertices)[1]
    skin, share = SKINS["skin"], solid.areola[nearest][:, None].astype(np.float64)
    colour = (1.0 - share) * np.array(skin.base_rgb) + share * np.array(skin.areola_rgb)
    if solid.tint is not None:
        colour = colour * solid.tint[nearest]
    facing = np.clip(solid.mesh.vertex_normals()[nearest] @ (_LAMP / np.linalg.norm(_LAMP)), 0.0, 1.0)
    light = _LIGHT * (_AMBIENT + (1.0 - _AMBIENT) * facing)[:, None]
    return np.round(255.0 * srgb_encoded(np.clip(light * colour, 0.0, 1.0))).astype(np.uint8)
