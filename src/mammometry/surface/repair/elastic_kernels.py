"""Compiled kernels of the elastic repair: neighbours, rings, conjugate gradients, plausible points.

Plain NumPy versions: tests/unit/surface/.
"""

import numpy as np

from mammometry.base.machine.compiled import kernel
from mammometry.geometry.arrays import Array, Bool, Float32, Float64, Int32, Int64

_STEPS = 6  # most steps of the walk to the nearest datum; it ends earlier when the datum does not change


@kernel
def adjacency(n: int, edges: Int32[Array, "e 2"]) -> tuple[Int64[Array, " n1"], Int32[Array, " k"]]:
    """Neighbours of each vertex in ascending order, as (indptr, indices). Edges may be repeated."""
    start = np.zeros(n + 1, dtype=np.int64)
    for edge in range(len(edges)):
        start[edges[edge, 0] + 1] += 1
        start[edges[edge, 1] + 1] += 1
    for vertex in range(n):
        start[vertex + 1] += start[vertex]
    at = start[:-1].copy()
    all_of_them = np.empty(start[n], dtype=np.int32)
    for edge in range(len(edges)):
        a, b = edges[edge, 0], edges[edge, 1]
        all_of_them[at[a]] = b
        all_of_them[at[b]] = a
        at[a] += 1
        at[b] += 1
    kept = 0
    first = 0
    for vertex in range(n):
        last = start[vertex + 1]
        row = all_of_them[first:last]
        first = last
        for i in range(1, len(row)):  # about a dozen: insertion sort is fastest
            value, j = row[i], i - 1
            while j >= 0 and row[j] > value:
                row[j + 1] = row[j]
                j -= 1
            row[j + 1] = value
        start[vertex] = kept
        for i in range(len(row)):
            if i == 0 or row[i] != row[i - 1]:
                all_of_them[kept] = row[i]
                kept += 1
    start[n] = kept
    return start, all_of_them[:kept].copy()


@kernel
def propagate(
    indptr: Int64[Array, " n1"],
    indices: Int32[Array, " k"],
    vertices: Float64[Array, "n 3"],
    values: Float64[Array, "n c"],
    away_mm: Float64[Array, " n"],
    known: Int64[Array, " q"],
) -> None:
    """Fill `values` and `away_mm` (infinite: unknown) ring by ring, in place (see `repair.propagate`)."""
    frontier = known
    width = values.shape[1]
    while len(frontier) > 0:
        room = 0
        for vertex in frontier:
            room += indptr[vertex + 1] - indptr[vertex]
        fresh = np.empty(room, dtype=np.int64)
        count = 0
        for vertex in frontier:
            for entry in range(indptr[vertex], indptr[vertex + 1]):
                neighbour = indices[entry]
                if np.isinf(away_mm[neighbour]):
                    away_mm[neighbour] = -1.0  # in the ring that is being filled
                    fresh[count] = neighbour
                    count += 1
        fresh = fresh[:count]
        away = np.empty(count)
        for i in range(count):
            vertex = fresh[i]
            nearest, total = np.inf, 0
            for entry in range(indptr[vertex], indptr[vertex + 1]):
                neighbour = indices[entry]
                if away_mm[neighbour] < 0.0 or np.isinf(away_mm[neighbour]):
                    continue
                total += 1
                for column in range(width):
                    values[vertex, column] += values[neighbour, column]
                step = np.sqrt(
                    (vertices[vertex, 0] - vertices[neighbour, 0]) ** 2
                    + (vertices[vertex, 1] - vertices[neighbour, 1]) ** 2
                    + (vertices[vertex, 2] - vertices[neighbour, 2]) ** 2
                )
                nearest = min(nearest, away_mm[neighbour] + step)
            for column in range(width):
                values[vertex, column] /= total
            away[i] = nearest
        for i in range(count):
            away_mm[fresh[i]] = away[i]
        frontier = fresh


