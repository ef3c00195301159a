"""Incoming photographs: their checks, reduced pictures, cameras, and photographs set aside."""

import io
import json
import os
import shutil
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from mammometry.api.job import open_session
from mammometry.base.errors import CalibrationError, ImageError, MammometryError
from mammometry.base.parse import LimitSettings
from mammometry.base.photograph import Photograph
from mammometry.calibration.adjust.initialise import least_views
from mammometry.calibration.features.keypoints import Keypoints, keypoints
from mammometry.calibration.judge.camera_names import check_names, wrong_photographs
from mammometry.calibration.targets.table import target_from_table
from mammometry.capture import camera_checks, checks
from mammometry.capture.camera_checks import KnownCamera
from mammometry.capture.checks import NO_PHOTOGRAPH, Finding, not_only_a_photograph
from mammometry.clinic.intake.check_photographs import known_photograph
from mammometry.clinic.intake.places import Target
from mammometry.clinic.models import Calibration, DailyCheck, Upload, Visit
from mammometry.clinic.site import the_clinic
from mammometry.geometry.camera import Rig
from mammometry.io.photographs.images import read_header, read_photograph
from mammometry.io.photographs.same_pixels import pixels_digest
from mammometry.io.photographs.tags import read_exposure
from mammometry.io.write import disk_errors, sync_folder
from mammometry.job.stages import calibrate

_LONGEST_PX, _QUALITY = 480, 75  # thumbnails of about 20 kB; affects their appearance only
_SCREEN_PX, _SCREEN_QUALITY = 1600, 85  # screen-filling pictures of about 200 kB; affects their appearance only


def thumbnail_path(upload: Upload) -> Path:
    """Path of an upload's thumbnail."""
    return upload.path.with_suffix(".webp")


def files_of(upload: Upload) -> list[Path]:
    """Files of an upload that is not in a session."""
    return [upload.path, Path(f"{upload.path}.lock"), thumbnail_path(upload)]


def write_thumbnail(upload: Upload, photograph: Photograph) -> None:
    """Write an upload's thumbnail."""
    small_picture(_roughly(photograph, _LONGEST_PX), thumbnail_path(upload))


def screen_picture(photograph: Photograph) -> bytes:
    """The photograph as a WebP that fills a screen."""
    picture = _roughly(photograph, _SCREEN_PX)
    picture.thumbnail((_SCREEN_PX, _SCREEN_PX))
    buffer = io.BytesIO()
    picture.save(buffer, format="WEBP", quality=_SCREEN_QUALITY)
    return buffer.getvalue()


