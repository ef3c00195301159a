"""The skin flattened around the trunk, as a relief over the thorax without breasts.

Where a breast hangs over its fold there are several layers, of which the innermost is used. The relief then jumps back
to the chest along the fold, so that the fold is a crease of the map whether the breast hangs over it or not.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import (
    distance_transform_edt,
    gaussian_filter,
    gaussian_laplace,
    grey_opening,
    label,
    map_coordinates,
)

from mammometry.base.errors import MeasureError
from mammometry.base.machine.compiled import kernel
from mammometry.base.machine.cores import in_bands
from mammometry.base.value import value
from mammometry.geometry import Array, Bool, Float64, Int32, Int64, TriangleMesh
from mammometry.measure.trunk.thorax import ARM, AROUND, HEIGHT_WINDOW_MM, WIDEST_DEG, Thorax, Trunk


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
        limits: half width of the trunk, half width and half height of the map, distance to the side at which an arm
            begins; all in mm.
        pixel_mm: side of a pixel.
        size: rows and columns of the map.
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
    """Longest side of every ``every``-th face, mm."""
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
    """Centroids of the n² equal parts of every ``every``-th face, mm.

    Args:
        vertices: mm.
        faces: corners.
        every: step through the faces.
        parts: n, for each of these faces.
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


PIXEL_MM = 2.0  # side of a pixel, half of the scale of creases
_SPECK = 3  # pixels; smaller spots of an outer layer are removed
_FINEST_MM = 0.75 * PIXEL_MM  # spacing of samples on the skin, so that no pixel is missed
_MOST_SAMPLES = 1_000_000  # most samples of the skin; chosen for memory
KNOWN_MM = 5.0  # a pixel is known if there is visible skin within this distance; not critical
_EDGE_MM = 13.0  # margin at the end of the visible skin: three times the 4 mm scale of creases, and a pixel
_JUMP_MM, _JUMP_REACH = 10.0, 20
"""Least rise of the bulge between pixels at the edge of an arm, mm, and number of pixels of trunk after which such a
rise is ignored: an arm's edge is near the trunk's side, an equally steep flank of a breast near the midline."""
_RISE_MM = 6.0  # largest rise of skin that continues to the side, as at a border (`boundary.crease`)
_STEEP_MM = 60.0  # cap on the bulge; not critical


@value(eq=False)
class Relief:
    """Bulge of the innermost skin over a grid (half width × θ, y) in mm."""

    low: Float64[Array, 2]
    """Position of the first pixel's centre, mm."""
    bulge_mm: Float64[Array, "h w"]
    """Height over the thorax. Rows go to the head, columns to the patient's left. Gaps have the nearest value."""
    known: Bool[Array, "h w"]
    """Whether there is visible skin within `KNOWN_MM`."""
    arm: Bool[Array, "h w"]
    """Whether there is an arm, connected to the shoulder, and no skin of the trunk."""

    def smooth_mm(self, sigma_mm: float) -> Float64[Array, "h w"]:
        """The bulge, Gaussian-smoothed, mm."""
        smoothed: Float64[Array, "h w"] = gaussian_filter(self.bulge_mm, sigma_mm / PIXEL_MM)
        return smoothed

    def concavity_per_mm(self, sigma_mm: float) -> Float64[Array, "h w"]:
        """Laplacian of the smoothed bulge, 1/mm, positive in a valley (twice the mean curvature).

        Zero where no skin is visible and near the outer end of the visible skin, where it depends on the filling.
        """
        shallow = np.minimum(self.bulge_mm, _STEEP_MM)  # so that the height of a breast does not deepen its fold
        laplacian = gaussian_laplace(shallow, sigma_mm / PIXEL_MM) / PIXEL_MM**2
        return np.where(self.known, laplacian * self.within_its_end(_EDGE_MM), 0.0)

    def within_its_end(self, reach_mm: float) -> Float64[Array, "h w"]:
        """Ramp from 0 at the outer end of the visible skin to 1 at `reach_mm` inwards."""
        around = np.pad(~self.known, 1, constant_values=True)
        parts, _ = label(around)
        away_mm = distance_transform_edt(parts != parts[0, 0])[1:-1, 1:-1] * PIXEL_MM
        return np.clip((away_mm - KNOWN_MM) / (reach_mm - KNOWN_MM), 0.0, 1.0)

    def at(self, flat: Float64[Array, "*n 2"], values: Float64[Array, "h w"]) -> Float64[Array, "*n"]:
        """A map sampled bilinearly at (half width × θ, y), mm, beyond its edge the nearest value."""
        column, row = np.moveaxis((flat - self.low) / PIXEL_MM, -1, 0)
        sampled: Float64[Array, "*n"] = map_coordinates(values, [row, column], order=1, mode="nearest")
        return sampled

    def within(self, flat: Float64[Array, "*n 2"]) -> Bool[Array, "*n"]:
        """Mask of the positions inside the map."""
        column, row = np.moveaxis((flat - self.low) / PIXEL_MM, -1, 0)
        height, width = self.bulge_mm.shape
        return np.asarray((column >= 0) & (row >= 0) & (column <= width - 1) & (row <= height - 1))


