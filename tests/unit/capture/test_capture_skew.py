"""The counting lamps: what they show at a moment, and the moment that is read from their pictures."""

import json
from dataclasses import replace

import numpy as np
import pytest
from tests.unit.capture.virtual_capture import rig_file

from mammometry.base.errors import CaptureError, SessionError
from mammometry.calibration.targets.kinds.charuco import CharucoTarget
from mammometry.calibration.targets.lamps import LAMPS
from mammometry.capture.skew import Moment, moment_of, read_moment, read_skew, skew_of, write_skew
from mammometry.cli.main import run
from mammometry.geometry.transform import Transform
from mammometry.simulate.rendering.lamps import LampScene, hold_lamps, render_lamps
from mammometry.simulate.rigs.build import REFERENCE, build_rig, flashes

BOARD = CharucoTarget(squares=(14, 10), square_mm=25.0, marker_mm=18.0, dictionary="DICT_5X5_250")
SCENE = LampScene(board=BOARD, lights=flashes(0.4))
LIMIT_MS = 0.2  # the issue's: ± 0.2 ms at an exposure of 1 ms


def lit_by_counting(begin_ms, exposure_ms, steps=4000):
    """An independent oracle: the lamps looked at in small steps of time, the counter in Gray code by its definition."""
    times = begin_ms + exposure_ms * (np.arange(steps) + 0.5) / steps
    counts = [int(t / LAMPS.tick_ms) % 2**LAMPS.bits for t in times]
    codes = [format(c ^ (c >> 1), f"0{LAMPS.bits}b") for c in counts]
    return np.array([[int(digit) for digit in code] for code in codes]).mean(axis=0)


@pytest.mark.parametrize("begin_ms", [0.0, 0.3, 511.9, 1023.75, 2047.6])
@pytest.mark.parametrize("exposure_ms", [0.25, 1.0, 3.0])
def test_a_lamp_s_share_is_the_time_it_was_lit(begin_ms, exposure_ms):
    assert LAMPS.lit_share(np.array([begin_ms]), exposure_ms)[0] == pytest.approx(
        lit_by_counting(begin_ms, exposure_ms), abs=2e-3
    )  # steps of 1/4000, two of which may fall on either side of a tick


def test_neighbouring_counts_differ_in_one_lamp():
    moments = LAMPS.tick_ms * (np.arange(2**LAMPS.bits) + 0.25)
    shares = LAMPS.lit_share(moments, 0.5 * LAMPS.tick_ms)
    assert set(np.unique(shares)) == {0.0, 1.0}
    assert (np.abs(shares - np.roll(shares, 1, axis=0)).sum(axis=1) == 1).all()
    assert len(np.unique(shares, axis=0)) == 2**LAMPS.bits


@pytest.mark.slow
def test_moments_are_read_to_a_fifth_of_a_millisecond_from_noisy_shares():
    rng = np.random.default_rng(4)
    errors, sigmas = [], []
    for begin_ms in rng.uniform(0, LAMPS.period_ms, 300):
        shares = LAMPS.lit_share(np.array([begin_ms]), 1.0)[0] + rng.normal(0, 0.05, LAMPS.bits)
        moment = moment_of(shares, 1.0)
        errors.append((moment.begin_ms - begin_ms + 0.5 * LAMPS.period_ms) % LAMPS.period_ms - 0.5 * LAMPS.period_ms)
        sigmas.append(moment.std_ms)
    assert np.abs(errors).max() < LIMIT_MS
    assert 0.5 < np.std(np.array(errors) / sigmas) < 2.0  # the stated uncertainty is the true one


def test_lamps_that_count_nothing_are_refused():
    with pytest.raises(CaptureError, match="count"):
        moment_of(np.full(LAMPS.bits, 0.5), 1.0)


@pytest.fixture(scope="module")
def rig():
    return build_rig(REFERENCE, 0.2, 3)


@pytest.fixture(scope="module")
def pose(rig):
    return hold_lamps(rig, BOARD)


def lamps_of(rig, pose, begin_ms, exposure_ms=1.0):
    return {
        name: render_lamps(camera, pose, SCENE, begin_ms.get(name, 0.0), exposure_ms, seed=index)
        for index, (name, camera) in enumerate(rig.cameras.items())
    }


