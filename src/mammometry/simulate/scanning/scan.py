"""Scans of a virtual body: its clean front, and what a telephone makes of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from scipy.spatial import cKDTree

from mammometry.base.machine.compiled import kernel
from mammometry.base.value import value
from mammometry.geometry.arrays import Array, Bool, Float32, Float64, UInt8
from mammometry.geometry.mesh import TriangleMesh
from mammometry.simulate.rendering.in_camera import srgb_encoded
from mammometry.simulate.rendering.objects.skin import SKINS
from mammometry.simulate.scanning.depth_camera import DepthPicture, depth_pictures
from mammometry.simulate.subjects.solid import Solid
from mammometry.study.rays import RayScene
from mammometry.surface.fusion.marching import march

_TRUNCATION_CUBES = 4.0  # as voxel grids of telephones have; ARKit's and Open3D's samples: 3 to 5
_MARGIN_CUBES = 3  # around the body, so that the level never meets the grid's edge
_OFF_LEVEL = 1e-3  # share of a cube by which a value of 0 is moved, since marching cubes wants none
_LEAST_WEIGHT = 0.5  # of a corner: about one picture that looks at it nearly straight


def fuse(
    pictures: Sequence[DepthPicture], low: Float64[Array, 3], high: Float64[Array, 3], cube_mm: float
) -> TriangleMesh:
    """Fuse depth pictures on a grid of cubes, and return the largest piece of the surface.

    Args:
        pictures: with the places at which the telephone believes that it took them.
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
    """Add one picture's truncated signed distances, weighted by its trust in each pixel.

    A corner takes the nearest pixel's depth minus its own, at most `truncation_mm`. One that lies further behind the
    skin is not seen and takes nothing.

    Args:
        total: sum of weighted distances, mm. Changed.
        weight: sum of weights. Changed.
        depth: along the camera's axis, mm. NaN where nothing is seen.
        trust: weight of each pixel.
        camera_from_grid: camera's frame, mm, from a corner's index.
        focal_px: of a camera without distortion, whose axis meets the picture's middle.
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
                if not distance > -truncation_mm:  # also where nothing is seen
                    continue
                share = trust[row, column]
                total[i, j, k] += share * min(distance, truncation_mm)
                weight[i, j, k] += share


_LIGHT, _AMBIENT = 1.5, 0.45  # of the room's lamp, and the share of it that comes from all sides; chosen by eye
_LAMP = np.array([0.25, 0.55, 0.8])  # where it hangs: above, before her
_ASIDE_MM, _BELOW_MM, _ABOVE_MM, _BACK_MM = 235.0, 235.0, 190.0, 150.0  # scanned around the chest's middle


@dataclass(frozen=True, slots=True, kw_only=True)
class ScanQuality:
    """How a body is scanned."""

    noise_mm: float
    """Standard deviation of a pixel's depth at half a metre."""
    cube_mm: float
    """Edge of the cubes in which the pictures are fused."""
    width_px: int
    """Width of a depth picture."""


QUALITIES: Mapping[str, ScanQuality] = MappingProxyType(
    {
        "fine": ScanQuality(noise_mm=0.5, cube_mm=2.0, width_px=480),
        "telephone": ScanQuality(noise_mm=1.0, cube_mm=4.0, width_px=320),
    }
)
"""Kinds of scans: a good scanner's or a new telephone's at its best, and a telephone's as is usual."""


@value(eq=False)
class VirtualScan:
    """An open mesh and its colours, mm, in the solid's frame: y to the head, z ahead."""

    mesh: TriangleMesh
    colours: UInt8[Array, "n 3"]
    """sRGB of each vertex."""

    @property
    def ply_colours(self) -> dict[str, UInt8[Array, " n"]]:
        """Channel → value of each vertex, as a PLY file names them."""
        return {name: np.ascontiguousarray(self.colours[:, k]) for k, name in enumerate(("red", "green", "blue"))}


def clean_front(solid: Solid) -> VirtualScan:
    """The body's own triangles from the back's edge forward, without noise."""
    low, high = _box(solid)
    inside = np.all((solid.mesh.vertices > low) & (solid.mesh.vertices < high), axis=1)
    mesh = solid.mesh.submesh(inside[solid.mesh.faces].all(axis=1) & _faces_ahead(solid))
    _, label = mesh.components()
    mesh = mesh.submesh(label[mesh.faces[:, 0]] == np.argmax(np.bincount(label[mesh.faces[:, 0]])))
    return VirtualScan(mesh=mesh, colours=_colours(solid, mesh))


def scan(solid: Solid, quality: ScanQuality, seed: int) -> VirtualScan:
    """Scan a body with a virtual telephone.

    Args:
        solid: the body.
        quality: of the depth pictures and of their fusion.
        seed: of everything random. Another seed scans the same body anew.
    """
    rng = np.random.default_rng([seed, 101])
    low, high = _box(solid)
    target = np.append((low + high)[:2] / 2, high[2] - 60.0)
    pictures = list(
        depth_pictures(
            RayScene(solid.mesh), target, noise_mm=quality.noise_mm, width_px=quality.width_px, rng=rng
        )
    )  # fmt: skip
    shift = rng.uniform(0.0, quality.cube_mm, 3)
    mesh = fuse(pictures, low - shift, high, quality.cube_mm)
    return VirtualScan(mesh=mesh, colours=_colours(solid, mesh))


def _box(solid: Solid) -> tuple[Float64[Array, 3], Float64[Array, 3]]:
    """Corners of what is scanned: the front with the shoulders and the upper arms."""
    middle = solid.landmarks["midline"].mean(axis=0)
    low = np.array([middle[0] - _ASIDE_MM, middle[1] - _BELOW_MM, middle[2] - _BACK_MM])
    high = np.array([middle[0] + _ASIDE_MM, middle[1] + _ABOVE_MM, np.inf])
    vertices = solid.mesh.vertices
    return np.maximum(low, vertices.min(axis=0)), np.minimum(high, vertices.max(axis=0) + 1.0)


def _faces_ahead(solid: Solid) -> Bool[Array, " m"]:
    """Faces of the front: all but those that look back. Of a hanging breast some do."""
    vectors = solid.mesh.face_vectors()
    length = np.maximum(np.linalg.norm(vectors, axis=1), 1e-12)
    ahead = np.asarray(vectors[:, 2] / length > -0.6)
    for breast in solid.breasts.values():
        ahead[breast.skin_faces] = True
    return ahead


def _colours(solid: Solid, mesh: TriangleMesh) -> UInt8[Array, "n 3"]:
    nearest = cKDTree(solid.mesh.vertices).query(mesh.vertices)[1]
    skin, share = SKINS["skin"], solid.areola[nearest][:, None].astype(np.float64)
    colour = (1.0 - share) * np.array(skin.base_rgb) + share * np.array(skin.areola_rgb)
    if solid.tint is not None:
        colour = colour * solid.tint[nearest]
    facing = np.clip(solid.mesh.vertex_normals()[nearest] @ (_LAMP / np.linalg.norm(_LAMP)), 0.0, 1.0)
    light = _LIGHT * (_AMBIENT + (1.0 - _AMBIENT) * facing)[:, None]
    return np.round(255.0 * srgb_encoded(np.clip(light * colour, 0.0, 1.0))).astype(np.uint8)