@kernel
def minimised(
    indptr: Int64[Array, " n1"],
    indices: Int32[Array, " k"],
    external: Float32[Array, " n"],
    internal: float,
    targets: Float32[Array, "n 3"],
    start: Float32[Array, "n 3"],
    tolerance: float,
    most: int,
) -> tuple[Float32[Array, "n 3"], int]:
    """Solve (Ω + internal · L) δ = Ω targets by conjugate gradients. Returns δ and iterations.

    Preconditioned by the diagonal. Ω = diag(external); the graph Laplacian L is never stored. Stops when every
    coordinate's residual is below `tolerance` times the norm of its right side.
    """
    n = len(external)
    stiffness = np.float32(internal)
    x = start.copy()
    residual = np.empty((n, 3), dtype=np.float32)
    direction = np.empty((n, 3), dtype=np.float32)
    image = np.empty((n, 3), dtype=np.float32)
    inverse = np.empty(n, dtype=np.float32)
    goal0, goal1, goal2 = 0.0, 0.0, 0.0
    rz0, rz1, rz2 = 0.0, 0.0, 0.0
    rr0, rr1, rr2 = 0.0, 0.0, 0.0
    for i in range(n):
        weight = external[i] + stiffness * np.float32(indptr[i + 1] - indptr[i])
        inverse[i] = np.float32(1.0) / weight
        s0, s1, s2 = np.float32(0), np.float32(0), np.float32(0)
        for entry in range(indptr[i], indptr[i + 1]):
            j = indices[entry]
            s0 += x[j, 0]
            s1 += x[j, 1]
            s2 += x[j, 2]
        b0, b1, b2 = external[i] * targets[i, 0], external[i] * targets[i, 1], external[i] * targets[i, 2]
        r0 = b0 - weight * x[i, 0] + stiffness * s0
        r1 = b1 - weight * x[i, 1] + stiffness * s1
        r2 = b2 - weight * x[i, 2] + stiffness * s2
        residual[i, 0], residual[i, 1], residual[i, 2] = r0, r1, r2
        direction[i, 0], direction[i, 1], direction[i, 2] = inverse[i] * r0, inverse[i] * r1, inverse[i] * r2
        goal0 += np.float64(b0) * b0
        goal1 += np.float64(b1) * b1
        goal2 += np.float64(b2) * b2
        rr0 += np.float64(r0) * r0
        rr1 += np.float64(r1) * r1
        rr2 += np.float64(r2) * r2
        rz0 += np.float64(r0) * direction[i, 0]
        rz1 += np.float64(r1) * direction[i, 1]
        rz2 += np.float64(r2) * direction[i, 2]
    limit = tolerance * tolerance
    goal0, goal1, goal2 = max(goal0, 1e-24) * limit, max(goal1, 1e-24) * limit, max(goal2, 1e-24) * limit
    for iteration in range(most):
        if rr0 <= goal0 and rr1 <= goal1 and rr2 <= goal2:
            return x, iteration
        c0, c1, c2 = 0.0, 0.0, 0.0
        for i in range(n):
            weight = external[i] + stiffness * np.float32(indptr[i + 1] - indptr[i])
            s0, s1, s2 = np.float32(0), np.float32(0), np.float32(0)
            for entry in range(indptr[i], indptr[i + 1]):
                j = indices[entry]
                s0 += direction[j, 0]
                s1 += direction[j, 1]
                s2 += direction[j, 2]
            s0 = weight * direction[i, 0] - stiffness * s0
            s1 = weight * direction[i, 1] - stiffness * s1
            s2 = weight * direction[i, 2] - stiffness * s2
            image[i, 0], image[i, 1], image[i, 2] = s0, s1, s2
            c0 += np.float64(s0) * direction[i, 0]
            c1 += np.float64(s1) * direction[i, 1]
            c2 += np.float64(s2) * direction[i, 2]
        a0 = np.float32(rz0 / c0 if c0 > 0.0 else 0.0)
        a1 = np.float32(rz1 / c1 if c1 > 0.0 else 0.0)
        a2 = np.float32(rz2 / c2 if c2 > 0.0 else 0.0)
        rr0, rr1, rr2 = 0.0, 0.0, 0.0
        n0, n1, n2 = 0.0, 0.0, 0.0
        for i in range(n):
            x[i, 0] += a0 * direction[i, 0]
            x[i, 1] += a1 * direction[i, 1]
            x[i, 2] += a2 * direction[i, 2]
            r0 = residual[i, 0] - a0 * image[i, 0]
            r1 = residual[i, 1] - a1 * image[i, 1]
            r2 = residual[i, 2] - a2 * image[i, 2]
            residual[i, 0], residual[i, 1], residual[i, 2] = r0, r1, r2
            rr0 += np.float64(r0) * r0
            rr1 += np.float64(r1) * r1
            rr2 += np.float64(r2) * r2
            n0 += np.float64(r0) * inverse[i] * r0
            n1 += np.float64(r1) * inverse[i] * r1
            n2 += np.float64(r2) * inverse[i] * r2
        b0 = np.float32(n0 / rz0 if rz0 > 0.0 else 0.0)
        b1 = np.float32(n1 / rz1 if rz1 > 0.0 else 0.0)
        b2 = np.float32(n2 / rz2 if rz2 > 0.0 else 0.0)
        rz0, rz1, rz2 = n0, n1, n2
        for i in range(n):
            direction[i, 0] = inverse[i] * residual[i, 0] + b0 * direction[i, 0]
            direction[i, 1] = inverse[i] * residual[i, 1] + b1 * direction[i, 1]
            direction[i, 2] = inverse[i] * residual[i, 2] + b2 * direction[i, 2]
    return x, most


