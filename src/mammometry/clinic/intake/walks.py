"""Photographs or one video of a walk, taken with one telephone and a printed board.

Sent files are kept unchanged in ``uploads/`` until a measurement has prepared the session, which contains the
photographs by number, cropped to the body and without EXIF data. Then the sent files and their thumbnails are deleted:
they may show a face. Frames of a video are decoded into the same folder, and are deleted when the job ends.
"""

from __future__ import annotations

import shutil
from collections.abc import Collection, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, TypeGuard

from django.db import transaction

from mammometry.api.photos import WALK, read_walk
from mammometry.base.errors import ImageError
from mammometry.base.extras import MissingLibraryError
from mammometry.base.listing import by_number
from mammometry.base.parse import LimitSettings
from mammometry.calibration.targets.board import SquaresBoard
from mammometry.calibration.targets.table import target_from_table
from mammometry.capture.checks import NO_PHOTOGRAPH, Finding, not_only_a_photograph
from mammometry.clinic.intake.announced import Announced, check_announced, require_size
from mammometry.clinic.intake.photographs import files_of, write_thumbnail
from mammometry.clinic.intake.places import Target, UploadError, require_open, uploads_of
from mammometry.clinic.intake.walk_video import is_of_video, look_at_sent_video, require_one_kind
from mammometry.clinic.models import Person, Upload, Visit, Walk
from mammometry.clinic.site import the_clinic
from mammometry.io.photographs.heic import is_heic
from mammometry.io.photographs.tags import read_exposure
from mammometry.io.photographs.telephone import read_facts, read_from_sensor
from mammometry.io.photographs.video_file import is_video
from mammometry.walk.inputs import PictureFacts, judge_files
from mammometry.walk.print_size import PRINT_STD
from mammometry.walk.region import TELEPHONE_BOARD
from mammometry.walk.sharpness import BoardImage, board_image, judge_images
from mammometry.walk.stations import FEWEST, TELEPHONE, find_boards

LEAST, MOST = 12, 60
"""Fewest and most photographs of a walk. Fewer leave skin that no pair shows; more take time, without more accuracy."""
PREPARED = "These photographs are already prepared, and the sent files are deleted. Send all photographs of a new walk."
"""Why a prepared walk cannot be changed."""


def is_walk(target: Target) -> TypeGuard[Visit]:
    """Whether a record is a visit with photographs by one telephone."""
    return isinstance(target, Visit) and target.is_walk


def is_prepared(visit: Visit) -> bool:
    """Whether a visit's session has been made from its photographs, by this or another version."""
    return (visit.folder / WALK).is_file()


def begin(visit: Visit, by: Person | None, file: Announced) -> Upload:
    """Start the upload of a photograph or video of a walk, or find an interrupted one.

    Raises:
        UploadError: it is too large, there are too many, a video would be mixed with other files, or the visit is being
            measured or is prepared.
    """
    require_open(visit)
    if is_prepared(visit):
        raise UploadError(PREPARED)
    check_announced(file, video=file.is_video)
    present = uploads_of(visit).exclude(state=Upload.State.REFUSED)
    if file.sha256 and (earlier := present.filter(sha256=file.sha256).first()) is not None:
        return earlier
    if file.is_video and not file.sha256:  # the browser sends no digest of a video
        arriving = present.filter(state=Upload.State.RECEIVING, size_bytes=file.size_bytes)
        if (earlier := next(filter(is_of_video, arriving), None)) is not None:
            return earlier
    require_one_kind(visit, None, is_video=file.is_video)
    if present.count() >= MOST:
        raise UploadError(f"There are {MOST} photographs already. Take one away first.")
    name = file.camera_file
    words = "A video." if file.is_video else f"The file is called {name}."
    about = ({} if name is None else {"file": name}) | ({"video": True} if file.is_video else {})
    named = [Finding("name", "unknown", words).as_table()] if about else []
    with transaction.atomic():
        upload = Upload.objects.create(
            visit=visit, camera=TELEPHONE, size_bytes=file.size_bytes, sha256=file.sha256, created_by=by,
            checks=[{**check, **about} for check in named],
        )  # fmt: skip
        if visit.state == Visit.State.NEW:
            visit.state = Visit.State.UPLOADING
            visit.save(update_fields=["state"])
    return upload


def look(upload: Upload) -> tuple[list[Finding], dict[str, Any]]:
    """All checks of a photograph or video that has arrived, and the stored data of its file."""
    assert upload.visit is not None
    file = next((check.get("file") for check in upload.checks if check.get("file")), None)
    video = is_video(upload.path)  # by its content, not by what was announced
    try:
        require_size(upload.size_bytes, video=video)
        require_one_kind(upload.visit, upload, is_video=video)
    except UploadError as error:
        return [_refused(str(error))], {}
    findings, about = look_at_sent_video(upload) if video else _look_at_photograph(upload)
    return findings, {**about, "file": file} if about and file is not None else about


