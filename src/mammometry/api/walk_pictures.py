"""Usable pictures of a walk: photographs in a folder, or frames of its video."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

from mammometry.base.errors import ImageError, SessionError
from mammometry.base.listing import by_number, visible
from mammometry.base.photograph import Photograph
from mammometry.base.progress import Progress, part
from mammometry.base.shell import command_line
from mammometry.calibration.detection.detect import Observations
from mammometry.calibration.targets.board import SquaresBoard
from mammometry.calibration.targets.target import Target
from mammometry.io.looked_up import LazyMapping
from mammometry.io.meshes.measured import can_be_opened
from mammometry.io.photographs.heic import HEIC_EXTENSIONS
from mammometry.io.photographs.images import EXTENSIONS, UNREAD_ENDINGS
from mammometry.io.photographs.telephone import read_facts, read_from_sensor
from mammometry.io.photographs.video import write_frames
from mammometry.io.photographs.video_file import VIDEO_EXTENSIONS
from mammometry.walk.copies import judge_copies
from mammometry.walk.held_lens import with_held_lens
from mammometry.walk.inputs import LeftOut, judge_files, require_enough, usual_orientation
from mammometry.walk.one_lens import judge_lenses
from mammometry.walk.sharpness import board_image, judge_images
from mammometry.walk.stations import FEWEST, Stations, find_boards, stations_of
from mammometry.walk.tilted_boards import tilted_boards

_STILLS = (*EXTENSIONS, *HEIC_EXTENSIONS)
_DECODING = 0.5  # share of the progress for decoding a video


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WalkPictures:
    """The pictures of a walk, by number ("01")."""

    names: Mapping[str, str]
    """Number → file name of the picture, or its time in the video."""
    photographs: Mapping[str, Photograph]
    """Number → photograph, read when looked up."""
    observations: Observations
    """The board in the usable pictures."""
    left_out: Mapping[str, LeftOut]
    """Number of a picture that is not used → the reason."""

    def placed(self) -> tuple[Stations, Mapping[str, LeftOut]]:
        """The telephone at each picture that fits the common lens, and all pictures that are left out.

        Raises:
            CalibrationError: too few fit, or they do not determine the positions.
        """
        observations, out = self.observations, dict(self.left_out)
        stations = stations_of(observations)
        # Pictures with another lens bias the common one (a zoom of 50 % by 0.3 %), so the others are tested again.
        while odd := judge_lenses(stations.calibration, stations.rig.cameras):
            out |= odd
            good = tuple(board for board in observations.detections if board.pose not in odd)
            require_enough([board.pose for board in good], out, self.names, FEWEST)
            observations = replace(observations, detections=good)
            stations = stations_of(observations)
        return self._with_tilted(stations, observations, out)

    def _with_tilted(
        self, stations: Stations, observations: Observations, out: Mapping[str, LeftOut]
    ) -> tuple[Stations, Mapping[str, LeftOut]]:
        """Add photographs that show the board at a flat angle, and remove them from those left out."""
        stations = with_held_lens(stations, *tilted_boards(observations, stations, self.photographs))
        return stations, {name: why for name, why in out.items() if name not in stations.rig.cameras}


def walk_files(folder: Path) -> dict[str, Path]:
    """The photographs of a walk in the order of their names: number ("01") → file.

    Numbers in names count as numbers. Pictures in formats that are not read are among them, so that they are reported,
    unless the same picture is there as JPEG, HEIC, PNG or TIFF.

    Raises:
        SessionError: there are none.
    """
    files = _files(folder, _STILLS)
    read = {path.stem.casefold() for path in files}
    unread = [path for path in _files(folder, UNREAD_ENDINGS) if path.stem.casefold() not in read]
    files = sorted({*files, *unread}, key=by_number)
    if not files and can_be_opened(folder):
        raise SessionError(
            str(folder),
            found="a session or a scan",
            expected="the folder of a walk's photographs",
            remedy=f"Measure it: {command_line('mammometry', 'run', folder)}",
        )
    if not files:
        raise _none_in(folder)
    return _numbered(files)


def _none_in(folder: Path) -> SessionError:
    """Why a path has no photographs."""
    found, remedy = "no such folder", "Copy them from the telephone into one folder"
    if folder.is_file():
        found, remedy = "a file", "Name the folder with the photographs; unpack an archive first"
    elif folder.is_dir():
        below = next((path for path in visible(folder) if path.is_dir() and _files(path, _STILLS)), None)
        found = "no photographs" if below is None else f"no photographs, but some in its folder {below.name}"
        if below is not None:
            remedy = f"Measure that: {command_line('mammometry', 'photos', below)}"
    return SessionError(
        str(folder),
        found=found,
        expected="12 to 60 photographs of one walk around the patient, JPEG, HEIC or PNG, or one video",
        remedy=remedy,
    )


def walk_video(folder: Path) -> Path | None:
    """The video of a walk. None if the folder has none.

    A video with the same name as a photograph is the moving part of an iPhone's Live Photo, and is ignored.

    Raises:
        SessionError: several videos, or photographs as well.
    """
    stills = _files(folder, _STILLS)
    of_stills = {_of_live_photo(path) for path in stills}
    videos = [path for path in _files(folder, VIDEO_EXTENSIONS) if _of_live_photo(path) not in of_stills]
    if videos and (stills or len(videos) > 1):
        many = f"{len(videos)} videos" if len(videos) > 1 else f"the video {videos[0].name}"
        raise SessionError(
            str(folder),
            found=f"{many} and {len(stills)} photographs" if stills else many,
            expected="either photographs or one video of one walk",
            remedy="Move the others to another folder",
        )
    return videos[0] if videos else None


@contextmanager
def usable_pictures(
    folder: Path, target: Target, progress: Progress, scratch: Path | None = None
) -> Iterator[WalkPictures]:
    """Check the pictures of a walk, first by their files, then by the board in them.

    The frames of a video are deleted when the context ends.

    Args:
        folder: folder with the photographs or the video.
        target: the board.
        progress: fraction of the pictures checked.
        scratch: folder for the frames of a video. None: the system's.

    Raises:
        SessionError: no pictures, or both photographs and a video.
        CalibrationError: too few are usable.
        ImageError: the video cannot be read.
    """
    video = walk_video(folder)
    if video is None:
        files = walk_files(folder)
        yield _usable(files, {number: path.name for number, path in files.items()}, target, progress)
        return
    with TemporaryDirectory(prefix="mammometry-", dir=scratch) as frames:
        files = _numbered(write_frames(video, Path(frames), target, progress=part(progress, 0.0, _DECODING)))
        names = {number: path.stem for number, path in files.items()}
        yield _usable(files, names, target, part(progress, _DECODING, 1.0))


def _files(folder: Path, endings: tuple[str, ...]) -> list[Path]:
    found = (path for path in visible(folder) if path.suffix.lower() in endings and path.is_file())
    return sorted(found, key=by_number)


def _of_live_photo(path: Path) -> str:
    """Name that a still and its moving part share. An iPhone calls the edited still of IMG_1234 IMG_E1234."""
    return re.sub(r"^img_e(?=[0-9])", "img_", path.stem.lower())


def _numbered(files: list[Path]) -> dict[str, Path]:
    digits = max(2, len(str(len(files))))
    return {f"{number:0{digits}d}": path for number, path in enumerate(files, start=1)}


def _usable(files: Mapping[str, Path], names: Mapping[str, str], target: Target, progress: Progress) -> WalkPictures:
    facts, out = {}, {}
    for number, path in files.items():
        if path.suffix.lower() not in _STILLS:
            out[number] = _in_another_format(path)
            continue
        try:
            facts[number] = read_facts(path, number)
        except ImageError as error:
            out[number] = _damaged(error)
    out |= judge_files(facts)
    orientation = usual_orientation({number: of for number, of in facts.items() if number not in out})
    while True:
        left = {number: path for number, path in files.items() if number not in out}
        require_enough(left, out, names, FEWEST)
        photographs = LazyMapping(left, lambda number, path: read_from_sensor(path, number, orientation))
        try:
            observations = find_boards(photographs, target, progress)
        except ImageError:  # some damage shows only when pixels are decoded
            damaged = _unreadable(photographs)
            if not damaged:
                raise
            out |= damaged
        else:
            break
    out |= {miss.pose: LeftOut(code=miss.code, found=miss.found, remedy=miss.remedy) for miss in observations.missed}
    qualities = {number: of.jpeg_quality for number, of in facts.items()}
    out |= judge_copies(observations.detections, qualities, names)
    if isinstance(target, SquaresBoard):
        seen = {
            board.pose: board_image(photographs[board.pose], board, target)
            for board in observations.detections
            if board.pose not in out
        }
        out |= judge_images({number: image for number, image in seen.items() if image is not None})
    good = tuple(board for board in observations.detections if board.pose not in out)
    require_enough([board.pose for board in good], out, names, FEWEST)
    return WalkPictures(
        names=names,
        photographs=photographs,
        observations=replace(observations, detections=good),
        left_out=out,
    )


def _unreadable(photographs: Mapping[str, Photograph]) -> dict[str, LeftOut]:
    """All pictures that cannot be decoded, so that the search for boards is repeated only once."""
    found = {}
    for number in photographs:
        try:
            photographs[number]
        except ImageError as error:
            found[number] = _damaged(error)
    return found


def _in_another_format(path: Path) -> LeftOut:
    return LeftOut(
        code="photograph",
        found=f"a picture in a format that is not read ({path.suffix[1:].upper()})",
        expected="JPEG, HEIC or PNG",
        remedy="Copy it from the telephone as JPEG or HEIC, at full size",
    )


def _damaged(error: ImageError) -> LeftOut:
    return LeftOut(code=error.code, found=error.found, expected=error.expected, remedy=error.remedy)
