"""Errors put into artefacts are found with the right size, decided by ISO 14253-1, and covered by the uncertainty."""

import datetime
from typing import Any

import numpy as np
import pytest
from scipy.optimize import least_squares
from tests.first_cases import first

from mammometry.geometry.mesh import TriangleMesh, joined
from mammometry.simulate.artefacts import DeviceErrors, measured_mesh
from mammometry.simulate.scan import QUALITIES, scan
from mammometry.simulate.subjects.artefacts import artefact_mesh
from mammometry.simulate.subjects.registry import make_subject
from mammometry.simulate.subjects.shapes import plate
from mammometry.study.acceptance.artefacts import (
    POSITIONS,
    AcceptanceTest,
    Artefact,
    Bar,
    Cast,
    Kind,
    Limits,
    Plane,
    Sphere,
    breast_area_mm2,
    effect_cc,
)
from mammometry.study.acceptance.evaluate import (
    AcceptanceFinding,
    Outcome,
    PositionResult,
    decide,
    evaluate_mesh,
    worst_of,
)
from mammometry.study.acceptance.patches import PatchError
from mammometry.study.acceptance.spheres import find_sphere

BALL = Sphere(diameter_mm=145.0, diameter_std_mm=0.01, form_std_mm=0.01, source="drawn")
BAR = Bar(distance_mm=300.0, distance_std_mm=0.01, diameter_mm=60.0, diameter_std_mm=0.01, source="drawn")
FLAT = Plane(flatness_std_mm=0.01, source="drawn")
CAST = Cast(volume_cc=400.0, volume_std_cc=0.2, source="drawn")
ARTEFACTS: dict[Kind, Artefact] = {"sphere": BALL, "bar": BAR, "plane": FLAT, "cast": CAST}


def found(
    kind: Kind, errors: DeviceErrors, *, place: int = 0, seed: int = 0, also: Any = None
) -> dict[str, AcceptanceFinding]:
    """Errors of a drawn artefact at a position, by quantity."""
    position = POSITIONS[kind][place]
    mesh = artefact_mesh(ARTEFACTS[kind], position, edge_mm=3.0)
    mesh = mesh if also is None else joined([mesh, also])
    measured = measured_mesh(mesh, errors, np.random.default_rng(seed))
    return {
        one.quantity: one for one in evaluate_mesh(measured, kind, position.name, ARTEFACTS[kind], Limits()).findings
    }


@pytest.mark.requirement("R-ACCEPT-1")
@pytest.mark.parametrize("place", [0, 1, 9])
def test_a_perfect_sphere_has_no_error(place: int) -> None:
    errors = found("sphere", DeviceErrors(), place=place)
    assert abs(errors["size"].error) < 0.005  # its triangles' corners lie on it to 1 µm
    assert errors["form"].error < 0.005
    assert {one.decision for one in errors.values()} == {"accept"}


@pytest.mark.requirement("R-ACCEPT-1")
@pytest.mark.parametrize("scale", first(1, [0.002, -0.002]))
def test_a_wrong_scale_is_found_with_its_size(scale: float) -> None:
    errors = DeviceErrors(scale=scale, noise_mm=0.05)
    size, bar = found("sphere", errors)["size"], found("bar", errors)
    for one in (size, *bar.values()):
        assert one.error == pytest.approx(scale * one.reference, abs=0.02)
    assert {size.decision, bar["spacing"].decision, bar["length"].decision} == {"reject"}
    volume = found("cast", errors)["volume"]
    assert volume.error / volume.reference == pytest.approx((1 + scale) ** 3 - 1, abs=2e-4)
    assert bar["spacing"].effect_cc == pytest.approx(400.0 * ((1 + scale) ** 3 - 1), rel=0.1)


@pytest.mark.slow
@pytest.mark.requirement("R-ACCEPT-1")
@pytest.mark.parametrize("noise_mm", [0.05, 0.3])
def test_noise_is_found_with_its_size(noise_mm: float) -> None:
    """95 % of normal errors lie within ± 1.96 standard deviations."""
    errors = DeviceErrors(noise_mm=noise_mm)
    for one in (found("sphere", errors)["form"], found("plane", errors)["flatness"]):
        assert one.error == pytest.approx(2 * 1.96 * noise_mm, rel=0.06)
        assert one.decision == ("accept" if noise_mm < 0.1 else "reject")
    assert abs(found("sphere", errors)["size"].error) < 0.1 * noise_mm + 0.005


def deviations_by_scipy(points: np.ndarray) -> np.ndarray:
    """Distances from the ball that scipy fits to points around the origin."""

    def rest(ball: np.ndarray) -> np.ndarray:
        return np.linalg.norm(points - ball[:3], axis=1) - ball[3]

    return np.asarray(least_squares(rest, [0.0, 0.0, 0.0, 70.0]).fun)


