"""What cameras or a body that moved leave unknown of a volume.

To first order a skin that lies off by u changes the volume by ∫ n·u over it. What moves the boundary along changes
nothing, since the wall moves, too: the rigid motion of the boundary is taken off u.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mammometry.geometry import Array, Float64, Int32, Rig, TriangleMesh
from mammometry.geometry.nearest import point_tree
from mammometry.surface.motion.motion_test import Stillness
from mammometry.surface.motion.rigid_motion import effects, rigid_motions
from mammometry.surface.repair.repair import RepairedSurface

_SAMPLES = 2000  # vertices of the skin at which displacements are computed; chosen for speed
_ALIKE_MM = 40.0
"""Distance within which the motion that is not rigid is alike, mm: breathing lifts whole parts of a chest. Chosen by
eye."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Movement:
    """What moved, and the rig that measured."""

    found: Stillness
    rig: Rig
    """The cameras where they were taken to stand."""


def movement_of(found: Stillness, rig: Rig) -> Movement | None:
    """Motion between calibration and exposures. None if nothing moved."""
    return Movement(found=found, rig=rig) if found.moved else None


def movement_std_cc(
    movement: Movement, skin: TriangleMesh, boundary_world: Float64[Array, "n 3"], surface: RepairedSurface
) -> float:
    """Standard deviation of a volume by what the motions leave unknown, cc.

    Args:
        movement: of the capture.
        skin: the breast's own, mm, world frame.
        boundary_world: the curve around it.
        surface: the whole repaired surface, which knows what pairs measured each vertex.
    """
    found = movement.found
    area_mm2 = np.zeros(len(skin.vertices))
    for corner in range(3):
        np.add.at(area_mm2, skin.faces[:, corner], np.linalg.norm(skin.face_vectors(), axis=1) / 3)
    some = slice(None, None, max(1, len(skin.vertices) // _SAMPLES))
    points, normals, weights = skin.vertices[some], skin.vertex_normals()[some], area_mm2[some]
    weights = weights * (area_mm2.sum() / weights.sum())
    own, around = (_displacements(movement, array, surface) for array in (points, boundary_world))
    centre = boundary_world.mean(axis=0)
    motion_parameters = around.shape[2]
    rigid = np.linalg.lstsq(
        rigid_motions(boundary_world - centre).reshape(-1, 6), around.reshape(-1, motion_parameters), rcond=None
    )[0]
    own = own - rigid_motions(points - centre) @ rigid
    gradient = np.einsum("n,ni,nip->p", weights, normals, own)
    whole_mm2 = float(area_mm2.sum())
    alike_mm2 = min(np.pi * _ALIKE_MM**2, whole_mm2)
    rest_mm3 = found.rest_mm / np.sqrt(2) * np.sqrt(whole_mm2 * alike_mm2)
    return float(np.hypot(np.sqrt(gradient @ found.covariance @ gradient), rest_mm3)) / 1000


def _displacements(
    movement: Movement, points: Float64[Array, "n 3"], surface: RepairedSurface
) -> Float64[Array, "n 3 p"]:
    """Displacement of surface points by a unit of each unknown. Mean of the pairs that measured there."""
    bits = _measured_by(points, surface)
    total = np.zeros((len(points), 3, movement.found.parameters.count))
    count = np.zeros(len(points))
    for number, pair in enumerate(surface.pair_names):
        seen = (bits >> number & 1).astype(bool)
        if seen.any() and any(pair in group for group in movement.found.parameters.groups):
            total[seen] += effects(movement.rig, pair, points[seen], movement.found.parameters).points_mm
            count[seen] += 1
    shared: Float64[Array, "n 3 p"] = total / np.maximum(count, 1)[:, None, None]
    return shared


def _measured_by(points: Float64[Array, "n 3"], surface: RepairedSurface) -> Int32[Array, " n"]:
    """Pairs that measured the nearest vertex which some pair measured."""
    known = np.flatnonzero(surface.pair_bits)
    if not len(known):
        return np.zeros(len(points), dtype=np.int32)
    nearest = np.asarray(point_tree(surface.mesh.vertices[known]).query(points, workers=1)[1])
    return np.asarray(surface.pair_bits[known[nearest]])
