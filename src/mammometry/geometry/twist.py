"""Small rigid motions as six numbers: a *twist* is a rotation vector, rad, then a translation, mm.

To first order it moves a point x to x + rotation × x + translation.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mammometry.geometry.arrays import Array, Float64
from mammometry.geometry.camera import Camera
from mammometry.geometry.transform import Transform


def as_twist(motion: Transform) -> Float64[Array, 6]:
    """Return a motion as a twist."""
    return np.concatenate([motion.rotation_vector_rad, motion.translation_mm])


def as_motion(twist: Float64[Array, 6], about: Float64[Array, 3] | None = None) -> Transform:
    """Return a twist as a motion.

    Args:
        twist: rotation vector, rad, and translation, mm.
        about: centre of the rotation, mm. None: the origin.
    """
    motion = Transform.from_rotation_vector(twist[:3].copy(), twist[3:].copy())
    if about is None:
        return motion
    return Transform(rotation=motion.rotation, translation_mm=twist[3:] + about - motion.rotation @ about)


def moved_camera(camera: Camera, motion: Transform) -> Camera:
    """Return the camera after a motion in the world's frame."""
    return replace(camera, camera_from_world=camera.camera_from_world @ motion.inverse())


def rigid_motions(points: Float64[Array, "n 3"]) -> Float64[Array, "n 3 6"]:
    """Displacements of points by the six unit twists, mm."""
    turns = np.cross(np.eye(3)[None], points[:, None, :]).transpose(0, 2, 1)
    return np.concatenate([turns, np.broadcast_to(np.eye(3), (len(points), 3, 3))], axis=2)


def without(common: Float64[Array, "n 3 k"], displacements: Float64[Array, "n 3 p"]) -> Float64[Array, "n 3 p"]:
    """Remove common displacements from those of points, by least squares.

    Args:
        common: independent displacements to remove, such as `rigid_motions`.
        displacements: p of them, mm.
    """
    basis, _ = np.linalg.qr(common.reshape(-1, common.shape[2]))
    flat = displacements.reshape(len(basis), -1)
    left: Float64[Array, "n 3 p"] = (flat - basis @ (basis.T @ flat)).reshape(displacements.shape)
    return left
