"""Most probable small motions of cameras and body, from the pairs' disagreement.

Cameras turn, and the body moves between the pairs' exposures: rigidly, and smoothly when the chest breathes. The
distances between two pairs' surfaces and the vertical disparity within a pair are linear in the errors θ of the
cameras' poses: y = Hθ + noise, with the covariance of calibration and matching. Turns and shifts have normal priors,
whose sizes are those that make y most probable (the evidence, or type-II likelihood: MacKay 1992, Neural Computation 4,
415). With sizes of zero nothing moved.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from typing import TypeAlias

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.spatial.distance import cdist

from mammometry.base.normal import MAD
from mammometry.base.value import value
from mammometry.calibration.adjust.calibrated import ParameterCovariance
from mammometry.calibration.adjust.linear_model import Fit, LinearModel, linear_model
from mammometry.calibration.adjust.network import POSE_NAMES_CAMERA
from mammometry.calibration.judge.pose_motion import shifts
from mammometry.geometry import Array, Bool, Float64, Int64, Rig
from mammometry.geometry.twist import rigid_motions
from mammometry.surface.motion.agreement import Differences, RowErrors

_CELL_MM = 0.06
"""Standard deviation of a cell's difference in addition to its data's own, mm: matching errors within a window."""
_COMMON_MM = 0.05  # standard deviation common to cells within `_REACH_MM`, mm: matching smooths curved skin
_EXPECTED_SHARE = 0.5
"""Standard deviation of a cell's median relative to the two pairs' expected one, and again common to cells near it:
noise and weak texture cause similar errors in neighbouring windows (docs/decisions/0009 has 0.35 for one pair)."""
_REACH_MM = 40.0
_ROW_PX = 0.1
"""Standard deviation of a cell's vertical disparity, px of the matched image. A correct calibration leaves 0.02 to 0.05
RMS, similar over the image (docs/decisions/0027)."""
_LEVER_MM = 150.0
"""Lever arm, mm: half a trunk's width. A body that shifts by 1 mm also turns, by 1 mm at this distance."""
_TURNS_DEG = (0.0, 0.001, 0.0015, 0.0025, 0.004, 0.006, 0.01, 0.015, 0.025, 0.04, 0.06)
_SHIFTS_MM = (0.0, 0.03, 0.06, 0.1, 0.2, 0.35, 0.6, 1.0, 1.7)
_RESTS_MM = (0.0, 0.05, 0.1, 0.15, 0.2, 0.3, 0.45, 0.7, 1.1)
"""Standard deviations of turns, shifts and rests that are compared, degrees and mm."""
BREATHS_MM = (0.2, 0.5, 1.2)
"""Standard deviations of smooth motions that are compared, mm."""
BREATH_REACH_MM = 90.0
"""Gaussian σ of a smooth motion around its centre, and spacing of the centres, mm: a third of a chest's width. Not
critical."""
_FIRST_TURN_DEG, _FIRST_SHIFT_MM, _FIRST_REST_MM = 0.05, 1.0, 0.1
"""Sizes for the search for outliers: large, so that motions do not count as outliers."""
_OUTLIER_SIGMAS = 4.0  # robust standard deviations of a cell's difference beyond which it is an outlier; not critical
_CONTRADICTION = 2.0  # largest motion by a pair's rows alone, relative to the distance between pairs; not critical
_OUTLIER_ROUNDS = 5  # most searches for outliers; it ends earlier when nothing changes
LEAST_EVIDENCE = 10.0
"""Least rise of the log probability of all observations for a motion. Sizes of motions whose log probability is lower
than the best by more are left out. e¹⁰ is 22,000. Clean captures reach 0 to 3."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Effects:
    """Effect of a unit of each unknown on one pair's points."""

    points_mm: Float64[Array, "n 3 p"]
    """Displacement of the true points relative to the measured ones, world axes, mm."""
    vertical_rad: Float64[Array, "n p"]
    """Vertical disparity that it causes (`shifts.Shifts.vertical_rad`)."""


EffectsOf: TypeAlias = Callable[[Rig, str, Float64[Array, "n 3"]], Effects]
"""Rig, pair and points that the pair measured, world frame, mm → effects of all unknowns."""


