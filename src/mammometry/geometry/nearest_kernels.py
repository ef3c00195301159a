"""Compiled searches for the nearest triangle. The NumPy version is in tests/unit/geometry/."""

from __future__ import annotations

import numpy as np

from mammometry.base.machine.compiled import kernel
from mammometry.geometry.arrays import Array, Float64, Int32, Int64

IN_A_LEAF = 4  # faces; affects speed only
"""Triangles in a leaf of the tree."""


@kernel
def faces_in_box(
    vertices: Float64[Array, "n 3"], faces: Int32[Array, "m 3"], low: Float64[Array, " 3"], high: Float64[Array, " 3"]
) -> Int64[Array, " k"]:
    """Indices of the faces whose bounding boxes intersect a box."""
    meets = np.zeros(len(faces), dtype=np.bool_)
    count = 0
    for face in range(len(faces)):
        inside = True
        for axis in range(3):
            a, b, c = vertices[faces[face, 0], axis], vertices[faces[face, 1], axis], vertices[faces[face, 2], axis]
            inside = inside and min(a, b, c) <= high[axis] and max(a, b, c) >= low[axis]
        meets[face] = inside
        count += inside
    found = np.empty(count, dtype=np.int64)
    count = 0
    for face in range(len(faces)):
        if meets[face]:
            found[count] = face
            count += 1
    return found


@kernel
def morton(corners: Float64[Array, "m 3 3"], bits: int) -> Int64[Array, " m"]:
    """Position of each face's centroid along the Morton curve, which keeps neighbours together.

    `bits` of each coordinate are used.
    """
    middles, low, high = np.empty((len(corners), 3)), np.full(3, np.inf), 0.0
    for face in range(len(corners)):
        for axis in range(3):
            middles[face, axis] = (corners[face, 0, axis] + corners[face, 1, axis] + corners[face, 2, axis]) / 3
            low[axis] = min(low[axis], middles[face, axis])
    for face in range(len(corners)):
        for axis in range(3):
            high = max(high, middles[face, axis] - low[axis])
    code = np.zeros(len(corners), dtype=np.int64)
    for face in range(len(corners)):
        for axis in range(3):
            cell = int((middles[face, axis] - low[axis]) / max(high, 1e-300) * (2**bits - 1))
            for bit in range(bits):
                code[face] |= ((cell >> bit) & 1) << (3 * bit + axis)
    return code


@kernel
def boxes(corners: Float64[Array, "m 3 3"]) -> tuple[Float64[Array, "k 3"], Float64[Array, "k 3"]]:
    """Bounding boxes of a complete binary tree.

    Node i has the children 2 i + 1 and 2 i + 2. The leaves contain the faces. Empty boxes are at infinite distance.
    """
    width = 1
    while width * IN_A_LEAF < len(corners):
        width *= 2
    low, high = np.full((2 * width - 1, 3), np.inf), np.full((2 * width - 1, 3), -np.inf)
    for face in range(len(corners)):
        node = width - 1 + face // IN_A_LEAF
        for corner in range(3):
            for axis in range(3):
                low[node, axis] = min(low[node, axis], corners[face, corner, axis])
                high[node, axis] = max(high[node, axis], corners[face, corner, axis])
    for node in range(width - 2, -1, -1):
        for axis in range(3):
            low[node, axis] = min(low[2 * node + 1, axis], low[2 * node + 2, axis])
            high[node, axis] = max(high[2 * node + 1, axis], high[2 * node + 2, axis])
    return low, high


@kernel
def search(
    points: Float64[Array, "n 3"],
    corners: Float64[Array, "m 3 3"],
    low: Float64[Array, "k 3"],
    high: Float64[Array, "k 3"],
) -> Int64[Array, " n"]:
    """Index of each point's nearest triangle."""
    found = np.zeros(len(points), dtype=np.int64)
    first_leaf = len(low) // 2
    nodes, gaps = np.empty(64, dtype=np.int64), np.empty(64)
    face = 0
    for query in range(len(points)):
        point = points[query]
        best = _squared_distance(point, corners[face])
        nodes[0], gaps[0], waiting = 0, 0.0, 1
        while waiting:
            waiting -= 1
            node = nodes[waiting]
            if gaps[waiting] >= best:
                continue
            if node >= first_leaf:
                first = (node - first_leaf) * IN_A_LEAF
                for candidate in range(first, min(first + IN_A_LEAF, len(corners))):
                    squared = _squared_distance(point, corners[candidate])
                    if squared < best:
                        best, face = squared, candidate
                continue
            near, far = 2 * node + 1, 2 * node + 2
            near_gap, far_gap = _squared_gap(point, low[near], high[near]), _squared_gap(point, low[far], high[far])
            if far_gap < near_gap:
                near, far, near_gap, far_gap = far, near, far_gap, near_gap
            if far_gap < best:
                nodes[waiting], gaps[waiting] = far, far_gap
                waiting += 1
            if near_gap < best:
                nodes[waiting], gaps[waiting] = near, near_gap
                waiting += 1
        found[query] = face
    return found


@kernel
def scan(points: Float64[Array, "n 3"], corners: Float64[Array, "m 3 3"]) -> Int64[Array, " n"]:
    """Index of each point's nearest triangle, by exhaustive search."""
    found = np.zeros(len(points), dtype=np.int64)
    for query in range(len(points)):
        best = np.inf
        for candidate in range(len(corners)):
            squared = _squared_distance(points[query], corners[candidate])
            if squared < best:
                best, found[query] = squared, candidate
    return found


@kernel
def _squared_gap(point: Float64[Array, 3], low: Float64[Array, 3], high: Float64[Array, 3]) -> float:
    """Squared distance from a point to a box, mm². 0 inside."""
    total = 0.0
    for axis in range(3):
        gap = max(low[axis] - point[axis], point[axis] - high[axis], 0.0)
        total += gap * gap
    return total


@kernel
def _squared_distance(point: Float64[Array, 3], triangle: Float64[Array, "3 3"]) -> float:
    """Squared distance from a point to a triangle, mm²: `closest_on_triangles` for a single point."""
    d1, d2, d3, d4, d5, d6 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for axis in range(3):
        a, b, c, p = triangle[0, axis], triangle[1, axis], triangle[2, axis], point[axis]
        d1 += (b - a) * (p - a)
        d2 += (c - a) * (p - a)
        d3 += (b - a) * (p - b)
        d4 += (c - a) * (p - b)
        d5 += (b - a) * (p - c)
        d6 += (c - a) * (p - c)
    va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
    v, w = 0.0, 0.0  # the nearest point is a + v (b − a) + w (c − a)
    if d1 <= 0 and d2 <= 0:
        pass
    elif d3 >= 0 and d4 <= d3:
        v = 1.0
    elif d6 >= 0 and d5 <= d6:
        w = 1.0
    elif vc <= 0 and d1 >= 0 and d3 <= 0:
        v = d1 / (d1 - d3) if d1 != d3 else 0.0
    elif vb <= 0 and d2 >= 0 and d6 <= 0:
        w = d2 / (d2 - d6) if d2 != d6 else 0.0
    elif va <= 0 and d4 >= d3 and d5 >= d6:
        w = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        v = 1.0 - w
    elif va + vb + vc > 0:
        v, w = vb / (va + vb + vc), vc / (va + vb + vc)
    total = 0.0
    for axis in range(3):
        a, b, c = triangle[0, axis], triangle[1, axis], triangle[2, axis]
        gap = point[axis] - (a + v * (b - a) + w * (c - a))
        total += gap * gap
    return total