@pytest.mark.slow
@pytest.mark.requirement("R-ACCEPT-1")
def test_a_virtual_telephones_errors_are_found_with_their_size() -> None:
    """Form: the width about scipy's ball. Scale: 2 % put into the scan, beside the errors of the telephone's poses."""
    widths = {}
    for quality in ("telephone", "fine"):
        mesh = scan(make_subject("test-sphere_1", 0, edge_mm=2.0), QUALITIES[quality], 0).mesh
        (form, _) = evaluate_mesh(mesh, "sphere", "1", BALL, Limits()).findings
        points = find_sphere(mesh, BALL.diameter_mm).points
        rest = deviations_by_scipy(points)
        assert form.error == pytest.approx(np.ptp(np.percentile(rest, [2.5, 97.5])), rel=0.1)
        widths[quality] = form.error
    assert widths["telephone"] > 1.3 * widths["fine"] > 1.3 * Limits().form_mm
    bar = make_subject("test-bar_1", 0, edge_mm=2.0)
    for seed in range(2):
        mesh = scan(bar, QUALITIES["fine"], seed).mesh
        for share in (0.0, 0.02):
            grown = TriangleMesh(vertices=(1 + share) * mesh.vertices, faces=mesh.faces)
            spacing, length = evaluate_mesh(grown, "bar", "1", BAR, Limits()).findings
            assert spacing.error == pytest.approx(300 * share, abs=0.4)
            assert length.error == pytest.approx(360 * share, abs=0.6)
            assert not share or {spacing.decision, length.decision} == {"reject"}


@pytest.mark.requirement("R-ACCEPT-1")
def test_a_bent_plane_is_found_with_its_size() -> None:
    mesh = artefact_mesh(FLAT, POSITIONS["plane"][0])
    y = mesh.vertices[:, 1]  # from −120 to 120 mm
    bent = TriangleMesh(vertices=mesh.vertices + np.outer(y**2 / 120.0**2, [0.0, 0.0, 1.0]), faces=mesh.faces)
    (flatness,) = evaluate_mesh(bent, "plane", "1", FLAT, Limits()).findings
    assert flatness.error == pytest.approx((0.95 * 110.0 / 120.0) ** 2, abs=0.05)  # 10 mm at the edges are left out


@pytest.mark.parametrize("place", range(6))
def test_a_bump_in_front_of_a_plane_is_positive(place: int) -> None:
    """The device is at positive z, whatever the order of the mesh's triangles."""
    position = POSITIONS["plane"][place]
    mesh = artefact_mesh(FLAT, position)
    normal = np.array(position.axis) / np.linalg.norm(position.axis)
    away = np.linalg.norm(mesh.vertices - mesh.vertices.mean(axis=0), axis=1)
    bump = np.exp(-((away / 20.0) ** 2))
    bent = TriangleMesh(vertices=mesh.vertices + np.outer(bump, normal), faces=mesh.faces)
    (patch,) = evaluate_mesh(bent, "plane", position.name, FLAT, Limits()).patches
    assert patch.deviations_mm.max() > 0.5
    assert patch.deviations_mm.min() > -0.5


def test_an_open_cast_is_refused() -> None:
    mesh = artefact_mesh(CAST, POSITIONS["cast"][0], edge_mm=6.0)
    with pytest.raises(PatchError):
        evaluate_mesh(TriangleMesh(vertices=mesh.vertices, faces=mesh.faces[1:]), "cast", "1", CAST, Limits())


@pytest.mark.slow
def test_a_table_and_a_stand_are_not_taken_for_the_ball() -> None:
    table = plate(400.0, 400.0, 6.0, edge_mm=4.0).mesh
    up = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
    table = TriangleMesh(vertices=table.vertices @ up.T + [0.0, -72.5, 0.0], faces=table.faces)
    errors = found("sphere", DeviceErrors(noise_mm=0.03), also=table)
    assert abs(errors["size"].error) < 0.02
    assert errors["form"].error < 0.15


@pytest.mark.slow
def test_spikes_within_the_ball_are_reported() -> None:
    """2 % of the points fly 20 mm before the ball: more than the rule lets be left out."""
    mesh = artefact_mesh(BALL, POSITIONS["sphere"][0], edge_mm=3.0)
    rng = np.random.default_rng(0)
    vertices = mesh.vertices.copy()
    spikes = rng.random(len(vertices)) < 0.02
    vertices[spikes] *= 1.0 + 20.0 / 72.5
    result = evaluate_mesh(TriangleMesh(vertices=vertices, faces=mesh.faces), "sphere", "1", BALL, Limits())
    assert 0.01 < result.share_left_out < 0.04
    assert abs(result.findings[1].error) < 0.5