@value(eq=False)
class MotionParameters:
    """Unknowns: turns of the cameras, then rigid motions of groups of pairs, then smooth motions.

    A camera turns about its centre. Smooth motions have one direction, and their mean over the groups is 0: a
    deformation that all groups share is the body's shape.
    """

    cameras: tuple[str, ...]
    groups: tuple[tuple[str, ...], ...]
    """Groups of pairs that share cameras, and so are exposed together."""
    centre_world: Float64[Array, 3]
    """Point about which groups turn, mm."""
    breath_centres: Float64[Array, "k 3"] = field(default_factory=lambda: np.zeros((0, 3)))
    """Centres of the smooth motions, world frame, mm. Empty for rigid bodies."""
    breath_direction: Float64[Array, 3] = field(default_factory=lambda: np.array([0.0, 0.0, 1.0]))
    """Unit vector of the smooth motions, from the body to the cameras."""

    @property
    def count(self) -> int:
        """Number of unknowns."""
        return self.of_breath.stop

    @property
    def of_breath(self) -> slice:
        """Smooth motions of all groups, mm: for each centre, one contrast fewer than there are groups."""
        start = 3 * len(self.cameras) + 6 * len(self.groups)
        return slice(start, start + len(self.breath_centres) * max(0, len(self.groups) - 1))

    def of_camera(self, camera: str) -> slice:
        """A camera's rotation vector in its frame, rad, applied from the left."""
        start = 3 * self.cameras.index(camera)
        return slice(start, start + 3)

    def of_group(self, pair: str) -> slice:
        """A group's rotation vector about the centre, rad, and translation, mm, world axes."""
        start = 3 * len(self.cameras) + 6 * self.group_of(pair)
        return slice(start, start + 6)

    def group_of(self, pair: str) -> int:
        """Index of a pair's group."""
        return next(i for i, names in enumerate(self.groups) if pair in names)

    def breath_mm(self, pair: str, points: Float64[Array, "n 3"]) -> Float64[Array, "n b"]:
        """Displacement of a pair's points along the direction by a unit of each smooth motion, mm."""
        contrast = np.linalg.qr(np.eye(len(self.groups)) - 1 / len(self.groups))[0][self.group_of(pair), :-1]
        across = points - np.outer(points @ self.breath_direction, self.breath_direction)
        near = np.exp(-cdist(across, self.breath_centres, "sqeuclidean") / (2 * BREATH_REACH_MM**2))
        return np.kron(near, contrast)

    def prior_std(self, turn_rad: float, shift_mm: float, breath_mm: float = 0.0) -> Float64[Array, " p"]:
        """Standard deviations of all unknowns for given sizes of turns, shifts and smooth motions."""
        group = np.repeat([shift_mm / _LEVER_MM, shift_mm], 3)
        breath = np.full(self.of_breath.stop - self.of_breath.start, breath_mm)
        return np.concatenate([np.full(3 * len(self.cameras), turn_rad), np.tile(group, len(self.groups)), breath])

    def effects(self, rig: Rig, pair: str, points: Float64[Array, "n 3"]) -> Effects:
        """Effects of all unknowns on one pair's points (world frame, mm)."""
        names = tuple(f"{camera}.{name}" for camera in self.cameras for name in POSE_NAMES_CAMERA[:3])
        of_turns = shifts(rig.pair(pair), points, names)
        moved, vertical = np.zeros((len(points), 3, self.count)), np.zeros((len(points), self.count))
        moved[:, :, : len(names)], vertical[:, : len(names)] = of_turns.points_mm, of_turns.vertical_rad
        moved[:, :, self.of_group(pair)] = rigid_motions(points - self.centre_world)
        if len(self.breath_centres):
            along = self.breath_mm(pair, points)
            moved[:, :, self.of_breath] = along[:, None, :] * self.breath_direction[:, None]
        return Effects(points_mm=moved, vertical_rad=vertical)

    def breathing(self, rig: Rig, points: Float64[Array, "n 3"]) -> MotionParameters:
        """The parameters with smooth motions of the skin around these points."""
        towards = -np.mean([rig.cameras[name].axis_world for name in self.cameras], axis=0)
        direction = towards / np.linalg.norm(towards)
        across = np.linalg.svd(direction[None])[2][1:]
        cells = np.unique(np.round(points @ across.T / BREATH_REACH_MM), axis=0)
        return replace(self, breath_centres=BREATH_REACH_MM * cells @ across, breath_direction=direction)


