"""Register two scans of one visit, and refuse them unless they show one body in one posture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from mammometry.base.errors import MeasureError
from mammometry.base.value import value
from mammometry.geometry import Array, Bool, Float64, Int64, Transform, TriangleMesh, mesh_kernels
from mammometry.geometry.nearest import closest_on_mesh, point_tree
from mammometry.measure.trunk.mirror_plane import Registration, mirror, register

LEAST_OVERLAP = 0.35
"""Least share of the smaller scan that the other one shows too. Scans of one woman from the front and from below have
0.9 (decision 50)."""
DOUBT_MM, REFUSE_MM = 2.5, 4.0
"""Residuals (`ScanFit.within_mm`) above which a warning is given, or scans are refused, mm: the posture changed. Pairs
of one woman in one posture have 0.4 to 0.5 (decision 50)."""
LARGEST_SCALE = 0.006
"""Relative difference of lengths above which scans are refused. Virtual telephones differ by 0.001."""
_BORDER_MM = 8.0  # skin nearer to a mesh's edge is not compared: scanners lose and distort it there
_FINE_MM, _MEDIUM_MM, _COARSE_MM = 6.0, 9.0, 22.0
"""Spacing of the samples, mm: for residuals and the last registration, for choosing among starts, for the search."""
_STARTS, _REFINED = 3, 12  # sets of 60 initial rotations, and number of the best that are refined
_ROUNDS = 12  # iterations of the coarse search
_KEPT = 0.7  # share of nearest pairs that the coarse search keeps: the others may be in one scan only
_FAR_MM = 20.0  # distance at which a point's misfit is capped when starts are compared
_FACING = 0.5  # least cosine between the normals of the same skin in both scans
_SAME_SKIN_MM = 60.0  # largest distance between the scans on the same skin
_PATCH_MM = 15.0  # radius of the patches over which differences are averaged: noise averages out, posture does not
_QUANTILE = 0.95  # share of the patches that differ by less than the residual
_CERTAIN_MM = 1.0  # residual below which scans are not tested for mirroring: no body is so symmetric
_MIRROR_GAIN = 0.6  # residual of the mirrored scan, relative to the scan's own, below which the scan is mirrored
_WEAKEST_MM = 1.0  # largest standard uncertainty of the least certain motion
_SCALE_ROUNDS = 8  # iterations, after which the scale changes by less than 1e-4


@dataclass(frozen=True, slots=True, kw_only=True)
class ScanFit:
    """Registration of a scan to another one of the same visit."""

    first_from_second: Transform
    """Motion from the second file's frame to the first one's, mm."""
    overlap: float
    """Share of the smaller scan's skin that both scans show, 0 to 1."""
    within_mm: float
    """Residual: 95 % of the 30 mm wide patches of shared skin are within this distance of the other scan, mm."""
    scatter_mm: float
    """Robust standard deviation of points of shared skin along the normal, mm."""
    weakest_mm: float
    """Standard uncertainty of the least certain motion (`Registration.weakest_mm`), mm."""
    sigma_mm: float
    """Standard uncertainty of one scan's skin relative to the other's along the normal, mm: from the patches'
    differences (root mean square) and the registration's own uncertainty."""
    scale: float
    """Relative difference of lengths: second over first, minus 1."""

    @property
    def doubtful(self) -> bool:
        """Whether the body may have moved between the scans."""
        return self.within_mm > DOUBT_MM


@value(eq=False)
class _Sampled:
    """Evenly spaced points of a mesh, away from its edges."""

    points: Float64[Array, "n 3"]
    normals: Float64[Array, "n 3"]


