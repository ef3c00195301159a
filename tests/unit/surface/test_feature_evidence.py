"""A correction is made only where features that pairs share confirm it: they were not used to find it."""

from dataclasses import replace

import numpy as np
import pytest
from moving_rig import RADII, calibrated_rig, measured, standing
from spheres import ellipsoid_range

from mammometry.surface.motion.feature_evidence import SharedFeatures, weigh_correction
from mammometry.surface.motion.motion_detection import concerns, find, summary

RIG = calibrated_rig()


def still(camera, points):
    return np.zeros_like(points)


def shared_by(stood, count=60, *, by_chance=0, noise=0.4, seed=2):
    """Features on the body that cameras of different pairs share, as the cameras stood."""
    rng = np.random.default_rng(seed)
    found = []
    for first, second in (("front_l", "left_r"), ("front_r", "right_l"), ("front_l", "right_l"), ("front_r", "left_r")):
        camera, other = stood.cameras[first], stood.cameras[second]
        uv = rng.uniform(40, 110, (6 * count, 2))
        column, row = np.rint(uv).astype(int).T
        distance = ellipsoid_range(camera, RADII)[row, column]
        good = np.flatnonzero(np.isfinite(distance))[:count]
        points = camera.centre_world + camera.rays_world(np.rint(uv[good])) * distance[good, None]
        uv_first, uv_second = (each.project(points) for each in (camera, other))
        wild = rng.uniform(0, 150, (2, by_chance, 2))
        found.append(
            SharedFeatures(
                first=first,
                second=second,
                uv_first=np.concatenate([uv_first + rng.normal(0, noise, uv_first.shape), wild[0]]),
                unit_px=1.0,
                uv_second=np.concatenate([uv_second + rng.normal(0, noise, uv_second.shape), wild[1]]),
            )
        )
    return found


def turned(degrees):
    rng = np.random.default_rng(3)
    turns = {
        name: np.radians(degrees) * vector for name, vector in zip(RIG.cameras, rng.normal(size=(6, 3)), strict=True)
    }
    return standing(RIG, turns)


@pytest.mark.parametrize("by_chance", [0, 40])
def test_features_confirm_what_is_true_and_refute_what_is_not(by_chance):
    stood = turned(0.4)
    right = weigh_correction(RIG, stood, still, shared_by(stood, by_chance=by_chance))
    assert right.verdict == "confirmed"
    assert abs(right.share - 1.0) < 4 * right.std
    wrong = weigh_correction(RIG, stood, still, shared_by(RIG, by_chance=by_chance))
    assert wrong.verdict == "refuted"
    assert abs(wrong.share) < 4 * wrong.std


@pytest.mark.parametrize("seed", range(4))
def test_an_error_that_all_features_of_two_cameras_share_does_not_refute_what_is_true(seed):
    """A rest of the calibration moves all of them alike: many features know no more of a small motion than few."""
    rng = np.random.default_rng(seed)
    stood = turned(0.06)
    shared = shared_by(stood, 200, seed=seed)
    shared = [replace(two, uv_second=two.uv_second + rng.normal(0, 0.4, 2)) for two in shared]
    evidence = weigh_correction(RIG, stood, still, shared)
    assert evidence.verdict != "refuted"
    assert abs(evidence.share - 1.0) < 3 * evidence.std


def test_half_of_what_is_claimed_is_half():
    half = weigh_correction(RIG, turned(0.4), still, shared_by(turned(0.2)))
    assert abs(half.share - 0.5) < max(4 * half.std, 0.05)


def test_features_are_silent_of_what_is_smaller_than_they_are_sharp():
    assert weigh_correction(RIG, turned(0.002), still, shared_by(RIG)).verdict == "silent"
    assert weigh_correction(RIG, turned(0.4), still, []).verdict == "silent"
    assert weigh_correction(RIG, turned(0.4), still, shared_by(RIG, 1)[:1]).verdict == "silent"


def test_a_body_that_moved_between_exposures_is_a_displacement_of_its_points():
    """What a shift of a pair's cameras explains, the same displacement of its points does."""
    shift = np.array([4.0, -2.0, 3.0])
    stood = standing(RIG, shifts_mm={"left": shift})
    features = shared_by(stood)

    def breathed(camera, points):
        return np.tile(-shift if camera.startswith("left") else np.zeros(3), (len(points), 1))

    as_cameras = weigh_correction(RIG, stood, still, features)
    assert as_cameras.verdict == "confirmed"
    signs = {sign: weigh_correction(RIG, RIG, lambda c, p, s=sign: s * breathed(c, p), features) for sign in (1, -1)}
    best = max(signs.values(), key=lambda evidence: evidence.share)
    assert best.share == pytest.approx(as_cameras.share, abs=0.1)


@pytest.fixture(scope="module")
def disagreeing():
    """What pairs measure whose cameras turned by .1°."""
    stood = turned(0.06)
    both = {pair: measured(RIG, stood, pair, noise_mm=0.04) for pair in RIG.pair_names}
    return stood, [image for image, _ in both.values()], {pair: rows for pair, (_, rows) in both.items()}


@pytest.mark.slow
def test_a_correction_that_features_confirm_is_made(disagreeing):
    stood, images, rows = disagreeing
    found = find(RIG, images, rows, shared=lambda: shared_by(stood, 200, noise=0.02))
    assert found.corrected
    assert found.confirmation.verdict == "confirmed"


@pytest.mark.parametrize(("left", "made"), [(0.5, True), (0.0, False)])
@pytest.mark.slow
def test_where_features_are_silent_a_correction_must_explain_the_disagreement(disagreeing, left, made, monkeypatch):
    monkeypatch.setattr("mammometry.surface.motion.motion_detection._EXPLAINED_SHARE", left)
    _, images, rows = disagreeing
    found = find(RIG, images, rows, shared=list)
    assert found.confirmation.verdict == "silent"
    assert found.corrected == made
    assert ("motion-not-confirmed" in {notice.code for notice in concerns(found)}) != made


@pytest.mark.slow
@pytest.mark.requirement("R-CAL-2")
def test_a_correction_that_features_refute_is_not_made_and_said(disagreeing):
    """Pairs disagree as if cameras had turned, but all that they share lies where it should."""
    _, images, rows = disagreeing
    found = find(RIG, images, rows, shared=lambda: shared_by(RIG, 200, noise=0.02))
    assert not found.corrected
    assert found.rig(RIG) is RIG
    assert found.refuted
    assert not found.motions.any()
    assert found.rest_mm > 0.1
    assert [notice.code for notice in concerns(found)] == ["pairs-matched-less-well"]
    assert summary(found).startswith("nothing ")
