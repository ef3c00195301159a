"""Photographs of the board that contradict others, and calibration without them.

The calibration in use is never changed, because visits were measured with it. A new one is made from the same
photographs, except those left out, which are set aside. The former one can be used again.
"""

import re
import uuid
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from django.db import transaction

from mammometry.capture.sessions import cameras_of, share_calibration
from mammometry.clinic.intake.photographs import poses_needed, set_aside, thumbnail_path
from mammometry.clinic.intake.places import UploadError
from mammometry.clinic.models import Calibration, Person, Upload
from mammometry.clinic.rig_history import new_calibration
from mammometry.clinic.site import the_clinic
from mammometry.io.photographs.images import EXTENSIONS
from mammometry.io.write import disk_errors, file_digest
from mammometry.report.content import sentence


@dataclass(frozen=True, slots=True, kw_only=True)
class BoardPhotograph:
    """A calibration's photograph of one pose by one camera."""

    pose: str
    camera: str
    path: Path

    @property
    def key(self) -> str:
        """Pose and camera, as used in forms and addresses."""
        return f"{self.pose}/{self.camera}"


@dataclass(frozen=True, slots=True, kw_only=True)
class PhotographWarning:
    """A calibration's warning, and the photographs that it concerns."""

    sentence: str
    photographs: Sequence[BoardPhotograph]


def board_photographs(calibration: Calibration) -> dict[str, BoardPhotograph]:
    """Pose and camera → the photograph, in their order."""
    folder = the_clinic().folder / calibration.folder / "calibration"
    found = [
        BoardPhotograph(pose=path.parent.name, camera=path.stem, path=path)
        for path in sorted(folder.glob("*/*"))
        if path.suffix.lower() in EXTENSIONS
    ]
    return {photograph.key: photograph for photograph in found}


def doubts_of(calibration: Calibration) -> list[PhotographWarning]:
    """Warnings of a calibration that name photographs of the board, the worst first."""
    photographs = board_photographs(calibration)
    doubts = []
    for doubt in calibration.result.doubts:
        if doubt.photographs is None:
            named = _named_in_1_0(doubt.sentence, photographs.values())
        else:
            named = [photographs[key] for key in doubt.photographs if key in photographs]
        if named:
            doubts.append(PhotographWarning(sentence=sentence(doubt.sentence), photographs=named))
    return doubts


def _named_in_1_0(words: str, photographs: Iterable[BoardPhotograph]) -> list[BoardPhotograph]:
    """Photographs mentioned in a warning that version 1.0 stored as a sentence."""

    def names(word: str) -> bool:
        return re.search(rf"(?<![\w.-]){re.escape(word)}(?![\w-])", words, re.IGNORECASE) is not None

    return [one for one in photographs if names(f"pose {one.pose}") and names(one.camera)]


def calibrate_without(calibration: Calibration, left_out: Collection[str], by: Person | None) -> Calibration:
    """Make another calibration from the same photographs without some of them.

    Args:
        calibration: completed.
        left_out: pose and camera of each, as `BoardPhotograph.key`.
        by: the user.

    Raises:
        UploadError: it is not completed, has no such photograph, or too few would be left for a camera.
        StorageError: the disk is full or refuses.
    """
    if calibration.state != Calibration.State.DONE:
        raise UploadError("This calibration has no result yet. Wait for it.")
    photographs = board_photographs(calibration)
    out = [photographs[key] for key in left_out if key in photographs]
    if not out or len(out) != len(set(left_out)):
        raise UploadError("Tick a photograph of this calibration.")
    kept = [(photograph.pose, photograph.camera) for photograph in photographs.values() if photograph not in out]
    definition = calibration.rig.definition
    if needed := poses_needed(definition, cameras_of(definition), kept):
        raise UploadError(f"Too few photographs would be left. {needed} Photograph the board again instead.")
    folder = the_clinic().folder
    with transaction.atomic():
        made = new_calibration(calibration.rig, by)
        made.taken_at = calibration.taken_at  # its photographs are not newer
        made.save(update_fields=["taken_at"])
        share_calibration(folder / calibration.folder, folder / made.folder)
        known = {
            Path(row.name).with_suffix("").as_posix(): row
            for row in calibration.uploads.filter(state=Upload.State.PLACED)
        }
        for photograph in photographs.values():
            row = _copied(known.get(f"calibration/{photograph.key}"), photograph, made, by)
            if photograph in out:
                set_aside(row, folder / made.folder)
    return made


def _copied(known: Upload | None, photograph: BoardPhotograph, made: Calibration, by: Person | None) -> Upload:
    """The row of a photograph in another calibration."""
    size_bytes = photograph.path.stat().st_size
    row = Upload.objects.create(
        pk=uuid.uuid4(),
        calibration=made,
        camera=photograph.camera,
        name=f"calibration/{photograph.pose}/{photograph.path.name}",
        size_bytes=size_bytes,
        received_bytes=size_bytes,
        sha256=file_digest(photograph.path) if known is None else known.sha256,
        state=Upload.State.PLACED,
        checks=[] if known is None else known.checks,
        created_by=by,
    )
    if known is not None and thumbnail_path(known).is_file():
        with disk_errors(thumbnail_path(row)):
            thumbnail_path(row).write_bytes(thumbnail_path(known).read_bytes())
    return row


def left_out_of(calibration: Calibration) -> list[str]:
    """Photographs that were left out of a calibration, as text."""
    rows = calibration.uploads.filter(state=Upload.State.SET_ASIDE).order_by("name")
    return [f"pose {Path(row.name).parent.name}, {row.camera.replace('_', ' ')}" for row in rows]


@transaction.atomic
def use(calibration: Calibration) -> None:
    """Use an earlier calibration again for new visits.

    Raises:
        UploadError: it has no result.
    """
    if calibration.state != Calibration.State.DONE:
        raise UploadError("This calibration has no result. Choose one that has.")
    for other in Calibration.objects.select_for_update().filter(rig=calibration.rig, current=True):
        other.current = False
        other.save(update_fields=["current"])
    calibration.current = True
    calibration.save(update_fields=["current"])
