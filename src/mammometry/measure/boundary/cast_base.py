"""The base of a cast: a plane or a convex cylinder, fitted robustly to candidates for its rim.

Both are one family: a circle of curvature κ moved along straight lines, with κ = 0 for the plane. Candidates on an
occluding limb instead of the rim are always above the base, so the cost is one-sided.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal, TypeAlias

import numpy as np
from scipy.spatial.transform import Rotation

from mammometry.base.errors import MeasureError
from mammometry.base.value import value
from mammometry.geometry.arrays import Array, Float64, Int64
from mammometry.measure.settings import BaseRimSettings

BaseKind: TypeAlias = Literal["plane", "convex-cylinder"]

SECTORS = 72  # directions around the cast with equal weight, so that a well visible side does not tilt the base
INLIER_MM = 1.0  # largest distance of a rim point from the base; not critical
BEND_GAIN = 1.2
"""Factor by which the disagreement must decrease for a curved base to replace a plane, or for an alternative to be
excluded. Not critical."""
_TRIALS = 2000  # random minimal samples; ten times as many found no better base (docs/decisions/0017)
_GENERATORS = 12  # directions of a cylinder's lines that are tried, 15° apart; not critical
_POLISH_ROUNDS = 40  # most Gauss–Newton iterations
_SEEDS = 6  # planes that are refined; refining all found no other base (docs/decisions/0017)
_COARSENESS = (4.0, 2.0, 1.0)  # factors of Tukey's constant, from coarse to fine; not critical
_WAYS = 6  # directions in which a plane is bent, 30° apart (docs/decisions/0017)
_EVERY = 1e3  # inlier distance relative to the rim's radius that includes every point: plain least squares
_SURFACE_POINTS = 3000  # approximate number of measured points for the cost; chosen for speed
_CUT_COST = 100.0  # cost of cutting off the whole surface: 1 % costs as much as one direction without rim
_STEP_MM = 1e-3  # step of numerical derivatives
_CONVERGED_MM = 1e-4  # a smaller step ends the iteration


@value(eq=False)
class Base:
    """A plane (curvature 0) or a circular cylinder that bends away from the viewer, mm, world frame."""

    origin: Float64[Array, 3]
    """A point on the base, near the centre of the rim."""
    frame: Float64[Array, "3 3"]
    """Rows: the direction of bending, that of the straight lines, and the normal at `origin` towards the viewer."""
    curvature_per_mm: float
    """1 / radius; 0 for a plane."""

    @property
    def is_plane(self) -> bool:
        """Whether the curvature is 0."""
        return self.curvature_per_mm == 0.0

    @property
    def kind(self) -> BaseKind:
        """Kind of the base, as in results."""
        return "plane" if self.is_plane else "convex-cylinder"

    def height(self, points_world: Float64[Array, "n 3"]) -> Float64[Array, " n"]:
        """Signed distance above the base, mm, positive on the viewer's side."""
        s, _, w = ((points_world - self.origin) @ self.frame.T).T
        k = self.curvature_per_mm
        excess = 2 * w + k * (w * w + s * s)
        return excess / (1 + np.sqrt(np.maximum(1 + k * excess, 0.0)))

    def flatten(self, points_world: Float64[Array, "n 3"]) -> Float64[Array, "n 2"]:
        """Unrolled coordinates, mm: arc length along the bend, and distance along the straight lines."""
        s, t, w = ((points_world - self.origin) @ self.frame.T).T
        k = self.curvature_per_mm
        return np.stack([s if k == 0 else np.arctan2(k * s, k * w + 1) / k, t], axis=1)

    def lift(self, flat: Float64[Array, "n 2"]) -> Float64[Array, "n 3"]:
        """World points of unrolled coordinates, mm (the inverse of `flatten` on the base)."""
        arc, t = flat.T
        half_turn = self.curvature_per_mm * arc / 2
        s = arc * np.sinc(2 * half_turn / np.pi)
        w = -arc * half_turn * np.sinc(half_turn / np.pi) ** 2
        return self.origin + np.stack([s, t, w], axis=1) @ self.frame


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BaseFit:
    """Best plane and best convex cylinder through the candidates."""

    plane: Base
    cylinder: Base
    plane_cost: float
    """Cost of the plane (`_Data.cost`)."""
    cylinder_cost: float
    """Cost of the cylinder."""


