"""Robust registration of surfaces, and the plane of greatest symmetry of skin."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from mammometry.base.errors import MeasureError
from mammometry.base.normal import MAD
from mammometry.base.value import value
from mammometry.geometry import Array, Float64, Transform
from mammometry.geometry.nearest import point_tree

_SAMPLES = 6000  # moving points; chosen for speed
_ROUNDS = 60  # most iterations
_FEWEST = 200  # fewest partners; not critical
_FACING = 0.7  # least cosine between partners' normals; not critical
_TUKEY = 4.0  # Tukey's constant, in scatters; not critical
_FINEST_MM = 0.15  # least scatter: the skin's own noise
_RIDGE = 1e-6  # regularisation of motions that the surfaces do not determine, as a share of the trace
_SHARED = 25.0  # number of points with a common error: neighbours share a matching window
_FIRST_REACH_MM, _NARROWING, _REACH, _LEAST_REACH_MM = 30.0, 0.8, 6.0, 3.0
"""Search distance for partners: first value, mm; factor per round; lower limits, in scatters and mm. Not critical."""
_AT_REST = 0.01  # final step, relative to the motion's uncertainty; below it, partners may oscillate


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Registration:
    """A rigid motion with its quality."""

    fixed_from_moving: Transform
    scatter_mm: float
    """Robust standard deviation of the distances along the normal, mm."""
    weakest_mm: float
    """Standard uncertainty of the least certain of the six motions, as displacement at the surface's radius, mm; large
    for a round trunk, which can slide along itself. One in 25 points counts as independent, because neighbours share
    the errors of their matching windows."""


def register(
    moving: tuple[Float64[Array, "n 3"], Float64[Array, "n 3"]],
    fixed: tuple[Float64[Array, "m 3"], Float64[Array, "m 3"]],
    *,
    start: Transform | None = None,
    subject: str = "surfaces",
) -> Registration:
    """Rigid registration of points with normals: point-to-plane ICP with Tukey's weights.

    Partners must be within a distance that shrinks with the scatter, and have similar normals. Motions that the
    surfaces do not determine remain unchanged (regularised normal equations).

    Args:
        moving: points and unit normals that are moved, mm.
        fixed: points and unit normals, mm, at least about as dense.
        start: initial motion; None: the identity.
        subject: what is registered, for messages.

    Raises:
        MeasureError: too few partners are found.
    """
    points, normals = (array[:: max(1, len(moving[0]) // _SAMPLES)] for array in moving)
    fixed_points, outward = fixed
    tree = point_tree(fixed_points)
    motion = start or Transform.identity()
    reach = scale = _FIRST_REACH_MM
    weakest = np.inf
    for _ in range(_ROUNDS):
        moved, turned = motion.apply(points), motion.rotate(normals)
        distance, partner = tree.query(moved, distance_upper_bound=reach)
        found = np.isfinite(distance)
        partner = np.where(found, partner, 0)
        plane = outward[partner]
        found &= (plane * turned).sum(axis=1) > _FACING
        if found.sum() < _FEWEST:
            raise MeasureError(
                subject,
                found=f"{int(found.sum())} matching points of {len(points)}",
                expected=f"at least {_FEWEST}",
                remedy="Check that both show the same part of the same patient, in about the same posture",
            )
        away = ((fixed_points[partner] - moved) * plane).sum(axis=1)
        scale = max(MAD * float(np.median(np.abs(away[found]))), _FINEST_MM)
        weights = np.where(found, np.clip(1 - (away / (_TUKEY * scale)) ** 2, 0, None) ** 2, 0.0)
        middle = moved[found].mean(axis=0)
        size = float(np.sqrt(((moved[found] - middle) ** 2).sum(axis=1).mean()))
        rows = np.concatenate([np.cross((moved - middle) / size, plane), plane], axis=1)
        normal_matrix = (rows * weights[:, None]).T @ rows
        ridge = _RIDGE * np.trace(normal_matrix) * np.eye(6)
        step = np.linalg.solve(normal_matrix + ridge, (rows * weights[:, None]).T @ away)
        turn = Rotation.from_rotvec(step[:3] / size).as_matrix()
        motion = Transform(rotation=turn, translation_mm=middle + step[3:] - turn @ middle) @ motion
        weakest = scale / float(np.sqrt(max(np.linalg.eigvalsh(normal_matrix)[0] / _SHARED, 1e-9)))
        if np.abs(step).max() < _AT_REST * weakest and reach <= max(_REACH * scale, _LEAST_REACH_MM):
            break
        reach = max(reach * _NARROWING, _REACH * scale, _LEAST_REACH_MM) if reach > _LEAST_REACH_MM else reach
    return Registration(fixed_from_moving=motion, scatter_mm=scale, weakest_mm=float(weakest))


_PLANE_ROUNDS = 6  # most iterations of mirroring and registering
_AT_REST_RAD = 1e-4  # a smaller turn of the plane ends the iteration


@value(eq=False)
class MirrorPlane:
    """A plane of symmetry with its quality."""

    point_world: Float64[Array, 3]
    """A point of the plane, mm."""
    normal_world: Float64[Array, 3]
    """Its unit normal, towards the patient's left."""
    sigma_mm: float
    """Standard uncertainty of the plane's position along its normal, mm."""
    scatter_mm: float
    """Robust standard deviation of the skin from its own mirror image, mm."""

    def mirrored(self, points_world: Float64[Array, "n 3"]) -> Float64[Array, "n 3"]:
        """Points mirrored at the plane, mm."""
        return mirror(points_world, self.point_world, self.normal_world)


