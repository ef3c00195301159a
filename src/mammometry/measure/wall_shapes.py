"""Walls of a torso: surfaces through a breast's boundary that stand in for the chest behind it."""

from __future__ import annotations

import numpy as np

from mammometry.geometry.arrays import Array, Float64
from mammometry.geometry.mesh import TriangleMesh
from mammometry.measure.base import frame_towards
from mammometry.measure.cut import OpenPart
from mammometry.measure.patch import Patch, fill, harmonic, signed_area_mm2
from mammometry.measure.sew import sew
from mammometry.measure.thorax import Thorax, Trunk

_SPACING_MM = 2.5


def cylinder_membrane(part: OpenPart, trunk: Trunk) -> tuple[TriangleMesh, TriangleMesh]:
    """The radius from the trunk's axis, harmonic over (θ, y), equal to the skin's on the boundary."""
    loops = tuple(trunk.cylindrical(part.mesh.vertices[loop]) for loop in part.loops)

    def lift(patch: Patch) -> Float64[Array, "k 3"]:
        radius = harmonic(patch, np.concatenate(loops)[:, 2:])
        return trunk.world(np.concatenate([patch.points, radius], axis=1)[patch.n_loop :])

    return sew(
        part, tuple(loop[:, :2] for loop in loops), lift, spacing_mm=_SPACING_MM, subject="cylinder-membrane wall"
    )


def thorax_fit(part: OpenPart, thorax: Thorax) -> tuple[TriangleMesh, TriangleMesh]:
    """The thorax fitted to the skin beside the breasts, plus its misfit on the boundary carried in harmonically."""
    trunk = thorax.trunk
    loops = tuple(trunk.cylindrical(part.mesh.vertices[loop]) for loop in part.loops)
    boundary = np.concatenate(loops)
    misfit = boundary[:, 2] - thorax.radius_mm(boundary[:, :2])

    def lift(patch: Patch) -> Float64[Array, "k 3"]:
        radius = thorax.radius_mm(patch.points)[:, None] + harmonic(patch, misfit[:, None])
        return trunk.world(np.concatenate([patch.points, radius], axis=1)[patch.n_loop :])

    return sew(part, tuple(loop[:, :2] for loop in loops), lift, spacing_mm=_SPACING_MM, subject="thorax-fit wall")


def membrane(part: OpenPart) -> tuple[TriangleMesh, TriangleMesh]:
    """The height over the boundary's best plane, harmonic inside: nearly the surface of least area."""
    loops, origin, frame = _on_best_plane(part)

    def lift(patch: Patch) -> Float64[Array, "k 3"]:
        height = harmonic(patch, np.concatenate(loops)[:, 2:])
        return origin + np.concatenate([patch.points, height], axis=1)[patch.n_loop :] @ frame

    return sew(part, tuple(loop[:, :2] for loop in loops), lift, spacing_mm=_SPACING_MM, subject="membrane wall")


def flat(part: OpenPart) -> tuple[TriangleMesh, TriangleMesh]:
    """The boundary's best plane, joined to the boundary by a skirt along the plane's normal."""
    loops, origin, frame = _on_best_plane(part)
    patch = fill(tuple(loop[:, :2] for loop in loops))
    loop = np.concatenate(part.loops)
    n, n_skin = len(loop), len(part.mesh.vertices)
    sunk = origin + np.concatenate([patch.points, np.zeros((n, 1))], axis=1) @ frame
    upper, lower, follower = [], [], []
    start = 0
    for one in part.loops:
        index = np.arange(start, start + len(one))
        upper.append(index)
        follower.append(np.roll(index, -1))
        lower.append(index + n)
        start += len(one)
    a, b = np.concatenate(upper), np.concatenate(follower)
    skirt = np.concatenate([np.stack([b, a, a + n], axis=1), np.stack([b, a + n, b + n], axis=1)])
    faces = np.concatenate([skirt, patch.faces[:, ::-1] + n])
    wall = TriangleMesh(vertices=np.concatenate([part.mesh.vertices[loop], sunk]), faces=faces.astype(np.int32))
    number = np.concatenate([loop, n_skin + np.arange(n)])
    closed = TriangleMesh(
        vertices=np.concatenate([part.mesh.vertices, sunk]),
        faces=np.concatenate([part.mesh.faces, number[faces].astype(np.int32)]),
    )
    return wall, closed


def _on_best_plane(
    part: OpenPart,
) -> tuple[tuple[Float64[Array, "_ 3"], ...], Float64[Array, 3], Float64[Array, "3 3"]]:
    """Loops in the frame of the plane of least squares through them, its origin and frame.

    The frame's third axis points to the side from which the skin's edge runs counter-clockwise: that of the breast.
    """
    points = part.mesh.vertices[np.concatenate(part.loops)]
    origin = points.mean(axis=0)
    frame = frame_towards(np.linalg.svd(points - origin, full_matrices=False)[2][2])
    if sum(signed_area_mm2((part.mesh.vertices[loop] - origin) @ frame[:2].T) for loop in part.loops) < 0:
        frame = frame_towards(-frame[2])
    return tuple((part.mesh.vertices[loop] - origin) @ frame.T for loop in part.loops), origin, frame