def fit_base(
    candidates: Float64[Array, "n 3"],
    surface_points: Float64[Array, "m 3"],
    viewer_direction: Float64[Array, 3],
    settings: BaseRimSettings = BaseRimSettings(),
) -> BaseFit:
    """Best plane and best convex cylinder through a cast's rim.

    Random minimal samples are scored by the directions that support them (not by the number of points, which a well
    visible side would dominate) and by the measured surface that they would cut off, and refined with Tukey's weights.

    Args:
        candidates: possible rim points, mm, world frame; up to half may be on occluding limbs.
        surface_points: measured points of the cast, nearly all on the viewer's side of the base.
        viewer_direction: direction from the cast towards the cameras, approximately.
        settings: tolerances.

    Raises:
        MeasureError: too few candidates.
    """
    if len(candidates) < settings.minimum_sectors:
        raise no_rim(f"{len(candidates)} possible rim points", settings)
    centre = np.median(surface_points, axis=0)
    step = max(1, len(surface_points) // _SURFACE_POINTS)
    data = _Data(
        points=candidates,
        sectors=_sectors(candidates, centre, viewer_direction),
        surface=surface_points[::step],
        settings=settings,
        extent=float(np.percentile(np.linalg.norm(candidates - centre, axis=1), 90)),
    )
    rng = np.random.default_rng(0)  # fixed seed: the same photographs give the same volume
    planes = _plane_seeds(data, viewer_direction, rng)
    plane = min((_polish(seed, data, bend=False) for seed in planes), key=data.cost)
    curved = [seed for start in (plane, *planes[:2]) for seed in _cylinder_seeds(start, data, rng)]
    cylinder = min((_polish(seed, data, bend=True) for seed in curved), key=data.cost)
    return BaseFit(plane=plane, cylinder=cylinder, plane_cost=data.cost(plane), cylinder_cost=data.cost(cylinder))


def sectors_held(points: Float64[Array, "n 3"], middle: Float64[Array, 3], base: Base) -> int:
    """Number of directions around the cast's centre with points, out of `SECTORS`."""
    return len(np.unique(_sectors(points, middle, base.frame[2])))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Data:
    points: Float64[Array, "n 3"]
    sectors: Int64[Array, " n"]
    surface: Float64[Array, "m 3"]
    settings: BaseRimSettings
    extent: float
    """Radius about the centre that contains nine tenths of the points, mm."""
    inlier_mm: float = INLIER_MM

    def scale(self, coarseness: float) -> float:
        """Tukey's constant, mm."""
        return 2.0 * self.inlier_mm * coarseness

    def balance(self) -> Float64[Array, " n"]:
        """Weight of each candidate such that each direction has weight 1."""
        return 1.0 / np.bincount(self.sectors, minlength=SECTORS)[self.sectors]

    def cost(self, base: Base) -> float:
        """Number of directions that do not support a base, plus 1 per 1 % of the surface that it cuts off."""
        constant = self.scale(1.0)
        loss = _tukey_loss(base.height(self.points), constant)
        per_sector = np.bincount(self.sectors, loss * self.balance(), minlength=SECTORS)
        empty = np.bincount(self.sectors, minlength=SECTORS) == 0
        cut_off = float((base.height(self.surface) < -self.inlier_mm).mean())
        return float(per_sector[~empty].sum() + empty.sum() + _CUT_COST * cut_off)


def no_rim(found: str, settings: BaseRimSettings) -> MeasureError:
    """Error for too little of a cast's rim."""
    return MeasureError(
        "base of the model",
        found=found,
        expected=f"its rim in at least {settings.minimum_sectors} of {SECTORS} directions around it",
        remedy="Photograph the whole cast from more sides, its base free of other objects and darker or paler than "
        "they are; or draw the boundary",
    )


def _sectors(points: Float64[Array, "n 3"], centre: Float64[Array, 3], viewer: Float64[Array, 3]) -> Int64[Array, " n"]:
    """Index of each point's direction from the centre, as the viewer sees it."""
    frame = frame_towards(viewer)
    x, y = ((points - centre) @ frame[:2].T).T
    return (np.floor((np.arctan2(y, x) / (2 * np.pi) + 0.5) * SECTORS).astype(np.int64)) % SECTORS


def frame_towards(direction: Float64[Array, 3]) -> Float64[Array, "3 3"]:
    """Right-handed orthonormal frame (rows) whose third axis is the direction."""
    normal = direction / np.linalg.norm(direction)
    first = np.cross(np.eye(3)[np.argmin(np.abs(normal))], normal)
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(normal, first), normal])


def _tukey(residuals: Float64[Array, "*n"], constant: float) -> Float64[Array, "*n"]:
    """Tukey's weights, but at least 0.25 just below the base, where there are no limbs (see the module)."""
    weights = np.clip(1 - (residuals / constant) ** 2, 0.0, None) ** 2
    return np.where((residuals < 0) & (residuals > -3 * constant), np.maximum(weights, 0.25), weights)


