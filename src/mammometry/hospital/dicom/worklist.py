"""Modality worklist: planned patients and their orders (C-FIND)."""

import datetime
from collections.abc import Sequence
from dataclasses import dataclass

from pydicom import Dataset
from pydicom.config import disable_value_validation
from pydicom.multival import MultiValue
from pydicom.sequence import Sequence as DicomSequence
from pynetdicom.sop_class import ModalityWorklistInformationFind  # type: ignore[attr-defined]  # made at run time

from mammometry.base.errors import ArchiveError, SettingsError
from mammometry.hospital.codes import text_fault
from mammometry.hospital.dicom.association import OWN_TITLE, associated, found_by
from mammometry.hospital.exported import ExportedPatient, Order, Sex
from mammometry.hospital.peers import Peer, PeerTls

_DESCRIPTION = 64  # letters that DICOM allows in a procedure's description; the rest is cut off
_SEXES: dict[str, Sex] = {"F": "F", "M": "M", "O": "O"}


@dataclass(frozen=True, slots=True, kw_only=True)
class WorklistEntry:
    """One line of a worklist."""

    patient: ExportedPatient
    order: Order


@dataclass(frozen=True, slots=True, kw_only=True)
class Worklist:
    """Entries of a worklist, and unusable ones with the reason."""

    entries: tuple[WorklistEntry, ...]
    refused: tuple[ArchiveError, ...] = ()
    """One per entry with text that DICOM does not allow, such as an id with a backslash."""


def entries(
    peer: Peer,
    *,
    accession: str = "",
    patient_id: str = "",
    day: datetime.date | None = None,
    modality: str = "",
    own_title: str = OWN_TITLE,
    tls: PeerTls | None = None,
) -> Worklist:
    """Query a worklist. Empty arguments match everything.

    Args:
        peer: the worklist's server.
        accession: Accession Number.
        patient_id: number of the patient's record.
        day: planned day.
        modality: such as XC.
        own_title: our AE title.
        tls: encryption. None: none.

    Raises:
        ArchiveError: it does not answer or refuses.
    """
    query = Dataset()
    query.SpecificCharacterSet = "ISO_IR 192"
    query.AccessionNumber, query.PatientID = accession, patient_id
    for name in ("PatientName", "PatientBirthDate", "PatientSex", "StudyInstanceUID", "ReferringPhysicianName"):
        setattr(query, name, "")
    query.RequestedProcedureID = query.RequestedProcedureDescription = ""
    step = Dataset()
    step.Modality = modality
    step.ScheduledProcedureStepStartDate = "" if day is None else f"{day:%Y%m%d}"
    step.ScheduledProcedureStepStartTime = step.ScheduledProcedureStepDescription = ""
    query.ScheduledProcedureStepSequence = DicomSequence([step])
    with associated(peer, [(ModalityWorklistInformationFind, None)], own_title=own_title, tls=tls) as association:
        answers = found_by(association, query, ModalityWorklistInformationFind, peer)
    return read_answers([answer for answer in answers if answer is not None], peer)


def read_answers(answers: Sequence[Dataset], peer: Peer) -> Worklist:
    """Read answers of a worklist, and separate those that cannot be used."""
    usable: list[WorklistEntry] = []
    refused: list[ArchiveError] = []
    for answer in answers:
        try:
            with disable_value_validation():  # our subject names the entry
                usable.append(entry(answer))
        except SettingsError as error:
            number = _text(answer, "AccessionNumber")
            place = f"{peer}, entry {'without an accession number' if text_fault(number, 'SH') else number}"
            remedy = "Have the entry corrected in the system that made it"
            found = f"{error.subject} with {error.found}"
            refused.append(ArchiveError(place, found=found, expected=error.expected, remedy=remedy))
    return Worklist(entries=tuple(usable), refused=tuple(refused))


def only_entry(worklist: Worklist, peer: Peer, query: str) -> WorklistEntry:
    """Return the only entry of a worklist's answer.

    Raises:
        ArchiveError: there is none, or more than one, or it cannot be used.
    """
    if worklist.refused:
        raise worklist.refused[0]
    if len(worklist.entries) != 1:
        raise ArchiveError(
            str(peer),
            found=f"{len(worklist.entries)} entries of the worklist for {query}",
            expected="exactly one",
            remedy="Select it by --accession, and --patient-id if needed",
        )
    return worklist.entries[0]


def entry(answer: Dataset) -> WorklistEntry:
    """Read one answer. Missing values and invalid dates are empty.

    Raises:
        SettingsError: text that DICOM does not allow.
    """
    steps = answer.get("ScheduledProcedureStepSequence") or [Dataset()]
    patient = ExportedPatient(
        id=_text(answer, "PatientID"),
        name=_text(answer, "PatientName"),
        born=_day(_text(answer, "PatientBirthDate")),
        sex=_SEXES.get(_text(answer, "PatientSex"), ""),
    )
    order = Order(
        accession=_text(answer, "AccessionNumber"),
        study_uid=_text(answer, "StudyInstanceUID"),
        referring=_text(answer, "ReferringPhysicianName"),
        procedure_id=_text(answer, "RequestedProcedureID"),
        procedure=(
            _text(answer, "RequestedProcedureDescription") or _text(steps[0], "ScheduledProcedureStepDescription")
        )[:_DESCRIPTION],
    )
    return WorklistEntry(patient=patient, order=order)


def _text(dataset: Dataset, name: str) -> str:
    value = dataset.get(name, "") or ""
    return ("\\".join(map(str, value)) if isinstance(value, MultiValue) else str(value)).strip()


def _day(text: str) -> datetime.date | None:
    try:
        return datetime.datetime.strptime(text, "%Y%m%d").date()
    except ValueError:
        return None
