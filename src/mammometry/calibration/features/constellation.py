"""Identify an image's dots as points of a surveyed target, by their positions only.

Three neighbouring dots and three neighbouring points give two scaled orthographic cameras (Alter 1994). Each is tested
on the surrounding points. The best are grown into perspective cameras, point by point. The camera that explains most
dots is chosen. If another explains nearly as many differently, the image is ambiguous and both are returned.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from mammometry.calibration.features.pixels import MIN_POINTS
from mammometry.geometry.arrays import Array, Bool, Float64, Int64

_NEAREST = 8
"""Neighbours of a point that may complete its triple."""
_SEEDS = 6
"""Dots from which triples are started."""
_AROUND = 12
"""Points around the triple on which a start is tested."""
_GROWN = 8
"""Starts grown for each seed."""
_FOCAL_WIDTHS = (1.4, 3.2)
"""Initial focal lengths, in image widths. Each converges from half to twice its value."""
_LOOSE, _TIGHT = 0.35, 0.12
"""Largest distance of a dot from its predicted position, in distances between neighbouring dots: at first, and at
last."""
_FITTING = 0.015
"""Largest median distance of a reading's dots from their prediction, in distances between neighbouring dots. A target
with inverted relief would fit to about a twentieth."""
_ROUNDS = 5
"""Rounds of growing. Each matches twice as many points around the start as the one before. The last uses the strict
limit."""
_STEPS = 12
"""Most Gauss–Newton steps of one adjustment."""
_FOCAL_PRIOR, _LENS_PRIOR = 0.7, 0.5
"""Standard deviations of the focal length's logarithm about its start, and of the radial term about 0."""
_LEAST_SHARE = 0.65
"""Smallest share of dots to explain in the area of the target."""
_FLAT = 0.03
"""Points with a smaller relative thickness are in a plane. One plane of a spatial target is not enough to identify it:
seen from behind, the plane has the same image as its mirror image."""
_RIVAL_SHARE = 0.8
"""Share of the best reading's dots above which a second reading makes the image ambiguous."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TargetCamera:
    """A camera that explains the dots of one image. Target → pixels.

    It has one focal length and one radial term, both centred.
    """

    rotation_vector: Float64[Array, 3]
    translation_mm: Float64[Array, 3]
    focal_px: float
    k1: float
    centre_px: Float64[Array, 2]

    def image(self, points: Float64[Array, "*n 3"]) -> Float64[Array, "*n 2"]:
        """Pixels of points of the target. NaN behind the camera."""
        row = np.concatenate([self.rotation_vector, self.translation_mm, [np.log(self.focal_px), self.k1]])
        return _images(row[None], points.reshape(-1, 3), self.centre_px)[0].reshape(*points.shape[:-1], 2)

    @property
    def centre_mm(self) -> Float64[Array, 3]:
        """The camera's position, target frame."""
        rotation = Rotation.from_rotvec(self.rotation_vector).as_matrix()
        centre: Float64[Array, 3] = -rotation.T @ self.translation_mm
        return centre


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DotAssignment:
    """One assignment of an image's dots to points of the target."""

    camera: TargetCamera
    ids: Int64[Array, " n"]
    dots: Int64[Array, " n"]
    """Index of the dot of each point."""


def read_constellation(
    points: Float64[Array, "n 3"], uv: Float64[Array, "m 2"], size_wh: tuple[int, int]
) -> tuple[DotAssignment, ...]:
    """Assign the dots of an image to points of a target.

    Args:
        points: the target's points, target frame, mm; not mirrored.
        uv: dots, pixels. Some may be something else, and not every point needs a dot.
        size_wh: the image's size, pixels.

    Returns:
        Empty if nothing fits. One reading if the image is unambiguous. Otherwise the best two, which explain nearly the
        same number of dots by different points.
    """
    if len(points) < MIN_POINTS or len(uv) < MIN_POINTS:
        return ()
    tree = cKDTree(uv)
    spacing = np.asarray(tree.query(uv, k=3)[0])[:, 2]
    readings = sorted(_readings(points, uv, spacing, tree, size_wh), key=lambda reading: -len(reading.ids))
    if not readings:
        return ()
    best = readings[0]
    for rival in readings[1:]:
        if len(rival.ids) < _RIVAL_SHARE * len(best.ids):
            break
        if _common(best, rival) < 0.5 * len(rival.ids):
            return best, rival
    return (best,)


