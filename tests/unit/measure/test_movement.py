"""What a motion leaves unknown of a volume, worked by hand on a flat sheet that two pairs measured."""

from dataclasses import replace

import numpy as np
import pytest
from test_uncertainty import RIM, SHEET, wall

from mammometry.geometry.camera import Camera, Rig
from mammometry.geometry.transform import Transform
from mammometry.measure.boundary.boundary import Boundary
from mammometry.measure.volume.uncertainty import CaptureMotion, VolumeEvidence, interval, movement_cc, movement_of
from mammometry.surface.motion.motion_detection import Displaced, MotionEstimate
from mammometry.surface.motion.rigid_motion import MotionParameters, motion_parameters
from mammometry.surface.repair.repair import Provenance, RepairedSurface

MIDDLE = np.array([50.0, 50.0, 0.0])
BAND_MM = 4.5  # along the rim, measured by one pair; the other one measured all within


def _camera(name: str, x_mm: float) -> Camera:
    """800 mm above the sheet, looking down."""
    rotation = np.diag([1.0, -1.0, -1.0])
    centre = MIDDLE + np.array([x_mm, 0.0, 800.0])
    return Camera(
        name=name,
        size_wh=(1000, 1000),
        matrix=np.array([[2000.0, 0, 500], [0, 2000, 500], [0, 0, 1]]),
        distortion=np.zeros(5),
        camera_from_world=Transform(rotation=rotation, translation_mm=-rotation @ centre),
    )


RIG = Rig(
    name="two",
    cameras={name: _camera(name, x) for name, x in (("al", -300.0), ("ar", -100.0), ("bl", 100.0), ("br", 300.0))},
    pair_names={"a": ("al", "ar"), "b": ("bl", "br")},
)
ASKED: MotionParameters = motion_parameters(RIG, ["a", "b"], MIDDLE)


def _surface() -> RepairedSurface:
    inner = ((SHEET.vertices[:, :2] > BAND_MM) & (SHEET.vertices[:, :2] < 100 - BAND_MM)).all(axis=1)
    return RepairedSurface(
        mesh=SHEET,
        provenance=np.full(len(inner), Provenance.MEASURED, dtype=np.uint8),
        sigma_mm=np.full(len(inner), 0.05, dtype=np.float32),
        pair_bits=np.where(inner, 2, 1).astype(np.int32),
        pair_names=("a", "b"),
        convergence=np.zeros(1),
    )


def _found(covariance: np.ndarray, *, rest_mm: float = 0.0, moved: bool = True) -> MotionEstimate:
    return MotionEstimate(
        compared=True, moved=moved, corrected=True, parameters=ASKED, motions=np.zeros(ASKED.count),
        covariance=covariance, rest_mm=rest_mm, evidence=20.0, distance_mm=(0.4, 0.1),
        displaced=(Displaced(pair="b", effect_mm=0.3, std_mm=0.1, body_mm=0.3),),
    )  # fmt: skip


def _std_cc(mode: np.ndarray, rest_mm: float = 0.0) -> float:
    movement = CaptureMotion(found=_found(np.outer(mode, mode), rest_mm=rest_mm), rig=RIG)
    shared_cc, own_cc = movement_cc(movement, SHEET, RIM, _surface())
    return float(np.hypot(np.linalg.norm(shared_cc), own_cc))


def _mode(**values_of_pairs: tuple[int, float]) -> np.ndarray:
    mode = np.zeros(ASKED.count)
    for pair, (number, value) in values_of_pairs.items():
        mode[ASKED.of_group(pair)][number] = value
    return mode


def test_a_pair_that_moved_towards_the_skin_lifts_what_it_measured() -> None:
    """0.2 mm over the square within the band: a cell more or less on either side, 2 %."""
    within_mm2 = (100 - 2 * BAND_MM) ** 2
    assert _std_cc(_mode(b=(5, 0.2))) == pytest.approx(0.2 * within_mm2 / 1000, rel=0.025)


def test_the_wall_moves_along_with_the_pair_that_measured_the_boundary() -> None:
    """Lifting the boundary alone is lowering the skin within it."""
    assert _std_cc(_mode(a=(5, 0.2))) == pytest.approx(_std_cc(_mode(b=(5, 0.2))), rel=1e-6)


def test_what_moves_all_pairs_together_changes_no_volume() -> None:
    for number, value in ((0, 1e-3), (2, 1e-3), (5, 0.5)):
        assert _std_cc(_mode(a=(number, value), b=(number, value))) < 1e-6


def test_along_the_skin_nothing_changes() -> None:
    assert _std_cc(_mode(b=(0, 0.0))) == 0.0
    assert _std_cc(_mode(b=(3, 0.5))) < 1e-9


def test_a_camera_that_turned_lifts_by_the_square_of_the_distance_over_the_baseline() -> None:
    """The right camera turned by δ about its y: depth is off by Z²δ/b, and more to the side of it by its square."""
    mode = np.zeros(ASKED.count)
    mode[ASKED.of_camera("br")] = [0.0, 1e-4, 0.0]
    x, y = SHEET.vertices[:, 0], SHEET.vertices[:, 1]
    inner = ((SHEET.vertices[:, :2] > BAND_MM) & (SHEET.vertices[:, :2] < 100 - BAND_MM)).all(axis=1)
    tangent = (x - 350.0) / 800.0
    lifted_mm = 800.0**2 / 200.0 * 1e-4 * (1 + tangent**2)
    assert y[inner].size
    assert _std_cc(mode) == pytest.approx(lifted_mm[inner].mean() * (100 - 2 * BAND_MM) ** 2 / 1000, rel=0.03)


def test_what_no_motion_explains_is_alike_within_some_distance() -> None:
    expected = 0.2 / np.sqrt(2) * np.sqrt(10_000 * np.pi * 40.0**2) / 1000
    assert _std_cc(np.zeros(ASKED.count), rest_mm=0.2) == pytest.approx(expected, rel=1e-6)


def test_the_interval_has_the_term_and_says_so() -> None:
    boundary = Boundary(name="model", points_world=RIM, method="", sigma_mm=0.05)
    mode = _mode(b=(5, 0.2))
    evidence = VolumeEvidence(surface=_surface(), movement=movement_of(_found(np.outer(mode, mode)), RIG))
    found, without = (
        interval(boundary, wall("plane"), 400.0, evidence=each) for each in (evidence, replace(evidence, movement=None))
    )
    assert found.terms_cc["movement"] == pytest.approx(1.96 * _std_cc(mode))
    assert {name: term for name, term in found.terms_cc.items() if name != "movement"} == dict(without.terms_cc)
    assert "moved" in found.note
    assert "moved" not in without.note
    assert found.interval_cc is not None
    assert without.interval_cc is not None
    assert found.interval_cc[1] > without.interval_cc[1]


def test_nothing_moved_is_no_term() -> None:
    assert movement_of(_found(np.zeros((ASKED.count,) * 2), moved=False), RIG) is None