def lay_flat(thorax: Thorax, points_world: Float64[Array, "n 3"]) -> Relief:
    """Relief of the skin around the trunk, without arms.

    Args:
        thorax: the trunk without breasts.
        points_world: samples of the skin (`dense_samples`), mm, world frame.

    Raises:
        MeasureError: there is no skin.
    """
    trunk = thorax.trunk
    width, height = np.deg2rad(WIDEST_DEG) * trunk.half_width_mm, HEIGHT_WINDOW_MM
    low = np.array([-width, -height])
    size = np.array([int(2 * height / PIXEL_MM) + 2, int(2 * width / PIXEL_MM) + 2])
    limits = np.array([trunk.half_width_mm, width, height, ARM * trunk.half_width_mm])
    radius = thorax.coefficients.reshape(-1, AROUND)

    def of_band(band: slice) -> Float64[Array, "h w"]:
        found: Float64[Array, "h w"] = innermost(
            points_world[band], trunk.frame, trunk.origin, radius, limits, PIXEL_MM, size
        )
        return found

    inner = np.min(in_bands(of_band, len(points_world)), axis=0)
    aside = points_world[np.abs((points_world - trunk.origin) @ trunk.frame[0]) >= limits[3]]
    if len(aside):
        limits = np.array([*limits[:3], np.inf])
        beyond = innermost(aside, trunk.frame, trunk.origin, radius, limits, PIXEL_MM, size)
        inner = np.where(_continues(inner, beyond), beyond, inner)
    known = np.isfinite(inner)
    if not known.any():
        raise MeasureError(
            "torso",
            found="no skin around the trunk",
            expected="the trunk's front and sides",
            remedy="Check the rig",
            mesh_remedy="Check --head and --ahead",
        )
    away, nearest = distance_transform_edt(~known, return_indices=True)
    seen = np.asarray(away * PIXEL_MM < KNOWN_MM)
    # A few pixels under an overhang may have samples of its outer layer only.
    bulge_mm = grey_opening(inner[tuple(nearest)], size=(_SPECK, _SPECK))
    return Relief(low=low, bulge_mm=bulge_mm, known=seen, arm=_arms(trunk, points_world, low, ~seen))


