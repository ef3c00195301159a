"""Robust means of rigid transforms, and node poses of a graph.

The poses come from the relative poses along its edges.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations

import numpy as np
from scipy.spatial.transform import Rotation

from mammometry.geometry.transform import Transform

_SWEEPS = 5
"""Sweeps of medians over poses and cameras. Chosen by eye."""
_AGREE_RAD, _AGREE_SHARE = 0.05, 0.1  # first intrinsics may be off by some per cent; another pose's picture is far off


def median_transform(transforms: Sequence[Transform]) -> Transform:
    """Rotation and translation nearest to all others (medoids).

    Up to half of the transforms may be arbitrarily wrong; exactly half only if the others agree.
    """
    if len(transforms) == 1:
        return transforms[0]
    matrices = np.stack([transform.rotation for transform in transforms])
    cosine = (np.einsum("aij,bij->ab", matrices, matrices) - 1) / 2
    rotation = matrices[int(np.arccos(np.clip(cosine, -1, 1)).sum(axis=1).argmin())]
    shifts = np.stack([transform.translation_mm for transform in transforms])
    translation_mm = shifts[int(np.linalg.norm(shifts[:, None] - shifts[None], axis=2).sum(axis=1).argmin())]
    return Transform(rotation=rotation, translation_mm=translation_mm)


def components(views: Sequence[tuple[str, str]]) -> list[tuple[set[str], set[str]]]:
    """Group cameras and poses that are connected by views (camera, pose).

    The group with most cameras first.
    """
    groups: list[tuple[set[str], set[str]]] = []
    for camera, pose in views:
        touched = [group for group in groups if camera in group[0] or pose in group[1]]
        merged: tuple[set[str], set[str]] = ({camera}, {pose})
        for group in touched:
            merged[0].update(group[0])
            merged[1].update(group[1])
            groups.remove(group)
        groups.append(merged)
    return sorted(groups, key=lambda group: (-len(group[0]), -len(group[1]), min(group[0])))


def average_network(
    camera_from_target: Mapping[tuple[str, str], Transform],
) -> tuple[dict[str, Transform], dict[str, Transform]]:
    """Compute poses of all cameras and targets from each view's own estimate.

    Views must be connected. A spanning tree over the cameras whose relative poses agree in most poses, each edge their
    median, then sweeps of medians over poses and cameras. Frame of the results: the world is the target in the first
    pose, in name order.

    Returns:
        camera → camera_from_world, and pose → world_from_target.
    """
    cameras = sorted({camera for camera, _ in camera_from_target})
    poses = sorted({pose for _, pose in camera_from_target})
    cameras_from_rig = _spanning_tree(cameras, camera_from_target)
    rig_from_targets: dict[str, Transform] = {}
    for _ in range(_SWEEPS):
        for pose in poses:
            seen = [camera for camera in cameras if (camera, pose) in camera_from_target]
            rig_from_targets[pose] = median_transform(
                [cameras_from_rig[camera].inverse() @ camera_from_target[camera, pose] for camera in seen]
            )
        for camera in cameras:
            seen = [pose for pose in poses if (camera, pose) in camera_from_target]
            cameras_from_rig[camera] = median_transform(
                [camera_from_target[camera, pose] @ rig_from_targets[pose].inverse() for pose in seen]
            )
    rig_from_world = rig_from_targets[poses[0]]
    world_from_rig = rig_from_world.inverse()
    return (
        {camera: camera_from_rig @ rig_from_world for camera, camera_from_rig in cameras_from_rig.items()},
        {pose: world_from_rig @ rig_from_target for pose, rig_from_target in rig_from_targets.items()},
    )


def _spanning_tree(
    cameras: Sequence[str], camera_from_target: Mapping[tuple[str, str], Transform]
) -> dict[str, Transform]:
    """Find camera → camera_from_rig, the rig's frame being one camera's.

    By what most poses agree on first (Prim).
    """
    edges: dict[tuple[str, str], tuple[int, Transform]] = {}
    for camera_pair, other in combinations(cameras, 2):
        relative = [
            placed @ camera_from_target[camera_pair, pose].inverse()
            for (camera, pose), placed in camera_from_target.items()
            if camera == other and (camera_pair, pose) in camera_from_target
        ]
        if relative:
            other_from_one = median_transform(relative)
            agreeing = sum(_agree(motion, other_from_one) for motion in relative)
            edges[camera_pair, other] = agreeing, other_from_one
            edges[other, camera_pair] = agreeing, other_from_one.inverse()
    root = max(edges, key=lambda edge: edges[edge][0])[0] if edges else cameras[0]
    found = {root: Transform.identity()}
    while len(found) < len(cameras):
        onwards = [edge for edge in edges if edge[0] in found and edge[1] not in found]
        if not onwards:
            raise ValueError(f"no pose leads to {sorted(set(cameras) - set(found))}")
        known, camera = max(onwards, key=lambda edge: edges[edge][0])
        found[camera] = edges[known, camera][1] @ found[known]
    return found


def _agree(one: Transform, other: Transform) -> bool:
    between = one @ other.inverse()
    turn_rad = float(np.linalg.norm(Rotation.from_matrix(between.rotation).as_rotvec()))
    shift_mm = float(np.linalg.norm(one.translation_mm - other.translation_mm))
    return turn_rad < _AGREE_RAD and shift_mm < _AGREE_SHARE * float(np.linalg.norm(other.translation_mm))
