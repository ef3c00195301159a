"""Check that an exposure of the target was made after the calibration, so that it can show a movement."""

from collections.abc import Iterable, Mapping
from pathlib import Path

from mammometry.base.errors import SessionError
from mammometry.base.photograph import Photograph
from mammometry.io.drift import DriftEntry
from mammometry.io.photographs.same_pixels import may_be_same, pixels_digest
from mammometry.io.photographs.tags import read_exposure
from mammometry.io.write import file_digest

Shot = tuple[str, str]
"""Pose and camera."""
_REMEDY = "Photograph the board now with every camera, and check that exposure"


def require_later(
    image_set: Path,
    files: Mapping[Shot, Path],
    photographs: Mapping[Shot, Photograph],
    calibrated: Mapping[Shot, Path],
    earlier: Iterable[DriftEntry],
) -> dict[str, str]:
    """Raise an error unless photographs are newer than the calibration and differ from all known ones.

    An earlier check of the same folder is ignored, so that an exposure can be checked again.

    Args:
        image_set: folder of the exposure.
        files: its photographs.
        photographs: their content.
        calibrated: photographs of the calibration.
        earlier: checks against that calibration.

    Returns:
        Digest of each photograph's pixels, for the history.

    Raises:
        SessionError: it names the photograph and the reason.
    """
    digests = {shot: pixels_digest(photographs[shot]) for shot in files}
    known_files = {file_digest(path): shot for shot, path in calibrated.items()}
    for shot, path in files.items():
        own = known_files.get(file_digest(path)) or _same_picture(path, photographs[shot], shot[1], calibrated)
        if own is not None:
            raise _refusal(path, f"a photograph of the calibration itself (calibration/{own[0]}/{own[1]})")
        _require_newer(path, shot[1], calibrated)
    for entry in earlier:
        if entry.image_set == str(image_set):
            continue
        for shot, digest in digests.items():
            if digest in entry.photographs.values():
                raise _refusal(files[shot], f"a photograph of the check of {entry.when} ({entry.image_set})")
    return {"/".join(shot): digest for shot, digest in digests.items()}


def _same_picture(path: Path, photograph: Photograph, camera: str, calibrated: Mapping[Shot, Path]) -> Shot | None:
    """Photograph of the calibration with the same pixels, or None."""
    from mammometry.io.photographs.images import read_photograph

    for shot, other in calibrated.items():
        if shot[1] != camera or not may_be_same(path, other):
            continue
        if pixels_digest(read_photograph(other, str(other))) == pixels_digest(photograph):
            return shot
    return None


def _require_newer(path: Path, camera: str, calibrated: Mapping[Shot, Path]) -> None:
    """Raise an error if a photograph is not newer than those of its camera in the calibration."""
    taken_s = read_exposure(path).taken_s
    if taken_s is None:
        return
    moments = (read_exposure(other).taken_s for shot, other in calibrated.items() if shot[1] == camera)
    newest_s = max((moment for moment in moments if moment is not None), default=None)
    if newest_s is not None and taken_s <= newest_s:
        raise _refusal(path, "a photograph that is not newer than the calibration's, by the camera's own clock")


def _refusal(path: Path, found: str) -> SessionError:
    return SessionError(str(path), found=found, expected="a later exposure of the target", remedy=_REMEDY)
