"""Scans of a virtual body: its clean front, and what a telephone makes of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from scipy.spatial import cKDTree

from mammometry.base.value import value
from mammometry.geometry.arrays import Array, Bool, Float64, UInt8
from mammometry.geometry.mesh import TriangleMesh
from mammometry.simulate.rendering.in_camera import srgb_encoded
from mammometry.simulate.rendering.objects.skin import SKINS
from mammometry.simulate.scanning.depth_camera import depth_pictures
from mammometry.simulate.scanning.fusion import fuse
from mammometry.simulate.subjects.solid import Solid
from mammometry.study.rays import RayScene

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
    mesh = solid.mesh.submesh(inside[solid.mesh.faces].all(axis=1) & _faces_ahead(solid.mesh))
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


def _faces_ahead(mesh: TriangleMesh) -> Bool[Array, " m"]:
    """Faces of the front: all but those of the back that lie far behind."""
    vectors = mesh.face_vectors()
    length = np.maximum(np.linalg.norm(vectors, axis=1), 1e-12)
    return np.asarray(vectors[:, 2] / length > -0.6)


def _colours(solid: Solid, mesh: TriangleMesh) -> UInt8[Array, "n 3"]:
    nearest = cKDTree(solid.mesh.vertices).query(mesh.vertices)[1]
    skin, share = SKINS["skin"], solid.areola[nearest][:, None].astype(np.float64)
    colour = (1.0 - share) * np.array(skin.base_rgb) + share * np.array(skin.areola_rgb)
    if solid.tint is not None:
        colour = colour * solid.tint[nearest]
    facing = np.clip(solid.mesh.vertex_normals()[nearest] @ (_LAMP / np.linalg.norm(_LAMP)), 0.0, 1.0)
    light = _LIGHT * (_AMBIENT + (1.0 - _AMBIENT) * facing)[:, None]
    return np.round(255.0 * srgb_encoded(np.clip(light * colour, 0.0, 1.0))).astype(np.uint8)