def _look_at_photograph(upload: Upload) -> tuple[list[Finding], dict[str, Any]]:
    assert upload.visit is not None
    other = not_only_a_photograph(upload.path, heic=True)
    if other is not None:
        what = "not a photograph or video" if other is NO_PHOTOGRAPH else f"{other} as well as a photograph"
        return [_refused(f"This file is {what}. Send the telephone's original JPEG, HEIC, PNG, MP4 or MOV.")], {}
    same = uploads_of(upload.visit).filter(state=Upload.State.PLACED, sha256=upload.sha256).exclude(pk=upload.pk)
    if same.exists():
        return [_refused("This photograph was sent before.")], {}
    limits = LimitSettings(megapixels=float(the_clinic().limits.photograph_megapixels))
    try:
        facts = read_facts(upload.path, "The photograph", limits)
        photograph = read_from_sensor(upload.path, "The photograph", facts.orientation, limits)
    except ImageError as error:
        return [_refused(str(error))], {}
    except MissingLibraryError:
        return [_refused("HEIC cannot be read here. Set the telephone to JPEG (“Most compatible”), or convert it.")], {}
    except MemoryError:
        return [_refused("The photograph is too large for this machine.")], {}
    board = target_from_table(TELEPHONE_BOARD)
    seen = find_boards({"": photograph}, board)
    width, height = photograph.size_wh
    findings = [Finding("format", "ok", f"A photograph of {width} × {height} pixels.")]
    if seen.missed:
        findings.append(_will_be_left_out(seen.missed[0].found))
    else:
        findings.append(Finding("board", "ok", "The board is in the photograph."))
    write_thumbnail(upload, photograph)
    assert isinstance(board, SquaresBoard)
    image = None if seen.missed else board_image(photograph, seen.detections[0], board)
    about = {
        "taken_s": None if is_heic(upload.path) else read_exposure(upload.path).taken_s,
        "facts": asdict(facts), "board": not seen.missed, "image": None if image is None else asdict(image),
    }  # fmt: skip
    return findings, about


def photographs_of(visit: Visit) -> list[Upload]:
    """Photographs of a walk, in order.

    They are sorted by time if all have one, else by the number in their file names if all have one, else by arrival.
    Photographs that have not arrived or are refused come last.
    """
    rows = list(uploads_of(visit).exclude(state=Upload.State.PREPARED))
    placed = [row for row in rows if row.state == Upload.State.PLACED]
    taken = {row.pk: _seen(row).get("taken_s") for row in placed}
    files = {row.pk: _seen(row).get("file") or "" for row in placed}
    if None not in taken.values():
        placed.sort(key=lambda row: (taken[row.pk], row.created))
    elif all(files.values()):
        placed.sort(key=lambda row: by_number(Path(files[row.pk])))
    return placed + [row for row in rows if row.state != Upload.State.PLACED]


def _placed(visit: Visit) -> list[Upload]:
    return [row for row in photographs_of(visit) if row.state == Upload.State.PLACED]


def findings_together(visit: Visit) -> dict[Any, Finding]:
    """Key of a photograph → why the measurement will leave it out, compared with the others."""
    placed = [row for row in _placed(visit) if not is_of_video(row)]
    out = judge_files({str(row.pk): _facts(row) for row in placed})
    images = {str(row.pk): BoardImage(**image) for row in placed if (image := _seen(row).get("image"))}
    out |= judge_images({key: image for key, image in images.items() if key not in out})
    return {row.pk: _will_be_left_out(str(out[str(row.pk)])) for row in placed if str(row.pk) in out}


def state_of(visit: Visit, left_out: Collection[Any]) -> dict[str, Any]:
    """Whether a walk can be measured, and what is still needed.

    Args:
        visit: a visit with a telephone.
        left_out: keys of photographs that will be left out, from `findings_together`.
    """
    placed = _placed(visit)
    if placed and is_of_video(placed[0]):
        return {"together": [], "ready": True, "needed": "The video has arrived. Sharp frames will be chosen from it."}
    usable = sum(bool(_seen(row).get("board")) and row.pk not in left_out for row in placed)
    needed = _needed(len(placed), usable)
    if not placed and any(is_of_video(row) for row in uploads_of(visit).filter(state=Upload.State.RECEIVING)):
        needed = "The video is being sent."
    prepared = is_prepared(visit)
    words = needed or f"{len(placed)} photographs have arrived; {usable} show the board and belong to one walk."
    return {"together": [], "ready": prepared or not needed, "needed": "" if prepared else words}


def job_files(visit: Visit) -> dict[str, Any]:
    """Files, board and pseudonym for the preparation of a walk. Each file gets its number."""
    placed = _placed(visit)
    for number, row in enumerate(placed, start=1):
        Upload.objects.filter(pk=row.pk).update(name=f"{number:02d}")
    walk = Walk.objects.get(visit=visit)
    return {
        "files": [str(row.path) for row in placed],
        "board": board_table(walk.edge_mm, walk.edge_std_mm),
        "subject": visit.patient.pseudonym,
        "scratch": str(_scratch(visit)),
    }


