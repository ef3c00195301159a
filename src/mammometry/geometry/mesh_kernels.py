"""Compiled kernels for triangle meshes and their rasterisation.

The equivalent NumPy code is in tests/unit/geometry/. For `nearest_faces`, it is a ray caster.
"""

import numpy as np

from mammometry.base.machine.compiled import kernel
from mammometry.geometry.arrays import Array, Bool, Float32, Float64, Int32, Int64


@kernel
def area_vectors(vertices: Float64[Array, "n 3"], faces: Int32[Array, "m 3"]) -> Float64[Array, "m 3"]:
    """Normals of the faces (right-hand rule) whose length is the face's area."""
    result = np.empty((len(faces), 3))
    for face in range(len(faces)):
        a, b, c = faces[face, 0], faces[face, 1], faces[face, 2]
        ux, uy, uz = (
            vertices[b, 0] - vertices[a, 0], vertices[b, 1] - vertices[a, 1], vertices[b, 2] - vertices[a, 2],
        )  # fmt: skip
        vx, vy, vz = (
            vertices[c, 0] - vertices[a, 0], vertices[c, 1] - vertices[a, 1], vertices[c, 2] - vertices[a, 2],
        )  # fmt: skip
        result[face, 0] = 0.5 * (uy * vz - uz * vy)
        result[face, 1] = 0.5 * (uz * vx - ux * vz)
        result[face, 2] = 0.5 * (ux * vy - uy * vx)
    return result


@kernel
def vertex_normals(n: int, faces: Int32[Array, "m 3"], vectors: Float64[Array, "m 3"]) -> Float64[Array, "n 3"]:
    """Unit sum of the faces' vectors at each of n vertices. Zero without a face."""
    normals = np.zeros((n, 3))
    for face in range(len(faces)):
        for corner in range(3):
            vertex = faces[face, corner]
            for axis in range(3):
                normals[vertex, axis] += vectors[face, axis]
    for vertex in range(n):
        length = np.sqrt(normals[vertex, 0] ** 2 + normals[vertex, 1] ** 2 + normals[vertex, 2] ** 2)
        if length > 0.0:
            for axis in range(3):
                normals[vertex, axis] /= length
    return normals


@kernel
def angle_defects(vertices: Float64[Array, "n 3"], faces: Int32[Array, "m 3"]) -> Float64[Array, " n"]:
    """Angle defect of each vertex (integrated curvature): 2π minus its faces' angles, rad."""
    defects = np.full(len(vertices), 2 * np.pi)
    for face in range(len(faces)):
        for corner in range(3):
            a, b, c = faces[face, corner], faces[face, (corner + 1) % 3], faces[face, (corner + 2) % 3]
            ux, uy, uz = (
                vertices[b, 0] - vertices[a, 0], vertices[b, 1] - vertices[a, 1], vertices[b, 2] - vertices[a, 2],
            )  # fmt: skip
            vx, vy, vz = (
                vertices[c, 0] - vertices[a, 0], vertices[c, 1] - vertices[a, 1], vertices[c, 2] - vertices[a, 2],
            )  # fmt: skip
            x, y, z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
            defects[a] -= np.arctan2(np.sqrt(x * x + y * y + z * z), ux * vx + uy * vy + uz * vz)
    return defects


@kernel
def open_vertices(n: int, faces: Int32[Array, "m 3"]) -> Bool[Array, " n"]:
    """Mask of the n vertices at which a half-edge without an opposite ends.

    For each half-edge, the hash of its end is added to its start, and the hash of its start is subtracted from its end.
    A half-edge and its opposite cancel.
    """
    balance = np.zeros(n, dtype=np.uint64)
    for face in range(len(faces)):
        for corner in range(3):
            start, end = faces[face, corner], faces[face, (corner + 1) % 3]
            balance[start] += _scrambled(end)
            balance[end] -= _scrambled(start)
    return balance != 0


@kernel
def _scrambled(number):  # type: ignore[no-untyped-def]
    """Hash of a number by splitmix64 (Steele, Lea and Flood). Sums collide with a probability of 1 in 2⁶⁴."""
    x = np.uint64(number) + np.uint64(0x9E3779B97F4A7C15)
    x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return x ^ (x >> np.uint64(31))


