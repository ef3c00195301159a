"""Which photographs of a folder belong to a walk, and how they are turned."""

import shutil
from dataclasses import replace

import board_walk
import numpy as np
import pytest
from board_walk import arc, photograph, save

from mammometry.api.photos import prepare_walk, read_walk
from mammometry.base.errors import CalibrationError
from mammometry.io.photographs.telephone import read_facts, read_from_sensor
from mammometry.walk.inputs import PictureFacts, judge_files
from mammometry.walk.sharpness import BoardImage, judge_images

COUNT = 10


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    folder = tmp_path_factory.mktemp("good")
    for number, station in enumerate(arc(COUNT)):
        save(folder / f"IMG_{number:02d}.jpg", photograph(*station))
    return folder


def bad_pictures(folder):
    """One of each kind; file → code."""
    pixels = photograph(20.0, 3.0)
    wide = np.concatenate([pixels[200:600], pixels[200:600]], axis=1)
    save(folder / "a.jpg", pixels, model="Two")
    save(folder / "b.jpg", wide)
    save(folder / "c.jpg", pixels, rendered=6)
    save(folder / "d.jpg", pixels, rendered=8)
    save(folder / "e.jpg", pixels, exposure_s=1.0)
    save(folder / "f.jpg", photograph(20.0, 3.0, zoom=2.0), zoom=2.0, focal_35=52)
    save(folder / "g.png", pixels[:700, :320], model="")
    save(folder / "h.jpg", pixels[::2, ::2], model="")
    save(folder / "i.jpg", pixels[:, ::-1])
    save(folder / "j.jpg", photograph(20.0, 3.0, blur_px=3.0))
    save(folder / "k.jpg", pixels.swapaxes(0, 1), model="")
    save(folder / "l.jpg", pixels)
    (folder / "l.jpg").write_bytes((folder / "l.jpg").read_bytes()[:20_000])
    save(folder / "m.jpg", np.full_like(pixels, 120))
    save(folder / "p.jpg", pixels, quality=30)
    save(folder / "q.jpg", (pixels // 2 + np.roll(pixels, 8, axis=1) // 2))  # two exposures, as of an HDR ghost
    return {
        "a.jpg": "another-telephone",
        "b.jpg": "panorama",
        "c.jpg": "panorama",
        "d.jpg": "portrait-mode",
        "e.jpg": "long-exposure",
        "f.jpg": "zoom",
        "g.png": "screenshot",
        "h.jpg": "other-size",
        "i.jpg": "mirrored",
        "j.jpg": "blurred",
        "k.jpg": "turned",
        "l.jpg": "photograph",
        "m.jpg": "no-target",
        "p.jpg": "compressed",
        "q.jpg": "no-target",
    }


@pytest.mark.slow
@pytest.mark.requirement("R-PHOTO-1")
def test_bad_pictures_are_left_out_by_name(good, tmp_path):
    folder = tmp_path / "photos"
    shutil.copytree(good, folder)
    expected = bad_pictures(folder)
    for name, zoom, code in (("n.jpg", 1.1, "zoom"), ("o.jpg", 1.5, "zoom")):  # which the files do not state
        save(folder / name, photograph(30.0, 3.0, zoom=zoom))
        expected[name] = code
    walk = prepare_walk(folder, tmp_path / "session")
    names = [path.name for path in sorted(folder.iterdir())]
    found = {names[int(number) - 1]: why.code for number, why in walk.left_out.items()}
    assert {name: code for name, code in found.items() if code != "not-in-a-pair"} == expected
    assert all(why.remedy for why in walk.left_out.values() if why.code not in ("not-in-a-pair", "no-target"))
    assert read_walk(tmp_path / "session") == walk
    assert walk.focal_px == pytest.approx(board_walk.FOCAL_PX, rel=2e-3)


@pytest.mark.slow
@pytest.mark.requirement("R-PHOTO-1")
def test_too_few_that_are_left_are_a_refusal_that_lists_all(good, tmp_path):
    folder = tmp_path / "photos"
    folder.mkdir()
    for path in sorted(good.iterdir())[:5]:
        shutil.copy(path, folder)
    expected = bad_pictures(folder)
    with pytest.raises(CalibrationError) as refused:
        prepare_walk(folder, tmp_path / "session")
    assert {detail.partition(":")[0] for detail in refused.value.details} == set(expected)
    assert not (tmp_path / "session").exists()


def test_all_damaged_pictures_are_counted(tmp_path):
    folder = tmp_path / "photos"
    folder.mkdir()
    whole = save(tmp_path / "whole.jpg", np.random.default_rng(1).integers(0, 255, (300, 400, 3), dtype=np.uint8))
    for number in range(COUNT):
        (folder / f"{number}.jpg").write_bytes(whole.read_bytes()[:20_000] + bytes([number]))
    with pytest.raises(CalibrationError) as refused:
        prepare_walk(folder, tmp_path / "session")
    assert len(refused.value.details) == COUNT
    assert not (tmp_path / "session").exists()


@pytest.mark.slow
def test_a_telephone_that_is_turned_is_the_same_camera(tmp_path):
    """Upright, on either side, and upside down: one lens, whose principal point is not the picture's middle."""
    folder = tmp_path / "photos"
    folder.mkdir()
    rolls = {1: 0.0, 6: -90.0, 8: 90.0, 3: 180.0}
    for number, station in enumerate(arc(COUNT)):
        orientation = (1, 6, 1, 8, 1, 3, 1)[number % 7]
        pixels = photograph(*station, roll_deg=rolls[orientation])
        save(folder / f"{number:02d}.jpg", pixels, orientation=orientation)
    walk = prepare_walk(folder, tmp_path / "session")
    assert {why.code for why in walk.left_out.values()} <= {"not-in-a-pair"}
    assert walk.board_rms_px < 0.1
    assert walk.focal_px == pytest.approx(board_walk.FOCAL_PX, rel=2e-3)


@pytest.mark.parametrize("orientation", range(1, 9))
def test_pictures_are_read_from_the_sensor_and_turned_alike(tmp_path, orientation):
    pixels = np.zeros((20, 30, 3), np.uint8)
    pixels[:10, :15] = 250
    path = save(tmp_path / "1.png", pixels, orientation=orientation)
    assert read_facts(path, "1").orientation == orientation
    assert read_facts(path, "1").stored_wh == (30, 20)
    np.testing.assert_array_equal(read_from_sensor(path, "1", 1).pixels, pixels)
    np.testing.assert_array_equal(read_from_sensor(path, "1", 8).pixels, np.rot90(pixels, 1))
    np.testing.assert_array_equal(read_from_sensor(path, "1", 6).pixels, np.rot90(pixels, -1))


@pytest.mark.parametrize("quality", [25, 49, 50, 75, 98])
def test_the_quality_of_a_jpeg_is_that_of_libjpeg(tmp_path, quality):
    """Steps are rounded to whole numbers of at most 255."""
    path = save(tmp_path / "1.jpg", np.zeros((20, 30, 3), np.uint8), quality=quality)
    assert read_facts(path, "1").jpeg_quality == pytest.approx(quality, abs=1.0)


def test_compression_that_takes_the_skins_texture_is_named(tmp_path):
    """At quality 50 the points of a pair are twice as far off as in the original (decision 52)."""
    of = PictureFacts(stored_wh=(400, 300))
    facts = {"png": of, "sent": replace(of, jpeg_quality=40.0), "own": replace(of, jpeg_quality=85.0)}
    assert {name: why.code for name, why in judge_files(facts).items()} == {"sent": "compressed"}


def test_tags_that_all_pictures_share_are_no_reason():
    """A walk with one telephone's second lens, zoomed as a whole, and one picture without tags."""
    of = PictureFacts(stored_wh=(400, 300), model="One", focal_mm=9.0, focal_35_mm=77.0, zoom=1.2)
    facts = {str(number): of for number in range(10)} | {"x": PictureFacts(stored_wh=(400, 300))}
    assert judge_files(facts) == {}


def test_blur_is_compared_with_that_of_the_walk():
    soft = {str(number): BoardImage(blur_px=1.8, square_px=120.0) for number in range(10)}
    assert judge_images(soft) == {}
    found = judge_images({**soft, "x": BoardImage(blur_px=4.0, square_px=120.0)})
    assert {name: why.code for name, why in found.items()} == {"x": "blurred"}


def test_a_board_of_too_few_pixels_is_named():
    small = {str(number): BoardImage(blur_px=0.5, square_px=15.0) for number in range(10)}
    assert {why.code for why in judge_images(small).values()} == {"too-small"}
