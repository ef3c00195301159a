"""Checks of incoming photographs, on photographs whose fault is known because the test made it."""

import datetime
import io
from functools import lru_cache

import numpy as np
import pytest
from PIL import Image
from scipy import ndimage

from mammometry.base.photograph import Photograph
from mammometry.capture import camera_checks, checks
from mammometry.capture.camera_checks import KnownCamera
from mammometry.capture.checks import not_only_a_photograph
from mammometry.clinic.rig_history import Calibrated, LatestCheck, judge
from mammometry.clinic.rig_results import CheckResult
from mammometry.io.photographs.tags import PhotographTags, read_exposure

SIZE_WH = (900, 600)


@lru_cache
def subject(centre=(0.5, 0.5), radius=0.3, value=0.6, blur_px=0.6, seed=3):
    """A pale, mottled ball before a dark wall, as a lens draws it that blurs by a Gaussian σ."""
    width, height = SIZE_WH
    x, y = np.meshgrid((np.arange(width) + 0.5) / width, (np.arange(height) + 0.5) / height)
    distance = np.hypot((x - centre[0]) * width / height, y - centre[1])
    mottling = np.random.default_rng(seed).normal(1.0, 0.12, (height, width))
    shade = np.sqrt(np.clip(1 - (distance / radius) ** 2, 0.05, 1))
    light = np.where(distance < radius, value * (0.6 + 0.4 * shade) * ndimage.gaussian_filter(mottling, 0.5), 0.03)
    light = np.clip(ndimage.gaussian_filter(light, blur_px), 0, 1)
    return Photograph(name="it", pixels=(np.stack([light, 0.8 * light, 0.7 * light], axis=2) * 255).astype(np.uint8))


def levels(photograph, kind="model"):
    return {each.check: each.level for each in checks.judge(checks.look(photograph), kind)}


ALL_WELL = {"sharpness": "ok", "exposure": "ok", "whole": "ok"}


def test_a_good_photograph_has_no_warning():
    assert levels(subject()) == ALL_WELL


@pytest.mark.parametrize(
    ("fault", "check"),
    [
        ({"blur_px": 3.0}, "sharpness"),
        ({"value": 1.6}, "exposure"),
        ({"value": 0.2}, "exposure"),
        ({"centre": (0.1, 0.5)}, "whole"),
        ({"centre": (0.5, 0.95)}, "whole"),
        ({"radius": 0.08}, "whole"),
    ],
)
def test_a_fault_is_found_and_no_other(fault, check):
    assert levels(subject(**fault)) == {**ALL_WELL, check: "warn"}


def test_a_torso_may_go_on_beyond_the_picture_and_a_cast_may_not():
    cut = subject(centre=(0.5, 0.75))
    assert levels(cut, "torso")["whole"] == "ok"
    found = next(each for each in checks.judge(checks.look(cut), "model") if each.check == "whole")
    assert "cut" in found.sentence


@pytest.mark.slow
def test_blur_grows_with_the_lens():
    blurs = [checks.look(subject(blur_px=sigma)).blur for sigma in (0.6, 1.5, 2.5, 4.0)]
    assert blurs == sorted(blurs)


def test_nothing_before_the_wall_is_said():
    empty = Photograph(name="it", pixels=np.full((600, 900, 3), 9, dtype=np.uint8))
    found = {each.check: each for each in checks.judge(checks.look(empty), "torso")}
    assert "subject" in found["whole"].sentence


@pytest.mark.slow
def test_a_16_bit_photograph_is_judged_as_its_8_bit_twin():
    plain = subject()
    deep = Photograph(name="it", pixels=plain.pixels.astype(np.uint16) * 257)
    ours, theirs = checks.look(plain), checks.look(deep)
    assert theirs.cover == pytest.approx(ours.cover, abs=1e-3)
    assert theirs.median == pytest.approx(ours.median, abs=1e-3)
    assert theirs.blur == pytest.approx(ours.blur, abs=1e-3)


