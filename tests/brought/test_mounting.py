"""A pair with one camera upside down, as some rigs are built to bring two lenses close together."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
from tests.first_cases import first
from tests.unit.calibration.virtual_rig import cameras_in_rig, observe, placements

from mammometry.base.errors import CalibrationError
from mammometry.calibration.adjust.bundle import calibrate
from mammometry.calibration.detection.detect import Observations
from mammometry.calibration.judge.scale import require_sides
from mammometry.geometry.camera import Camera, Rig
from mammometry.geometry.transform import Transform
from mammometry.measure.trunk.body import rig_frame

UPRIGHT = {name: camera for name, camera in cameras_in_rig().items() if name.startswith("front")}
PAIR = {"front": ("front_left", "front_right")}
EXCHANGED = {"front": ("front_right", "front_left")}


def upside_down(camera: Camera) -> Camera:
    """The same camera at the same place, turned by half a turn about its line of sight."""
    turned = np.diag([-1.0, -1.0, 1.0])
    matrix = camera.matrix.copy()
    matrix[:2, 2] = np.array(camera.size_wh) - 1 - matrix[:2, 2]
    pose = camera.camera_from_world
    return replace(
        camera,
        matrix=matrix,
        distortion=camera.distortion * np.array([1, 1, -1, -1, 1]),
        camera_from_world=Transform(rotation=turned @ pose.rotation, translation_mm=turned @ pose.translation_mm),
    )


def with_turned(*names: str) -> dict[str, Camera]:
    return {name: upside_down(camera) if name in names else camera for name, camera in UPRIGHT.items()}


def seen_by(cameras: Mapping[str, Camera]) -> Observations:
    return observe(cameras, placements(4))


@pytest.mark.parametrize("name", first(1, ["front_left", "front_right"]))
def test_a_pair_with_one_camera_upside_down_is_calibrated_as_it_stands(name: str) -> None:
    cameras = with_turned(name)
    rig = calibrate(seen_by(cameras), PAIR, "rig").rig
    require_sides(rig, [name])
    pair = rig.pair("front")
    apart = np.linalg.norm(pair.right.centre_world - pair.left.centre_world)
    true_mm = np.linalg.norm(cameras["front_right"].centre_world - cameras["front_left"].centre_world)
    assert apart == pytest.approx(true_mm, rel=1e-3)


@pytest.mark.parametrize(
    ("turned", "told", "pairs", "remedy"),
    [
        (("front_left",), (), PAIR, r'rig.mounting = \{ front_left = "upside-down" \}'),
        (("front_left",), ("front_left",), EXCHANGED, "Exchange left and right"),
        (("front_right",), ("front_right",), EXCHANGED, "Exchange left and right"),
        ((), (), EXCHANGED, "Exchange left and right"),
    ],
)
def test_what_is_refused_has_a_way_out(
    turned: tuple[str, ...], told: tuple[str, ...], pairs: dict[str, tuple[str, str]], remedy: str
) -> None:
    rig = Rig(name="rig", cameras=with_turned(*turned), pair_names=pairs)
    with pytest.raises(CalibrationError, match=remedy):
        require_sides(rig, told)


@pytest.mark.parametrize("pairs", [PAIR, EXCHANGED], ids=["from behind", "in the pictures"])
def test_a_whole_rig_upside_down_is_named_from_behind_or_as_its_pictures_show(
    pairs: dict[str, tuple[str, str]],
) -> None:
    both = ("front_left", "front_right")
    require_sides(Rig(name="rig", cameras=with_turned(*both), pair_names=pairs), both)


@pytest.mark.parametrize("name", ["front_left", "front_right"])
@pytest.mark.requirement("R-SIDE-1")
def test_up_and_the_patients_left_do_not_hang_on_the_mounting(name: str) -> None:
    upright, turned = (Rig(name="rig", cameras=cameras, pair_names=PAIR) for cameras in (UPRIGHT, with_turned(name)))
    np.testing.assert_allclose(rig_frame(turned, {name: "upside-down"}), rig_frame(upright), atol=1e-12)
