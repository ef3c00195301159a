"""Compiled kernels: signed distance of the solid at millions of corners, contours of silhouettes.

Plain NumPy versions: tests/unit/surface/.
"""

from typing import NamedTuple

import numpy as np

from mammometry.base.machine.compiled import kernel
from mammometry.geometry.arrays import Array, Bool, Float32, Float64, Int32, Int64
from mammometry.surface.fusion.camera_records import LEAST_DEPTH_MM, CameraRecord, in_camera, pixel, view_of
from mammometry.surface.fusion.marching import longer
from mammometry.surface.ranges.image_kernels import incidence_cosine

RULE_DEFAULT, RULE_NEAREST, RULE_FURTHEST, RULE_TSDF = 0, 1, 2, 3
"""Numbers of the rules by which views are merged."""

_LEAST_COSINE = 0.1  # 84° from the normal: with a smaller cosine every gap would shrink to nothing
_UNKNOWN_COSINE = 0.5  # cosine for a datum without a normal: 60°, as 0.5 is the mean of 0 and 1
_STEEPEST = 6.0
"""Largest slope of a continued tangent plane, mm per mm across the ray: 80°. Seen edge-on it would diverge."""
SPANNED = np.float32(1e-30)
"""Weight of a range that spans a gap: too small to count. It only bounds what was not measured."""
_DISTORTION = 1.5  # largest ratio of a block's width in the image to that of a ball around it without lens distortion


class SampleBlock(NamedTuple):
    """Corners of cubes to be sampled: side³ points from the origin (x, y, z), world frame, mm."""

    x: float
    y: float
    z: float
    side: int
    spacing: float


class ViewEvidence(NamedTuple):
    """Evidence of the views about a block's samples, accumulated view by view."""

    total: Float64[Array, " k"]
    """Weighted sum of the signed distances. With the paper's two rules, the minimum or maximum."""
    weights: Float64[Array, " k"]
    """Sum of the weights."""
    free: Bool[Array, " k"]
    """Whether a view sees through the sample."""
    supported: Bool[Array, " k"]
    """Whether the sample is on or behind a view's surface."""


@kernel
def sample_field(
    origins: Float64[Array, "n 3"],
    side: int,
    spacing: float,
    views: Float64[Array, "v 24"],
    elements: Float32[Array, "p 3"],
    contours: Float64[Array, "c 24"],
    distances: Float32[Array, " q"],
    planes: Float64[Array, "f 4"],
    truncation: float,
    jump: float,
    rule: int,
) -> Float32[Array, "n s s s"]:
    """Signed distance in n blocks, mm, positive outside, limited to ±truncation.

    The samples of a block are computed source by source. Silhouettes too far from a block to matter are skipped.

    Args:
        origins: first sample of each block, world, mm.
        side: samples along each edge of a block.
        spacing: distance between samples, mm.
        views: the range images' cameras, as rows of `camera_records.view_row`.
        elements: range, cosine of incidence and weight per pixel of every view. Weight > 0: measured. −w: extrapolated
            with weight w, without evidence of free space. `SPANNED`: spans a gap; what was not measured is free in
            front of it. 0 with a range: filled, supports only what is behind it. Range 0: nothing.
        contours: the silhouettes' cameras, likewise.
        distances: pixels from the silhouette, positive outside.
        planes: planes of the closing box: n·x − d, positive outside.
        truncation: half-width of the band within which views are averaged, mm.
        jump: difference of neighbouring ranges above which nothing is interpolated, mm.
        rule: one of ``RULE_…``.
    """
    n, samples = origins.shape[0], side * side * side
    reach = 0.5 * np.sqrt(3.0) * (side - 1) * spacing
    out = np.empty((n, samples), dtype=np.float32)
    for number in range(n):
        block = SampleBlock(origins[number, 0], origins[number, 1], origins[number, 2], side, spacing)
        bound = _bound_by_planes(planes, block, truncation)
        outside = bound.min() >= truncation
        for c in range(contours.shape[0]):
            if outside:
                break
            contour = view_of(contours[c])
            side_of_it = _side_of_silhouette(contour, distances, block, reach, truncation)
            if side_of_it > 0:
                outside = True
            elif side_of_it == 0:
                outside = _bound_by_silhouette(contour, distances, block, truncation, bound)
        if outside:
            out[number] = truncation
            continue

        evidence = ViewEvidence(
            np.zeros(samples), np.zeros(samples), np.zeros(samples, dtype=np.bool_), np.zeros(samples, dtype=np.bool_)
        )
        if rule == RULE_NEAREST:
            evidence.total[:] = np.inf
        elif rule == RULE_FURTHEST:
            evidence.total[:] = -np.inf
        for w in range(views.shape[0]):
            _add_view(view_of(views[w]), elements, block, truncation, jump, rule, evidence)
        for index in range(samples):
            measured = _merged(
                evidence.total[index],
                evidence.weights[index],
                evidence.free[index],
                evidence.supported[index],
                truncation,
                rule,
            )
            out[number, index] = min(max(bound[index], measured), truncation)
    return out.reshape(n, side, side, side)


