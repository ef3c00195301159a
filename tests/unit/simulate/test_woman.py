"""Virtual women have the statistics of the real ones, and volumes that are known exactly."""

import functools

import numpy as np
import pytest
from tests.first_cases import first

from mammometry.geometry.mesh import TriangleMesh
from mammometry.simulate.subjects.solid import SubjectSolid
from mammometry.simulate.subjects.woman import Woman, woman_named
from mammometry.simulate.subjects.woman_shape import (
    FLAT_CC,
    HEIGHT_MM,
    LAYER_MM,
    LAYER_SD_MM,
    LAYER_SIDES_R,
    MUSCLE_MM,
    MUSCLE_SD_MM,
    RADII,
    SIDES,
    WIDTH_MM,
    outline_area_mm2,
    outline_mm,
    woman_shape,
)

_WOMEN = 200
_STANDARD_ERRORS = 4.0  # of a mean of so many women; sides of one woman are nearly one
_REAL_WOMEN = 77  # on whom the statistics rest


@functools.cache
def drawn() -> dict[str, np.ndarray]:
    """Measure → (woman, side, …)."""
    shapes = [woman_shape(number, 0) for number in range(_WOMEN)]
    breasts = [[shape.breasts[side] for side in SIDES] for shape in shapes]
    return {
        "width": np.array([[each.width_mm for each in both] for both in breasts]),
        "height": np.array([[each.height_mm for each in both] for both in breasts]),
        "area": np.array([[outline_area_mm2(outline_mm(each)) / 100 for each in both] for both in breasts]),
        "volume": np.log([[each.volume_cc for each in both] for both in breasts]),
        "layer": np.array([[each.layer_mm for each in both] for both in breasts]),
        "muscle": np.array([[shape.muscle_mm[side] for side in SIDES] for shape in shapes]),
        "radii": np.array([[_radii(outline_mm(each)) for each in both] for both in breasts]),
    }


def _radii(curve: np.ndarray) -> np.ndarray:
    """Radius over the root of the area, every 45°, about the centroid of the area."""
    following = np.roll(curve, -1, axis=0)
    cross = curve[:, 0] * following[:, 1] - curve[:, 1] * following[:, 0]
    offset = curve - ((curve + following) * cross[:, None]).sum(axis=0) / (3 * cross.sum())
    angle = np.arctan2(offset[:, 1], offset[:, 0])
    order = np.argsort(angle)
    found = np.interp(np.arange(8) * np.pi / 4, angle[order], np.linalg.norm(offset, axis=1)[order], period=2 * np.pi)
    return np.asarray(found / np.sqrt(cross.sum() / 2))


def alike(found: np.ndarray, mean: object, deviation: object) -> None:
    """Mean and standard deviation within the sampling error of women drawn and of women measured."""
    spread = np.asarray(deviation) * np.sqrt(1 / _WOMEN + 1 / _REAL_WOMEN)
    assert np.all(np.abs(found.mean(axis=(0, 1)) - mean) < _STANDARD_ERRORS * spread)
    assert np.all(np.abs(found.std(axis=(0, 1)) - deviation) < _STANDARD_ERRORS * spread / np.sqrt(2))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("measure", "mean", "deviation"),
    [
        ("width", *WIDTH_MM),
        ("height", *HEIGHT_MM),
        ("area", 170.0, 28.0),
        ("volume", np.log(FLAT_CC[0]), FLAT_CC[1]),
        ("layer", LAYER_MM, LAYER_SD_MM),
        ("muscle", MUSCLE_MM, MUSCLE_SD_MM),
        ("radii", RADII, np.full(8, 0.04)),
    ],
)
def test_drawn_women_have_the_real_ones_means_and_deviations(measure: str, mean: object, deviation: object) -> None:
    alike(drawn()[measure], mean, deviation)


def test_both_sides_of_a_woman_are_alike() -> None:
    left, right = drawn()["layer"].mean(axis=2).T
    assert np.corrcoef(left, right)[0, 1] == pytest.approx(LAYER_SIDES_R, abs=0.03)


def test_sectors_of_one_layer_correlate() -> None:
    found = np.corrcoef(drawn()["layer"][:, 0].T)[np.triu_indices(4, 1)]
    assert np.all((found > 0.55) & (found < 0.8))  # real ones: .6 to .75


def test_wide_draws_reach_from_small_to_large() -> None:
    volumes = [woman_shape(number, 0, wide=True).breasts["left"].volume_cc for number in range(200)]
    assert min(volumes) < 130
    assert max(volumes) > 1200


@functools.cache
def made(name: str) -> Woman:
    return woman_named(name, 0, edge_mm=4.0)


@pytest.mark.slow
@pytest.mark.parametrize("name", first(1, ["leaning-woman_3", "woman_1"]))
def test_a_woman_is_closed_and_her_volumes_are_exact(name: str) -> None:
    woman = made(name)
    solid: SubjectSolid = woman.solid
    assert solid.mesh.is_watertight()
    assert solid.mesh.volume_mm3() > 0
    for side in SIDES:
        assert solid.volumes_cc[side] == pytest.approx(woman.shape.breasts[side].volume_cc, rel=1e-3)
        # What lies behind a flat chest is the layer: 4 to 45 mm of it over the base.
        layer = 10 * (woman.muscle_cc(side) - solid.volumes_cc[side]) / woman.shape.areas_cm2[side]
        assert 4 < layer < 45


def test_a_front_is_open_and_reaches_around_the_boundaries() -> None:
    woman = made("woman_1")
    front: TriangleMesh = woman.front()
    assert not front.is_watertight()
    parts, _ = front.components()
    assert parts == 1
    there = {tuple(place) for place in front.vertices.tolist()}
    for breast in woman.solid.breasts.values():
        rim = woman.solid.mesh.vertices[breast.boundary]
        assert all(tuple(place) in there for place in rim.tolist())
        assert front.vertices[:, 2].min() < rim[:, 2].min() - 5


def test_an_unknown_woman_is_refused() -> None:
    with pytest.raises(ValueError, match="women"):
        woman_named("woman_x", 0)
