"""Find dark dots on a bright surface and index them by row and column of a bent lattice."""

from __future__ import annotations

from collections import deque

import cv2
import numpy as np
from scipy.spatial import cKDTree

from mammometry.geometry.arrays import Array, Float64, Int64, UInt8

_DARKER = 20
"""Smallest darkness of a dot below its neighbourhood's mean, of 255 grey levels."""
_MIN_AREA_PX = 30
"""Smallest dot in the reduced image, px²."""
_MAX_AREA_SHARE = 5e-3
"""Largest dot, as a share of the image."""
_MIN_FILL = 0.7
"""Smallest share of its bounding box that a dot covers: a rotated or round dot has π/4, letters less."""
_NEIGHBOURS = 12
"""Nearest dots among which the next one in a direction is searched."""
_CONE_COS = 0.64
"""Cosine of the search cone: a neighbour is within 50° of the expected direction."""
_STEP_CHANGE = 1.6
"""Two consecutive steps may differ by this factor."""


def find_dots(grey: UInt8[Array, "h w"], neighbourhood: float) -> Float64[Array, "n 2"]:
    """Find compact blobs darker than their neighbourhood (side in image widths).

    Returns centroids, pixels.
    """
    height, width = grey.shape
    block = max(11, int(neighbourhood * width)) | 1
    binary = cv2.adaptiveThreshold(grey, 255, cv2.ADAPTIVE_THRESH_MEAN_C, cv2.THRESH_BINARY_INV, block, _DARKER)
    _, _, stats, centroids = cv2.connectedComponentsWithStats(binary, connectivity=4)
    x, y, w, h, area = (np.asarray(stats[:, k], np.int64) for k in range(5))
    good = (area >= _MIN_AREA_PX) & (area < _MAX_AREA_SHARE * height * width) & (area > _MIN_FILL * w * h)
    good &= (np.maximum(w, h) < 8 * np.minimum(w, h)) & (x > 0) & (y > 0) & (x + w < width) & (y + h < height)
    good[0] = False
    return np.asarray(centroids, np.float64)[good]


def index_lattice(uv: Float64[Array, "n 2"]) -> tuple[Int64[Array, " m"], Int64[Array, "m 2"]]:
    """Index the lattice from neighbour to neighbour.

    Returns the indices of the points that belong to it, and their (row, column). Rows count upwards and columns to the
    right in the image, from 0. The lattice must be upright within about 40°. Of several connected pieces the largest is
    returned.
    """
    if len(uv) < 4:
        return np.zeros(0, np.int64), np.zeros((0, 2), np.int64)
    links = _links(uv)
    best: dict[int, tuple[int, int]] = {}
    unseen = set(range(len(uv)))
    while unseen:
        piece = _walk(next(iter(unseen)), links)
        unseen -= piece.keys()
        if len(piece) > len(best):
            best = piece
    points = np.array(sorted(best), dtype=np.int64)
    places = np.array([best[point] for point in points.tolist()], dtype=np.int64)
    # Two points have the same position: indexing failed there, and neither is reliable.
    _, inverse, count = np.unique(places, axis=0, return_inverse=True, return_counts=True)
    single = count[inverse.ravel()] == 1
    points, places = points[single], places[single]
    return points, places - places.min(axis=0, initial=np.iinfo(np.int64).max)


def _links(uv: Float64[Array, "n 2"]) -> Int64[Array, "n 4"]:
    """Right, left, upper and lower neighbour of each point, −1 for none. Only mutual links."""
    found = cKDTree(uv).query(uv, k=min(_NEIGHBOURS + 1, len(uv)))
    distance, near = np.asarray(found[0])[:, 1:], np.asarray(found[1])[:, 1:]
    direction = (uv[near] - uv[:, None]) / np.maximum(distance, 1e-9)[..., None]
    links = np.full((len(uv), 4), -1, np.int64)
    for side, axis in enumerate(np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, -1.0], [0.0, 1.0]])):
        along = direction @ axis
        # Distances across the direction count more: the next dot in line is preferred.
        reach = np.where(along > _CONE_COS, distance / np.maximum(along, 1e-9), np.inf)
        choice = reach.argmin(axis=1)
        any_ahead = np.isfinite(reach[np.arange(len(uv)), choice])
        links[any_ahead, side] = near[np.arange(len(uv)), choice][any_ahead]
    for side, opposite in ((0, 1), (2, 3)):
        for there, back in ((side, opposite), (opposite, side)):
            target = links[:, there]
            mutual = (target >= 0) & (links[target, back] == np.arange(len(uv)))
            links[~mutual, there] = -1
    _drop_jumps(uv, links)
    return links


def _drop_jumps(uv: Float64[Array, "n 2"], links: Int64[Array, "n 4"]) -> None:
    """Remove links much longer than the adjacent ones in line: a dot was missed there."""
    for side, opposite in ((0, 1), (2, 3)):
        after, before = links[:, side], links[:, opposite]
        both = (after >= 0) & (before >= 0)
        forward = np.linalg.norm(uv[after] - uv, axis=1)
        backward = np.linalg.norm(uv[before] - uv, axis=1)
        for point in np.flatnonzero(both & (forward > _STEP_CHANGE * backward)):
            links[links[point, side], opposite] = -1
            links[point, side] = -1
        for point in np.flatnonzero(both & (backward > _STEP_CHANGE * forward)):
            links[links[point, opposite], side] = -1
            links[point, opposite] = -1


def _walk(start: int, links: Int64[Array, "n 4"]) -> dict[int, tuple[int, int]]:
    places = {start: (0, 0)}
    queue = deque([start])
    steps = ((0, 1), (0, -1), (1, 0), (-1, 0))
    while queue:
        point = queue.popleft()
        row, column = places[point]
        for neighbour, (up, right) in zip(links[point].tolist(), steps, strict=True):
            if neighbour >= 0 and neighbour not in places:
                places[neighbour] = (row + up, column + right)
                queue.append(neighbour)
    return places