def motion_parameters(rig: Rig, pairs: Sequence[str], centre_world: Float64[Array, 3]) -> MotionParameters:
    """Parameters of all motions of these pairs of a rig."""
    groups: list[tuple[set[str], list[str]]] = []
    for pair in pairs:
        cameras, names = set(rig.pair_names[pair]), [pair]
        for joined in [group for group in groups if group[0] & cameras]:
            groups.remove(joined)
            cameras, names = cameras | joined[0], joined[1] + names
        groups.append((cameras, names))
    return MotionParameters(
        cameras=tuple(dict.fromkeys(camera for pair in pairs for camera in rig.pair_names[pair])),
        groups=tuple(tuple(names) for _, names in groups),
        centre_world=centre_world,
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Observed:
    """All observations of the pairs' disagreement, and the effect of each unknown."""

    values: Float64[Array, " m"]
    """Distances between surfaces, mm, then rows' angles, rad."""
    by_unknown: Float64[Array, "m p"]
    own: tuple[Float64[Array, "b b"], ...]
    """Covariance by matching, as diagonal blocks: one for each two compared pairs, then one for each pair's rows."""
    common: Float64[Array, "m k"]
    """Factor of the covariance by calibration: common · commonᵀ."""
    distances: Bool[Array, " m"]
    """Observations that are distances between surfaces."""
    rows_of: Int64[Array, " m"]
    """Index of the pair of a row's observation. −1 for distances."""

    def only(self, keep: Bool[Array, " m"]) -> Observed:
        """Some of the observations."""
        return Observed(
            values=self.values[keep],
            by_unknown=self.by_unknown[keep],
            own=tuple(block[np.ix_(kept, kept)] for block, kept in zip(self.own, self.of_blocks(keep), strict=True)),
            common=self.common[keep],
            distances=self.distances[keep],
            rows_of=self.rows_of[keep],
        )

    @property
    def variance(self) -> Float64[Array, " m"]:
        """Variance of each observation's noise."""
        return np.concatenate([np.diag(block) for block in self.own]) + np.sum(self.common**2, axis=1)

    def of_blocks(self, values: Array) -> list[Array]:
        """Rows of the observations that belong to each block."""
        return np.split(values, np.cumsum([len(block) for block in self.own])[:-1])

    def model(self, rest_mm: float) -> LinearModel:
        """Observations whitened block by block.

        In one matrix, time would grow with the sixth power of the number of pairs.

        Args:
            rest_mm: standard deviation of distances between surfaces that neither noise nor motion explains.
        """
        both = np.column_stack([self.by_unknown, self.values, self.common])
        white, log_det = [], 0.0
        for own, part, distances in zip(self.own, self.of_blocks(both), self.of_blocks(self.distances), strict=True):
            if len(own):
                lower = cholesky(own + np.diag(distances * rest_mm**2), lower=True, check_finite=False)
                white.append(solve_triangular(lower, part, lower=True, check_finite=False))
                log_det += 2 * float(np.sum(np.log(np.diag(lower))))
        return linear_model(white, self.by_unknown.shape[1], log_det=log_det)

    def rms_mm(self, motions: Float64[Array, " p"] | None = None) -> float:
        """RMS distance between surfaces, measured or after a correction, mm."""
        values, design = self.values[self.distances], self.by_unknown[self.distances]
        left = values if motions is None else values - design @ motions
        return float(np.sqrt(np.mean(left**2))) if len(left) else 0.0


def own_noise_mm2(comparison: Differences) -> Float64[Array, "n n"]:
    """Covariance of two pairs' distances by matching, mm². Neighbouring cells have similar errors."""
    near = np.exp(-cdist(comparison.points, comparison.points, "sqeuclidean") / (2 * _REACH_MM**2))
    own, shared = (np.hypot(floor, _EXPECTED_SHARE * comparison.expected_mm) for floor in (_CELL_MM, _COMMON_MM))
    noise: Float64[Array, "n n"] = np.diag(comparison.scatter_mm**2 + own**2) + np.outer(shared, shared) * near
    return noise


def observed(
    rig: Rig,
    apart: Sequence[Differences],
    rows: Mapping[str, RowErrors],
    covariance: ParameterCovariance | None,
    effects_of: EffectsOf,
    noise_mm2: Callable[[Differences], Float64[Array, "n n"]] = own_noise_mm2,
) -> Observed:
    """All observations as one linear system.

    Args:
        rig: rig with which the points were measured.
        apart: distances between the pairs' surfaces.
        rows: pair → its vertical disparity.
        covariance: covariance of the calibration. None if unknown: its errors then count as motion.
        effects_of: effects of the unknowns.
        noise_mm2: covariance of two pairs' distances by matching, mm².
    """
    names = () if covariance is None else tuple(n for n in covariance.names if n.rpartition(".")[0] in rig.cameras)
    values, design, of_calibration, noises = [], [], [], []
    for comparison in apart:
        both = (comparison.first, comparison.second)
        one, other = (effects_of(rig, name, comparison.points).points_mm for name in both)
        design.append(np.einsum("ni,nip->np", comparison.normals, other - one))
        one, other = (shifts(rig.pair(name), comparison.points, names).points_mm for name in both)
        of_calibration.append(np.einsum("ni,nip->np", comparison.normals, other - one))
        values.append(comparison.distance_mm)
        noises.append(noise_mm2(comparison))
    count = sum(map(len, values))
    for name, seen in rows.items():
        design.append(effects_of(rig, name, seen.points).vertical_rad)
        of_calibration.append(shifts(rig.pair(name), seen.points, names).vertical_rad)
        values.append(seen.angle_rad)
        noises.append(np.eye(len(seen.points)) * (_ROW_PX * seen.pixel_rad) ** 2)
    common = np.concatenate(of_calibration)
    if covariance is not None:
        index = [covariance.names.index(name) for name in names]
        sizes, vectors = np.linalg.eigh(covariance.matrix[np.ix_(index, index)])
        common = common @ (vectors * np.sqrt(np.maximum(sizes, 0.0)))
    return Observed(
        values=np.concatenate(values),
        by_unknown=np.concatenate(design),
        own=tuple(noises),
        common=common,
        distances=np.arange(len(common)) < count,
        rows_of=np.repeat([-1, *range(len(rows))], [count, *(len(seen.points) for seen in rows.values())]),
    )


def without_outliers(seen: Observed, parameters: MotionParameters) -> Observed:
    """Observations without cells that no plausible motion explains.

    Such cells are on hair, edges or arms in front of the trunk. All rows of a pair are left out together: if much of
    the pair was matched by chance, as on a pale wall, they are pixels off although nothing moved.
    """
    keep = np.ones(len(seen.values), dtype=bool)
    std = np.sqrt(seen.variance)
    large_std = parameters.prior_std(np.radians(_FIRST_TURN_DEG), _FIRST_SHIFT_MM, _FIRST_SHIFT_MM)
    for _ in range(_OUTLIER_ROUNDS):
        large = seen.only(keep).model(_FIRST_REST_MM).fit(large_std)
        left = np.abs(seen.values - seen.by_unknown @ large.motions)
        typical = max(MAD * float(np.median(left[keep & seen.distances])), _CELL_MM)
        inside = ~seen.distances | (left < _OUTLIER_SIGMAS * typical)
        for pair in range(seen.rows_of.max(initial=-1) + 1):
            its = seen.rows_of == pair
            inside[its] = np.sqrt(np.mean((left[its] / std[its]) ** 2)) < _OUTLIER_SIGMAS
        if np.array_equal(inside, keep):
            break
        keep = inside
    return seen.only(keep)


def without_contradicted_rows(seen: Observed, parameters: MotionParameters) -> Observed:
    """Observations without rows that common skin contradicts.

    The motion that such rows alone suggest is much larger than the distances between surfaces, and does not reduce
    them: parts of the pair were matched by chance.
    """
    distance_mm, by_unknown = seen.values[seen.distances], seen.by_unknown[seen.distances]
    keep = np.ones(len(seen.values), dtype=bool)
    for pair in range(seen.rows_of.max(initial=-1) + 1) if len(distance_mm) else ():
        its = seen.rows_of == pair
        if not its.any():
            continue
        moved_mm = by_unknown @ most_probable(seen.only(its), parameters).expected.motions
        far = float(moved_mm @ moved_mm) > _CONTRADICTION**2 * float(distance_mm @ distance_mm)
        keep[its] = not far or float(np.sum((distance_mm - moved_mm) ** 2)) < float(distance_mm @ distance_mm)
    return seen.only(keep)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Found:
    """Motions estimated from the observations."""

    still: Fit
    """Best fit without any motion."""
    still_rest_mm: float
    """Disagreement that it leaves in addition to the noise, standard deviation, mm."""
    expected: Fit
    """Mean over all motions, each size weighted by its evidence. `log_evidence` is that of the best one."""
    rest_mm: float
    """Disagreement that the best motions leave in addition to the noise, standard deviation, mm."""
    alone: tuple[str, Fit] | None
    """Camera, or first pair of a group, whose motion alone explains everything as well, and that fit. None if none."""


def most_probable(seen: Observed, parameters: MotionParameters, breaths_mm: Sequence[float] = (0.0,)) -> Found:
    """Most probable motions, with smooth motions of one of these sizes.

    All cameras share one size of turns, and all groups one size of motions. The motion of a single camera or group is
    tested only to name it: two cameras of a pair may turn alike by chance, and the others' motions would then seem
    certain.
    """
    rests_mm = _RESTS_MM if seen.distances.any() else _RESTS_MM[:1]  # rows alone do not determine it
    models = {rest_mm: seen.model(rest_mm) for rest_mm in rests_mm}
    none = np.zeros(parameters.count)
    still_rest_mm = max(models, key=lambda rest_mm: float(models[rest_mm].log_evidence(none[None])[0]))
    sizes = product(np.radians(_TURNS_DEG).tolist(), _SHIFTS_MM, breaths_mm)
    stds = np.array([parameters.prior_std(*size) for size in sizes])
    tried = [(evidence, rest_mm, std) for rest_mm in rests_mm
             for evidence, std in zip(models[rest_mm].log_evidence(stds).tolist(), stds, strict=True)]  # fmt: skip
    evidence, rest_mm, std = max(tried, key=lambda hypothesis: hypothesis[0])
    likely = [models[rest].fit(std) for log_evidence, rest, std in tried if log_evidence > evidence - LEAST_EVIDENCE]
    names, alone = zip(*_alone(parameters), strict=True)
    by_one = models[rest_mm].log_evidence(np.array(alone))
    most = int(np.argmax(by_one))
    return Found(
        still=models[still_rest_mm].fit(none),
        still_rest_mm=still_rest_mm,
        expected=_expected(likely, models[rest_mm].fit(std)),
        rest_mm=rest_mm,
        alone=(names[most], models[rest_mm].fit(alone[most])) if by_one[most] > evidence else None,
    )


def _expected(likely: Sequence[Fit], top: Fit) -> Fit:
    """Mean and covariance over the likely sizes, weighted by their evidence."""
    weights = np.exp([fit.log_evidence - top.log_evidence for fit in likely])
    weights /= weights.sum()
    motions = np.sum([w * fit.motions for w, fit in zip(weights, likely, strict=True)], axis=0)
    spread = [
        w * (fit.covariance + np.outer(fit.motions - motions, fit.motions - motions))
        for w, fit in zip(weights, likely, strict=True)
    ]
    return replace(top, motions=np.asarray(motions), covariance=np.asarray(np.sum(spread, axis=0)))


def _alone(parameters: MotionParameters) -> Iterator[tuple[str, Float64[Array, " p"]]]:
    """Prior standard deviations for the turn of a single camera, or the motion of a single group."""
    parts = [
        (n, parameters.of_camera(n), (turn, 0.0)) for n in parameters.cameras for turn in np.radians(_TURNS_DEG[1:])
    ]
    parts += [
        (group[0], parameters.of_group(group[0]), (0.0, mm)) for group in parameters.groups for mm in _SHIFTS_MM[1:]
    ]
    for name, where, size in parts:
        std = np.zeros(parameters.count)
        std[where] = parameters.prior_std(*size)[where]
        yield name, std