def _tukey_loss(residuals: Float64[Array, "*n"], constant: float) -> Float64[Array, "*n"]:
    return 1 - np.clip(1 - (residuals / constant) ** 2, 0.0, None) ** 3


def _plane_seeds(data: _Data, viewer: Float64[Array, 3], rng: np.random.Generator) -> list[Base]:
    """Best planes through three candidates in different directions."""
    points = data.points
    pick = rng.choice(len(points), size=(_TRIALS, 3), p=data.balance() / data.balance().sum())
    a, b, c = np.moveaxis(points[pick], 1, 0)
    normals = np.cross(b - a, c - a)
    length = np.linalg.norm(normals, axis=1)
    spread = np.maximum(np.linalg.norm(b - a, axis=1), np.linalg.norm(c - a, axis=1))
    usable = length > 0.2 * spread**2 + 1e-9
    normals, a = normals[usable] / length[usable, None], a[usable]
    normals *= np.sign(normals @ viewer)[:, None]
    tilted = normals @ (viewer / np.linalg.norm(viewer)) > 0.3
    normals, a = normals[tilted], a[tilted]
    if not len(a):
        raise no_rim("rim points on one line only", data.settings)
    offsets = (normals * a).sum(axis=1)
    some = rng.permutation(len(points))[:1500]
    balance = data.balance()[some]
    constant = data.scale(_COARSENESS[0])
    loss = _tukey_loss(points[some] @ normals.T - offsets, constant).T @ balance
    cut_off = (data.surface[::3] @ normals.T - offsets < -constant / 2).mean(axis=0)
    order = np.argsort(loss / balance.sum() + 2.0 * cut_off)[: 4 * _SEEDS]
    centre = points.mean(axis=0)
    seeds: list[Base] = []
    for i in order:
        if all(normals[i] @ seed.frame[2] < 0.995 for seed in seeds):
            origin = centre - normals[i] * (centre @ normals[i] - offsets[i])
            seeds.append(Base(origin=origin, frame=frame_towards(normals[i]), curvature_per_mm=0.0))
    return seeds[:_SEEDS]