@pytest.mark.slow
def test_the_skew_of_eight_cameras_is_read_from_their_pictures(rig, pose):
    """At 1 ms of exposure, to ± 0.2 ms, as the issue asks; pictures a fifth as wide as the rig's."""
    rng = np.random.default_rng(8)
    for start_ms in (3.3, 1023.6, 2047.9):  # the last: some cameras after the counter began again
        delay_ms = dict(zip(rig.cameras, rng.uniform(-2, 2, len(rig.cameras)), strict=True))
        pictures = lamps_of(rig, pose, {name: start_ms + delay for name, delay in delay_ms.items()})
        moments = {name: read_moment(picture, BOARD, 1.0) for name, picture in pictures.items()}
        skew = skew_of([moments], 1.0)
        middle = np.median(list(delay_ms.values()))
        for name, delay in delay_ms.items():
            assert skew.offset_ms[name] == pytest.approx(delay - middle, abs=LIMIT_MS), name
        assert skew.std_ms < LIMIT_MS


@pytest.mark.slow
@pytest.mark.parametrize(("how", "said"), [({"lamp_light": 4.0}, "bright"), ({"lamp_light": 0.0}, "light")])
def test_lamps_too_bright_or_off_are_named(rig, pose, how, said):
    camera = rig.cameras["front_left"]
    picture = render_lamps(camera, pose, replace(SCENE, **how), 5.0, 1.0)
    with pytest.raises(CaptureError, match=said):
        read_moment(picture, BOARD, 1.0, camera="front_left")


def test_a_picture_without_the_board_or_with_half_the_strip_is_named(rig, pose):
    camera = rig.cameras["front_left"]
    moved = Transform(rotation=pose.rotation, translation_mm=pose.translation_mm + np.array([0.0, 5000.0, 0.0]))
    with pytest.raises(CaptureError, match="board"):
        read_moment(render_lamps(camera, moved, SCENE, 5.0, 1.0), BOARD, 1.0)


def test_cameras_released_seconds_apart_are_refused():
    moments = {name: Moment(begin_ms=begin, std_ms=0.05) for name, begin in (("a", 0.0), ("b", 900.0))}
    with pytest.raises(CaptureError, match="wire"):
        skew_of([moments], 1.0)


def test_the_record_of_a_skew_comes_back_as_written(tmp_path):
    moments = {name: Moment(begin_ms=begin, std_ms=0.05) for name, begin in (("a", 1.0), ("b", 1.4), ("c", 1.1))}
    skew = skew_of([moments], 1.0, when="2026-01-01T00:00:00+00:00")
    write_skew(tmp_path, skew)
    read = read_skew(tmp_path)
    assert read is not None
    assert read.spread_ms == pytest.approx(0.4, abs=1e-3)
    assert read.worst == "b"
    (tmp_path / "skew.json").write_text('{"format": 1}')
    with pytest.raises(SessionError, match="skew"):
        read_skew(tmp_path)


@pytest.mark.slow
def test_the_command_measures_the_skew_and_a_patient_s_capture_is_then_refused(place, capsys):
    options = f'session = "{place / "calibrated"}"\nscene = "lamps"\nskew_ms = {{ left_left = 1.6 }}'
    rig = str(rig_file(place, options=options, lines="exposure_ms = 1.0"))
    session = str(place / "calibrated")
    assert run(["skew", session, "--rig", rig, "--firings", "1", "--json"]) == 12
    table = json.loads(capsys.readouterr().out)
    assert table["offset_ms"]["left_left"] == pytest.approx(1.6, abs=LIMIT_MS)
    assert table["spread_ms"] == pytest.approx(1.6, abs=LIMIT_MS)
    assert run(["capture", str(place / "s"), "--rig", str(rig_file(place, subject="torso")), "--json"]) == 12
    said = json.loads(capsys.readouterr().out)
    refusing = [one for one in said["checks"] if one["level"] == "refuse"]
    assert [one["check"] for one in refusing] == ["skew"]
    assert "left_left" in refusing[0]["sentence"]