def fit_scans(first: TriangleMesh, second: TriangleMesh) -> ScanFit:
    """Rigid registration of two scans of one body, with its quality.

    The identity is tried first. If it does not fit, 180 rotations are tried.

    Args:
        first: open or closed, mm, faces outwards.
        second: the same, in any frame.

    Raises:
        MeasureError: the scans do not show one body in one posture and at one scale.
    """
    sampled = _sampled(first, _FINE_MM), _sampled(second, _FINE_MM)
    found = _registered(*sampled)
    residual = None if found is None else _residual(first, second, found.fixed_from_moving)
    if residual is None or not residual.fits:
        _refuse_mirrored(first, second, residual)
    if found is None or residual is None:
        raise _refused("a scan that does not match the first one", "two scans of one body, each of most of its front")
    if residual.overlap < LEAST_OVERLAP:
        raise _refused(
            f"only {100 * residual.overlap:.0f} % of its skin in the first scan",
            f"at least {100 * LEAST_OVERLAP:.0f} %",
            "Scan again so that chest, breasts and shoulders are in both scans",
        )
    scale = _scale(*sampled, found.fixed_from_moving)
    if abs(scale) > LARGEST_SCALE and _explains(scale, first, second, found.fixed_from_moving):
        raise _refused(
            f"lengths {100 * abs(scale):.1f} % {'larger' if scale > 0 else 'smaller'} than in the first scan",
            f"at most {100 * LARGEST_SCALE:.1f} %",
            "Check the unit and the scale of both files",
        )
    if residual.within_mm > REFUSE_MM:
        raise _refused(
            f"skin {residual.within_mm:.0f} mm from that of the first scan",
            f"one patient in one posture, within {REFUSE_MM:.0f} mm",
            "Check that both scans are of this patient and show most of her front. If she moved between them, "
            "scan again with the patient still",
        )
    if found.weakest_mm > _WEAKEST_MM:
        raise _refused(
            f"a registration uncertain by {found.weakest_mm:.1f} mm",
            f"at most {_WEAKEST_MM:.0f} mm",
            "Scan again so that chest, breasts and shoulders are in both scans",
        )
    return ScanFit(
        first_from_second=found.fixed_from_moving,
        overlap=residual.overlap,
        within_mm=residual.within_mm,
        scatter_mm=found.scatter_mm,
        weakest_mm=found.weakest_mm,
        sigma_mm=float(np.hypot(residual.rms_mm, found.weakest_mm)),
        scale=scale,
    )


def _refused(
    found: str, expected: str, remedy: str = "Check that both scans are of this patient and of one visit"
) -> MeasureError:
    return MeasureError("the second scan", found=found, expected=expected, remedy=remedy)


def _refuse_mirrored(first: TriangleMesh, second: TriangleMesh, residual: _Residual | None) -> None:
    """Raise a MeasureError if the second scan's mirror image fits and the scan itself does not."""
    plain = np.array([1.0, 0.0, 0.0])
    image = second.mapped(lambda points: mirror(points, np.zeros(3), plain)).turned_over()
    found = _registered(_sampled(first, _FINE_MM), _sampled(image, _FINE_MM))
    if found is None:
        return
    mirrored = _residual(first, image, found.fixed_from_moving)
    if mirrored.overlap < LEAST_OVERLAP or mirrored.within_mm > REFUSE_MM:
        return
    if residual is None or residual.overlap < LEAST_OVERLAP or mirrored.within_mm < _MIRROR_GAIN * residual.within_mm:
        raise _refused(
            "a mirror image of the first scan",
            "left and right the same in both",
            "Compare a mole or a tattoo with the patient, and export the mirrored scan again without mirroring",
        )


def edge_distance_mm(points: Float64[Array, "n 3"], mesh: TriangleMesh) -> Float64[Array, " n"]:
    """Distance of points from the nearest vertex on an open edge, mm. Infinite for a closed mesh."""
    ends = mesh_kernels.open_vertices(len(mesh.vertices), mesh.faces)
    if not ends.any():
        return np.full(len(points), np.inf)
    return np.asarray(point_tree(mesh.vertices[ends]).query(points)[0])


def _sampled(mesh: TriangleMesh, step_mm: float) -> _Sampled:
    chosen = _one_per_cell(mesh.vertices, step_mm)
    chosen = chosen[edge_distance_mm(mesh.vertices[chosen], mesh) > _BORDER_MM]
    return _Sampled(points=mesh.vertices[chosen], normals=mesh.vertex_normals()[chosen])


def _one_per_cell(points: Float64[Array, "n 3"], step_mm: float) -> Int64[Array, " k"]:
    """Indices of one point per cell of a grid."""
    cells = np.floor((points - points.min(axis=0)) / step_mm).astype(np.int64)
    keys = (cells[:, 0] * (cells[:, 1].max() + 1) + cells[:, 1]) * (cells[:, 2].max() + 1) + cells[:, 2]
    return np.unique(keys, return_index=True)[1]


