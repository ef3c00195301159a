"""Range images, silhouettes and meshes of spheres and ellipsoids in closed form."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mammometry.geometry.camera import Camera, Rig
from mammometry.geometry.mesh import TriangleMesh
from mammometry.geometry.transform import Transform
from mammometry.matching.foreground.foreground import Foreground
from mammometry.surface.ranges.range_image import RangeImage


def camera_towards(name, direction, *, distance=400.0, size=120, focal=400.0, target=(0.0, 0.0, 0.0)) -> Camera:
    """A camera that looks at `target` from `distance` mm along `direction`; pixels of 1 mm there by default."""
    z = -np.asarray(direction, dtype=float) / np.linalg.norm(direction)
    x = np.cross(np.eye(3)[np.argmin(np.abs(z))], z)
    x /= np.linalg.norm(x)
    rotation = np.stack([x, np.cross(z, x), z])
    centre = np.asarray(target) - distance * z
    middle = (size - 1) / 2
    return Camera(
        name=name,
        size_wh=(size, size),
        matrix=np.array([[focal, 0, middle], [0, focal, middle], [0, 0, 1.0]]),
        distortion=np.zeros(5),
        camera_from_world=Transform(rotation=rotation, translation_mm=-rotation @ centre),
    )


def ellipsoid_range(camera: Camera, radii, centre=(0.0, 0.0, 0.0), uv=None):
    """Distance along each pixel's ray to the nearer intersection with an ellipsoid, mm; NaN where it misses."""
    if uv is None:
        height, width = camera.shape_hw
        uv = np.stack(np.meshgrid(np.arange(width, dtype=float), np.arange(height, dtype=float)), axis=-1)
    scale = 1.0 / np.asarray(radii, dtype=float)
    ray = camera.rays_world(uv) * scale
    origin = (camera.centre_world - np.asarray(centre)) * scale
    a, b, c = (ray**2).sum(-1), ray @ origin, origin @ origin - 1.0
    with np.errstate(invalid="ignore"):
        return (-b - np.sqrt(b * b - a * c)) / a


def range_image(camera: Camera, range_mm, *, name=None, sigma_mm=0.05) -> RangeImage:
    valid = np.isfinite(range_mm)
    return RangeImage(
        name=name or camera.name,
        camera=camera,
        range_mm=np.where(valid, range_mm, 0).astype(np.float32),
        sigma_mm=np.where(valid, sigma_mm, 0).astype(np.float32),
        confidence=valid.astype(np.float32),
        valid=valid,
    )


def silhouette(camera: Camera, radii, samples=4) -> Foreground:
    """Share of each pixel that the ellipsoid covers, by supersampling."""
    height, width = camera.shape_hw
    steps = (np.arange(samples) + 0.5) / samples - 0.5
    covered = np.zeros((height, width))
    base = np.stack(np.meshgrid(np.arange(width, dtype=float), np.arange(height, dtype=float)), axis=-1)
    for du in steps:
        for dv in steps:
            covered += np.isfinite(ellipsoid_range(camera, radii, uv=base + np.array([du, dv])))
    return Foreground(
        camera=camera.name, coverage=(covered / samples**2).astype(np.float32), contour_level=0.5, everything=False
    )


def rig_of(cameras: Sequence[Camera]) -> Rig:
    """A rig in which each camera is the left one of a pair of its own name (the right one is any other)."""
    names = [camera.name for camera in cameras]
    pairs = {name: (name, names[(k + 1) % len(names)]) for k, name in enumerate(names)}
    return Rig(name="test", cameras={camera.name: camera for camera in cameras}, pair_names=pairs)


def sphere_mesh(radius: float, rings: int = 40) -> TriangleMesh:
    """A closed sphere of latitude rings, faces outwards."""
    segments = 2 * rings
    theta = np.pi * np.arange(1, rings) / rings
    phi = 2 * np.pi * np.arange(segments) / segments
    body = np.stack(
        [
            np.outer(np.sin(theta), np.cos(phi)),
            np.outer(np.sin(theta), np.sin(phi)),
            np.outer(np.cos(theta), 0 * phi + 1),
        ],
        axis=-1,
    ).reshape(-1, 3)
    vertices = radius * np.concatenate([body, [[0, 0, 1], [0, 0, -1]]])
    top, bottom = len(body), len(body) + 1
    faces = []
    for k in range(segments):
        n = (k + 1) % segments
        faces += [(top, k, n), (bottom, (rings - 2) * segments + n, (rings - 2) * segments + k)]
        for r in range(rings - 2):
            a, b, c, d = r * segments + k, r * segments + n, (r + 1) * segments + k, (r + 1) * segments + n
            faces += [(a, c, d), (a, d, b)]
    return TriangleMesh(vertices=vertices, faces=np.array(faces, dtype=np.int32))
