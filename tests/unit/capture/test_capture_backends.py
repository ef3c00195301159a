"""Back-ends of real makers, on the cameras that they simulate themselves. Skipped where they are not installed."""

import importlib.util
import multiprocessing
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from mammometry.base.errors import CaptureError, SettingsError
from mammometry.capture.camera import BACKENDS, CameraSettings, Devices
from mammometry.capture.shots import PendingShot, take
from mammometry.io.photographs.images import demosaiced, read_photograph

SOFTWARE = CameraSettings(exposure_ms=1.0, trigger="software")
NAMES = tuple(f"camera_{number}" for number in range(8))
GENICAM = (importlib.util.find_spec("gi") or Path("/usr/lib/python3/dist-packages/gi").is_dir()) and shutil.which(
    "arv-fake-gv-camera-0.8"
)


def test_all_back_ends_are_known_and_an_unknown_one_names_them():
    assert set(BACKENDS) == {"virtual", "folder", "pylon", "aravis", "gphoto2"}
    with pytest.raises(SettingsError, match="'aravis'"):
        BACKENDS.find("arvis", "it")


@pytest.fixture
def basler(monkeypatch):
    """Eight cameras that pylon emulates."""
    if importlib.util.find_spec("pypylon") is None:
        pytest.skip("pypylon is not installed: pip install 'mammometry[basler]'")
    monkeypatch.setenv("PYLON_CAMEMU", "8")
    ids = {name: f"0815-{number:04d}" for number, name in enumerate(NAMES)}
    rig = BACKENDS["pylon"](Devices(cameras=NAMES, ids=ids, options={}))
    rig.settings(SOFTWARE)
    yield rig
    rig.close()


@pytest.mark.slow
def test_eight_emulated_basler_cameras_deliver_by_software_trigger(basler, tmp_path):
    for firing in (1, 2):
        shot = PendingShot(tmp_path)
        taken = take(basler, NAMES, shot, timeout_s=3.0, features=False)
        assert taken.faults == {}
        assert {one.serial for one in taken.frames.values()} == {f"0815-{n:04d}" for n in range(8)}
        folder = shot.finish({})
        assert folder.name == f"{firing:03d}"
        picture = read_photograph(folder / "camera_3.jpg", "it")
        assert picture.size_wh == basler.health("camera_3").size_wh
        assert picture.pixels.std() > 5  # pylon's test picture is a slope of grey


def test_a_spoilt_buffer_is_that_camera_s_fault_alone(basler, tmp_path):
    device = basler._cameras["camera_5"]
    device.ForceFailedBufferCount.Value = 1
    basler.arm()
    device.ForceFailedBuffer.Execute()
    basler.fire()
    with pytest.raises(CaptureError, match="damaged"):
        basler.fetch("camera_5", 3.0)
    assert basler.fetch("camera_4", 3.0).content.pixels.size
    with pytest.raises(CaptureError, match="within"):  # one pulse, one picture
        basler.fetch("camera_4", 0.2)


def test_an_absent_and_a_held_basler_camera_are_named(basler):
    ids = {"a": "0815-0000", "b": "9999-0000"}
    other = BACKENDS["pylon"](Devices(cameras=("a", "b"), ids=ids, options={}))  # another rig on the same bus
    try:
        assert "9999-0000" in other.health("b").fault
        with pytest.raises(CaptureError, match="9999-0000"):
            other.fetch("b", 0.1)
    finally:
        other.close()


def test_live_pictures_of_basler_cameras_come_without_a_pulse(basler):
    assert basler.live("camera_0").pixels.size
    basler.arm()
    basler.fire()
    assert basler.fetch("camera_0", 3.0).content.pixels.size


@pytest.fixture
def genicam():
    """A fake GigE Vision camera of Aravis on this computer's own network, and Aravis' built-in one."""
    if not GENICAM:
        pytest.skip("Aravis is not installed: apt-get install gir1.2-aravis-0.8 aravis-tools python3-gi")
    server = subprocess.Popen(["arv-fake-gv-camera-0.8", "-i", "127.0.0.1", "-s", "GV01"], stdout=subprocess.DEVNULL)
    try:
        ids = {"a": "Aravis-Fake-GV01", "b": "Fake_1", "c": "127.0.0.9"}
        until = time.monotonic() + 10
        while True:
            options = {"interfaces": ["Fake"], "ptp": True}
            rig = BACKENDS["aravis"](Devices(cameras=("a", "b", "c"), ids=ids, options=options))
            if not rig.health("a").fault or time.monotonic() > until:
                break
            rig.close()
            time.sleep(0.2)
        yield rig
        rig.close()
    finally:
        server.kill()
        server.wait()


@pytest.mark.slow
def test_aravis_fake_cameras_deliver_and_an_absent_one_is_named(genicam, tmp_path):
    genicam.settings(CameraSettings(exposure_ms=10.0, trigger="software"))  # the fake ones are black at 1 ms
    shot = PendingShot(tmp_path, suffix="png")
    taken = take(genicam, ("a", "b", "c"), shot, timeout_s=5.0, features=False)
    assert set(taken.frames) == {"a", "b"}, {name: str(error) for name, error in taken.faults.items()}
    assert taken.frames["a"].serial == "GV01"
    assert abs(taken.frames["a"].taken_s - taken.fired_s) < 5
    assert "127.0.0.9" in taken.faults["c"].found
    assert read_photograph(shot.folder / "a.png", "it").pixels.std() > 5