def _registered(first: _Sampled, second: _Sampled) -> Registration | None:
    """Best registration, started from the identity if that fits, else from any rotation. None: it failed."""
    as_given = _fitted(first, second, [Transform.identity()])
    if as_given is not None and as_given[0] < _CERTAIN_MM:
        return as_given[1]
    medium = _thinned(first, _MEDIUM_MM), _thinned(second, _MEDIUM_MM)
    chosen = _fitted(*medium, [Transform.identity(), *_starts(*medium)])
    best = None if chosen is None else _fitted(first, second, [chosen[1].fixed_from_moving])
    return None if best is None else best[1]


def _fitted(first: _Sampled, second: _Sampled, starts: Sequence[Transform]) -> tuple[float, Registration] | None:
    """Misfit, mm, and registration of the best start. None if the registration fails from all of them."""
    found: list[tuple[float, Registration]] = []
    for start in starts:
        try:
            fitted = register(
                (second.points, second.normals), (first.points, first.normals), start=start, subject="the two scans"
            )
        except MeasureError:
            continue
        found.append((_misfit_mm(first, second, fitted.fixed_from_moving), fitted))
    return min(found, key=lambda scored: scored[0]) if found else None


def _misfit_mm(first: _Sampled, second: _Sampled, motion: Transform) -> float:
    """Trimmed mean distance between two scans, the larger of both directions, mm."""
    moved, turned = motion.apply(second.points), motion.rotate(second.normals)
    return max(
        _one_way_mm(moved, turned, first.points, first.normals), _one_way_mm(first.points, first.normals, moved, turned)
    )


def _one_way_mm(
    points: Float64[Array, "n 3"], normals: Float64[Array, "n 3"], onto: Float64[Array, "m 3"],
    outward: Float64[Array, "m 3"],
) -> float:  # fmt: skip
    away, nearest = point_tree(onto).query(points, distance_upper_bound=_FAR_MM)
    met = np.isfinite(away)
    nearest = np.where(met, nearest, 0)
    met &= (normals * outward[nearest]).sum(axis=1) > _FACING
    along = np.abs(((points - onto[nearest]) * outward[nearest]).sum(axis=1))
    return float(np.mean(np.sort(np.where(met, along, _FAR_MM))[: max(1, int(_KEPT * len(points)))]))


def _starts(first: _Sampled, second: _Sampled) -> list[Transform]:
    """The best few coarse registrations, from trimmed ICP started at many rotations."""
    fixed, moving = (_thinned(sampled, _COARSE_MM) for sampled in (first, second))
    tree = point_tree(fixed.points)
    middle, own = fixed.points.mean(axis=0), moving.points.mean(axis=0)
    kept = int(_KEPT * len(moving.points))
    turns = Rotation.create_group("I")
    scored: list[tuple[float, int, Transform]] = []
    for offset in Rotation.random(_STARTS, rng=np.random.default_rng(0)):
        for turn in (turns * offset).as_matrix():
            rotation, shift = turn, middle - turn @ own
            for _ in range(_ROUNDS):
                moved = moving.points @ rotation.T + shift
                away, nearest = tree.query(moved)
                near = np.argsort(away)[:kept]
                rotation, shift = _kabsch(moving.points[near], fixed.points[np.asarray(nearest)[near]])
            motion = Transform(rotation=rotation, translation_mm=shift)
            scored.append((_misfit_mm(fixed, moving, motion), len(scored), motion))
    best: list[Transform] = []
    for _, _, motion in sorted(scored):
        if all(_differ(motion, other, own) for other in best):
            best.append(motion)
        if len(best) == _REFINED:
            break
    return best


def _differ(motion: Transform, other: Transform, middle: Float64[Array, 3]) -> bool:
    turn = np.linalg.norm((other.inverse() @ motion).rotation_vector_rad)
    return bool(turn > 0.1 or np.linalg.norm(motion.apply(middle) - other.apply(middle)) > _COARSE_MM)


def _thinned(sampled: _Sampled, step_mm: float) -> _Sampled:
    chosen = _one_per_cell(sampled.points, step_mm)
    return _Sampled(points=sampled.points[chosen], normals=sampled.normals[chosen])


