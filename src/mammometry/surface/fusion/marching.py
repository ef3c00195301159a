"""Compiled marching cubes whose surface is always closed.

In each cube the crossings of the edges are linked face by face. Where all four edges of a face are crossed, the sign of
the bilinear field at its saddle decides which corners are connected (Nielson and Hamann 1991), so that both cubes at a
face agree. The links form loops, which are filled with triangles. The tables of all possible loops are computed once,
in plain Python. Plain NumPy version of the kernel (the crossed edges): tests/unit/surface/.
"""

import numpy as np

from mammometry.base.machine.compiled import kernel
from mammometry.geometry.arrays import Array, Bool, Float32, Float64, Int32

# Corner c of a cube is at (c >> 2, c >> 1 & 1, c & 1). Edges go from the lower to the higher corner, four each along x,
# y and z. Corners of a face are counter-clockwise seen from outside.
_EDGES = np.array([[a, a | 1 << bit] for bit in (2, 1, 0) for a in range(8) if not a & 1 << bit])
_FACES = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
_EDGE_OF = {frozenset(edge): number for number, edge in enumerate(_EDGES.tolist())}
_MOST_EDGES, _MOST_LOOPS = 12, 4  # per cube: a loop has at least three of the twelve edges


def _ambiguous(code: int) -> list[int]:
    """Faces around which the signs alternate. Bit c of the code: the field is positive at corner c."""
    return [
        f for f, (a, b, c, d) in enumerate(_FACES) if code >> a & 1 == code >> c & 1 != code >> b & 1 == code >> d & 1
    ]


def _loops(code: int, joined: set[int]) -> list[tuple[list[int], bool]]:
    """Edges of each loop in order, and whether it passes a face twice.

    `joined`: faces that connect inner corners.
    """
    following: dict[int, int] = {}
    twice = []
    for face, corners in enumerate(_FACES.tolist()):
        sides = list(zip(corners, corners[1:] + corners[:1], strict=True))
        changes = [(code >> b & 1, _EDGE_OF[frozenset((a, b))]) for a, b in sides if code >> a & 1 != code >> b & 1]
        if changes and changes[0][0]:  # start where the path around the face enters the inside
            changes = changes[1:] + changes[:1]
        enters, leaves = [edge for _, edge in changes[::2]], [edge for _, edge in changes[1::2]]
        if face in joined:
            leaves.reverse()
        following.update(zip(enters, leaves, strict=True))
        if len(enters) == 2:
            twice.append(set(enters))
    loops = []
    while following:
        edge = next(iter(following))
        loop = []
        while edge in following:
            loop.append(edge)
            edge = following.pop(edge)
        loops.append((loop, any(links <= set(loop) for links in twice)))
    return loops


def _tables() -> tuple[Int32[Array, " 256"], Int32[Array, "256 6"], Int32[Array, "r 4"], Int32[Array, "r 12"]]:
    """Tables of loops: first row of each code, its ambiguous faces (then −1), lengths and edges by row.

    The rows of a code are ordered by the faces that connect inner corners, as bits. The length of a loop that passes a
    face twice is negative.
    """
    first = np.zeros(256, dtype=np.int32)
    faces = np.full((256, 6), -1, dtype=np.int32)
    lengths: list[list[int]] = []
    edges = []
    for code in range(256):
        ambiguous = _ambiguous(code)
        first[code] = len(lengths)
        faces[code, : len(ambiguous)] = ambiguous
        for bits in range(1 << len(ambiguous)):
            loops = _loops(code, {face for n, face in enumerate(ambiguous) if bits >> n & 1})
            length = [-len(loop) if pinched else len(loop) for loop, pinched in loops]
            flat = [edge for loop, _ in loops for edge in loop]
            lengths.append(length + [0] * (_MOST_LOOPS - len(length)))
            edges.append(flat + [-1] * (_MOST_EDGES - len(flat)))
    return first, faces, np.array(lengths, dtype=np.int32), np.array(edges, dtype=np.int32)


_FIRST, _AMBIGUOUS, _LENGTHS, _LOOP_EDGES = _tables()