@pytest.fixture
def nikon(monkeypatch, tmp_path):
    """The Nikon that libgphoto2 simulates; it photographs what lies in its memory."""
    if importlib.util.find_spec("gphoto2") is None:
        pytest.skip("gphoto2 is not installed: pip install 'mammometry[tethered]'")
    memory = tmp_path / "memory"
    memory.mkdir()
    pixels = np.random.default_rng(1).integers(0, 255, (48, 64, 3), dtype=np.uint8)
    Image.fromarray(pixels).save(memory / "DSC_0001.jpg")
    monkeypatch.setenv("VCAMERADIR", str(memory))
    devices = Devices(cameras=("a", "b"), ids={"a": "usb:001,001", "b": "usb:001,077"}, options={})
    rig = BACKENDS["gphoto2"](devices)
    yield rig, (memory / "DSC_0001.jpg").read_bytes()
    rig.close()


@pytest.mark.slow
def test_a_simulated_nikon_delivers_its_own_file_and_an_absent_one_is_named(nikon, tmp_path):
    rig, content = nikon
    if "a camera" in rig.health("a").fault or "no camera" in rig.health("a").fault:
        pytest.skip("this gphoto2 has no simulated camera (vusb)")
    assert "Nikon" in rig.health("a").model
    assert "usb:001,077" in rig.health("b").fault
    rig.settings(SOFTWARE)
    shot = PendingShot(tmp_path / "s")
    taken = take(rig, ("a", "b"), shot, timeout_s=10.0, features=False)
    assert set(taken.frames) == {"a"}, {name: str(error) for name, error in taken.faults.items()}
    assert taken.frames["a"].path.read_bytes() == content
    assert "usb:001,077" in taken.faults["b"].found


@pytest.mark.slow
def test_each_tethered_camera_has_a_process_that_ends(nikon):
    rig, _ = nikon
    running = multiprocessing.active_children()
    assert len(running) >= 1
    rig.close()
    assert not [each for each in running if each.is_alive()]


@pytest.mark.parametrize("name", ["pylon", "gphoto2"])
def test_a_back_end_that_is_not_installed_says_how_to_install_it(name, monkeypatch):
    monkeypatch.setitem(sys.modules, "pypylon.pylon" if name == "pylon" else "gphoto2", None)
    monkeypatch.setitem(sys.modules, "pypylon", None)
    with pytest.raises(SettingsError, match="pip"):
        BACKENDS[name](Devices(cameras=("a",), ids={}, options={}))


@pytest.mark.parametrize(("pattern", "places"), [("RG", ((0, 0), (1, 1))), ("BG", ((1, 1), (0, 0)))])
def test_bayer_patterns_give_back_red_and_blue(pattern, places):
    """A picture of one colour everywhere, counted through the filters, is that colour again."""
    colour = (200, 90, 30)
    raw = np.full((8, 10), colour[1], np.uint8)
    (r0, c0), (r1, c1) = places
    raw[r0::2, c0::2], raw[r1::2, c1::2] = colour[0], colour[2]
    assert (demosaiced(raw, pattern)[2:-2, 2:-2] == colour).all()


@pytest.mark.slow
def test_the_folder_of_other_software_gives_complete_sets_only(tmp_path):
    rig = BACKENDS["folder"](Devices(cameras=("a", "b"), ids={}, options={"path": str(tmp_path), "together_s": 2.0}))
    picture(tmp_path / "old_a.jpg", "2026:01:01 09:00:00", 1)
    rig.arm()
    picture(tmp_path / "x_a.jpg", "2026:01:01 10:00:00", 2)  # an exposure that b never had
    picture(tmp_path / "y_a.jpg", "2026:01:01 10:05:00", 3)
    picture(tmp_path / "y_b.jpg", "2026:01:01 10:05:01", 4)
    assert rig.fetch("a", 3.0).content == (tmp_path / "y_a.jpg").read_bytes()
    assert rig.fetch("b", 3.0).content == (tmp_path / "y_b.jpg").read_bytes()
    rig.arm()
    picture(tmp_path / "z_a.jpg", "2026:01:01 10:09:00", 5)
    (tmp_path / "z_b.jpg").write_bytes((tmp_path / "z_a.jpg").read_bytes()[:300])  # still being written
    with pytest.raises(CaptureError, match=r"\bb\b"):
        rig.fetch("b", 0.6)
    assert rig.fetch("a", 0.6).content == (tmp_path / "z_a.jpg").read_bytes()


def test_a_raw_picture_of_other_software_is_named(tmp_path):
    rig = BACKENDS["folder"](Devices(cameras=("a", "b"), ids={}, options={"path": str(tmp_path)}))
    rig.arm()
    (tmp_path / "a 17.NEF").write_bytes(b"raw")
    with pytest.raises(CaptureError, match=r"17\.NEF"):
        rig.fetch("a", 0.0)
    with pytest.raises(CaptureError, match=r"\b0 s\b"):
        rig.fetch("b", 0.0)


def test_a_folder_that_is_not_there_is_refused(tmp_path):
    with pytest.raises(SettingsError, match="software"):
        BACKENDS["folder"](Devices(cameras=("a",), ids={}, options={"path": str(tmp_path / "none")}))


def picture(path, taken, seed):
    exif = Image.Exif()
    exif.get_ifd(0x8769)[0x9003] = taken
    pixels = np.random.default_rng(seed).integers(0, 255, (48, 64, 3), dtype=np.uint8)
    Image.fromarray(pixels).save(path, exif=exif)
    os.utime(path)