def _roughly(photograph: Photograph, longest_px: int) -> Image.Image:
    """A picture of at least twice that size, with 8 bits, which Pillow then reduces further."""
    pixels = photograph.pixels
    shift = 8 * (pixels.dtype.itemsize - 1)
    step = max(1, max(photograph.size_wh) // (2 * longest_px))
    return Image.fromarray(np.ascontiguousarray((pixels[::step, ::step] >> shift).astype(np.uint8)))


def small_picture(picture: Image.Image, path: Path) -> None:
    """Write a thumbnail of a picture opened by Pillow. A JPEG is decoded only as far as needed."""
    picture.draft("RGB", (_LONGEST_PX, _LONGEST_PX))
    picture.thumbnail((_LONGEST_PX, _LONGEST_PX))
    small = picture if picture.mode in ("L", "RGB") else picture.convert("RGB")
    small.save(path, format="WEBP", quality=_QUALITY)


_KEPT = 64  # photographs with cached features, 0.5 MB each: those of visits that are being entered
_features: dict[str, Keypoints] = {}


def note(sha256: str, photograph: Photograph) -> None:
    """Cache the features of a decoded photograph."""
    _features[sha256] = keypoints(photograph)
    for old in list(_features)[:-_KEPT]:
        _features.pop(old, None)


Placed = tuple[tuple[str, str, Path], ...]
"""Camera, digest and path of each photograph."""


@dataclass(frozen=True, slots=True)
class NamesChecked:
    """Result of comparing all photographs with their cameras."""

    findings: tuple[Finding, ...] = ()
    exchanged: Mapping[str, str] = field(default_factory=dict)
    """Camera → camera under which its photograph was stored."""


def check(visit: Visit, photographs: Placed) -> NamesChecked:
    """Find photographs that are swapped or do not belong to the others.

    Args:
        visit: with its calibration, if any.
        photographs: those with a camera.
    """
    calibration = visit.calibration
    if calibration is None or not calibration.figures:
        return NamesChecked()
    return _checked(str(the_clinic().folder / calibration.folder), photographs)


@lru_cache(maxsize=32)
def _checked(calibration: str, photographs: Placed) -> NamesChecked:
    try:
        rig = _rig(calibration)
        seen = {camera: _seen(sha256, path) for camera, sha256, path in photographs if camera in rig.cameras}
    except MammometryError:  # the job reports faults of the calibration or of a photograph
        return NamesChecked()
    names = check_names(rig, seen)
    wrong = wrong_photographs(names, rig.pair_names)
    findings = [
        Finding("names", "refuse", f"{mismatch.listed}: {mismatch.found}. {mismatch.remedy}.") for mismatch in wrong
    ]
    if names.unknown and not findings:
        pairs = ", ".join(names.unknown)
        sentence = f"Too little texture to check whether the photographs of pair {pairs} belong to their cameras."
        findings.append(Finding("names", "unknown", sentence))
    return NamesChecked(tuple(findings), dict(names.exchanged))


def cameras_by_geometry(visit: Visit, placed: Placed, unnamed: Placed) -> dict[str, str]:
    """Digest of each photograph of an unknown camera → the camera that took it, from the calibration.

    Args:
        visit: with its calibration, if any.
        placed: photographs with a camera.
        unnamed: photographs without a camera, for the cameras that have none.

    Returns:
        Empty if the camera of any photograph cannot be determined.
    """
    calibration = visit.calibration
    if calibration is None or not calibration.figures or not unnamed:
        return {}
    return dict(_by_geometry(str(the_clinic().folder / calibration.folder), placed, unnamed))


@lru_cache(maxsize=32)
def _by_geometry(calibration: str, placed: Placed, unnamed: Placed) -> tuple[tuple[str, str], ...]:
    try:
        rig = _rig(calibration)
        seen = {camera: _seen(sha256, path) for camera, sha256, path in (*placed, *unnamed)}
    except MammometryError:
        return ()
    if set(seen) != set(rig.cameras):
        return ()
    moves = check_names(rig, seen).exchanged
    if set(moves) & {camera for camera, *_ in placed}:
        return ()  # a photograph with a camera seems to be wrong
    right = {camera: moves.get(camera, camera) for camera in rig.cameras}
    after = check_names(rig, {camera: seen[source] for camera, source in right.items()})
    without_names = {camera for camera, *_ in unnamed}
    is_sure = all(after.pairs[pair].sure for pair, both in rig.pair_names.items() if without_names & set(both))
    if not (after.right and is_sure):
        return ()
    digests = {camera: sha256 for camera, sha256, _ in unnamed}
    return tuple((digests[right[camera]], camera) for camera in sorted(without_names))


@lru_cache(maxsize=8)
def _rig(calibration: str) -> Rig:
    job = open_session(calibration, the_clinic().measuring())
    if not job.store.has(job.plan[calibrate.cameras].key):  # computed by a job, not while a page waits
        raise CalibrationError(
            calibration, found="no result that is current", expected="one", remedy="Calibrate the rig again"
        )
    return job.calibrate().rig


def _seen(sha256: str, path: Path) -> Keypoints:
    if sha256 not in _features:
        note(sha256, read_photograph(path, path.name))
    return _features[sha256]


def look(upload: Upload, target: Target) -> tuple[list[Finding], dict[str, Any]]:
    """Run all checks of one photograph. Returns the findings and the EXIF data to store."""
    other = not_only_a_photograph(upload.path)
    if other is not None:
        what = "no photograph" if other is NO_PHOTOGRAPH else f"{other} as well as a photograph"
        sentence = f"This file is {what}. Send the original JPEG, PNG or TIFF of the camera."
        return [Finding("format", "refuse", sentence)], {}
    limits = LimitSettings(megapixels=float(the_clinic().limits.photograph_megapixels))
    try:
        header = read_header(upload.path, "The photograph", limits)
        photograph = read_photograph(upload.path, "The photograph", limits)
    except ImageError as error:
        return [Finding("format", "refuse", str(error))], {}
    except MemoryError:
        return [Finding("format", "refuse", "The photograph is too large for this machine.")], {}
    exposure = read_exposure(upload.path)
    known = known_cameras(target)
    named = next((check.get("named") for check in upload.checks if check.get("named")), None)
    file = next((check.get("file") for check in upload.checks if check.get("file")), None)
    if not upload.camera:
        upload.camera = camera_checks.camera_of_serial(exposure.serial, known) or ""
    megapixels = header.stored_wh[0] * header.stored_wh[1] / 1e6
    findings = [Finding("format", "ok", f"A photograph of {megapixels:.1f} megapixels.")]
    if upload.camera:
        findings.append(camera_checks.right_camera(upload.camera, exposure, named, known))
        findings.append(camera_checks.right_size(upload.camera, header.stored_wh, header.orientation, known))
    else:
        sentence = "The file's name and EXIF do not show which camera took it. Choose the camera."
        findings.append(Finding("camera", "unknown", sentence))
    if isinstance(target, Visit):
        findings += checks.judge(checks.look(photograph), target.subject_kind)
        note(upload.sha256, photograph)
    pixels = "" if isinstance(target, Visit) else pixels_digest(photograph)
    if isinstance(target, DailyCheck):
        findings += known_photograph(upload, target, pixels, exposure.taken_s)
    write_thumbnail(upload, photograph)
    seen = {"serial": exposure.serial, "taken_s": exposure.taken_s, "named": named, "pixels": pixels}
    return findings, seen if file is None else {**seen, "file": file}


def known_cameras(target: Target) -> Mapping[str, KnownCamera]:
    """Cameras as known from the calibration of a target. Empty for a new calibration."""
    if isinstance(target, Calibration):
        return {}
    return target.calibration.result.cameras if target.calibration is not None else {}


def poses_needed(definition: Mapping[str, Any], cameras: Sequence[str], photographs: Iterable[tuple[str, str]]) -> str:
    """Sentence on the poses of the board that are still needed. Empty if the rig can be calibrated.

    Args:
        definition: description of the rig.
        cameras: names of the rig's cameras.
        photographs: pose and camera of each.
    """
    table = definition.get("target")
    least = least_views(target_from_table(table)) if table else 1
    of_camera = Counter(camera for _, camera in photographs)
    missing = max((least - of_camera[camera] for camera in cameras), default=least)
    if missing <= 0:
        return ""
    poses = "one more pose" if missing == 1 else f"{missing} more poses"
    return f"Add {poses} of the board: each camera must see it {least} times at least; ten poses are better."


FOLDER = "set-aside"


def set_aside(upload: Upload, folder: Path, *, kept_name: str = "") -> None:
    """Set aside a photograph that has a camera, under a unique file name.

    Args:
        upload: its camera is known.
        folder: folder of the visit, calibration or check.
        kept_name: file that the next photograph will replace. It is not moved.

    Raises:
        StorageError: the disk is full or refuses.
    """
    place = Path(upload.name)
    pose = [place.parts[1]] if len(place.parts) == 3 else []
    name = Path(FOLDER, *pose, f"{place.stem}-{upload.pk.hex}{place.suffix}")
    if not (folder / name).exists():
        _copy(folder / place, folder / name)
    upload.name, upload.state = name.as_posix(), Upload.State.SET_ASIDE
    upload.save()
    if place.name != kept_name:
        (folder / place).unlink(missing_ok=True)


def clear_place(others: Sequence[Upload], upload: Upload, folder: Path, goal: Path) -> bool:
    """Set aside the photograph that a new one replaces, and delete incomplete uploads for the same camera.

    Args:
        others: other uploads for the same camera and pose.
        upload: the new one.
        folder: folder of the visit, calibration or check.
        goal: its final file.

    Returns:
        False if the same photograph was there already.

    Raises:
        StorageError: the disk is full or refuses.
    """
    changed = True
    for other in others:
        if other.state == Upload.State.PLACED and other.sha256 != upload.sha256:
            set_aside(other, folder, kept_name=goal.name)
            continue
        changed = changed and other.state != Upload.State.PLACED
        thumbnail_path(other).unlink(missing_ok=True)
        other.delete()
    for path in goal.parent.glob(f"{upload.camera}.*"):
        if path != goal:
            path.unlink()
    return changed


def fired_files(folder: Path) -> dict[str, str]:
    """Digest of every captured picture → its permanent file, below the visit's folder."""
    names: dict[str, str] = {}
    for path in sorted((folder / "shots").glob("[0-9]*/shot.json")):
        try:
            cameras = json.loads(path.read_text(encoding="utf-8"))["cameras"]
            names |= {about["sha256"]: f"shots/{path.parent.name}/{about['file']}" for about in cameras.values()}
        except (OSError, ValueError, KeyError, TypeError, AttributeError):
            continue  # from a failed capture
    return names


def put_back(upload: Upload, folder: Path, goal: Path) -> None:
    """Restore the file of a photograph that was set aside.

    The set-aside file remains until the database row is updated.

    Raises:
        StorageError: the disk is full or refuses.
    """
    _copy(folder / upload.name, goal)


def _copy(source: Path, goal: Path) -> None:
    """Link a file, or copy it if the disk has no links, atomically."""
    with disk_errors(goal):
        goal.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        part = goal.with_name(f".{goal.name}.part")
        part.unlink(missing_ok=True)
        try:
            os.link(source, part)
        except OSError:
            shutil.copy2(source, part)
        part.replace(goal)
        part.unlink(missing_ok=True)  # rename does nothing if both are links to one file
        sync_folder(goal.parent)