def _readings(
    points: Float64[Array, "n 3"],
    uv: Float64[Array, "m 2"],
    spacing: Float64[Array, " m"],
    tree: cKDTree,
    size_wh: tuple[int, int],
) -> Iterator[DotAssignment]:
    """All consistent readings, grown from several triples of neighbouring dots."""
    middle = np.median(uv, axis=0)
    seeds = np.argsort(np.linalg.norm(uv - middle, axis=1))
    triples = _triples(points)
    for seed in seeds[:: max(1, len(seeds) // _SEEDS)][:_SEEDS]:
        _, near = tree.query(uv[seed], k=3)
        starts = _orthographic(points, triples, uv[near])
        scores = _local_scores(points, triples, starts, spacing, tree)
        for start in np.argsort(-scores, kind="stable")[:_GROWN]:
            if scores[start] < 4:
                break
            yield from _grow(points, starts[start], int(triples[start % len(triples), 0]), uv, spacing, tree, size_wh)


def _triples(points: Float64[Array, "n 3"]) -> Int64[Array, "t 3"]:
    """Each point with every ordered pair of its neighbours."""
    near = np.asarray(cKDTree(points).query(points, k=min(_NEAREST + 1, len(points)))[1])[:, 1:]
    i, j = np.nonzero(~np.eye(near.shape[1], dtype=bool))
    first = np.repeat(np.arange(len(points)), len(i))
    return np.stack([first, near[:, i].ravel(), near[:, j].ravel()], axis=1)


def _orthographic(
    points: Float64[Array, "n 3"], triples: Int64[Array, "t 3"], uv: Float64[Array, "3 2"]
) -> Float64[Array, "s 3 4"]:
    """Both scaled orthographic cameras of each triple. Rows u, v and depth (pixels) of homogeneous points."""
    origin, w1 = points[triples[:, 0]], points[triples[:, 1]] - points[triples[:, 0]]
    w2 = points[triples[:, 2]] - origin
    d1, d2 = uv[1] - uv[0], uv[2] - uv[0]
    r01, r02, r12 = (np.square(v).sum(axis=1) for v in (w1, w2, w2 - w1))
    p01, p02, p12 = float(d1 @ d1), float(d2 @ d2), float((d2 - d1) @ (d2 - d1))
    # Heights h₁, h₂ above the picture plane with (d, h) as long as s times the point's: a quadratic in s².
    a = 4 * r01 * r02 - (r01 + r02 - r12) ** 2
    b = p01 * (r02 + r12 - r01) + p02 * (r01 + r12 - r02) + p12 * (r01 + r02 - r12)
    c = 4 * p01 * p02 - (p01 + p02 - p12) ** 2
    scale2 = (b + np.sqrt(np.maximum(b * b - a * c, 0.0))) / np.maximum(a, 1e-12)
    h1 = np.sqrt(np.maximum(scale2 * r01 - p01, 0.0))
    h2 = np.sqrt(np.maximum(scale2 * r02 - p02, 0.0))
    h2 = np.where(p01 + p02 - p12 <= scale2 * (r01 + r02 - r12), h2, -h2)
    world = np.stack([w1, w2, np.cross(w1, w2)], axis=2)
    cameras = []
    for sign in (1.0, -1.0):
        c1 = np.column_stack([np.broadcast_to(d1, (len(h1), 2)), sign * h1])
        c2 = np.column_stack([np.broadcast_to(d2, (len(h2), 2)), sign * h2])
        image = np.stack([c1, c2, np.cross(c1, c2) / np.sqrt(np.maximum(scale2, 1e-12))[:, None]], axis=2)
        flat = np.abs(np.linalg.det(world)) < 1e-9  # three points on a line
        matrix = image @ np.linalg.inv(np.where(flat[:, None, None], np.eye(3), world))
        matrix[flat] = 0.0
        shift = np.append(uv[0], 0.0) - np.einsum("tij,tj->ti", matrix, origin)
        cameras.append(np.concatenate([matrix, shift[:, :, None]], axis=2))
    return np.concatenate(cameras)


def _local_scores(
    points: Float64[Array, "n 3"],
    triples: Int64[Array, "t 3"],
    starts: Float64[Array, "s 3 4"],
    spacing: Float64[Array, " m"],
    tree: cKDTree,
) -> Float64[Array, " s"]:
    """Number of points around each triple that project onto dots, plus a little for closeness."""
    around = np.asarray(cKDTree(points).query(points, k=min(_AROUND, len(points)))[1])
    first = np.tile(triples[:, 0], 2)
    nearby = points[around[first]]
    image = np.einsum("sij,spj->spi", starts[:, :2, :3], nearby) + starts[:, None, :2, 3]
    distance, dot = tree.query(image)
    ratio = np.asarray(distance) / (_LOOSE * spacing[np.asarray(dot)])
    score: Float64[Array, " s"] = np.maximum(0.0, 1.0 - ratio**2).sum(axis=1)
    score[np.abs(starts[:, 0, :3]).sum(axis=1) == 0.0] = 0.0
    return score


def _grow(
    points: Float64[Array, "n 3"],
    start: Float64[Array, "3 4"],
    seed: int,
    uv: Float64[Array, "m 2"],
    spacing: Float64[Array, " m"],
    tree: cKDTree,
    size_wh: tuple[int, int],
) -> Iterator[DotAssignment]:
    """Perspective cameras grown from an orthographic one: match around the triple, adjust, match farther."""
    scale = float(np.linalg.norm(start[0, :3]))
    u, _, vt = np.linalg.svd(start[:, :3])
    rotation = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    rotation_vector = Rotation.from_matrix(rotation).as_rotvec()
    centre_px = (np.array(size_wh) - 1) / 2
    far = np.linalg.norm(points - points[seed], axis=1)
    order = np.argsort(far)
    seed_uv = start[:2, :3] @ points[seed] + start[:2, 3]
    for focal_px in np.array(_FOCAL_WIDTHS) * max(size_wh):
        depth = focal_px / scale
        at = np.append((seed_uv - centre_px) / scale, depth)
        camera = TargetCamera(
            rotation_vector=rotation_vector,
            translation_mm=at - rotation @ points[seed],
            focal_px=float(focal_px),
            k1=0.0,
            centre_px=centre_px,
        )
        for round_ in range(_ROUNDS):
            reach = np.zeros(len(points), bool)
            reach[order[: _AROUND * 2**round_]] = True
            last = round_ == _ROUNDS - 1
            ids, dots = _match(camera, points, reach, spacing, tree, _TIGHT if last else _LOOSE)
            if len(ids) < (MIN_POINTS if last else 5):
                break
            camera = adjusted(camera, points[ids], uv[dots], free_lens=len(ids) >= 2 * MIN_POINTS)
        else:
            off = np.linalg.norm(camera.image(points[ids]) - uv[dots], axis=1) / spacing[dots]
            spatial = _thickness(points[ids]) > _FLAT or _thickness(points) < _FLAT
            if spatial and float(np.median(off)) < _FITTING and _explains(camera, points, uv, dots):
                yield DotAssignment(camera=camera, ids=ids, dots=dots)


def _match(
    camera: TargetCamera,
    points: Float64[Array, "n 3"],
    reach: Bool[Array, " n"],
    spacing: Float64[Array, " m"],
    tree: cKDTree,
    tolerance: float,
) -> tuple[Int64[Array, " k"], Int64[Array, " k"]]:
    """Pairs of points and dots that are each other's nearest, within the tolerance."""
    image = camera.image(points)
    usable = np.flatnonzero(reach & np.isfinite(image).all(axis=1))
    if not len(usable):
        return usable, usable
    distance, dot = (np.asarray(part) for part in tree.query(image[usable]))
    order = np.lexsort((distance, dot))
    first = np.append(True, np.diff(dot[order]) > 0)
    chosen = order[first]
    chosen = chosen[distance[chosen] < tolerance * spacing[dot[chosen]]]
    return usable[chosen], dot[chosen]


def adjusted(
    camera: TargetCamera, points: Float64[Array, "n 3"], uv: Float64[Array, "n 2"], *, free_lens: bool
) -> TargetCamera:
    """Adjust pose and focal length, and with `free_lens` the radial term.

    Robust Gauss–Newton with numerical derivatives. The focal length is held within a factor of about two of its start,
    and the lens near zero, since flat targets seen frontally determine neither.
    """
    lens = [camera.k1] if free_lens else []
    x = np.concatenate([camera.rotation_vector, camera.translation_mm, [np.log(camera.focal_px)], lens])
    start = x.copy()
    step = np.array([1e-5, 1e-5, 1e-5, 1e-3, 1e-3, 1e-3, 1e-5, 1e-5])[: len(x)]
    prior = np.diag([0.0] * 6 + [1 / _FOCAL_PRIOR**2, 1 / _LENS_PRIOR**2])[: len(x), : len(x)]
    start[7:] = 0.0
    for _ in range(_STEPS):
        image, *shifted = _images(np.vstack([x, x + np.diag(step)]), points, camera.centre_px)
        error = image - uv
        if not np.isfinite(error).all():
            return camera
        columns = [(moved - image).ravel() / size for moved, size in zip(shifted, step, strict=True)]
        jacobian = np.nan_to_num(np.stack(columns, axis=1))
        length = np.linalg.norm(error, axis=1)
        weight = np.repeat(1.0 / np.maximum(1.0, length / max(3.0 * float(np.median(length)), 0.5)), 2)
        normal = jacobian.T @ (jacobian * weight[:, None]) + prior
        normal[np.diag_indices(len(x))] *= 1.0 + 1e-6
        move = np.linalg.solve(normal, -jacobian.T @ (weight * error.ravel()) - prior @ (x - start))
        x = x + move
        if np.abs(move / step).max() < 1.0:
            break
    return TargetCamera(
        rotation_vector=x[:3],
        translation_mm=x[3:6],
        focal_px=float(np.exp(x[6])),
        k1=float(x[7]) if free_lens else 0.0,
        centre_px=camera.centre_px,
    )


def _images(
    cameras: Float64[Array, "q p"], points: Float64[Array, "n 3"], centre_px: Float64[Array, 2]
) -> Float64[Array, "q n 2"]:
    """Pixels of points in several cameras.

    A camera is a row: rotation vector, translation, log of the focal length, k1 if any.
    """
    rotations = Rotation.from_rotvec(cameras[:, :3]).as_matrix()
    camera = np.einsum("qij,nj->qni", rotations, points) + cameras[:, None, 3:6]
    front = camera[..., 2:] > 1.0
    xy = camera[..., :2] / np.where(front, camera[..., 2:], 1.0)
    if cameras.shape[1] > 7:
        xy = xy * (1.0 + cameras[:, None, 7:8] * np.square(xy).sum(axis=-1, keepdims=True))
    return np.where(front, xy * np.exp(cameras[:, 6])[:, None, None] + centre_px, np.nan)


def _thickness(points: Float64[Array, "n 3"]) -> float:
    """Extent across the best plane, as a share of the largest extent."""
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return float(spread[2] / spread[0])


def _explains(
    camera: TargetCamera, points: Float64[Array, "n 3"], uv: Float64[Array, "m 2"], dots: Int64[Array, " k"]
) -> bool:
    """Whether most dots in the area of the target are explained."""
    image = camera.image(points)
    inside = ((uv >= np.nanmin(image, axis=0)) & (uv <= np.nanmax(image, axis=0))).all(axis=1)
    inside[dots] = True
    return bool(len(dots) >= _LEAST_SHARE * inside.sum())


def _common(a: DotAssignment, b: DotAssignment) -> int:
    """Number of dots that both assign to the same point."""
    return len(
        set(zip(a.ids.tolist(), a.dots.tolist(), strict=True)) & set(zip(b.ids.tolist(), b.dots.tolist(), strict=True))
    )