@kernel
def march(
    field: Float32[Array, "x y z"], cells: Bool[Array, "x1 y1 z1"]
) -> tuple[Float64[Array, "n 3"], Int32[Array, "m 3"]]:
    """Vertices and faces of the level 0 in the chosen cells.

    Vertices are in steps from the first corner. Faces are counter-clockwise seen from the positive side. No value may
    be 0: every vertex is strictly inside an edge, except the centres of loops that pass a face twice, which are inside
    their cube.
    """
    nx, ny, nz = field.shape
    vertices, vertex_count = np.empty((1024, 3)), 0
    faces, face_count = np.empty((2048, 3), dtype=np.int32), 0
    # Vertex on each edge that starts at a corner of this layer or the next, along x, y and z, from 1. 0 for none.
    numbers = np.zeros((2, ny, nz, 3), dtype=np.int32)
    positive = np.zeros((2, ny, nz), dtype=np.uint8)
    for j in range(ny):
        for k in range(nz):
            positive[1, j, k] = field[0, j, k] > 0
    around = np.empty(nz, dtype=np.uint8)
    loop = np.empty(_MOST_EDGES, dtype=np.int32)
    for i in range(nx - 1):
        for j in range(ny):
            for k in range(nz):
                positive[0, j, k], positive[1, j, k] = positive[1, j, k], field[i + 1, j, k] > 0
                for axis in range(3):
                    numbers[0, j, k, axis], numbers[1, j, k, axis] = numbers[1, j, k, axis], 0
        for j in range(ny - 1):
            for k in range(nz):
                around[k] = positive[0, j, k] + positive[0, j + 1, k] + positive[1, j, k] + positive[1, j + 1, k]
            for k in range(nz - 1):
                outside = around[k] + around[k + 1]
                if outside == 0 or outside == 8 or not cells[i, j, k]:
                    continue
                if vertex_count + _MOST_EDGES + _MOST_LOOPS > len(vertices):
                    vertices = longer(vertices)
                if face_count + _MOST_EDGES > len(faces):
                    faces = longer(faces)
                code = 0
                for corner in range(8):
                    code |= positive[corner >> 2, j + (corner >> 1 & 1), k + (corner & 1)] << corner
                row, at = _FIRST[code] + _joined(field, i, j, k, code), 0
                for number in range(_MOST_LOOPS):
                    length = abs(_LENGTHS[row, number])
                    for n in range(length):
                        edge = _LOOP_EDGES[row, at + n]
                        axis = edge // 4
                        a, b = _EDGES[edge, 0], _EDGES[edge, 1]
                        p, q, r = a >> 2, j + (a >> 1 & 1), k + (a & 1)
                        if numbers[p, q, r, axis] == 0:
                            start = np.float64(field[i + p, q, r])
                            end = np.float64(field[i + (b >> 2), j + (b >> 1 & 1), k + (b & 1)])
                            vertices[vertex_count, 0], vertices[vertex_count, 1] = i + p, q
                            vertices[vertex_count, 2] = r
                            vertices[vertex_count, axis] += start / (start - end)
                            vertex_count += 1
                            numbers[p, q, r, axis] = vertex_count
                        loop[n] = numbers[p, q, r, axis] - 1
                    at += length
                    if _LENGTHS[row, number] < 0:  # a diagonal could coincide with the neighbour's in that face
                        for axis in range(3):
                            vertices[vertex_count, axis] = 0.0
                        for n in range(length):
                            for axis in range(3):
                                vertices[vertex_count, axis] += vertices[loop[n], axis] / length
                            faces[face_count, 0] = vertex_count
                            faces[face_count, 1], faces[face_count, 2] = loop[n], loop[(n + 1) % length]
                            face_count += 1
                        vertex_count += 1
                    elif length > 0:
                        first = _best_start(vertices, loop, length) if length > 3 else 0
                        for n in range(1, length - 1):
                            faces[face_count, 0] = loop[first]
                            faces[face_count, 1] = loop[(first + n) % length]
                            faces[face_count, 2] = loop[(first + n + 1) % length]
                            face_count += 1
    return vertices[:vertex_count].copy(), faces[:face_count].copy()


@kernel
def _joined(field, i, j, k, code):  # type: ignore[no-untyped-def]
    """Ambiguous faces of a cube that connect their inner corners (their saddle is negative), as bits."""
    bits = 0
    for n in range(6):
        face = _AMBIGUOUS[code, n]
        if face < 0:
            break
        inner, outer = 1.0, 1.0
        for corner in _FACES[face]:
            value = np.float64(field[i + (corner >> 2), j + (corner >> 1 & 1), k + (corner & 1)])
            inner, outer = (inner * value, outer) if value < 0.0 else (inner, outer * value)
        if inner > outer:
            bits |= 1 << n
    return bits


@kernel
def _best_start(vertices, loop, length):  # type: ignore[no-untyped-def]
    """Index in a loop from which a fan of triangles has the shortest diagonals."""
    best, least = 0, np.inf
    for first in range(length):
        total = 0.0
        for n in range(2, length - 1):
            a, b = loop[first], loop[(first + n) % length]
            for axis in range(3):
                total += (vertices[a, axis] - vertices[b, axis]) ** 2
        if total < least:
            best, least = first, total
    return best


@kernel
def longer(rows):  # type: ignore[no-untyped-def]
    """Copy of an array with space for twice as many rows."""
    copy = np.empty((2 * len(rows), rows.shape[1]), dtype=rows.dtype)
    for row in range(len(rows)):
        for column in range(rows.shape[1]):
            copy[row, column] = rows[row, column]
    return copy


@kernel
def without_saddles(
    field: Float32[Array, "x y z"], far: Bool[Array, "x1 y1 z1"], raised: float
) -> Float32[Array, "x y z"]:
    """The field without alternating signs on faces between far and near cubes.

    On such a face fine and coarse cubes may disagree which of its four crossings are connected. The weaker of its two
    inner corners is set to `raised`, until no such face is left. Corners are never set back, so this ends.
    """
    field = field.copy()
    nx, ny, nz = far.shape
    saddles = True
    while saddles:
        saddles = False
        for i in range(nx):
            for j in range(ny):
                for k in range(nz):
                    here = far[i, j, k]
                    if i + 1 < nx and far[i + 1, j, k] != here:
                        saddles |= _raise_weaker(field[i + 1, j : j + 2, k : k + 2], raised)
                    if j + 1 < ny and far[i, j + 1, k] != here:
                        saddles |= _raise_weaker(field[i : i + 2, j + 1, k : k + 2], raised)
                    if k + 1 < nz and far[i, j, k + 1] != here:
                        saddles |= _raise_weaker(field[i : i + 2, j : j + 2, k + 1], raised)
    return field


@kernel
def _raise_weaker(face: Float32[Array, "2 2"], raised: float) -> bool:
    """Whether the signs around a face alternate. If so, the weaker inner corner is set to `raised`."""
    if (face[0, 0] > 0) != (face[1, 1] > 0) or (face[0, 1] > 0) != (face[1, 0] > 0):
        return False
    if (face[0, 0] > 0) == (face[0, 1] > 0):
        return False
    if face[0, 0] < 0:
        if face[0, 0] >= face[1, 1]:
            face[0, 0] = raised
        else:
            face[1, 1] = raised
    elif face[0, 1] >= face[1, 0]:
        face[0, 1] = raised
    else:
        face[1, 0] = raised
    return True