@kernel
def _bound_by_planes(planes, block, truncation):  # type: ignore[no-untyped-def]
    """Signed distance of a block's samples from the closing box, mm. At least −truncation."""
    bound = np.empty(block.side * block.side * block.side)
    for index in range(len(bound)):
        i, j, k = index // (block.side * block.side), (index // block.side) % block.side, index % block.side
        value = -truncation
        for f in range(planes.shape[0]):
            value = max(
                value,
                planes[f, 0] * (block.x + i * block.spacing)
                + planes[f, 1] * (block.y + j * block.spacing)
                + planes[f, 2] * (block.z + k * block.spacing)
                - planes[f, 3],
            )
        bound[index] = value
    return bound


@kernel
def _merged(total: float, weight: float, free: bool, supported: bool, truncation: float, rule: int) -> float:
    """Signed distance of one sample from all views, mm. The first four parameters are its `ViewEvidence`."""
    averaged = rule in (RULE_DEFAULT, RULE_TSDF)
    if averaged and weight > 0.0:
        return total / weight
    if not averaged and np.isfinite(total):
        return total
    if not supported or (rule == RULE_DEFAULT and free):
        return truncation
    return -truncation


@kernel
def _between(image, start, width, u, v):  # type: ignore[no-untyped-def]
    """Bilinear value of a flat image at a position inside it."""
    column, row = int(u), int(v)
    du, dv = u - column, v - row
    at = start + row * width + column
    return (1.0 - dv) * ((1.0 - du) * image[at] + du * image[at + 1]) + dv * (
        (1.0 - du) * image[at + width] + du * image[at + width + 1]
    )


@kernel
def _side_of_silhouette(
    view: CameraRecord, distances: Float32[Array, " q"], block: SampleBlock, reach: float, truncation: float
) -> int:
    """Position of a block relative to a silhouette: 1 far outside, −1 far inside, 0 near it or unknown.

    `reach` is the distance from the block's centre to its corners, mm. The silhouette's distances change by at most
    one pixel per pixel.
    """
    middle = 0.5 * (block.side - 1) * block.spacing
    xc, yc, depth = in_camera(view, block.x + middle, block.y + middle, block.z + middle)
    if depth <= reach + LEAST_DEPTH_MM:
        return 0
    u, v = pixel(view, xc, yc, depth)
    radius = _DISTORTION * max(view.fx, view.fy) * reach / (depth - reach)
    if not (u >= radius and v >= radius and u + radius < view.width - 1.0 and v + radius < view.height - 1.0):
        return 0
    pixels = _between(distances, view.start, view.width, u, v)
    limit = truncation * view.fx / (depth - reach)
    if pixels - radius > limit:
        return 1
    return -1 if pixels + radius < -limit else 0