def _continues(inner: Float64[Array, "h w"], beyond: Float64[Array, "h w"]) -> Bool[Array, "h w"]:
    """Mask of the pixels beyond the trunk's side in which a breast's skin is seen.

    A large breast extends beyond the trunk's side. At each height its skin continues the trunk's outwards without
    rising, and the trunk's flank is seen outside it. An arm rises from the trunk, is not connected with it at that
    height, or hides it, so that the bulge jumps at its edge. Skin in a remaining hole also belongs to the breast.

    Args:
        inner: bulge of the skin up to the trunk's side, mm, ∞ where none is visible.
        beyond: the same for skin farther to the side.
    """
    trunk, arm = np.isfinite(inner), np.isfinite(beyond) & ~np.isfinite(inner)
    continued = np.zeros(inner.shape, dtype=bool)
    half = inner.shape[1] // 2
    for columns in (range(half, inner.shape[1]), range(half - 1, -1, -1)):
        lowest, missed = np.full(len(inner), -np.inf), np.zeros(len(inner), dtype=np.int64)
        since_jump = np.full(len(inner), _JUMP_REACH)
        for column in columns:
            jumped = trunk[:, column] & (inner[:, column] > lowest + _JUMP_MM) & np.isfinite(lowest)
            since_jump = np.where(jumped, 0, since_jump + trunk[:, column])
            own = arm[:, column] & (beyond[:, column] <= lowest + _RISE_MM) & (since_jump >= _JUMP_REACH)
            continued[:, column] = own
            lowest = np.where(trunk[:, column], inner[:, column], lowest)
            lowest = np.where(own, np.minimum(lowest, beyond[:, column]), lowest)
            missed = np.where(trunk[:, column] | own, 0, missed + 1)
            lowest = np.where(missed > _SPECK, -np.inf, lowest)
        flank_outside = np.zeros(len(inner), dtype=bool)
        for column in reversed(columns):
            flank_outside = np.where(arm[:, column] & ~continued[:, column], False, flank_outside | trunk[:, column])
            continued[:, column] &= flank_outside
    parts, _ = label(~(trunk | continued))
    outer = np.unique(np.concatenate([parts[0], parts[-1], parts[:, 0], parts[:, -1]]))
    return continued | (arm & ~np.isin(parts, np.append(outer, 0)))


def _arms(
    trunk: Trunk, points_world: Float64[Array, "n 3"], low: Float64[Array, 2], unseen: Bool[Array, "h w"]
) -> Bool[Array, "h w"]:
    """Mask of the pixels in or next to an arm, where no skin of the trunk is visible.

    An arm comes from the shoulder, above the map. Other skin as far to the side belongs to a breast that has fallen
    sideways.

    Args:
        trunk: coordinates of the map.
        points_world: samples of the skin, mm.
        low: (half width × θ, y) of the first pixel's centre, mm.
        unseen: pixels without visible skin of the trunk.
    """
    aside = np.abs((points_world - trunk.origin) @ trunk.frame[0]) >= ARM * trunk.half_width_mm
    column, row = np.rint((trunk.cylindrical(points_world[aside])[:, :2] - low) / PIXEL_MM).astype(np.int64).T
    height, width = unseen.shape
    there = (column >= 0) & (row >= 0) & (column < width) & (row < height)
    if not there.any():
        return np.zeros_like(unseen)
    away = np.ones(unseen.shape)
    away[row[there], column[there]] = 0.0
    parts, _ = label(unseen & (distance_transform_edt(away) * PIXEL_MM < KNOWN_MM))
    return np.isin(parts, np.setdiff1d(parts[-1], 0))


def dense_samples(mesh: TriangleMesh) -> Float64[Array, "n 3"]:
    """Points on all faces, at most about 1.5 mm apart, also on coarse meshes.

    A face with longest edge l is divided into ⌈l/spacing⌉² equal parts, each of which gives its centroid.
    """
    every = max(1, len(mesh.faces) // _MOST_SAMPLES)
    longest = longest_sides(mesh.vertices, mesh.faces, every)
    spacing = max(_FINEST_MM, float(np.sqrt((longest**2).sum() / _MOST_SAMPLES)))
    parts = np.maximum(np.ceil(longest / spacing).astype(np.int64), 1)
    samples: Float64[Array, "n 3"] = middles_of_parts(mesh.vertices, mesh.faces, every, parts)
    return samples
