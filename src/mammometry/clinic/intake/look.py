"""One photograph, looked at as it comes in: its format, its camera, its size, what it shows."""

from __future__ import annotations

from typing import Any

from mammometry.base.errors import ImageError
from mammometry.base.parse import LimitSettings
from mammometry.capture.checks import cameras, pixels
from mammometry.capture.checks.cameras import KnownCamera
from mammometry.capture.checks.content import not_only_a_photograph
from mammometry.capture.checks.found import Found
from mammometry.clinic.intake import names
from mammometry.clinic.intake.thumbnail import thumbnail_path, write_thumbnail
from mammometry.clinic.models import Calibration, DailyCheck, Upload, Visit
from mammometry.clinic.site import the_clinic
from mammometry.io.photographs.exposure import read_exposure
from mammometry.io.photographs.images import read_header, read_photograph

Target = Visit | Calibration | DailyCheck


def look(upload: Upload, target: Target) -> tuple[list[Found], dict[str, Any]]:
    """All checks of one photograph, and what is kept of its EXIF."""
    other = not_only_a_photograph(upload.path)
    if other is not None:
        what = "no photograph" if other == "no photograph" else f"{other} as well as a photograph"
        sentence = f"This file is {what}. Send the JPEG, PNG or TIFF as the camera wrote it."
        return [Found(check="format", level="refuse", sentence=sentence)], {}
    limits = LimitSettings(megapixels=float(the_clinic().limits.photograph_megapixels))
    try:
        header = read_header(upload.path, "The photograph", limits)
        photograph = read_photograph(upload.path, "The photograph", limits)
    except ImageError as error:
        return [Found(check="format", level="refuse", sentence=str(error))], {}
    except MemoryError:
        return [Found(check="format", level="refuse", sentence="The photograph is too large for this machine.")], {}
    exposure = read_exposure(upload.path)
    known = known_cameras(target)
    named = next((check.get("named") for check in upload.checks if check.get("named")), None)
    if not upload.camera:
        upload.camera = cameras.camera_of_serial(exposure.serial, known) or ""
    megapixels = header.stored_wh[0] * header.stored_wh[1] / 1e6
    found = [Found(check="format", level="ok", sentence=f"A photograph of {megapixels:.1f} megapixels.")]
    if upload.camera:
        found.append(cameras.right_camera(upload.camera, exposure, named, known))
        found.append(cameras.right_size(upload.camera, header.stored_wh, header.orientation, known))
    else:
        sentence = "Neither the file's name nor its EXIF says which camera took it. Choose the camera."
        found.append(Found(check="camera", level="unknown", sentence=sentence))
    if isinstance(target, Visit):
        found += pixels.judge(pixels.look(photograph), target.subject_kind)
        names.note(upload.sha256, photograph)
    write_thumbnail(photograph, thumbnail_path(upload))
    return found, {"serial": exposure.serial, "taken_s": exposure.taken_s, "named": named}


def known_cameras(target: Target) -> dict[str, KnownCamera]:
    """What the calibration that a target belongs to knows of its cameras. Nothing for a new calibration."""
    if isinstance(target, Calibration):
        return {}
    figures = target.calibration.figures if target.calibration is not None else {}
    return {name: KnownCamera.from_table(table) for name, table in figures.get("cameras", {}).items()}