@kernel
def parts(n: int, faces: Int32[Array, "m 3"]) -> tuple[int, Int32[Array, " n"]]:
    """Number of connected components, and the component of each vertex, in the order of first vertices."""
    root = np.arange(n).astype(np.int32)
    for face in range(len(faces)):
        a = _root(root, faces[face, 0])
        for corner in (1, 2):
            b = _root(root, faces[face, corner])
            if a < b:
                root[b] = a
            elif b < a:
                root[a] = b
                a = b
    count = 0
    for vertex in range(n):  # a root is the smallest vertex of its component
        if root[vertex] == vertex:
            root[vertex] = -count - 1
            count += 1
        else:
            above = root[vertex]
            while above >= 0:
                above = root[above]
            root[vertex] = above
    return count, (-root - 1).astype(np.int32)


@kernel
def edge_rings(n: int, faces: Int32[Array, "m 3"]) -> Int32[Array, " h"]:
    """Next half-edge on the same edge, for each half-edge. Together they form a ring.

    Half-edge 3 f + k goes from corner k of face f to the next corner. The only half-edge on an edge points to itself.
    """
    sides = 3 * len(faces)
    first = np.zeros(n + 1, dtype=np.int32)  # start of the half-edges grouped by smaller corner
    for face in range(len(faces)):
        for corner in range(3):
            first[min(faces[face, corner], faces[face, (corner + 1) % 3]) + 1] += 1
    for vertex in range(n):
        first[vertex + 1] += first[vertex]
    place = first.copy()
    of_vertex, other = np.empty(sides, dtype=np.int32), np.empty(sides, dtype=np.int32)
    for face in range(len(faces)):
        for corner in range(3):
            a, b = faces[face, corner], faces[face, (corner + 1) % 3]
            at = place[min(a, b)]
            place[min(a, b)] += 1
            of_vertex[at], other[at] = 3 * face + corner, max(a, b)
    rings = np.arange(sides).astype(np.int32)
    for vertex in range(n):
        for at in range(first[vertex], first[vertex + 1]):
            beginning = at
            for before in range(first[vertex], at):  # the first half-edge closes the ring
                if other[before] == other[at]:
                    beginning = before
                    break
            following = first[vertex + 1]
            for later in range(at + 1, first[vertex + 1]):
                if other[later] == other[at]:
                    following = later
                    break
            rings[of_vertex[at]] = of_vertex[beginning if following == first[vertex + 1] else following]
    return rings