# --- whose camera ---

KNOWN = {
    "front_left": KnownCamera(stored_wh=(4504, 3000), serial="A1", clock_s=-1.0),
    "front_right": KnownCamera(stored_wh=(4504, 3000), serial="B2", clock_s=61.0),
}


def camera_of(camera, serial="", named=None, known=KNOWN):
    return camera_checks.right_camera(camera, PhotographTags(serial=serial), named, known)


def test_the_serial_number_decides_and_the_name_only_without_one():
    assert camera_of("front_left", "A1", named="front_right").level == "ok"
    swapped = camera_of("front_left", "B2", named="front_left")
    assert swapped.level == "refuse"
    assert "front_right" in swapped.sentence
    assert "calibration" in camera_of("front_left", "C3").sentence
    assert camera_of("front_left", named="front_left").level == "ok"
    assert camera_of("front_left", named="front_right").level == "refuse"
    assert camera_of("front_left").level == "unknown"
    assert camera_of("front_left", "C3", known={}).level == "unknown"


@pytest.mark.parametrize(
    ("name", "camera"),
    [
        ("front_left.jpg", "front_left"),
        ("2026-11-23 Front_Left 0042.JPG", "front_left"),
        ("IMG_0042.JPG", None),
        ("front_leftover.jpg", "front"),
        ("confront.jpg", None),
        ("front_left front_right.jpg", None),
        ("front.jpg", "front"),
    ],
)
def test_a_name_names_one_camera_as_a_whole_word(name, camera):
    assert camera_checks.camera_of_name(name, ["front", "front_left", "front_right"]) == camera


def test_size_and_turn_are_those_of_the_calibration():
    assert camera_checks.right_size("front_left", (4504, 3000), 1, KNOWN).level == "ok"
    assert "4504 × 3000" in camera_checks.right_size("front_left", (2252, 1500), 1, KNOWN).sentence
    assert "rotated" in camera_checks.right_size("front_left", (4504, 3000), 6, KNOWN).sentence
    assert camera_checks.right_size("front_left", (1, 1), 1, {}).level == "unknown"


def test_clocks_that_differ_are_no_fault_where_the_calibration_tells_by_how_much():
    ahead = {name: about.clock_s for name, about in KNOWN.items()}
    assert camera_checks.together({"front_left": 99.0, "front_right": 161.0}, ahead).level == "ok"
    assert camera_checks.together({"front_left": 99.0, "front_right": 161.0}, {}).level == "warn"
    late = camera_checks.together({"front_left": 99.0, "front_right": 161.0 + 60.0}, ahead)
    assert late.level == "warn"
    assert camera_checks.together({"front_left": 99.0}, ahead).level == "unknown"


def test_clocks_are_told_by_exposures_made_together():
    taken = {(pose, "a"): 1000.0 * i for i, pose in enumerate(("01", "02", "03"))}
    taken |= {(pose, "b"): moment + 7.0 for (pose, _), moment in taken.items()}
    taken |= {(pose, "c"): moment + 3.0 for (pose, camera), moment in list(taken.items()) if camera == "a"}
    found = camera_checks.clocks(taken)
    assert found["b"] - found["a"] == pytest.approx(7.0)
    assert found["c"] == pytest.approx(0.0)


def test_one_file_in_two_places_is_refused():
    (found,) = camera_checks.twice({"front_left": "aa", "front_right": "bb", "left_left": "aa"})
    assert found.level == "refuse"
    assert "front_left and left_left" in found.sentence


# --- what a file is ---


def jpeg(exif=None):
    buffer = io.BytesIO()
    Image.fromarray(subject().pixels).save(buffer, format="JPEG", **({} if exif is None else {"exif": exif}))
    return buffer.getvalue()


