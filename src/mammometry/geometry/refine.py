"""Split edges of a mesh and their faces without opening gaps."""

from __future__ import annotations

import numpy as np

from mammometry.geometry.arrays import Array, Bool, Int32, Int64

_CORNERS = np.arange(3)


def edge_table(faces: Int32[Array, "m 3"]) -> tuple[Int64[Array, "e 2"], Int64[Array, "m 3"]]:
    """Unique edges, and the numbers of each face's three edges.

    Each edge has its smaller index first. A face's edges are 0–1, 1–2 and 2–0.
    """
    directed = np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1).astype(np.int64)
    directed.sort(axis=-1)
    count = int(faces.max()) + 1
    keys, number = np.unique(directed[..., 0] * count + directed[..., 1], return_inverse=True)
    return np.stack(np.divmod(keys, count), axis=1), number.reshape(-1, 3)


def split_edges(
    faces: Int32[Array, "m 3"], edges_of_face: Int64[Array, "m 3"], split: Bool[Array, " e"], first_new: int
) -> Int32[Array, "k 3"]:
    """Split the marked edges at one new vertex each. Each face at them becomes two, three or four.

    Args:
        faces: vertex indices.
        edges_of_face: as `edge_table` numbers them.
        split: which edges.
        first_new: index of the first marked edge's new vertex; the others' follow in order.
    """
    new_vertex = np.full(len(split), -1, dtype=np.int64)
    new_vertex[split] = first_new + np.arange(int(split.sum()))
    middle = new_vertex[edges_of_face]
    marked = middle >= 0
    count = marked.sum(axis=1)
    parts = [faces[count == 0].astype(np.int64)]
    # Turned such that with one marked edge it is the first, and with two the last is not.
    turn = np.where(count == 1, marked.argmax(axis=1), (np.argmin(marked, axis=1) + 1) % 3)
    order = (turn[:, None] + _CORNERS) % 3
    corner = np.take_along_axis(faces.astype(np.int64), order, axis=1)
    middle = np.take_along_axis(middle, order, axis=1)
    one, two, three = count == 1, count == 2, count == 3
    a, b, c = corner[one].T
    m = middle[one, 0]
    parts += [np.stack([a, m, c], axis=1), np.stack([m, b, c], axis=1)]
    a, b, c = corner[two].T
    m, n = middle[two, 0], middle[two, 1]
    parts += [np.stack([m, b, n], axis=1), np.stack([a, m, n], axis=1), np.stack([a, n, c], axis=1)]
    a, b, c = corner[three].T
    m, n, o = middle[three].T
    parts += [np.stack(part, axis=1) for part in ((a, m, o), (m, b, n), (n, c, o), (m, n, o))]
    return np.concatenate(parts).astype(np.int32)