@kernel
def feet(
    vertices: Float64[Array, "n 3"],
    rotation: Float64[Array, "3 3"],
    translation: Float64[Array, " 3"],
    intrinsics: Float64[Array, " 4"],
    points: Float32[Array, "h w 3"],
    normals: Float32[Array, "h w 3"],
    rows: Int32[Array, "h w"],
    columns: Int32[Array, "h w"],
    reach_mm: float,
) -> Int64[Array, " n"]:
    """Flat index of the datum nearest to each vertex, to within a datum's spacing. −1 if there is none.

    The search starts at the datum under the vertex (or nearest to that pixel: `rows`, `columns`) and steps to the datum
    under the vertex's foot on the tangent plane, until it does not change. `points` and `normals` are in the camera's
    frame, NaN without a datum.
    """
    height, width = rows.shape
    found = np.full(len(vertices), -1, dtype=np.int64)
    for i in range(len(vertices)):
        x, y, z = vertices[i, 0], vertices[i, 1], vertices[i, 2]
        vx = rotation[0, 0] * x + rotation[0, 1] * y + rotation[0, 2] * z + translation[0]
        vy = rotation[1, 0] * x + rotation[1, 1] * y + rotation[1, 2] * z + translation[1]
        vz = rotation[2, 0] * x + rotation[2, 1] * y + rotation[2, 2] * z + translation[2]
        fx, fy, fz = vx, vy, vz
        best, nearest = np.int64(-1), reach_mm * reach_mm
        for _ in range(_STEPS):
            if not fz > 0.0:
                break
            u = intrinsics[0] * fx / fz + intrinsics[2]
            v = intrinsics[1] * fy / fz + intrinsics[3]
            if not (u > -0.5 and v > -0.5 and u < width - 0.5 and v < height - 0.5):
                break
            column, row = int(np.rint(u)), int(np.rint(v))
            row, column = rows[row, column], columns[row, column]
            if row < 0:
                break
            dx, dy, dz = vx - points[row, column, 0], vy - points[row, column, 1], vz - points[row, column, 2]
            distance2 = dx * dx + dy * dy + dz * dz
            at = row * width + column
            if at == best or not distance2 < (nearest if best >= 0 else 16.0 * nearest):
                break
            best, nearest = at, distance2
            height_mm = dx * normals[row, column, 0] + dy * normals[row, column, 1] + dz * normals[row, column, 2]
            fx = vx - height_mm * normals[row, column, 0]
            fy = vy - height_mm * normals[row, column, 1]
            fz = vz - height_mm * normals[row, column, 2]
        if best >= 0 and nearest <= reach_mm * reach_mm:
            found[i] = best
    return found


@kernel
def turned_over(
    vertices: Float64[Array, "n 3"], moved: Float64[Array, "n 3"], faces: Int32[Array, "m 3"]
) -> Bool[Array, " m"]:
    """Mask of the faces whose normals turn by more than 90° when the vertices move."""
    turned = np.zeros(len(faces), dtype=np.bool_)
    for face in range(len(faces)):
        a, b, c = faces[face, 0], faces[face, 1], faces[face, 2]
        turned[face] = _alignment(vertices, moved, a, b, c) < 0.0
    return turned


@kernel
def _alignment(vertices, moved, a, b, c):  # type: ignore[no-untyped-def]
    ux, uy, uz = vertices[b, 0] - vertices[a, 0], vertices[b, 1] - vertices[a, 1], vertices[b, 2] - vertices[a, 2]
    vx, vy, vz = vertices[c, 0] - vertices[a, 0], vertices[c, 1] - vertices[a, 1], vertices[c, 2] - vertices[a, 2]
    px, py, pz = moved[b, 0] - moved[a, 0], moved[b, 1] - moved[a, 1], moved[b, 2] - moved[a, 2]
    qx, qy, qz = moved[c, 0] - moved[a, 0], moved[c, 1] - moved[a, 1], moved[c, 2] - moved[a, 2]
    return (
        (uy * vz - uz * vy) * (py * qz - pz * qy)
        + (uz * vx - ux * vz) * (pz * qx - px * qz)
        + (ux * vy - uy * vx) * (px * qy - py * qx)
    )