@kernel
def _bound_by_silhouette(
    view: CameraRecord,
    distances: Float32[Array, " q"],
    block: SampleBlock,
    truncation: float,
    bound: Float64[Array, " k"],
) -> bool:
    """Raise `bound` to a silhouette's distances, from px to mm by depth. Return whether all is outside."""
    u, v, depth = np.empty_like(bound), np.empty_like(bound), np.empty_like(bound)
    _project_block(view, block, u, v, depth, np.empty_like(bound))
    outside = True
    for index in range(len(bound)):
        if u[index] >= 0.0:
            pixels = _between(distances, view.start, view.width, u[index], v[index])
            bound[index] = max(bound[index], pixels * depth[index] / view.fx)
        outside = outside and bound[index] >= truncation
    return outside


@kernel
def _add_view(
    view: CameraRecord,
    elements: Float32[Array, "p 3"],
    block: SampleBlock,
    truncation: float,
    jump: float,
    rule: int,
    evidence: ViewEvidence,
) -> None:
    """Add a view's evidence about a block's samples."""
    total, weights, free, supported = evidence
    u, v, distance = np.empty_like(total), np.empty_like(total), np.empty_like(total)
    _project_block(view, block, u, v, np.empty_like(total), distance)
    for index in range(len(total)):
        if u[index] < 0.0:
            continue
        column, row = int(u[index]), int(v[index])
        du, dv = u[index] - column, v[index] - row
        at = view.start + row * view.width + column
        r00, r01 = elements[at, 0], elements[at + 1, 0]
        r10, r11 = elements[at + view.width, 0], elements[at + view.width + 1, 0]
        near = min(min(r00, r01), min(r10, r11))
        far = max(max(r00, r01), max(r10, r11))
        nearest = at + (1 if du >= 0.5 else 0) + (view.width if dv >= 0.5 else 0)
        if near > 0.0 and far - near < jump:
            seen = (1.0 - dv) * ((1.0 - du) * r00 + du * r01) + dv * ((1.0 - du) * r10 + du * r11)
        else:
            seen = np.float64(elements[nearest, 0])
        if seen <= 0.0:
            continue
        weight = elements[nearest, 2]
        gap = (seen - distance[index]) * elements[nearest, 1]
        if gap < truncation:
            supported[index] = True
        if weight == 0.0:
            continue
        if weight == SPANNED:
            free[index] = free[index] or (rule == RULE_DEFAULT and gap > 0.0)
            continue
        if rule == RULE_NEAREST:
            total[index] = min(total[index], gap)
        elif rule == RULE_FURTHEST:
            total[index] = max(total[index], gap)
        elif rule == RULE_TSDF:
            if gap > -truncation:
                total[index] += abs(weight) * min(gap, truncation)
                weights[index] += abs(weight)
        elif abs(gap) < truncation:
            total[index] += abs(weight) * gap
            weights[index] += abs(weight)
        elif gap > 0.0 and weight > 0.0:
            free[index] = True


@kernel
def _project_block(
    view: CameraRecord,
    block: SampleBlock,
    u: Float64[Array, " k"],
    v: Float64[Array, " k"],
    depth: Float64[Array, " k"],
    distance: Float64[Array, " k"],
) -> None:
    """Fill in column, row, depth and distance of a block's samples. The column is −1 outside the image."""
    side, spacing = block.side, block.spacing
    sx, sy, sz = view.rotation[2] * spacing, view.rotation[5] * spacing, view.rotation[8] * spacing
    for i in range(side):
        for j in range(side):
            x0, y0, z0 = in_camera(view, block.x + i * spacing, block.y + j * spacing, block.z)
            first = (i * side + j) * side
            for k in range(side):
                xc, yc, zc = x0 + k * sx, y0 + k * sy, z0 + k * sz
                u[first + k], v[first + k] = pixel(view, xc, yc, zc)
                depth[first + k] = zc
                distance[first + k] = np.sqrt(xc * xc + yc * yc + zc * zc)