def test_exif_tells_camera_and_moment(tmp_path):
    exif = Image.Exif()
    exif[271], exif[272] = "Canon\x00", "EOS"
    about = exif.get_ifd(0x8769)
    about[0x9003], about[0x9291], about[0x9011], about[0xA431] = "2026:11:23 10:00:01", "25", "+01:00", " 0123 "
    (tmp_path / "a.jpg").write_bytes(jpeg(exif))
    found = read_exposure(tmp_path / "a.jpg")
    expected = datetime.datetime(2026, 11, 23, 9, 0, 1, 250000, datetime.UTC).timestamp()
    assert (found.serial, found.model) == ("0123", "Canon EOS")
    assert found.taken_s == pytest.approx(expected)


def test_damaged_exif_tells_nothing(tmp_path):
    exif = Image.Exif()
    exif.get_ifd(0x8769)[0x9003] = "yesterday"
    (tmp_path / "a.jpg").write_bytes(jpeg(exif))
    assert read_exposure(tmp_path / "a.jpg") == PhotographTags()


@pytest.mark.parametrize(
    ("data", "what"),
    [
        (jpeg(), None),
        (jpeg() + b"\x00" * 500, None),  # as some cameras pad
        (jpeg() + jpeg(), None),  # as some cameras put a second, smaller picture
        (jpeg() + b"PK\x03\x04 and so on PK\x05\x06" + b"\x00" * 18, "an archive"),
        (jpeg() + b"%PDF-1.7", "a PDF"),
        (b"\xff\xd8\xff\xfe\x00\x40<html><script>alert(1)</script>" + jpeg()[2:], "a web page"),
        (b"GIF89a" + jpeg(), "no photograph"),
        (b"<svg xmlns='http://www.w3.org/2000/svg'/>", "no photograph"),
        (b"", "no photograph"),
    ],
)
def test_a_photograph_that_is_something_else_too(tmp_path, data, what):
    (tmp_path / "a.jpg").write_bytes(data)
    assert not_only_a_photograph(tmp_path / "a.jpg") == what


# --- may we measure today ---

TODAY = datetime.date(2026, 11, 23)
BEFORE = TODAY - datetime.timedelta(days=3)


def calibrated(on=BEFORE, verdict="pass"):
    return Calibrated(on=on, verdict=verdict, reasons=("Two poses were left out.",))


def checked(on, **found):
    return LatestCheck(on=on, result=CheckResult(**found))


@pytest.mark.parametrize(
    ("calibration", "check", "verdict", "word"),
    [
        (None, None, "no", "calibrated"),
        (calibrated(), None, "care", "checked"),
        (calibrated(TODAY), None, "yes", "calibrated"),
        (calibrated(), checked(BEFORE, verdict="unmoved"), "care", "checked"),
        (calibrated(), LatestCheck(on=TODAY, result=None), "care", "checked"),
        (calibrated(), checked(TODAY, verdict="unmoved"), "yes", "camera"),
        (calibrated(), checked(TODAY, verdict="moved", effect_mm=0.04), "care", "why"),
        (
            calibrated(),
            checked(TODAY, verdict="unmoved", unseen=("left_left",)),
            "care",
            "cameras",
        ),
        (calibrated(), checked(TODAY, verdict="refuse"), "no", "moved"),
        (calibrated(), checked(TODAY, verdict="refuse", exchanged=("a", "b")), "no", "exchanged"),
        (calibrated(), checked(BEFORE, verdict="refuse"), "no", "moved"),
        (calibrated(verdict="warn"), checked(TODAY, verdict="unmoved"), "care", "why"),
        (calibrated(TODAY - datetime.timedelta(days=91)), checked(TODAY, verdict="unmoved"), "care", "why"),
    ],
)
def test_may_we_measure_today(calibration, check, verdict, word):
    found = judge(TODAY, calibration, check)
    assert found.verdict == verdict
    assert word in found.sentence
    assert bool(found.remedy) == (verdict != "yes")