def _kabsch(
    moving: Float64[Array, "n 3"], fixed: Float64[Array, "n 3"]
) -> tuple[Float64[Array, "3 3"], Float64[Array, 3]]:
    """Least-squares rotation and translation of points onto their partners (Kabsch 1976)."""
    middle, onto = moving.mean(axis=0), fixed.mean(axis=0)
    u, _, v = np.linalg.svd((fixed - onto).T @ (moving - middle))
    turn = u @ np.diag([1.0, 1.0, np.linalg.det(u @ v)]) @ v
    return turn, onto - turn @ middle


@dataclass(frozen=True, slots=True, kw_only=True)
class _Residual:
    overlap: float
    within_mm: float
    rms_mm: float

    @property
    def fits(self) -> bool:
        """Whether the scans match so well that no other cause need be tested."""
        return self.overlap >= LEAST_OVERLAP and self.within_mm < _CERTAIN_MM


def _residual(first: TriangleMesh, second: TriangleMesh, motion: Transform) -> _Residual:
    """Differences of the scans where both show skin, in both directions."""
    moved = second.transformed(motion)
    differences, shares = [], []
    for one, other in ((moved, first), (first, moved)):
        sampled = _sampled(one, _FINE_MM)
        shared, away = _shared(sampled, other)
        shares.append(float(shared.mean()))
        points = sampled.points[shared]
        if len(points):
            near = point_tree(points).query_ball_point(points, _PATCH_MM)
            differences.append(np.array([away[shared][group].mean() for group in near]))
    every = np.concatenate(differences) if differences else np.array([np.inf])
    return _Residual(
        overlap=max(shares),
        within_mm=float(np.quantile(np.abs(every), _QUANTILE)),
        rms_mm=float(np.sqrt(np.mean(every**2))),
    )


def _shared(sampled: _Sampled, other: TriangleMesh) -> tuple[Bool[Array, " n"], Float64[Array, " n"]]:
    """Whether the other scan shows the same skin, and the signed distance from it, mm, for each point."""
    closest = closest_on_mesh(sampled.points, other)
    vectors = other.face_vectors()[closest.faces]
    outward = vectors / np.maximum(np.linalg.norm(vectors, axis=1), 1e-12)[:, None]
    facing = (outward * sampled.normals).sum(axis=1) > _FACING
    inside = edge_distance_mm(closest.points, other) > _BORDER_MM
    sign = np.sign(((sampled.points - closest.points) * outward).sum(axis=1))
    return facing & inside & (closest.distances_mm < _SAME_SKIN_MM), sign * closest.distances_mm


def _explains(scale: float, first: TriangleMesh, second: TriangleMesh, motion: Transform) -> bool:
    """Whether the second scan fits after it is scaled to the first one's lengths."""
    smaller = second.mapped(lambda points: points / (1 + scale))
    fitted = _fitted(_sampled(first, _FINE_MM), _sampled(smaller, _FINE_MM), [motion])
    return fitted is not None and _residual(first, smaller, fitted[1].fixed_from_moving).within_mm < REFUSE_MM


def _scale(first: _Sampled, second: _Sampled, motion: Transform) -> float:
    """Relative scale of the second scan, minus 1: point-to-plane registration with seven unknowns."""
    tree = point_tree(first.points)
    points, normals = motion.apply(second.points), motion.rotate(second.normals)
    total = 1.0
    for _ in range(_SCALE_ROUNDS):
        away, nearest = tree.query(points, distance_upper_bound=_FAR_MM)
        met = np.isfinite(away)
        nearest = np.where(met, nearest, 0)
        plane = first.normals[nearest]
        met &= (normals * plane).sum(axis=1) > _FACING
        gap = ((first.points[nearest] - points) * plane).sum(axis=1)
        limit = 4 * max(float(np.median(np.abs(gap[met]))), 0.1)
        weights = np.where(met, np.clip(1 - (gap / limit) ** 2, 0, None) ** 2, 0.0)
        middle = points[met].mean(axis=0)
        arm = (points - middle) / 100.0
        rows = np.column_stack([np.cross(arm, plane), plane, (arm * plane).sum(axis=1)])
        step = np.linalg.lstsq(rows * np.sqrt(weights)[:, None], gap * np.sqrt(weights), rcond=None)[0]
        turn = Rotation.from_rotvec(step[:3] / 100.0).as_matrix()
        factor = 1 + step[6] / 100.0
        points = middle + step[3:6] + factor * (points - middle) @ turn.T
        normals = normals @ turn.T
        total *= factor
    return float(1 / total - 1)
