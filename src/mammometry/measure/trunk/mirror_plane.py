"""The plane about which skin is most nearly its own mirror image."""

from __future__ import annotations

import numpy as np

from mammometry.base.value import value
from mammometry.geometry.arrays import Array, Float64
from mammometry.measure.trunk.register import register

_PLANE_ROUNDS = 6  # of mirroring and registering; it ends when the plane is at rest
_AT_REST_RAD = 1e-4  # a plane that turns by less is at rest


@value(eq=False)
class MirrorPlane:
    """A plane of symmetry and how well it holds."""

    point_world: Float64[Array, 3]
    """A point of the plane, mm."""
    normal_world: Float64[Array, 3]
    """Its unit normal, towards the patient's left."""
    sigma_mm: float
    """Standard uncertainty of the plane's place along its normal, mm."""
    scatter_mm: float
    """Robust standard deviation of the skin from its own mirror image, mm."""
    used: float
    """Share of the skin with a partner on the other side that is no outlier."""

    def mirrored(self, points_world: Float64[Array, "n 3"]) -> Float64[Array, "n 3"]:
        """Points mirrored at the plane, mm."""
        return mirror(points_world, self.point_world, self.normal_world)


def mirror(
    points: Float64[Array, "n 3"], plane_point: Float64[Array, 3], plane_normal: Float64[Array, 3]
) -> Float64[Array, "n 3"]:
    """Mirror points at a plane."""
    return points - 2 * ((points - plane_point) @ plane_normal)[:, None] * plane_normal


def mirror_plane(
    points_world: Float64[Array, "n 3"],
    normals_world: Float64[Array, "n 3"],
    point_world: Float64[Array, 3],
    left_world: Float64[Array, 3],
) -> MirrorPlane:
    """Find the plane that makes skin most nearly its mirror image.

    The skin is mirrored at a first plane and registered with itself. The motion found and the mirror make one improper
    motion, whose plane is the next guess.

    Args:
        points_world: skin, mm, world frame.
        normals_world: its unit outward normals.
        point_world: a point of the first plane, mm.
        left_world: its unit normal, towards the patient's left.

    Raises:
        MeasureError: too little of the skin was seen on both sides.
    """
    point, normal = point_world, left_world
    scatter = sigma = np.inf
    used = 0.0
    for _ in range(_PLANE_ROUNDS):
        turned = normals_world - 2 * (normals_world @ normal)[:, None] * normal
        image = mirror(points_world, point, normal)
        found = register((image, turned), (points_world, normals_world), subject="trunk and its mirror image")
        motion, scatter, used = found.fixed_from_moving, found.scatter_mm, found.used
        sigma = found.weakest_mm / 2
        linear = motion.rotation @ (np.eye(3) - 2 * np.outer(normal, normal))
        values, vectors = np.linalg.eigh((linear + linear.T) / 2)
        image = motion.apply(image)
        before, normal = normal, vectors[:, np.argmin(values)]
        normal = normal if normal @ left_world > 0 else -normal
        halfway = (points_world + image).mean(axis=0) / 2
        point = point + normal * float((halfway - point) @ normal)
        # Not the motion's own turn: skin that is not quite symmetric keeps one about the plane's normal.
        if np.linalg.norm(normal - before) < _AT_REST_RAD:
            break
    return MirrorPlane(
        point_world=point, normal_world=normal, sigma_mm=float(sigma), scatter_mm=float(scatter), used=used
    )