def _cylinder_seeds(plane: Base, data: _Data, rng: np.random.Generator) -> list[Base]:
    """Best parabolic bases over a plane, each through four candidates."""
    local = (data.points - plane.origin) @ plane.frame.T
    surface = (data.surface[::3] - plane.origin) @ plane.frame.T
    probability = data.balance() / data.balance().sum()
    some = rng.permutation(len(local))[:1000]
    constant = data.scale(_COARSENESS[1])
    trials = max(1, _TRIALS // _GENERATORS)
    seeds = []
    for angle in np.arange(_GENERATORS) * np.pi / _GENERATORS:
        across = np.array([np.cos(angle), np.sin(angle)])
        s = local[:, :2] @ across

        def design(points: Float64[Array, "*n 3"], across: Float64[Array, 2] = across) -> Float64[Array, "*n 4"]:
            bend = points[..., :2] @ across
            return np.stack([np.ones_like(bend), points[..., 0], points[..., 1], -bend * bend / 2], axis=-1)

        pick = rng.choice(len(local), size=(trials, 4), p=probability)
        matrix = design(local[pick])
        usable = np.abs(np.linalg.det(matrix)) > 1e-3 * data.extent**4
        if not usable.any():
            continue
        solution = np.linalg.solve(matrix[usable], local[pick[usable], 2][..., None])[..., 0]
        solution = solution[(solution[:, 3] > 0) & (solution[:, 3] < 1 / data.extent)]
        if not len(solution):
            continue
        loss = data.balance()[some] @ _tukey_loss(local[some, 2][:, None] - design(local[some]) @ solution.T, constant)
        cut_off = (surface[:, 2][:, None] - design(surface) @ solution.T < -constant / 2).mean(axis=0)
        total = loss / data.balance()[some].sum() + 2.0 * cut_off
        best = int(np.argmin(total))
        seeds.append((float(total[best]), _from_parabola(plane, solution[best], angle, float(np.median(s)))))
    seeds.sort(key=lambda scored: scored[0])
    return [seed for _, seed in seeds[: _SEEDS // 2]] or [plane]


def _from_parabola(plane: Base, solution: Float64[Array, 4], angle: float, s_centre: float) -> Base:
    """Cylinder touching a parabolic sheet at s = `s_centre`. w = c₀ + c₁ x + c₂ y − κ s²/2."""
    c0, cx, cy, kappa = solution
    across = np.array([np.cos(angle), np.sin(angle)])
    foot = across * s_centre
    w = c0 + cx * foot[0] + cy * foot[1] - kappa * s_centre**2 / 2
    gradient = np.array([cx, cy]) - kappa * s_centre * across
    normal = np.array([-gradient[0], -gradient[1], 1.0])
    normal /= np.linalg.norm(normal)
    first = np.array([*across, gradient @ across])
    first -= normal * (first @ normal)
    first /= np.linalg.norm(first)
    frame = np.stack([first, np.cross(normal, first), normal]) @ plane.frame
    return Base(origin=plane.origin + np.array([*foot, w]) @ plane.frame, frame=frame, curvature_per_mm=float(kappa))


def moved(base: Base, step: Float64[Array, " k"], extent: float) -> Base:
    """A base moved by tilts (mm at `extent`), height (mm), bend (mm of sag) and its direction."""
    turn = np.array([step[0], step[1], step[4] if len(step) > 3 else 0.0]) / extent
    rotation = Rotation.from_rotvec(turn @ base.frame).as_matrix()
    bend = 2 * step[3] / extent**2 if len(step) > 3 else 0.0
    return Base(
        origin=base.origin + base.frame[2] * step[2],
        frame=base.frame @ rotation.T,
        curvature_per_mm=float(np.clip(base.curvature_per_mm + bend, 0.0, 1 / extent)),
    )


def ways_to_bend(plane: Base) -> list[Float64[Array, "3 3"]]:
    """Frames of a plane turned about its normal, one per direction of bending."""
    first, second, normal = plane.frame
    angles = np.arange(_WAYS) * np.pi / _WAYS
    return [
        np.stack(
            [np.cos(angle) * first + np.sin(angle) * second, np.cos(angle) * second - np.sin(angle) * first, normal]
        )
        for angle in angles
    ]


def _polish(base: Base, data: _Data, *, bend: bool) -> Base:
    """A base refined by iteratively reweighted Gauss–Newton steps, with a decreasing Tukey's constant."""
    parameters = 5 if bend else 3
    balance = data.balance()
    for coarseness in _COARSENESS:
        constant = data.scale(coarseness)
        for _ in range(_POLISH_ROUNDS):
            residuals = base.height(data.points)
            weights = _tukey(residuals, constant) * balance
            jacobian = np.stack(
                [
                    (moved(base, _STEP_MM * unit, data.extent).height(data.points) - residuals) / _STEP_MM
                    for unit in np.eye(parameters)
                ],
                axis=1,
            )
            normal = jacobian.T @ (jacobian * weights[:, None])
            normal += np.diag(np.full(parameters, 1e-6) * (1 + np.trace(normal)))
            step = -np.linalg.solve(normal, jacobian.T @ (residuals * weights))
            step *= min(1.0, 3 * data.scale(1.0) / max(float(np.abs(step).max()), 1e-12))
            base = moved(base, step, data.extent)
            if np.abs(step).max() < _CONVERGED_MM:
                break
    return base


def base_through(
    points: Float64[Array, "n 3"], viewer_direction: Float64[Array, 3], *, kind: BaseKind | None = None
) -> Base:
    """Least-squares plane or convex cylinder through rim points.

    Args:
        points: a closed curve on or near the base, mm, world frame.
        viewer_direction: towards the viewer's side of it.
        kind: plane or cylinder; None: the better one.
    """
    centre = points.mean(axis=0)
    offset = points - centre
    normal = np.linalg.svd(offset, full_matrices=False)[2][2]
    frame = frame_towards(normal if normal @ viewer_direction >= 0 else -normal)
    plane = Base(origin=centre, frame=frame, curvature_per_mm=0.0)
    extent = float(np.percentile(np.linalg.norm(offset, axis=1), 90))
    plane_rms = _rms(plane.height(points))
    if kind == "plane" or (kind is None and plane_rms < 1e-6 * extent):
        return plane
    data = _Data(
        points=points,
        sectors=np.zeros(len(points), dtype=np.int64),
        surface=points,
        settings=BaseRimSettings(),
        extent=extent,
        inlier_mm=_EVERY * extent,
    )
    starts = [replace(plane, frame=turned, curvature_per_mm=0.1 / extent) for turned in ways_to_bend(plane)]
    bent = [_polish(start, data, bend=True) for start in starts]
    cylinder = min(bent, key=lambda base: _rms(base.height(points)))
    return cylinder if kind or plane_rms > BEND_GAIN * _rms(cylinder.height(points)) else plane


def _rms(values: Float64[Array, " n"]) -> float:
    return float(np.sqrt(np.mean(values**2)))
