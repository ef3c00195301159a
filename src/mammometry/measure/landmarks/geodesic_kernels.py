"""Compiled shortest paths over a surface. Reference in the tests: SciPy's Dijkstra."""

from heapq import heappop, heappush

import numpy as np

from mammometry.base.machine.compiled import kernel
from mammometry.geometry.arrays import Array, Float64, Int64


@kernel
def shortest(
    places: Float64[Array, "n 3"], of_face: Int64[Array, "m c"], start: int, stop: int, slack: float, more_mm: float
) -> tuple[Float64[Array, " n"], Int64[Array, " n"]]:
    """Lengths of shortest paths from one place to the others, and each place's predecessor (A*).

    Lengths are exact for places on any path from start to stop of at most `slack` times the shortest length plus
    `more_mm`. The straight distance to `stop` is the lower bound.

    Args:
        places: points on the surface, mm.
        of_face: indices of the places in each face, which are joined to one another; negative: none.
        start: index of the first place.
        stop: index of the last place.
        slack: a factor, 1 or more.
        more_mm: at least 0.

    Returns:
        Lengths, mm: exact where promised above, elsewhere too long or ∞. Predecessors, −1 for none.
    """
    n, (m, c) = len(places), of_face.shape
    first = np.zeros(n + 1, dtype=np.int64)
    for face in range(m):
        for k in range(c):
            if of_face[face, k] >= 0:
                first[of_face[face, k] + 1] += 1
    first = np.cumsum(first)
    faces_at, filled = np.empty(first[-1], dtype=np.int64), first.copy()
    for face in range(m):
        for k in range(c):
            place = of_face[face, k]
            if place >= 0:
                faces_at[filled[place]] = face
                filled[place] += 1
    length, before = np.full(n, np.inf), np.full(n, -1, dtype=np.int64)
    length[start] = 0.0
    heap, most = [(0.0, 0.0, start)], np.inf
    while len(heap):
        whole, travelled, place = heappop(heap)
        if whole > most:
            break
        if travelled > length[place]:
            continue
        if place == stop:
            most = travelled * slack + more_mm
        for face in faces_at[first[place] : first[place + 1]]:
            for k in range(c):
                other = of_face[face, k]
                if other < 0 or length[other] <= travelled:
                    continue
                longer = travelled + _distance(places, place, other)
                if longer < length[other]:
                    length[other], before[other] = longer, place
                    heappush(heap, (longer + _distance(places, other, stop), longer, other))
    return length, before


@kernel
def _distance(places: Float64[Array, "n 3"], one: int, other: int) -> float:
    x, y, z = places[one, 0] - places[other, 0], places[one, 1] - places[other, 1], places[one, 2] - places[other, 2]
    return np.sqrt(x * x + y * y + z * z)
