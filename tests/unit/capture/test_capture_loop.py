"""The whole loop on a virtual rig: fire, write, verdict, and each fault by its name."""

import errno
import json
import os
import shutil

import numpy as np
import pytest
from tests.unit.capture.virtual_capture import rig_file

from mammometry.base.errors import CaptureError, FullDiskError, SessionError
from mammometry.capture import shots
from mammometry.capture.camera import Frame
from mammometry.capture.loop import OpenRig
from mammometry.capture.skew import Skew, write_skew
from mammometry.cli.main import run
from mammometry.io.session import Session

CAMERAS = 8


def fire(place, session="s", **how):
    with OpenRig(rig_file(place, **how)) as rigged:
        return rigged.fire_into(place / session)


def levels(fired):
    """(camera, check) of all that is not well; the skew is measured in its own tests."""
    return {(who, one.check, one.level) for who, one in fired.verdict.findings if one.level not in ("ok", "unknown")}


def test_a_faultless_firing_becomes_the_session_s_capture(place):
    fired = fire(place)
    assert fired.accepted
    assert levels(fired) == set()
    assert {one.check for _, one in fired.verdict.findings} >= {
        "delivered", "size", "fresh", "times", "names", "moved", "sharpness", "exposure", "whole",
    }  # fmt: skip
    session = Session.open(place / "s")
    assert len(session.inputs().photographs) == CAMERAS
    assert not [path for path in (place / "s").rglob(".*") if path.is_dir()]  # nothing half-written


@pytest.mark.parametrize(
    ("faults", "expected", "delivered"),
    [
        ('front_left = "unplugged"', {("front_left", "delivered", "refuse")}, 7),
        pytest.param('front_left = "card-full"', {("front_left", "delivered", "refuse")}, 7, marks=pytest.mark.slow),
        pytest.param('front_left = "lost"', {("front_left", "delivered", "refuse")}, 7, marks=pytest.mark.slow),
        pytest.param('front_left = "slow"', {("front_left", "delivered", "refuse")}, 7, marks=pytest.mark.slow),
        pytest.param('front_left = "wrong-size"', {("front_left", "size", "refuse")}, 8, marks=pytest.mark.slow),
        pytest.param(
            'front_left = "old"',
            {("front_left", "fresh", "refuse"), ("", "times", "refuse")},
            8,
            marks=pytest.mark.slow,
        ),
        pytest.param('front_left = "late=0.003"', {("", "times", "refuse")}, 8, marks=pytest.mark.slow),
        pytest.param('front_left = "swapped=left_right"', {("", "names", "refuse")}, 8, marks=pytest.mark.slow),
        pytest.param('floor_left = "swapped=floor_right"', {("", "names", "refuse")}, 8, marks=pytest.mark.slow),
        pytest.param('front_left = "moved"', {("", "moved", "refuse")}, 8, marks=pytest.mark.slow),
        pytest.param('left_left = "blurred"', {("left_left", "sharpness", "warn")}, 8, marks=pytest.mark.slow),
    ],
)
@pytest.mark.requirement("R-FIRE-1", "R-FIRE-4")
def test_each_fault_is_named_and_the_other_cameras_frames_are_kept(place, faults, expected, delivered):
    fired = fire(place, faults=faults)
    assert levels(fired) == expected
    refused = any(level == "refuse" for *_, level in expected)
    assert fired.accepted is not refused
    assert len(list(fired.shot.glob("*.jpg"))) == delivered
    assert list((place / "s/capture").iterdir()) == [] if refused else True
    camera = faults.split(" =")[0]
    assert any(camera in sentence for sentence in fired.verdict.sentences) or "moved" in faults


@pytest.mark.slow
def test_exchanged_cables_are_both_named(place):
    said = fire(place, faults='front_left = "swapped=left_right"').verdict.sentences[0]
    assert "front_left" in said
    assert "left_right" in said
    assert "cables" in said


@pytest.mark.slow
def test_a_second_firing_replaces_the_first_and_keeps_its_pictures(place):
    with OpenRig(rig_file(place)) as rigged:
        first, second = rigged.fire_into(place / "s"), rigged.fire_into(place / "s")
    assert (first.shot.name, second.shot.name) == ("001", "002")
    assert second.accepted
    for camera in (place / "s/capture").iterdir():
        assert camera.samefile(second.shot / camera.name)
        assert camera.read_bytes() != (first.shot / camera.name).read_bytes()


@pytest.mark.slow
def test_a_refused_firing_leaves_an_earlier_capture_alone(place):
    fire(place)
    before = {path.name: path.read_bytes() for path in (place / "s/capture").iterdir()}
    assert not fire(place, faults='front_left = "unplugged"').accepted
    assert {path.name: path.read_bytes() for path in (place / "s/capture").iterdir()} == before


@pytest.mark.slow
@pytest.mark.requirement("R-FIRE-3")
def test_photographs_from_elsewhere_are_never_replaced(place):
    fire(place)
    shutil.copy(place / "calibrated/capture/front_left.png", place / "s/capture/mine.png")
    with pytest.raises(SessionError, match=r"mine\.png"):
        fire(place)
    assert (place / "s/capture/mine.png").exists()


@pytest.mark.slow
def test_the_last_picture_once_more_is_found_by_its_bytes(place, monkeypatch):
    with OpenRig(rig_file(place)) as rigged:
        rigged.fire_into(place / "s")
        kept = rigged.backend.fetch

        def stuck(camera: str, timeout_s: float) -> Frame:
            frame = kept(camera, timeout_s)
            return frame if camera != "front_left" else Frame(camera=camera, content=first, taken_s=frame.taken_s)

        first = (place / "s/shots/001/front_left.jpg").read_bytes()
        monkeypatch.setattr(rigged.backend, "fetch", stuck)
        fired = rigged.fire_into(place / "s")
    assert ("front_left", "fresh", "refuse") in levels(fired)


