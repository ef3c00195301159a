"""Frames of a telephone's video, decoded by OpenCV's FFmpeg (LGPL)."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from PIL import Image

from mammometry.base.errors import ImageError
from mammometry.base.machine.cores import available_cores
from mammometry.base.parse import LimitSettings
from mammometry.base.photograph import Photograph
from mammometry.base.progress import Progress, no_progress
from mammometry.calibration.targets.target import Target
from mammometry.geometry.arrays import Array, UInt8
from mammometry.io.photographs.images import check_size
from mammometry.io.photographs.video_file import require_whole
from mammometry.walk.frames import SeenFrame, choose_frames, direction_in

_LONGEST_S = 240.0  # a walk takes 20 to 60 s
_SEARCHED_PER_S = 4.0  # frames searched for the board per second: every 2.5 degrees of a walk of 120 degrees in 12 s
_SEARCHED_PX = 1100  # longest side of the frames that are searched, as for photographs
_MARGIN = 0.2  # margin of the frame in which sharpness is not measured: it shows the room
_MS = 1e-3  # seconds
_LEAST_READ = 0.9  # least readable share of the frames that the header states: it may state a few too many


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Candidate:
    """The sharpest of some successive frames."""

    index: int
    sharpness: float
    small: Photograph


def write_frames(
    path: Path,
    out: Path,
    board: Target,
    limits: LimitSettings = LimitSettings(),
    progress: Progress = no_progress,
) -> list[Path]:
    """Write the frames of a video that are used for a walk as PNG files, named by their time ("12.4 s").

    Frames are rotated as the video's metadata states.

    Args:
        path: the video.
        out: existing folder.
        board: the board on the patient.
        limits: largest size of a frame.
        progress: fraction of the video read.

    Returns:
        The files in order of time.

    Raises:
        ImageError: the video cannot be read, is too long, or its frames are too large.
    """
    candidates = _candidates(path, limits, progress)
    with ThreadPoolExecutor(available_cores()) as pool:
        directions = list(pool.map(lambda candidate: direction_in(candidate.small, board), candidates))
    seen = [
        SeenFrame(index=candidate.index, sharpness=candidate.sharpness, direction=direction)
        for candidate, direction in zip(candidates, directions, strict=True)
        if direction is not None
    ]
    if not seen:
        raise ImageError(
            path.name,
            found="the board in no frame",
            expected="a walk around the patient with the whole board in view",
            remedy="Film at full resolution, in portrait or landscape. Describe a board of your own in board.toml",
        )
    chosen = set(choose_frames(seen))
    files = []
    for index, time_s, frame in _frames(path, limits):
        if index in chosen:
            name = f"{time_s:.1f} s"
            files.append(out / f"{name if not (out / f'{name}.png').exists() else f'{time_s:.3f} s'}.png")
            Image.fromarray(np.ascontiguousarray(frame[..., ::-1])).save(files[-1], compress_level=1)
            if len(files) == len(chosen):
                break
    return files


def _candidates(path: Path, limits: LimitSettings, progress: Progress) -> list[_Candidate]:
    """The sharpest frame of each quarter of a second."""
    found: dict[int, _Candidate] = {}
    for index, time_s, frame in _frames(path, limits, progress):
        grey = np.asarray(cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY), dtype=np.uint8)
        height, width = grey.shape
        middle = grey[int(_MARGIN * height) : -int(_MARGIN * height), int(_MARGIN * width) : -int(_MARGIN * width)]
        sharpness = float(np.std(cv2.Laplacian(middle, cv2.CV_16S)))
        group = int(time_s * _SEARCHED_PER_S)
        if group not in found or sharpness > found[group].sharpness:
            photograph = Photograph(name=f"{time_s:.1f} s", pixels=_smaller(grey))
            found[group] = _Candidate(index=index, sharpness=sharpness, small=photograph)
    return [found[group] for group in sorted(found)]


@dataclass(frozen=True, slots=True, kw_only=True)
class OpenedVideo:
    """A video whose frames can be read."""

    capture: cv2.VideoCapture
    rate: float
    """Frames per second."""
    count: float
    """Number of frames by the header, which may state a few too many. 0 or less: not stated."""
    size_wh: tuple[int, int]
    """Width and height of a frame, pixels."""

    def small_frame(self, place: float) -> UInt8[Array, "h w 3"] | None:
        """A small RGB frame to search for the board. None if it cannot be read.

        Args:
            place: position in the video, from 0 (beginning) to 1 (end).
        """
        self.capture.set(cv2.CAP_PROP_POS_FRAMES, int(place * max(self.count, 0)))
        good, frame = self.capture.read()
        return np.ascontiguousarray(_smaller(np.asarray(frame, dtype=np.uint8))[..., ::-1]) if good else None


@contextmanager
def opened_video(path: Path, name: str, limits: LimitSettings = LimitSettings()) -> Iterator[OpenedVideo]:
    """Open a video. Frames are rotated as its metadata states.

    Args:
        path: the video.
        name: its name in messages.
        limits: largest size of a frame.

    Raises:
        ImageError: it is of another format, incomplete, without frames, too long, or its frames are too large.
    """
    require_whole(path, name)
    capture = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG)
    try:
        capture.set(cv2.CAP_PROP_ORIENTATION_AUTO, 1)
        rate, count = capture.get(cv2.CAP_PROP_FPS), capture.get(cv2.CAP_PROP_FRAME_COUNT)
        size = (int(capture.get(cv2.CAP_PROP_FRAME_WIDTH)), int(capture.get(cv2.CAP_PROP_FRAME_HEIGHT)))
        if not capture.isOpened() or not rate > 0 or min(size) < 1:
            raise no_frames(name)
        check_size(size, name, limits)
        if count / rate > _LONGEST_S:
            raise ImageError(
                name,
                found=f"a video of {count / rate:.0f} s",
                expected=f"at most {_LONGEST_S:g} s",
                remedy="Cut it to the walk in the telephone's gallery",
            )
        yield OpenedVideo(capture=capture, rate=rate, count=count, size_wh=size)
    finally:
        capture.release()


def no_frames(name: str) -> ImageError:
    """The error for a video from which no frame can be read."""
    return ImageError(
        name,
        found="no frame that can be read",
        expected="a video in H.264 or H.265, as telephones record it",
        remedy="Copy the original file from the telephone again",
    )


def _smaller(frame: UInt8[Array, ...]) -> UInt8[Array, ...]:
    """Reduce a frame to the size at which it is searched for the board."""
    height, width = frame.shape[:2]
    scale = min(1.0, _SEARCHED_PX / max(width, height))
    size = (round(scale * width), round(scale * height))
    return np.asarray(cv2.resize(frame, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)


def _frames(
    path: Path, limits: LimitSettings, progress: Progress = no_progress
) -> Iterator[tuple[int, float, UInt8[Array, "h w 3"]]]:
    """Number, time in seconds, and BGR pixels of each frame of a video.

    Raises:
        ImageError: as `opened_video`, or it is damaged.
    """
    with opened_video(path, path.name, limits) as video:
        index = 0
        while True:
            good, frame = video.capture.read()
            if not good:
                break
            time_s = _MS * video.capture.get(cv2.CAP_PROP_POS_MSEC)
            yield index, time_s, np.asarray(frame, dtype=np.uint8)
            index += 1
            progress(min(1.0, index / max(video.count, 1.0)))
    if index == 0:
        raise no_frames(path.name)
    if index < _LEAST_READ * video.count:
        raise ImageError(
            path.name,
            found=f"{index} frames that can be read",
            expected=f"{video.count:.0f}, as the file states",
            remedy="Copy the original file from the telephone again",
        )