@pytest.mark.slow
def test_moderate_outliers_count_in_the_form() -> None:
    mesh = artefact_mesh(BALL, POSITIONS["sphere"][0], edge_mm=3.0)
    rng = np.random.default_rng(0)
    vertices = mesh.vertices.copy()
    vertices[rng.random(len(vertices)) < 0.08] *= 1.0 + 5.0 / 72.5  # 8 % lie 5 mm out, beyond the search's shell
    form, _ = evaluate_mesh(TriangleMesh(vertices=vertices, faces=mesh.faces), "sphere", "1", BALL, Limits()).findings
    assert form.decision == "reject"
    assert form.error > 4.0


@pytest.mark.parametrize(
    ("kind", "wrong"), first(1, [("bar", "sphere"), ("plane", "cast"), ("sphere", "bar"), ("sphere", "plane")])
)
def test_another_artefact_is_refused(kind: Kind, wrong: Kind) -> None:
    mesh = artefact_mesh(ARTEFACTS[wrong], POSITIONS[wrong][0], edge_mm=3.0)
    with pytest.raises(PatchError):
        evaluate_mesh(mesh, kind, "1", ARTEFACTS[kind], Limits())


@pytest.mark.requirement("R-ACCEPT-2")
@pytest.mark.parametrize(
    ("error", "decision"),
    [(0.0, "accept"), (0.3, "accept"), (-0.3, "accept"), (0.35, "undecided"), (-0.45, "undecided"), (0.51, "reject"),
     (-0.51, "reject")],
)  # fmt: skip
def test_the_uncertainty_counts_in_the_decision(error: float, decision: str) -> None:
    assert decide(error, 0.1, 0.4) == decision


def outcome(*kinds: Kind, places: slice = slice(None), error_mm: float = 0.0) -> Outcome:
    """A test whose size errors are given, without meshes."""
    results = tuple(
        PositionResult(
            kind=kind,
            position=position.name,
            findings=(
                AcceptanceFinding(
                    kind=kind, position=position.name, quantity="size", measured=145.0 + error_mm, reference=145.0,
                    limit=0.2, artefact_std=0.01, fit_std=0.01,
                ),
            ),
        )
        for kind in kinds
        for position in POSITIONS[kind][places]
    )  # fmt: skip
    about = AcceptanceTest(
        device="Rig", software="", person="ab", date=datetime.date(2026, 11, 29), units="mm",
        artefacts={kind: ARTEFACTS[kind] for kind in kinds},
    )  # fmt: skip
    return Outcome(test=about, results=results)


@pytest.mark.requirement("R-ACCEPT-2")
def test_missing_positions_are_named_and_accept_nothing() -> None:
    assert outcome("sphere").decision == "accept"
    partly = outcome("sphere", places=slice(8))
    assert (partly.decision, dict(partly.missing)) == ("undecided", {"sphere": ("9", "10")})
    assert outcome("sphere", places=slice(8), error_mm=0.5).decision == "reject"


def test_the_fewest_positions_are_the_standards() -> None:
    assert (len(POSITIONS["sphere"]), len(POSITIONS["bar"])) == (10, 7)
    for positions in POSITIONS.values():
        assert [position.name for position in positions] == [str(k + 1) for k in range(len(positions))]
        assert len({(position.centre, position.axis, position.words) for position in positions}) == len(positions)


def test_the_worst_finding_decides() -> None:
    def one(measured: float, limit: float) -> AcceptanceFinding:
        return AcceptanceFinding(
            kind="sphere", position="1", quantity="size", measured=measured, reference=100.0, limit=limit,
            artefact_std=0.05, fit_std=0.0,
        )  # fmt: skip

    large, unsure = one(100.3, 0.5), one(99.95, 0.1)
    assert worst_of([large, unsure]) is unsure
    assert worst_of([large, one(100.1, 0.5)]) is large


def test_effects_on_a_breast_follow_from_geometry() -> None:
    radius = (3 * 400_000 / (2 * np.pi)) ** (1 / 3)
    assert breast_area_mm2() == pytest.approx(2 * np.pi * radius**2)
    grown = 2 / 3 * np.pi * (radius + 0.15) ** 3 / 1000 - 400
    assert effect_cc("size", 0.3, 145.0) == pytest.approx(grown, rel=0.01)
    assert effect_cc("spacing", 0.3, 100.0) == pytest.approx(400 * (1.003**3 - 1))
    assert effect_cc("volume", 4.0, 400.0) == pytest.approx(4.0)


@pytest.mark.slow
@pytest.mark.requirement("R-ACCEPT-3")
def test_the_uncertainty_covers_the_error() -> None:
    """Scans of a ball with errors that neighbours share: about 95 % are within the expanded uncertainty."""
    inside = [
        abs(one.error) <= one.expanded
        for seed in range(12)
        for one in [found("sphere", DeviceErrors(noise_mm=0.05, shared_mm=0.05), seed=seed)["size"]]
    ]
    assert np.count_nonzero(inside) >= 10  # fewer of 12 have a probability of 2 % at 95 %
