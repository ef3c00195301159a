"""Surveyed dots found by their constellation: every identity right, or none claimed; centres against exact pictures."""

import re
from dataclasses import replace

import numpy as np
import pytest
from printed import BRIGHT, DARK, SURROUND, _rays, camera, develop, distance_mm

from mammometry.base.photograph import Photograph
from mammometry.calibration.detection.detect import detect, detect_in
from mammometry.calibration.features.constellation import read_constellation
from mammometry.calibration.judge.no_target import no_target
from mammometry.calibration.targets.kinds.points import PointsTarget

DIAMETER_MM = 8.0
SLOPE = np.tan(np.radians(25.0))


def scattered(seed, count=30, apart_mm=19.0, half_mm=88.0):
    """Places in a square, never nearer to one another than `apart_mm`."""
    rng = np.random.default_rng(seed)
    places: list[np.ndarray] = []
    while len(places) < count:
        place = rng.uniform(-half_mm, half_mm, 2)
        if all(np.hypot(*(place - other)) > apart_mm for other in places):
            places.append(place)
    return np.array(places)


def on_roof(places):
    """Points of a roof whose ridge is the y axis, x counted along its slopes; it rises towards −z."""
    x = places[:, 0] * np.cos(np.arctan(SLOPE))
    return np.column_stack([x, places[:, 1], SLOPE * np.abs(x)])


def photograph_of_roof(view, places):
    """The roof with round dots, each pixel the mean of exact rays."""
    centre, rays = view.centre_world, _rays(view)
    value = np.full(rays.shape[:2], SURROUND)
    nearest = np.full(rays.shape[:2], np.inf)
    for side in (-1.0, 1.0):
        normal = np.array([-side * SLOPE, 0.0, 1.0])
        distance = -(centre @ normal) / (rays @ normal)
        point = centre + rays * distance[..., None]
        on = (distance > 0) & (distance < nearest) & (side * point[..., 0] >= 0)
        along = point[..., 0] / np.cos(np.arctan(SLOPE))
        on &= (np.abs(along) < 105) & (np.abs(point[..., 1]) < 105)
        off_mm = distance_mm(places[side * places[:, 0] >= 0], along[on], point[..., 1][on], DIAMETER_MM / 8)
        value[on] = np.where(off_mm < DIAMETER_MM / 2, DARK, BRIGHT)
        nearest = np.where(on, distance, nearest)
    return develop(value)


def target_of(points, **options):
    return PointsTarget(points_mm=tuple(map(tuple, points.tolist())), **options)


@pytest.fixture(scope="module")
def roof():
    places = scattered(3)
    places = places[np.abs(places[:, 0]) > 0.7 * DIAMETER_MM]  # no dot is folded over the ridge
    lens = (-0.12, 0.08, 0.0, 0.001, 0.0)
    view = camera(size_wh=(520, 420), turn_deg=(32.0, -24.0, 140.0), distortion=lens, focal_px=950.0)
    return places, view, photograph_of_roof(view, places)


@pytest.mark.slow
@pytest.mark.parametrize("diameter_mm", [DIAMETER_MM, pytest.param(None, marks=pytest.mark.slow)])
def test_dots_of_a_roof_are_found_named_and_measured(roof, diameter_mm):
    places, view, photograph = roof
    target = target_of(on_roof(places), dot_diameter_mm=diameter_mm)
    found = detect_in(photograph, target, camera="a", pose="00")
    error = found.uv - view.project(target.points_target)[found.ids]
    assert len(found.ids) >= len(places) - 2
    assert np.abs(error).max() < 0.2  # every dot is the point that it is said to be
    # Where the dots' diameter is not known, perspective moves their centres by what is then not corrected.
    assert np.sqrt(np.square(error).mean()) < (0.035 if diameter_mm is None else 0.03)
    assert np.abs(error.mean(axis=0)).max() < 0.01
    whitened = np.einsum("ni,nij,nj->n", error, np.linalg.inv(found.covariance_px2), error)
    assert np.median(whitened) < 6


@pytest.mark.slow
def test_a_target_that_is_not_in_the_picture_is_not_found(roof):
    other = target_of(on_roof(scattered(4)), dot_diameter_mm=DIAMETER_MM)
    seen = detect({("00", "a"): roof[2]}, other)
    assert seen.detections == ()
    assert re.match(r"no\b.*list", seen.missed[0].found)
    assert ".csv" in seen.missed[0].remedy
    blank = Photograph(name="blank", pixels=np.full((240, 320), 90, np.uint8))
    assert detect_in(blank, other, camera="a", pose="00") is None


