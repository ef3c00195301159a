"""A video of a walk instead of photographs."""

import re
import shutil
import struct

import cv2
import numpy as np
import pytest
from board_walk import BOARD, FOCAL_PX, SIZE_WH, photograph, printed_sheet, save

from mammometry.api.photos import prepare_walk, read_walk
from mammometry.api.walk_pictures import walk_video
from mammometry.base.errors import ImageError, SessionError
from mammometry.base.photograph import Photograph
from mammometry.io.photographs.video import write_frames
from mammometry.walk.frames import SeenFrame, choose_frames, direction_in

RATE = 10.0
"""Frames per second: every second one is blurred."""


def write_video(path, frames):
    height, width = frames[0].shape[:2]
    video = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), RATE, (width, height))
    assert video.isOpened()
    for frame in frames:
        video.write(np.ascontiguousarray(frame[..., ::-1]))
    video.release()
    return path


@pytest.fixture(scope="module")
def film(tmp_path_factory):
    """An arc at each height, with every second frame blurred, and 1 s at rest."""
    sheet = printed_sheet()
    stations = [(azimuth, height) for height in (-10.0, 14.0) for azimuth in np.linspace(-42, 42, 12)]
    frames = []
    for station in stations:
        frames += [photograph(*station, sheet=sheet), photograph(*station, sheet=sheet, blur_px=2.5)]
    frames += [frames[-2]] * round(RATE)
    return write_video(tmp_path_factory.mktemp("film") / "walk.mp4", frames)


@pytest.mark.slow
@pytest.mark.requirement("R-PHOTO-2")
def test_sharp_frames_that_are_spread_over_the_walk_are_used(film, tmp_path):
    (tmp_path / "photos").mkdir()
    shutil.copy(film, tmp_path / "photos")
    walk = prepare_walk(tmp_path / "photos", tmp_path / "session")
    assert walk == read_walk(tmp_path / "session") == prepare_walk(tmp_path / "photos", tmp_path / "session")
    assert 18 <= walk.pictures <= 30
    assert {why.code for why in walk.left_out.values()} <= {"not-in-a-pair"}
    assert walk.focal_px == pytest.approx(FOCAL_PX, rel=5e-3)
    times_s = [float(re.fullmatch(r"(\d+\.\d) s", time)[1]) for time in walk.names(tmp_path / "photos").values()]
    assert times_s == sorted(times_s)
    numbers = np.array(times_s) * RATE
    assert np.mean(np.abs((numbers + 1) % 2 - 1) < 0.5) > 0.9  # the sharp ones
    assert (numbers > 2 * 24 + 1).sum() <= 1  # one of those at rest


@pytest.mark.slow
@pytest.mark.requirement("R-PHOTO-2")
def test_a_video_and_photographs_or_two_videos_are_a_choice_of_the_user(film, tmp_path):
    shutil.copy(film, tmp_path / "walk.MP4")
    assert walk_video(tmp_path) == tmp_path / "walk.MP4"
    shutil.copy(film, tmp_path / "other.mov")
    with pytest.raises(SessionError):
        walk_video(tmp_path)
    (tmp_path / "other.mov").unlink()
    save(tmp_path / "1.jpg", photograph(0.0, 0.0))
    with pytest.raises(SessionError):
        prepare_walk(tmp_path, tmp_path.parent / "session")
    (tmp_path / "walk.MP4").rename(tmp_path / "1.MOV")  # a live photo's
    assert walk_video(tmp_path) is None


@pytest.mark.parametrize("content", [b"", b"\0\0\0\x18ftypmp42" + bytes(200), b"#EXTM3U\n#EXTINF:1,\nother.ts\n"])
def test_a_damaged_video_is_refused_by_name(tmp_path, content):
    (tmp_path / "walk.mp4").write_bytes(content)
    with pytest.raises(ImageError) as refused:
        write_frames(tmp_path / "walk.mp4", tmp_path, BOARD)
    assert refused.value.subject == "walk.mp4"


@pytest.mark.slow
def test_a_truncated_video_is_refused(film, tmp_path):
    content = film.read_bytes()
    (tmp_path / "walk.mp4").write_bytes(content[: len(content) // 2])
    with pytest.raises(ImageError):
        write_frames(tmp_path / "walk.mp4", tmp_path, BOARD)


def test_frames_are_turned_as_the_metadata_say(tmp_path):
    """A quarter turn in the track's matrix (ISO/IEC 14496-12, 8.3.2)."""
    path = write_video(tmp_path / "walk.mp4", [photograph(0.0, 5.0)] * 3)
    content = bytearray(path.read_bytes())
    start = content.index(b"tkhd") + 4 + 40
    matrix = (0, 1 << 16, 0, -(1 << 16), 0, 0, SIZE_WH[1] << 16, 0, 1 << 30)
    content[start : start + 36] = struct.pack(">9i", *matrix)
    path.write_bytes(content)
    (file,) = write_frames(path, tmp_path, BOARD)
    with_turn = cv2.imread(str(file))
    assert with_turn.shape[1::-1] == SIZE_WH[::-1]


@pytest.mark.slow
def test_directions_are_those_of_the_telephone():
    for azimuth, elevation in ((0.0, 0.0), (30.0, 10.0), (-40.0, -10.0)):
        frame = Photograph(name="1", pixels=photograph(azimuth, elevation))
        a, e = np.radians([azimuth, elevation])
        away = np.array([np.sin(a) * np.cos(e), -np.sin(e), -np.cos(a) * np.cos(e)])
        found = direction_in(frame, BOARD)
        assert np.degrees(np.arccos(found @ away)) < 3.0  # the principal point is only roughly the middle


def test_frames_are_chosen_apart_and_sharp():
    angles = np.radians(np.repeat(np.linspace(-60, 60, 121), 3))
    directions = np.column_stack([np.sin(angles), np.zeros_like(angles), -np.cos(angles)])
    sharpness = np.tile([1.0, 3.0, 2.0], 121)
    seen = [
        SeenFrame(index=index, sharpness=float(sharpness[index]), direction=direction)
        for index, direction in enumerate(directions)
    ]
    chosen = choose_frames(seen, most=25)
    assert len(chosen) == 25
    assert set(sharpness[chosen]) == {3.0}
    gaps = np.diff(np.degrees(angles[chosen]))
    assert gaps.min() >= 2.5
    assert gaps.max() < 9.0
    assert choose_frames(seen[:3]) == [1]
    assert choose_frames([]) == []