@pytest.mark.slow
@pytest.mark.requirement("R-FIRE-1")
def test_a_full_disk_is_named_and_what_fits_is_kept(place, monkeypatch):
    written = []

    def write(path, data):
        if path.suffix == ".jpg" and len(written) >= 3:
            path.write_bytes(data[: len(data) // 2])
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))
        written.append(path)
        path.write_bytes(data)

    monkeypatch.setattr(shots, "write_new", write)
    fired = fire(place)
    assert not fired.accepted
    assert len(list(fired.shot.glob("*.jpg"))) == 3
    missing = [one.sentence for _, one in fired.verdict.findings if one.check == "delivered" and one.level == "refuse"]
    assert len(missing) == CAMERAS - 3
    assert all("room" in sentence for sentence in missing)


@pytest.mark.slow
@pytest.mark.requirement("R-FIRE-1")
def test_a_disk_without_any_room_leaves_nothing(place, monkeypatch):
    def write(path, data):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))

    monkeypatch.setattr(shots, "write_new", write)
    with pytest.raises(FullDiskError):
        fire(place)
    assert list((place / "s/shots").iterdir()) == []


@pytest.mark.slow
@pytest.mark.parametrize("cut", ["after the first rename", "before any"])
@pytest.mark.requirement("R-FIRE-2")
def test_a_power_cut_while_the_capture_is_replaced_loses_nothing(place, cut):
    fire(place)
    session = place / "s"
    names = {path.name for path in (session / "capture").iterdir()}
    shutil.copytree(session / "shots/001", session / ".capture-new")
    (session / ".capture-new/shot.json").unlink()
    if cut == "after the first rename":
        (session / "capture").rename(session / ".capture-old")
    shots.require_replaceable(session)
    assert {path.name for path in (session / "capture").iterdir()} == names
    assert not (session / ".capture-new").exists()
    assert not (session / ".capture-old").exists()


@pytest.mark.slow
@pytest.mark.parametrize(("spread_ms", "accepted"), [(0.4, True), (1.6, False)])
@pytest.mark.requirement("R-FIRE-6")
def test_a_measured_skew_over_the_limit_refuses_a_patient(place, spread_ms, accepted):
    offsets = dict.fromkeys(Session.open(place / "calibrated").cameras, 0.0) | {"left_left": spread_ms}
    write_skew(place / "calibrated", Skew(offset_ms=offsets, std_ms=0.05, measured="2026-01-01", exposure_ms=1.0))
    fired = fire(place, subject="torso")
    assert fired.accepted is accepted
    assert any("left_left" in one.sentence for _, one in fired.verdict.findings if one.check == "skew") is not accepted
    assert (place / "s/skew.json").exists() is accepted


@pytest.mark.slow
def test_the_command_says_it_in_plain_words_and_by_its_exit_code(place, capsys):
    assert run(["capture", str(place / "s"), "--rig", str(rig_file(place)), "-q"]) == 0
    assert run(["capture", str(place / "t"), "--rig", str(rig_file(place, faults='left_left = "unplugged"'))]) == 12
    said = capsys.readouterr().out
    assert "left_left: " in said
    assert run(["capture", str(place / "t"), "--rig", str(rig_file(place)), "--json"]) == 0
    table = json.loads(capsys.readouterr().out)
    assert table["accepted"] is True
    assert table["seconds"] > 0


@pytest.mark.parametrize(
    ("wrong", "code"),
    [({"backend": "virtul"}, 3), ({"lines": "speed = 3"}, 3), ({"lines": 'cameras = { nobody = "1" }'}, 3)],
)
def test_a_wrong_rig_file_is_one_sentence(place, capsys, wrong, code):
    assert run(["capture", str(place / "s"), "--rig", str(rig_file(place, **wrong))]) == code
    assert "found" in capsys.readouterr().err
    assert not (place / "s").exists()


@pytest.mark.slow
@pytest.mark.requirement("R-FIRE-7")
def test_two_rigs_on_one_bus_are_told_who_has_the_camera(place):
    """The same serial number in two rigs' files: the second is refused, and the first goes on."""
    serial = f"S-{place.name}"  # of this test alone
    (place / "other").mkdir()
    shutil.copytree(place / "calibrated", place / "other/calibrated")
    mine = rig_file(place, lines=f'cameras = {{ front_left = "{serial}", front_right = "{serial}-2" }}')
    other = rig_file(place / "other", lines=f'cameras = {{ left_left = "{serial}-3", floor_left = "{serial}" }}')
    with OpenRig(mine) as rigged:
        with pytest.raises(CaptureError, match=rf"floor_left.*{serial}.* reference .*front_left"):
            OpenRig(other)
        with pytest.raises(CaptureError, match=str(serial)):  # nothing of the refused rig stays held
            OpenRig(other)
        assert rigged.backend.health("front_left").fault == ""
    OpenRig(other).close()  # the first let go


def test_a_camera_s_own_file_is_kept_byte_for_byte(tmp_path):
    content = b"\xff\xd8\xff" + np.random.default_rng(0).bytes(1000)
    shot = shots.PendingShot(tmp_path)
    assert shot.keep(Frame(camera="a", content=content)).read_bytes() == content
    assert shot.finish({}).name == "001"
