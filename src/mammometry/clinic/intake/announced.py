"""A sender's announcement of a photograph or video, before the data are sent."""

import re
from dataclasses import dataclass
from pathlib import PurePath

from mammometry.clinic.intake.places import UploadError
from mammometry.clinic.site import the_clinic
from mammometry.io.photographs.video_file import VIDEO_EXTENSIONS

_BY_A_CAMERA = re.compile(
    r"[A-Za-z]{0,4}[_-]?\d{2,8}\.[A-Za-z]{3,4}|(?:IMG_|PXL_)?20\d{6}_\d{6,9}\.[A-Za-z]{3,4}", re.ASCII
)
"""Names that cameras give their files, such as IMG_0001.JPG, DSC01234.JPG, P1010001.JPG, IMG_20261129_143000.jpg."""
_SHA256 = re.compile(r"[0-9a-f]{64}")


@dataclass(frozen=True, slots=True, kw_only=True)
class Announced:
    """A file that a sender is about to send."""

    name: str
    """The sender's file name. It is stored only if a camera gave it (IMG_0001.JPG). Otherwise only the name of a rig's
    camera that it contains is stored."""
    camera: str | None = None
    """Camera that took it. None: its name or EXIF data show the camera."""
    pose: str = ""
    """Pose, for a calibration's photograph."""
    size_bytes: int
    sha256: str
    """Hexadecimal digest. Empty: unknown."""

    @property
    def is_video(self) -> bool:
        """Whether its name is that of a video. When it has arrived, its content decides."""
        return PurePath(self.name).suffix.lower() in VIDEO_EXTENSIONS

    @property
    def camera_file(self) -> str | None:
        """The file's name if a camera gave it. Other names may contain a patient's and are not stored."""
        return self.name if _BY_A_CAMERA.fullmatch(self.name) else None


def check_announced(file: Announced, *, video: bool = False) -> None:
    """Refuse an invalid digest or size.

    Args:
        file: the announcement.
        video: whether it is a video, which may be larger.

    Raises:
        UploadError: the digest is not a SHA-256, or the file is empty or too large.
    """
    if file.sha256 and not _SHA256.fullmatch(file.sha256):
        raise UploadError("The digest is no SHA-256 in small hexadecimal letters.", 400)
    require_size(file.size_bytes, video=video)


def require_size(size_bytes: int, *, video: bool = False) -> None:
    """Refuse an empty or too large file.

    Raises:
        UploadError: with status 413.
    """
    limits = the_clinic().limits
    most_mb, what = (limits.video_mb, "video") if video else (limits.photograph_mb, "photograph")
    if not 0 < size_bytes <= most_mb * 10**6:
        raise UploadError(f"The file has {size_bytes / 1e6:.0f} MB. A {what} has 1 byte to {most_mb} MB.", 413)
