"""Errors of a device at each position of an artefact, with uncertainties and decisions."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Literal, TypeAlias

import numpy as np

from mammometry.base.value import value
from mammometry.geometry.arrays import Array, Float64
from mammometry.geometry.mesh import TriangleMesh
from mammometry.study.acceptance.artefacts import (
    KINDS,
    POSITIONS,
    QUANTITIES,
    AcceptanceTest,
    Artefact,
    Bar,
    Cast,
    Kind,
    Limits,
    Plane,
    Quantity,
    Sphere,
    effect_cc,
)
from mammometry.study.acceptance.fits import (
    DISPERSION,
    LEFT_OUT,
    jackknife_std,
    narrowest_width,
    sphere_shifts,
    width_shifts,
    within_rule,
)
from mammometry.study.acceptance.patches import PatchError, PlanePatch, SpherePatch
from mammometry.study.acceptance.planes import find_plane
from mammometry.study.acceptance.spheres import find_sphere, find_two_spheres

Decision: TypeAlias = Literal["accept", "reject", "undecided"]
_WORST: tuple[Decision, ...] = ("reject", "undecided", "accept")
COVERAGE = 2.0
"""Ratio of expanded to standard uncertainty: 95 % (ISO 14253-1)."""


@value
class AcceptanceFinding:
    """One error of the device at one position."""

    kind: Kind
    position: str
    quantity: Quantity
    measured: float
    """mm, or cc for a volume."""
    reference: float
    """Value of the artefact, in the same unit. 0 for form and flatness."""
    limit: float
    """Largest error of an accepted device, in the same unit."""
    artefact_std: float
    """Standard uncertainty of the reference, in the same unit."""
    fit_std: float
    """Standard uncertainty of the measured value due to the finite number of points, in the same unit."""

    @property
    def error(self) -> float:
        """Measured minus reference, in the same unit."""
        return self.measured - self.reference

    @property
    def expanded(self) -> float:
        """Expanded uncertainty of the error (95 %), in the same unit."""
        return COVERAGE * float(np.hypot(self.artefact_std, self.fit_std))

    @property
    def decision(self) -> Decision:
        """Decision according to ISO 14253-1."""
        return decide(self.error, self.expanded, self.limit)

    @property
    def effect_cc(self) -> float:
        """Change of a breast of 400 cc due to this error, cc."""
        return effect_cc(self.quantity, self.error, self.reference)


@value(eq=False)
class PositionResult:
    """Errors at one position of an artefact."""

    kind: Kind
    position: str
    findings: tuple[AcceptanceFinding, ...]
    patches: tuple[SpherePatch | PlanePatch, ...] = ()
    """Evaluated surfaces, for pictures. Empty for a cast."""

    @property
    def widest_mm(self) -> float | None:
        """Width that contains all points except the 0.3 % farthest ones, mm. None for a cast."""
        widths = [np.ptp(patch.deviations_mm[within_rule(patch.deviations_mm)]) for patch in self.patches]
        return float(max(widths)) if widths else None

    @property
    def share_left_out(self) -> float:
        """Share of points that are too far from the surface to belong to it. The rule allows 0.3 %."""
        return max((patch.share_left_out for patch in self.patches), default=0.0)


@value(eq=False)
class Outcome:
    """Result of an acceptance test."""

    test: AcceptanceTest
    results: tuple[PositionResult, ...]

    @property
    def findings(self) -> tuple[AcceptanceFinding, ...]:
        """All errors."""
        return tuple(finding for result in self.results for finding in result.findings)

    @property
    def missing(self) -> Mapping[Kind, tuple[str, ...]]:
        """Artefact of the test → positions without a measurement."""
        done = {(result.kind, result.position) for result in self.results}
        named = {
            kind: tuple(place.name for place in POSITIONS[kind] if (kind, place.name) not in done)
            for kind in KINDS
            if kind in self.test.artefacts
        }
        return {kind: names for kind, names in named.items() if names}

    @property
    def left_out(self) -> tuple[PositionResult, ...]:
        """Positions at which more points are excluded than the rule allows."""
        return tuple(result for result in self.results if result.share_left_out > LEFT_OUT)

    @property
    def worst(self) -> Mapping[tuple[Kind, Quantity], AcceptanceFinding]:
        """The decisive error for each quantity."""
        return {
            (kind, quantity): worst_of(found)
            for kind in KINDS
            for quantity in QUANTITIES[kind]
            if (found := [one for one in self.findings if (one.kind, one.quantity) == (kind, quantity)])
        }

    @property
    def decision(self) -> Decision:
        """Decision on the device. An incomplete test never leads to acceptance."""
        decisions = {finding.decision for finding in self.findings}
        if self.missing or self.left_out or not decisions:
            decisions.add("undecided")
        return next(one for one in _WORST if one in decisions)


def decide(error: float, expanded: float, limit: float) -> Decision:
    """Decide by ISO 14253-1: to pass or fail, the error must differ from the limit by its uncertainty.

    Args:
        error: measured error.
        expanded: its expanded uncertainty.
        limit: largest allowed error.

    Returns:
        ``accept`` if error plus uncertainty is within the limit, ``reject`` if the error exceeds the limit by more than
        the uncertainty, otherwise ``undecided``.
    """
    if abs(error) + expanded <= limit:
        return "accept"
    return "reject" if abs(error) - expanded > limit else "undecided"


def worst_of(findings: Iterable[AcceptanceFinding]) -> AcceptanceFinding:
    """The worst finding, by `severity`."""
    return min(findings, key=lambda one: severity(one.error, one.expanded, one.limit))


def severity(error: float, expanded: float, limit: float) -> tuple[int, float]:
    """Sort key that puts the worst error first: by decision, then by the ratio of error to limit."""
    return _WORST.index(decide(error, expanded, limit)), -abs(error) / limit


def evaluate_mesh(mesh: TriangleMesh, kind: Kind, position: str, artefact: Artefact, limits: Limits) -> PositionResult:
    """Evaluate the mesh of an artefact at one position.

    Args:
        mesh: the mesh, mm.
        kind: kind of the artefact.
        position: name of the position.
        artefact: the artefact, with reference values.
        limits: limits of the errors.

    Raises:
        PatchError: the artefact is not in the mesh, or a cast's mesh is open.
    """
    match artefact:
        case Sphere():
            return sphere_result(find_sphere(mesh, artefact.diameter_mm), position, artefact, limits)
        case Bar():
            return bar_result(
                find_two_spheres(mesh, artefact.diameter_mm, artefact.distance_mm), position, artefact, limits
            )
        case Plane():
            return _plane(find_plane(mesh), position, artefact, limits)
        case Cast():
            if not mesh.is_watertight():
                raise PatchError("an open mesh, which has no volume")
            return evaluate_volume(abs(mesh.volume_mm3()) / 1000.0, position, artefact, limits)


def evaluate_volume(volume_cc: float, position: str, cast: Cast, limits: Limits) -> PositionResult:
    """Evaluate the volume of a cast at one position."""
    finding = AcceptanceFinding(
        kind="cast", position=position, quantity="volume", measured=volume_cc, reference=cast.volume_cc,
        limit=limits.volume_share * cast.volume_cc, artefact_std=cast.volume_std_cc, fit_std=0.0,
    )  # fmt: skip
    return PositionResult(kind="cast", position=position, findings=(finding,))


def sphere_result(patch: SpherePatch, position: str, ball: Sphere, limits: Limits) -> PositionResult:
    """Form and size of a ball at one position."""
    size_std = 2 * float(jackknife_std(_shifts(patch))[3])
    findings = (
        AcceptanceFinding(
            kind="sphere", position=position, quantity="form", reference=0.0, limit=limits.form_mm,
            artefact_std=ball.form_std_mm, **_width(patch),
        ),
        AcceptanceFinding(
            kind="sphere", position=position, quantity="size", measured=2 * patch.fit.radius_mm,
            reference=ball.diameter_mm, limit=limits.size_mm, artefact_std=ball.diameter_std_mm, fit_std=size_std,
        ),
    )  # fmt: skip
    return PositionResult(kind="sphere", position=position, findings=findings, patches=(patch,))


def _width(patch: SpherePatch | PlanePatch) -> dict[str, float]:
    """Width that contains 95 % of the points, and its standard uncertainty, mm."""
    deviations = patch.deviations_mm
    shifts = [width_shifts(deviations, patch.weights, cells, DISPERSION) for cells in patch.cells]
    width = narrowest_width(deviations, patch.weights, DISPERSION)
    return {"measured": width, "fit_std": float(jackknife_std(shifts)[0])}


def _shifts(patch: SpherePatch) -> list[Float64[Array, "c 4"]]:
    """Changes of centre and radius as each cell is left out in turn, for each size of cells."""
    return [sphere_shifts(patch.fit, patch.points, patch.weights, cells) for cells in patch.cells]


def bar_result(patches: tuple[SpherePatch, SpherePatch], position: str, bar: Bar, limits: Limits) -> PositionResult:
    """Spacing and length of a bar at one position."""
    between = patches[1].fit.centre - patches[0].fit.centre
    distance = float(np.linalg.norm(between))
    variances = np.zeros(2)
    for patch, sign in zip(patches, (-1.0, 1.0), strict=True):
        to_ends = np.zeros((4, 2))  # along the bar, of the centre and of the outer end
        to_ends[:3], to_ends[3, 1] = (between / distance)[:, None], sign
        variances += jackknife_std(shifts @ to_ends for shifts in _shifts(patch)) ** 2
    length = distance + patches[0].fit.radius_mm + patches[1].fit.radius_mm
    reference = bar.distance_mm + bar.diameter_mm
    spacing_std, length_std = np.sqrt(variances)
    findings = (
        AcceptanceFinding(
            kind="bar", position=position, quantity="spacing", measured=distance, reference=bar.distance_mm,
            limit=limits.length_share * bar.distance_mm, artefact_std=bar.distance_std_mm, fit_std=float(spacing_std),
        ),
        AcceptanceFinding(
            kind="bar", position=position, quantity="length", measured=length, reference=reference,
            limit=limits.length_share * reference + limits.size_mm,
            artefact_std=float(np.hypot(bar.distance_std_mm, bar.diameter_std_mm)), fit_std=float(length_std),
        ),
    )  # fmt: skip
    return PositionResult(kind="bar", position=position, findings=findings, patches=patches)


def _plane(patch: PlanePatch, position: str, plane: Plane, limits: Limits) -> PositionResult:
    finding = AcceptanceFinding(
        kind="plane", position=position, quantity="flatness", reference=0.0, limit=limits.flatness_mm,
        artefact_std=plane.flatness_std_mm, **_width(patch),
    )  # fmt: skip
    return PositionResult(kind="plane", position=position, findings=(finding,), patches=(patch,))
