"""What "the breast" may mean: volumes and intervals that are kept apart."""

import numpy as np
import pytest

from mammometry.measure.settings import LayerSettings
from mammometry.measure.volume.measurement import DefinedVolume, HalfWidths, define, layer_before_muscle_mm


def defined(**changes: object) -> tuple[DefinedVolume, ...]:
    given: dict[str, object] = {
        "wall": "cylinder-membrane",
        "volume_cc": 500.0,
        "measured_wall": False,
        "errors": HalfWidths(chest_cc=85.0, fit_cc=30.0, other_cc=40.0),
        "cylinder": (500.0, 170.0),
        "settings": LayerSettings(),
    }
    return define("left", **(given | changes))  # type: ignore[arg-type]


def half(one: DefinedVolume) -> float:
    return (one.interval_cc[1] - one.interval_cc[0]) / 2


def test_each_meaning_has_its_own_interval() -> None:
    chest, wall, muscle = defined()
    assert [each.meaning for each in (chest, wall, muscle)] == ["flat chest", "named wall", "muscle"]
    assert half(chest) == pytest.approx(np.hypot(85, 40))
    assert half(wall) == pytest.approx(50.0)
    assert muscle.volume_cc == pytest.approx(500 + 1.78 * 170)  # 17.8 mm over 170 cm²
    assert half(muscle) == pytest.approx(np.hypot(1.2 * 170, 40))


def test_a_measured_wall_means_one_thing() -> None:
    (only,) = defined(measured_wall=True, errors=HalfWidths(chest_cc=17.0, fit_cc=30.0, other_cc=40.0))
    assert only.meaning == "measured wall"
    assert half(only) == pytest.approx(np.hypot(17, 40))


def test_without_the_cylinder_nothing_is_said_of_the_muscle() -> None:
    assert [each.meaning for each in defined(cylinder=None)] == ["flat chest", "named wall"]


def test_thicknesses_replace_the_mean_layer() -> None:
    """Four thicknesses 3 mm above the usual ones: a mean of 20.5 mm, and .6 mm more."""
    thicknesses = LayerSettings(left_lateral_mm=27.0, left_upper_mm=21.0, left_medial_mm=15.0, left_lower_mm=19.0)
    assert layer_before_muscle_mm("left", thicknesses) == (pytest.approx(21.1), pytest.approx(5.0), 4)
    assert layer_before_muscle_mm("right", thicknesses) == (17.8, 12.0, 0)


def test_two_thicknesses_stand_for_four_but_less_surely() -> None:
    thicknesses = LayerSettings(left_lateral_mm=27.0, left_lower_mm=19.0)
    layer, u95, count = layer_before_muscle_mm("left", thicknesses)
    assert (layer, count) == (pytest.approx(21.1), 2)
    assert u95 == pytest.approx(np.hypot(5, 3))


def test_one_thickness_is_too_few() -> None:
    assert layer_before_muscle_mm("left", LayerSettings(left_lateral_mm=27.0))[2] == 0


def test_thicknesses_that_are_too_few_are_named() -> None:
    muscle = defined(settings=LayerSettings(left_lateral_mm=27.0))[2]
    assert "(1 measured, 2" in muscle.sentence
    assert "needed" not in defined()[2].sentence


def test_a_thickness_in_the_wrong_unit_is_refused() -> None:
    with pytest.raises(ValueError, match="100 mm"):
        LayerSettings(left_lateral_mm=240.0)


def test_a_negative_thickness_is_refused() -> None:
    with pytest.raises(ValueError, match="thicknesses"):
        LayerSettings(right_lower_mm=-1.0)


def test_an_interval_does_not_go_below_zero() -> None:
    chest = defined(volume_cc=50.0)[0]
    assert chest.interval_cc[0] == 0.0


@pytest.mark.requirement("R-FRONT-2")
def test_an_assumed_layer_is_not_added_to_a_flat_chest() -> None:
    """17.8 mm over 170 cm² are 303 cc: twice what stands out, or more."""
    assert [each.meaning for each in defined(volume_cc=140.0, cylinder=(140.0, 170.0))] == ["flat chest", "named wall"]
    assert len(defined(volume_cc=160.0, cylinder=(160.0, 170.0))) == 3
    measured = LayerSettings(left_lateral_mm=27.0, left_upper_mm=21.0, left_medial_mm=15.0, left_lower_mm=19.0)
    assert len(defined(volume_cc=140.0, cylinder=(140.0, 170.0), settings=measured)) == 3