def mirror(
    points: Float64[Array, "n 3"], plane_point: Float64[Array, 3], plane_normal: Float64[Array, 3]
) -> Float64[Array, "n 3"]:
    """Points mirrored at a plane."""
    return points - 2 * ((points - plane_point) @ plane_normal)[:, None] * plane_normal


def mirror_plane(
    points_world: Float64[Array, "n 3"],
    normals_world: Float64[Array, "n 3"],
    point_world: Float64[Array, 3],
    left_world: Float64[Array, 3],
) -> MirrorPlane:
    """Plane about which skin is most symmetric.

    The skin is mirrored at a first plane and registered with itself. Reflection and motion together are an improper
    motion, whose plane is the next estimate.

    Args:
        points_world: skin, mm, world frame.
        normals_world: its unit outward normals.
        point_world: a point of the first plane, mm.
        left_world: its unit normal, towards the patient's left.

    Raises:
        MeasureError: too little skin is visible on both sides.
    """
    point, normal = point_world, left_world
    scatter = sigma = np.inf
    for _ in range(_PLANE_ROUNDS):
        turned = normals_world - 2 * (normals_world @ normal)[:, None] * normal
        image = mirror(points_world, point, normal)
        found = register((image, turned), (points_world, normals_world), subject="trunk and its mirror image")
        motion, scatter = found.fixed_from_moving, found.scatter_mm
        sigma = found.weakest_mm / 2
        linear = motion.rotation @ (np.eye(3) - 2 * np.outer(normal, normal))
        values, vectors = np.linalg.eigh((linear + linear.T) / 2)
        image = motion.apply(image)
        before, normal = normal, vectors[:, np.argmin(values)]
        normal = normal if normal @ left_world > 0 else -normal
        halfway = (points_world + image).mean(axis=0) / 2
        point = point + normal * float((halfway - point) @ normal)
        # Not the motion's rotation: on slightly asymmetric skin one about the plane's normal remains.
        if np.linalg.norm(normal - before) < _AT_REST_RAD:
            break
    return MirrorPlane(point_world=point, normal_world=normal, sigma_mm=float(sigma), scatter_mm=float(scatter))
