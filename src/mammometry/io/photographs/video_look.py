"""Quick check of a video: its length and size, and whether a few of its frames show the board."""

from __future__ import annotations

from pathlib import Path

from mammometry.base.parse import LimitSettings
from mammometry.base.photograph import Photograph
from mammometry.base.value import value
from mammometry.calibration.targets.target import Target
from mammometry.io.photographs.video import no_frames, opened_video
from mammometry.walk.frames import direction_in

_PLACES = (0.5, 0.25, 0.75)  # shares of the video's length: the patient's front, then both sides


@value(eq=False)
class VideoLook:
    """Length and size of a video, and how many of a few frames show the board."""

    seconds: float
    """Its length. 0: not stated in the file."""
    size_wh: tuple[int, int]
    """Width and height of a frame, pixels."""
    looked_at: int
    """Number of frames that were checked."""
    with_board: int
    """Number of those frames that show the board."""
    frame: Photograph
    """The first of those frames, from the middle of the video: RGB and small."""


def look_at_video(path: Path, name: str, board: Target, limits: LimitSettings = LimitSettings()) -> VideoLook:
    """Check a few frames of a video. `write_frames` reads all of them.

    Args:
        path: the video.
        name: its name in messages.
        board: the board on the patient.
        limits: largest size of a frame.

    Raises:
        ImageError: it is of another format, incomplete, too long, without frames, or its frames are too large.
    """
    with opened_video(path, name, limits) as video:
        found = [video.small_frame(place) for place in _PLACES]
        size_wh, seconds = video.size_wh, max(video.count, 0) / video.rate
    frames = [Photograph(name=name, pixels=pixels) for pixels in found if pixels is not None]
    if not frames:
        raise no_frames(name)
    with_board = sum(direction_in(frame, board) is not None for frame in frames)
    return VideoLook(seconds=seconds, size_wh=size_wh, looked_at=len(frames), with_board=with_board, frame=frames[0])