@kernel
def empty_cells(
    points: Float64[Array, "n 3"], origin: Float64[Array, " 3"], edge_mm: float, shape: tuple[int, int, int]
) -> Bool[Array, "x y z"]:
    """Cells of a grid without any of the points. Points outside the grid are ignored."""
    empty = np.ones(shape, dtype=np.bool_)
    for point in points:
        i = int(np.floor((point[0] - origin[0]) / edge_mm))
        j = int(np.floor((point[1] - origin[1]) / edge_mm))
        k = int(np.floor((point[2] - origin[2]) / edge_mm))
        if 0 <= i < shape[0] and 0 <= j < shape[1] and 0 <= k < shape[2]:
            empty[i, j, k] = False
    return empty


@kernel
def view_elements(
    range_mm: Float32[Array, "h w"],
    valid: Bool[Array, "h w"],
    sigma_mm: Float32[Array, "h w"],
    trust: Float32[Array, "h w"],
    normals: Float32[Array, "h w 3"],
    rows: Int32[Array, "h w"],
    columns: Int32[Array, "h w"],
    subject: Bool[Array, "h w"],
    spans_mm: Float32[Array, "h w"],
    intrinsics: Float64[Array, " 4"],
    pixel_mm: float,
    extend_mm: float,
    extend_weight: float,
    sigma_floor_mm: float,
) -> Float32[Array, "h w 3"]:
    """Values of a range image at each pixel, for `sample_field`. See `field.view_elements`.

    `normals`: camera frame. `rows`, `columns`: the nearest datum with a normal, −1 if there is none. `spans_mm`: from
    `image_kernels.spans`.
    """
    height, width = valid.shape
    elements = np.zeros((height, width, 3), dtype=np.float32)
    for row in range(height):
        y = (row - intrinsics[3]) / intrinsics[1]
        for column in range(width):
            x = (column - intrinsics[2]) / intrinsics[0]
            i, j = rows[row, column], columns[row, column]
            if valid[row, column]:
                cosine = _clipped(incidence_cosine(normals[row, column], x, y))
                variance = sigma_mm[row, column] ** 2 + sigma_floor_mm**2
                elements[row, column, 0] = range_mm[row, column]
                elements[row, column, 1] = cosine
                elements[row, column, 2] = cosine**2 * trust[row, column] / variance
            elif subject[row, column] and i >= 0:
                normal, nearest = normals[i, j], np.float64(range_mm[i, j])
                own = incidence_cosine(normal, (j - intrinsics[2]) / intrinsics[0], (i - intrinsics[3]) / intrinsics[1])
                cosine = _clipped(own)
                seen, weight = nearest, 0.0
                pixels = np.sqrt(float((i - row) ** 2 + (j - column) ** 2))
                if pixels * pixel_mm <= extend_mm:
                    here = incidence_cosine(normal, x, y)
                    continued = nearest * own / here if here != 0.0 else nearest
                    reach = _STEEPEST * pixel_mm * pixels
                    seen = min(max(continued if continued > 0.0 else nearest, nearest - reach), nearest + reach)
                    variance = sigma_mm[i, j] ** 2 + sigma_floor_mm**2
                    weight = -extend_weight * cosine**2 * trust[i, j] / variance
                if spans_mm[row, column] > 0.0:
                    seen, weight = np.float64(spans_mm[row, column]), np.float64(SPANNED)
                elements[row, column, 0] = seen
                elements[row, column, 1] = cosine
                elements[row, column, 2] = weight
    return elements


@kernel
def _clipped(cosine):  # type: ignore[no-untyped-def]
    return min(max(cosine, _LEAST_COSINE), 1.0) if np.isfinite(cosine) else _UNKNOWN_COSINE


# For each of the 16 cases of a square's corners: up to two pieces of the contour, as the sides where each enters and
# leaves, with the subject always on the same side. −1 for none.
_TOP, _RIGHT, _BOTTOM, _LEFT, _NONE = 0, 1, 2, 3, -1
_PIECES = np.array(
    [
        [_NONE, _NONE, _NONE, _NONE],
        [_TOP, _LEFT, _NONE, _NONE],
        [_RIGHT, _TOP, _NONE, _NONE],
        [_RIGHT, _LEFT, _NONE, _NONE],
        [_LEFT, _BOTTOM, _NONE, _NONE],
        [_TOP, _BOTTOM, _NONE, _NONE],
        [_RIGHT, _TOP, _LEFT, _BOTTOM],
        [_RIGHT, _BOTTOM, _NONE, _NONE],
        [_BOTTOM, _RIGHT, _NONE, _NONE],
        [_TOP, _LEFT, _BOTTOM, _RIGHT],
        [_BOTTOM, _TOP, _NONE, _NONE],
        [_BOTTOM, _LEFT, _NONE, _NONE],
        [_LEFT, _RIGHT, _NONE, _NONE],
        [_TOP, _RIGHT, _NONE, _NONE],
        [_LEFT, _TOP, _NONE, _NONE],
        [_NONE, _NONE, _NONE, _NONE],
    ]
)


