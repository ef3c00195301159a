"""Solids of known volume, and cameras around them, for the tests of the measurement."""

from typing import Any

import numpy as np
import trimesh

from mammometry.geometry.camera import Camera, Rig
from mammometry.geometry.mesh import TriangleMesh
from mammometry.geometry.transform import Transform
from mammometry.job.inputs import CameraSet
from mammometry.job.products import Single, at_hand
from mammometry.job.stages import surface
from mammometry.matching.foreground.foreground import Foreground
from mammometry.surface.repair.repair import Provenance, RepairedSurface


def ball(radius_mm: float = 50.0, subdivisions: int = 5) -> TriangleMesh:
    solid = trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius_mm)
    return TriangleMesh(vertices=np.asarray(solid.vertices), faces=np.asarray(solid.faces).astype(np.int32))


def as_surface(mesh: TriangleMesh, measured: np.ndarray | None = None) -> RepairedSurface:
    n = len(mesh.vertices)
    provenance = np.full(n, Provenance.MEASURED, dtype=np.uint8)
    if measured is not None:
        provenance[~measured] = Provenance.INVENTED
    return RepairedSurface(
        mesh=mesh,
        provenance=provenance,
        sigma_mm=np.full(n, 0.05, dtype=np.float32),
        pair_bits=np.ones(n, dtype=np.int32),
        pair_names=("front",),
        convergence=np.zeros(1),
    )


def dome(bend_radius_mm: float | None = None, sink_mm: float = 0.0, rings: int = 60, around: int = 240) -> TriangleMesh:
    """A closed dome, 60 mm in radius and 50 mm high, steep at its rim, on a plane or on a cylinder along y.

    Its floor, which no camera sees, is sunk by `sink_mm` along z, as where an unseen back is closed plainly behind.
    """
    t = np.linspace(0.0, 1.0, rings + 1)[1:]
    radius, height = 60.0 * np.sin(t * np.pi / 2), 50.0 * np.cos(t * np.pi / 2)
    floor_radius = 60.0 * np.linspace(1.0, 0.0, rings // 2)[1:-1]
    angle = np.linspace(0, 2 * np.pi, around, endpoint=False)
    profile = [(r, h, 0.0) for r, h in zip(radius, height, strict=True)]
    profile += [(60.0, 0.0, sink_mm)] if sink_mm else []
    profile += [(r, 0.0, sink_mm) for r in floor_radius]
    points = [np.array([[0.0, 0.0, 50.0]])]
    for r, h, sink in profile:
        x, y = r * np.cos(angle), r * np.sin(angle)
        z = np.full(around, h) if bend_radius_mm is None else h + np.sqrt(bend_radius_mm**2 - x**2) - bend_radius_mm
        points.append(np.stack([x, y, z - sink], axis=1))
    points.append(np.array([[0.0, 0.0, -sink_mm]]))
    vertices = np.concatenate(points)
    ring = 1 + np.arange(len(profile))[:, None] * around + np.arange(around)
    a, b = ring[:-1].ravel(), np.roll(ring, -1, axis=1)[:-1].ravel()
    c, d = ring[1:].ravel(), np.roll(ring, -1, axis=1)[1:].ravel()
    top = np.stack([np.zeros(around, dtype=int), ring[0], np.roll(ring[0], -1)], axis=1)
    last = np.full(around, len(vertices) - 1)
    bottom = np.stack([last, np.roll(ring[-1], -1), ring[-1]], axis=1)
    faces = np.concatenate([top, np.stack([a, c, b], axis=1), np.stack([b, c, d], axis=1), bottom])
    return TriangleMesh(vertices=vertices, faces=faces.astype(np.int32))


def camera_at(name: str, centre: np.ndarray, focal_px: float = 900.0, size: tuple[int, int] = (280, 240)) -> Camera:
    """A camera that looks at the origin, y upwards in its picture."""
    forward = -centre / np.linalg.norm(centre)
    down = np.array([0.0, -1.0, 0.0])
    down -= forward * (down @ forward)
    down /= np.linalg.norm(down)
    rotation = np.stack([np.cross(down, forward), down, forward])
    matrix = np.array([[focal_px, 0, size[0] / 2], [0, focal_px, size[1] / 2], [0, 0, 1.0]])
    pose = Transform(rotation=rotation, translation_mm=-rotation @ centre)
    return Camera(name=name, size_wh=size, matrix=matrix, distortion=np.zeros(5), camera_from_world=pose)


def rig_around(distance_mm: float = 700.0, tilt_deg: float = 50.0) -> Rig:
    """Three pairs that look down on the origin from +z: front, left and right, and one from below."""
    slant, cameras, pairs = np.deg2rad(tilt_deg), {}, {}
    for name, around in (("right", 0.0), ("left", 180.0), ("floor", 270.0), ("front", None)):
        for side, offset in (("left", -9.0), ("right", 9.0)):
            azimuth = np.deg2rad((0.0 if around is None else around) + offset)
            lean = np.deg2rad(9.0) if around is None else slant
            azimuth = np.deg2rad(90.0 + 90.0 * np.sign(offset)) if around is None else azimuth
            direction = np.array([np.sin(lean) * np.cos(azimuth), np.sin(lean) * np.sin(azimuth), np.cos(lean)])
            cameras[f"{name}_{side}"] = camera_at(f"{name}_{side}", distance_mm * direction)
        pairs[name] = (f"{name}_left", f"{name}_right")
    return Rig(name="test", cameras=cameras, pair_names=pairs)


def silhouettes(mesh: TriangleMesh, rig: Rig, samples: int = 5) -> dict[str, Foreground]:
    """Exact coverage: share of each pixel's area that the solid covers, by ray casting."""
    solid = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    offsets = (np.arange(samples) + 0.5) / samples - 0.5
    found = {}
    for name, camera in rig.cameras.items():
        width, height = camera.size_wh
        u = (np.arange(width)[:, None] + offsets).ravel()
        v = (np.arange(height)[:, None] + offsets).ravel()
        uv = np.stack(np.meshgrid(u, v), axis=-1)
        rays = camera.rays_world(uv).reshape(-1, 3)
        hit = solid.ray.intersects_any(np.broadcast_to(camera.centre_world, rays.shape), rays)
        share = hit.reshape(height, samples, width, samples).mean(axis=(1, 3))
        found[name] = Foreground(camera=name, coverage=share.astype(np.float32), contour_level=0.5, everything=False)
    return found


def given_surface(repaired: RepairedSurface, rig: Rig) -> dict[Single[Any], Single[Any]]:
    """Products at hand, from which a plan measures a surface."""
    values = {
        surface.corrected_cameras: CameraSet(rig=rig, std={}, world="", rms_px=None),
        surface.valid_patches: None,
        surface.mesh: None,
        surface.repaired: repaired,
    }
    return {
        product: at_hand(value, stage="surface", name=product.name, version=1, inputs={})
        for product, value in values.items()
    }
