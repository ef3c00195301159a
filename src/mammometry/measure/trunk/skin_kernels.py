"""Compiled laying flat of the skin around a trunk.

Plain NumPy twins stand in tests/unit/measure/test_skin_kernels.py.
"""

import numpy as np

from mammometry.base.machine.compiled import kernel
from mammometry.geometry.arrays import Array, Float64, Int32, Int64


@kernel
def innermost(
    points: Float64[Array, "n 3"],
    frame: Float64[Array, "3 3"],
    origin: Float64[Array, " 3"],
    radius: Float64[Array, "p q"],
    limits: Float64[Array, " 4"],
    pixel_mm: float,
    size: Int64[Array, " 2"],
) -> Float64[Array, "h w"]:
    """Least bulge in each pixel, mm. ∞ without a point.

    Args:
        points: skin, mm, world frame.
        frame: rows: the patient's left, the head, straight ahead.
        origin: a point of the trunk's axis.
        radius: coefficients of the trunk's radius, mm: row d belongs to the d-th power of height over the window's,
            the columns to 1, cos θ, sin θ, cos 2θ, sin 2θ, …
        limits: half width of the trunk, half width and half height of the picture, distance aside at which an arm
            begins; all in mm.
        pixel_mm: side of a pixel.
        size: rows and columns of the picture.
    """
    half_width, width, height, arm = limits
    found = np.full((size[0], size[1]), np.inf)
    for n in range(len(points)):
        dx, dy, dz = points[n, 0] - origin[0], points[n, 1] - origin[1], points[n, 2] - origin[2]
        aside = frame[0, 0] * dx + frame[0, 1] * dy + frame[0, 2] * dz
        up = frame[1, 0] * dx + frame[1, 1] * dy + frame[1, 2] * dz
        ahead = frame[2, 0] * dx + frame[2, 1] * dy + frame[2, 2] * dz
        if abs(up) >= height or abs(aside) >= arm:
            continue
        arc = half_width * np.arctan2(aside, ahead)
        if abs(arc) >= width:
            continue
        away = np.hypot(aside, ahead)
        cosine, sine = (ahead / away, aside / away) if away > 0.0 else (1.0, 0.0)
        trunk, power = 0.0, 1.0
        for d in range(len(radius)):
            along, c, s = radius[d, 0], 1.0, 0.0
            for k in range(1, radius.shape[1], 2):
                c, s = c * cosine - s * sine, s * cosine + c * sine
                along += radius[d, k] * c + radius[d, k + 1] * s
            trunk += power * along
            power *= up / height
        row, column = int(np.rint((up + height) / pixel_mm)), int(np.rint((arc + width) / pixel_mm))
        found[row, column] = min(found[row, column], away - trunk)
    return found


@kernel
def longest_sides(vertices: Float64[Array, "n 3"], faces: Int32[Array, "m 3"], every: int) -> Float64[Array, " k"]:
    """Longest side of every so many-th face, mm."""
    longest = np.zeros((len(faces) + every - 1) // every)
    for face in range(len(longest)):
        for corner in range(3):
            a, b = faces[face * every, corner], faces[face * every, (corner + 1) % 3]
            dx, dy, dz = (
                vertices[a, 0] - vertices[b, 0],
                vertices[a, 1] - vertices[b, 1],
                vertices[a, 2] - vertices[b, 2],
            )
            longest[face] = max(longest[face], np.sqrt(dx * dx + dy * dy + dz * dz))
    return longest


@kernel
def middles_of_parts(
    vertices: Float64[Array, "n 3"], faces: Int32[Array, "m 3"], every: int, parts: Int64[Array, " k"]
) -> Float64[Array, "s 3"]:
    """Middles of the n² equal parts of every so many-th face.

    Args:
        vertices: mm.
        faces: corners.
        every: step through the faces.
        parts: n, for each of the faces taken.
    """
    count = 0
    for face in range(len(parts)):
        count += parts[face] * parts[face]
    middles = np.empty((count, 3))
    count = 0
    for face in range(len(parts)):
        n = parts[face]
        a, b, c = faces[face * every, 0], faces[face * every, 1], faces[face * every, 2]
        for i in range(n):
            for j in range(n - i):
                for turned in range(2):
                    if turned and i + j >= n - 1:
                        continue
                    u, v = (i + (1 + turned) / 3) / n, (j + (1 + turned) / 3) / n
                    for axis in range(3):
                        start = vertices[a, axis]
                        middles[count, axis] = start + u * (vertices[b, axis] - start) + v * (vertices[c, axis] - start)
                    count += 1
    return middles