@kernel
def contour_pieces(
    coverage: Float32[Array, "h w"], window: Int64[Array, " 4"], holes: Bool[Array, "H W"], step: int, level: float
) -> tuple[Float64[Array, "n 2"], Float64[Array, "n 2"]]:
    """Straight pieces of the contours at a level.

    One or two in each square of four pixels that they cross. Row and column of each piece's start, and the vector to
    its end, in steps from the window's first pixel. Like skimage.measure.find_contours, but unordered.

    Args:
        coverage: coverage of each pixel.
        window: first and last row (plus one), first and last column (plus one).
        holes: holes at every `step`-th pixel of the window: pixels next to them count as covered.
        step: pixels per step.
        level: level of the contour.
    """
    starts, steps = np.empty((1024, 2)), np.empty((1024, 2))
    count = 0
    sides = np.empty((4, 2))
    for row in range(window[1] - window[0] - 1):
        for column in range(window[3] - window[2] - 1):
            upper_left = coverage[window[0] + row, window[2] + column]
            upper_right = coverage[window[0] + row, window[2] + column + 1]
            lower_left = coverage[window[0] + row + 1, window[2] + column]
            lower_right = coverage[window[0] + row + 1, window[2] + column + 1]
            case = _case(upper_left, upper_right, lower_left, lower_right, level)
            if case == 15:
                continue
            if holes[row // step, column // step]:
                upper_left = np.float32(1.0)
            if holes[row // step, (column + 1) // step]:
                upper_right = np.float32(1.0)
            if holes[(row + 1) // step, column // step]:
                lower_left = np.float32(1.0)
            if holes[(row + 1) // step, (column + 1) // step]:
                lower_right = np.float32(1.0)
            case = _case(upper_left, upper_right, lower_left, lower_right, level)
            sides[_TOP, 0], sides[_TOP, 1] = row, column + _share(upper_left, upper_right, level)
            sides[_BOTTOM, 0], sides[_BOTTOM, 1] = row + 1, column + _share(lower_left, lower_right, level)
            sides[_LEFT, 0], sides[_LEFT, 1] = row + _share(upper_left, lower_left, level), column
            sides[_RIGHT, 0], sides[_RIGHT, 1] = row + _share(upper_right, lower_right, level), column + 1
            for piece in range(2):
                start, end = _PIECES[case, 2 * piece], _PIECES[case, 2 * piece + 1]
                if start < 0 or (sides[start, 0] == sides[end, 0] and sides[start, 1] == sides[end, 1]):
                    continue
                if count == len(starts):
                    starts, steps = longer(starts), longer(steps)
                for axis in range(2):
                    starts[count, axis] = sides[start, axis] / step
                    steps[count, axis] = sides[end, axis] / step - sides[start, axis] / step
                count += 1
    return starts[:count].copy(), steps[:count].copy()


@kernel
def _case(upper_left, upper_right, lower_left, lower_right, level):  # type: ignore[no-untyped-def]
    case = 0
    if upper_left > level:
        case += 1
    if upper_right > level:
        case += 2
    if lower_left > level:
        case += 4
    if lower_right > level:
        case += 8
    return case


@kernel
def _share(start, end, level):  # type: ignore[no-untyped-def]
    """Fraction of the distance between two values at which the level is reached."""
    if end == start:
        return 0.0
    return (level - np.float64(start)) / (np.float64(end) - np.float64(start))