@kernel
def face_parts(rings: Int32[Array, " h"], walls: Bool[Array, " h"]) -> tuple[int, Int32[Array, " m"]]:
    """Number of parts, and the part of each face. Parts are joined across edges that are not walls.

    Parts are numbered in the order of their first faces.

    Args:
        rings: result of `edge_rings`.
        walls: whether each half-edge is on a wall.
    """
    part = np.full(len(rings) // 3, -1).astype(np.int32)
    waiting = np.empty(len(part), dtype=np.int32)
    count = 0
    for seed in range(len(part)):
        if part[seed] >= 0:
            continue
        part[seed], waiting[0], left = count, seed, 1
        while left:
            left -= 1
            face = waiting[left]
            for side in range(3 * face, 3 * face + 3):
                across = side if walls[side] else rings[side]
                while across != side:
                    if part[across // 3] < 0:
                        part[across // 3] = count
                        waiting[left] = across // 3
                        left += 1
                    across = rings[across]
        count += 1
    return count, part


@kernel
def part_volumes(
    vertices: Float64[Array, "n 3"], faces: Int32[Array, "m 3"], part: Int32[Array, " n"], count: int
) -> Float64[Array, " c"]:
    """Signed volume of each closed component, with coordinates relative to the first vertex."""
    volumes = np.zeros(count)
    for face in range(len(faces)):
        a, b, c = vertices[faces[face, 0]], vertices[faces[face, 1]], vertices[faces[face, 2]]
        ux, uy, uz = a[0] - vertices[0, 0], a[1] - vertices[0, 1], a[2] - vertices[0, 2]
        vx, vy, vz = b[0] - vertices[0, 0], b[1] - vertices[0, 1], b[2] - vertices[0, 2]
        wx, wy, wz = c[0] - vertices[0, 0], c[1] - vertices[0, 1], c[2] - vertices[0, 2]
        six = ux * (vy * wz - vz * wy) + uy * (vz * wx - vx * wz) + uz * (vx * wy - vy * wx)
        volumes[part[faces[face, 0]]] += six / 6.0
    return volumes


@kernel
def volume(vertices: Float64[Array, "n 3"], faces: Int32[Array, "m 3"], origin: Float64[Array, "3"]) -> float:
    """Signed volume of a closed mesh, with coordinates relative to an origin."""
    six = 0.0
    for face in range(len(faces)):
        a, b, c = faces[face, 0], faces[face, 1], faces[face, 2]
        ux, uy, uz = vertices[a, 0] - origin[0], vertices[a, 1] - origin[1], vertices[a, 2] - origin[2]
        vx, vy, vz = vertices[b, 0] - origin[0], vertices[b, 1] - origin[1], vertices[b, 2] - origin[2]
        wx, wy, wz = vertices[c, 0] - origin[0], vertices[c, 1] - origin[1], vertices[c, 2] - origin[2]
        six += ux * (vy * wz - vz * wy) + uy * (vz * wx - vx * wz) + uz * (vx * wy - vy * wx)
    return six / 6.0


@kernel
def _root(root: Int32[Array, " n"], vertex: int) -> int:
    while root[vertex] != vertex:
        root[vertex] = root[root[vertex]]
        vertex = root[vertex]
    return vertex


_SLACK = 1e-9
"""Tolerance of a barycentric weight, so that no pixel falls between two adjacent faces."""


@kernel
def nearest_faces(
    corners: Float64[Array, "n 3"], faces: Int32[Array, "m 3"], height: int, width: int
) -> tuple[Int32[Array, "h w"], Float32[Array, "h w 3"], Float32[Array, "h w"]]:
    """Face at each pixel's centre, the weights of its corners, and its position towards the viewer.

    `corners` has column, row and position towards the viewer of every vertex. The first pixel's centre is at 0, 0.
    Both sides of a face are visible. Without a face: index −1 and position −∞.
    """
    nearest = np.full((height, width), -1, dtype=np.int32)
    weights = np.zeros((height, width, 3), dtype=np.float32)
    towards = np.full((height, width), -np.inf, dtype=np.float32)
    for face in range(len(faces)):
        a, b, c = corners[faces[face, 0]], corners[faces[face, 1]], corners[faces[face, 2]]
        first, last = max(np.ceil(min(a[1], b[1], c[1])), 0.0), min(np.floor(max(a[1], b[1], c[1])), height - 1.0)
        left, right = max(np.ceil(min(a[0], b[0], c[0])), 0.0), min(np.floor(max(a[0], b[0], c[0])), width - 1.0)
        area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        if area == 0.0 or first > last or left > right:
            continue
        for row in range(int(first), int(last) + 1):
            for column in range(int(left), int(right) + 1):
                of_b = ((column - a[0]) * (c[1] - a[1]) - (row - a[1]) * (c[0] - a[0])) / area
                of_c = ((b[0] - a[0]) * (row - a[1]) - (b[1] - a[1]) * (column - a[0])) / area
                of_a = 1.0 - of_b - of_c
                if of_a < -_SLACK or of_b < -_SLACK or of_c < -_SLACK:
                    continue
                height_mm = of_a * a[2] + of_b * b[2] + of_c * c[2]
                if height_mm > towards[row, column]:
                    towards[row, column] = height_mm
                    nearest[row, column] = face
                    weights[row, column, 0] = of_a
                    weights[row, column, 1] = of_b
                    weights[row, column, 2] = of_c
    return nearest, weights, towards


@kernel
def extent(mask: Bool[Array, "h w"]) -> Int64[Array, " 4"]:
    """First row, end row, first and end column (ends exclusive) of the true pixels. Zeros without any."""
    height, width = mask.shape
    box = np.zeros(4, dtype=np.int64)
    left, right = width, 0
    for row in range(height):
        first = 0
        while first < width and not mask[row, first]:
            first += 1
        if first == width:
            continue
        last = width - 1
        while last >= right and not mask[row, last]:
            last -= 1
        if right == 0:
            box[0] = row
        box[1] = row + 1
        left, right = min(left, first), max(right, last + 1)
    if right > 0:
        box[2], box[3] = left, right
    return box