def board_table(edge_mm: float | None, edge_std_mm: float | None) -> dict[str, Any]:
    """Table of the printed board, with its measured length."""
    measured = {} if edge_mm is None else {"edge_mm": edge_mm, "edge_std_mm": edge_std_mm}
    return {**TELEPHONE_BOARD, **measured}


def discard_prepared(visit: Visit) -> None:
    """Delete the sent files of a walk whose session is prepared.

    Temporary files of its job, which has ended, are deleted in any case. Visits without a telephone are not changed.
    """
    if not visit.is_walk:
        return
    shutil.rmtree(_scratch(visit), ignore_errors=True)
    if not is_prepared(visit):
        return
    for row in uploads_of(visit).exclude(state=Upload.State.PREPARED):
        _remove_files(row)
        if row.state == Upload.State.PLACED:
            row.state = Upload.State.PREPARED
            row.save(update_fields=["state"])
        else:
            row.delete()


def begin_again(visit: Visit) -> None:
    """Remove the photographs of a walk that has no result, and their session.

    Raises:
        UploadError: the visit is being measured, or has a result or drawings.
    """
    require_open(visit)
    if visit.measurements.exists() or visit.drawings.exists():
        raise UploadError("This visit has a result or a drawing. Start a new visit for other photographs.")
    for row in uploads_of(visit):
        _remove_files(row)
        row.delete()
    shutil.rmtree(_scratch(visit), ignore_errors=True)
    shutil.rmtree(visit.folder, ignore_errors=True)
    visit.state = Visit.State.NEW
    visit.save(update_fields=["state"])


def erase(visit: Visit) -> None:
    """Remove the files that a killed preparation of a walk may have left in ``uploads/``."""
    shutil.rmtree(_scratch(visit), ignore_errors=True)


@dataclass(frozen=True, slots=True, kw_only=True)
class UnusedPhotograph:
    """A photograph that is not used, for its page."""

    name: str
    """Its number, with the file name if a camera gave it, or with its time in the video."""
    reason: str


@dataclass(frozen=True, slots=True, kw_only=True)
class WalkFacts:
    """Facts about a prepared walk, for its page."""

    is_video: bool
    """Whether its photographs are frames of a video."""
    pictures: int
    used: int
    left_out: Sequence[UnusedPhotograph]
    board_rms_px: float
    board_bow_mm: float
    edge_mm: float | None
    """Measured length of the print's columns, mm. None: not measured."""
    edge_std_mm: float | None
    is_by_card: bool
    """Whether a bank card on the board gave the print's size."""


def facts_of(visit: Visit) -> WalkFacts | None:
    """Facts about a visit's prepared walk. None if it has none."""
    prepared = read_walk(visit.folder)
    walk = Walk.objects.filter(visit=visit).first()
    if prepared is None or walk is None:
        return None
    files = prepared.times or {row.name: _seen(row).get("file", "") for row in uploads_of(visit)}
    return WalkFacts(
        is_video=bool(prepared.times),
        pictures=prepared.pictures,
        used=len(prepared.used),
        left_out=[
            UnusedPhotograph(name=", ".join(filter(None, [number, files.get(number)])), reason=_of_board(str(reason)))
            for number, reason in sorted(prepared.left_out.items())
        ],
        board_rms_px=prepared.board_rms_px,
        board_bow_mm=prepared.board_bow_mm,
        edge_mm=walk.edge_mm,
        edge_std_mm=walk.edge_std_mm,
        is_by_card=prepared.card_scale is not None,
    )


def volume_share_of_print() -> float:
    """Relative half-width of a volume's 95 % interval due to a print that was not measured.

    A volume has three times the relative uncertainty of a length. Half the interval is two standard uncertainties.
    """
    return 2 * 3 * PRINT_STD


def _needed(placed: int, usable: int) -> str:
    if not placed:
        return f"Nothing has arrived yet. Send at least {LEAST} photographs, better 20 to 30, or one video."
    if placed < LEAST:
        return f"{placed} of at least {LEAST} photographs have arrived. 20 to 30 are better."
    if usable < FEWEST:
        return f"{usable} of {placed} photographs can be used. At least {FEWEST} must show the whole board, in focus."
    return ""


def _facts(row: Upload) -> PictureFacts:
    facts = _seen(row)["facts"]
    return PictureFacts(**{**facts, "stored_wh": tuple(facts["stored_wh"])})


def _will_be_left_out(why: str) -> Finding:
    return Finding("board", "warn", f"The photograph will be left out: {_of_board(why)}")


def _refused(sentence: str) -> Finding:
    return Finding("format", "refuse", sentence)


def _of_board(reason: str) -> str:
    """A reason given by the detector, with the clinic's word for the target."""
    return f"{reason.replace('target', 'board').rstrip('.')}."


def _seen(row: Upload) -> dict[str, Any]:
    return row.checks[0] if row.checks else {}


def _remove_files(row: Upload) -> None:
    for path in files_of(row):
        path.unlink(missing_ok=True)


def _scratch(visit: Visit) -> Path:
    """Folder in which a job numbers the photographs."""
    return the_clinic().folder / "uploads" / f"walk-{visit.pk}"