@pytest.mark.slow
def test_a_symmetric_frame_is_refused_with_what_to_do(roof):
    """The same dots on both slopes: half a turn about the vertical and nobody could tell."""
    x, y = np.meshgrid([-75.0, -45.0, -15.0, 15.0, 45.0, 75.0], np.arange(-75.0, 76.0, 30.0))
    places = np.column_stack([x.ravel(), y.ravel()])
    target = target_of(on_roof(places), dot_diameter_mm=DIAMETER_MM)
    seen = detect({("00", "a"): photograph_of_roof(roof[1], places)}, target)
    assert seen.detections == ()
    found = seen.missed[0].found
    assert not found.startswith("no ")
    said = str(no_target(target, [seen], {}))
    assert found in said
    assert "symmetry" in said
    assert "id,u,v" in said
    assert ".csv" in said


@pytest.mark.slow
def test_a_mirrored_picture_shows_no_target(roof):
    places, _, photograph = roof
    mirrored = Photograph(name="m", pixels=np.ascontiguousarray(photograph.pixels[:, ::-1]))
    assert detect_in(mirrored, target_of(on_roof(places)), camera="a", pose="00") is None


# --- identities alone, from projected points ---


def shuffled(points, view, seed, *, clutter=6, noise_px=0.15, missing=0.2):
    """Dots of the points in any order, some missing, among others that are none; and which point each is (−1: none)."""
    rng = np.random.default_rng(seed)
    ids = np.flatnonzero(rng.random(len(points)) > missing)
    uv = np.concatenate([view.project(points[ids]), rng.uniform(0, 1, (clutter, 2)) * np.array(view.size_wh)])
    who = np.concatenate([ids, np.full(clutter, -1)])
    order = rng.permutation(len(uv))
    return (uv + noise_px * rng.normal(size=uv.shape))[order], who[order]


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_identities_hold_at_any_focal_length_obliquity_and_roll(seed):
    rng = np.random.default_rng(seed)
    points = on_roof(scattered(seed, 28)) + np.column_stack([np.zeros((28, 2)), rng.uniform(-8, 8, 28)])
    focal_px = [800.0, 1400.0, 2600.0][seed % 3]
    turn_deg = (*rng.uniform(-35, 35, 2), rng.uniform(-180, 180))
    view = camera(turn_deg=turn_deg, at=(10.0, -8.0, 0.6 * focal_px), focal_px=focal_px, distortion=(-0.1, 0, 0, 0, 0))
    uv, who = shuffled(points, view, seed)
    (reading,) = read_constellation(points, uv, view.size_wh)
    np.testing.assert_array_equal(who[reading.dots], reading.ids)
    assert len(reading.ids) > 0.9 * (who >= 0).sum()


@pytest.mark.slow
def test_a_regular_grid_is_ambiguous_and_said_to_be():
    x, y = np.meshgrid(np.arange(6) * 30.0, np.arange(5) * 30.0)
    points = np.column_stack([x.ravel() - 75, y.ravel() - 60, np.zeros(30)])
    view = camera(turn_deg=(20.0, 15.0, 10.0))
    uv, _ = shuffled(points, view, 1)
    assert len(read_constellation(points, uv, view.size_wh)) == 2


@pytest.mark.slow
@pytest.mark.parametrize("seed", [5])
def test_a_scatter_of_dots_and_an_inverted_relief_are_no_target(seed):
    points = on_roof(scattered(seed, 28)) + np.array([0.0, 0.0, 1.0]) * np.random.default_rng(seed).uniform(
        -10, 10, (28, 1)
    )
    view = camera(turn_deg=(25.0, 20.0, 10.0))
    scatter = np.random.default_rng(seed).uniform(0, 1, (30, 2)) * np.array(view.size_wh)
    assert read_constellation(points, scatter, view.size_wh) == ()
    uv, _ = shuffled(points * np.array([1.0, 1.0, -1.0]), view, seed, clutter=0, missing=0.0)
    assert read_constellation(points, uv, view.size_wh) == ()


def test_too_few_points_are_not_read():
    points = on_roof(scattered(1, 7))
    view = replace(camera())
    assert read_constellation(points, view.project(points), view.size_wh) == ()
