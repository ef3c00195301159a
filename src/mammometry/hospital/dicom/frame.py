"""Attributes of all objects of a study: patient, study, series, equipment."""

import datetime
import hashlib
from dataclasses import dataclass
from io import BytesIO

from pydicom import Dataset, dcmwrite
from pydicom.dataset import FileMetaDataset
from pydicom.sequence import Sequence
from pydicom.uid import UID, ExplicitVRLittleEndian

from mammometry.hospital.codes import Coded, uid
from mammometry.hospital.exported import Exported, ExportedPatient, Order

_IMPLEMENTATION = uid("mammometry", "implementation")
_NO_DAY = "19000101"  # if DICOM requires a date and none may be given
_NO_TIME = "000000"
_BASIC_PROFILE = Coded(value="113100", scheme="DCM", meaning="Basic Application Confidentiality Profile")


@dataclass(frozen=True, slots=True, kw_only=True)
class Study:
    """One study: patient, order, and exported content."""

    exported: Exported
    patient: ExportedPatient
    order: Order

    @property
    def uid(self) -> str:
        """Study Instance UID: the order's, otherwise derived from patient and photographs."""
        return self.order.study_uid or uid("study", self.exported.source, self.patient.id, self.order.accession)

    @property
    def frame_uid(self) -> str:
        """Frame of Reference UID of the world frame."""
        return uid("world", self.uid)

    def series_uid(self, kind: str) -> str:
        """Series Instance UID of one kind of object."""
        return uid("series", self.uid, kind)

    @property
    def day(self) -> str:
        """Day of the photographs. Empty if unknown or de-identified."""
        taken = self.exported.taken
        return "" if taken is None else taken.isoformat().replace("-", "")

    @property
    def made(self) -> tuple[str, str]:
        """Day and time of the results, UTC."""
        made = self.exported.made
        if made is None:
            return _NO_DAY, _NO_TIME
        moment = made.astimezone(datetime.UTC)
        return f"{moment:%Y%m%d}", f"{moment:%H%M%S}"


def begun(study: Study, *, sop_class: str, modality: str, kind: str, number: int, title: str, instance: int) -> Dataset:
    """Create an object with patient, study, series and equipment.

    Args:
        study: its study.
        sop_class: its SOP Class UID.
        modality: of its series.
        kind: of its series; one series per kind.
        number: of its series.
        title: of its series.
        instance: number of the object in its series.
    """
    made = Dataset()
    made.SpecificCharacterSet = "ISO_IR 192"
    made.SOPClassUID = sop_class
    describe(made, study)
    made.Modality = modality
    made.SeriesInstanceUID = study.series_uid(kind)
    made.SeriesNumber = number
    made.SeriesDescription = title
    made.InstanceNumber = instance
    return made


def describe(made: Dataset, study: Study) -> None:
    """Set patient, study and equipment of any object."""
    patient, order, day = study.patient, study.order, study.day
    written_day, written_time = study.made
    made.PatientID = patient.id
    made.PatientName = patient.name
    made.PatientBirthDate = "" if patient.born is None else patient.born.isoformat().replace("-", "")
    made.PatientSex = patient.sex
    made.StudyInstanceUID = study.uid
    made.StudyDate, made.StudyTime = day, ""
    made.ReferringPhysicianName = order.referring
    made.StudyID = order.procedure_id
    made.AccessionNumber = order.accession
    made.StudyDescription = order.procedure or "Stereophotogrammetry of the breasts"
    made.ContentDate, made.ContentTime = written_day, written_time
    made.InstanceCreationDate, made.InstanceCreationTime = written_day, written_time
    made.TimezoneOffsetFromUTC = "+0000"
    made.Manufacturer = "mammometry"
    made.ManufacturerModelName = "mammometry"
    made.DeviceSerialNumber = "none"
    made.SoftwareVersions = study.exported.software
    if study.exported.deidentified:
        made.PatientIdentityRemoved = "YES"
        made.DeidentificationMethod = "PS3.15 Basic Profile; no photographs, no colours"
        made.DeidentificationMethodCodeSequence = Sequence([coded(_BASIC_PROFILE)])
        made.LongitudinalTemporalInformationModified = "REMOVED"


def coded(concept: Coded) -> Dataset:
    """One item of a code sequence."""
    item = Dataset()
    item.CodeValue, item.CodingSchemeDesignator, item.CodeMeaning = concept.value, concept.scheme, concept.meaning
    return item


def finished(made: Dataset, transfer_syntax: UID = ExplicitVRLittleEndian) -> Dataset:
    """Set an object's UID and its file header. The UID is a hash of the whole content."""
    made.SOPInstanceUID = "2.25.0"
    _head(made, transfer_syntax)
    made.SOPInstanceUID = uid("object", hashlib.sha256(encoded(made)).hexdigest())
    made.file_meta.MediaStorageSOPInstanceUID = made.SOPInstanceUID
    return made


def encoded(made: Dataset) -> bytes:
    """A finished object as the content of a DICOM file."""
    buffer = BytesIO()
    dcmwrite(buffer, made, enforce_file_format=True)
    return buffer.getvalue()


def _head(made: Dataset, transfer_syntax: UID) -> None:
    made.file_meta = FileMetaDataset()
    made.file_meta.FileMetaInformationVersion = b"\x00\x01"
    made.file_meta.MediaStorageSOPClassUID = made.SOPClassUID
    made.file_meta.MediaStorageSOPInstanceUID = made.SOPInstanceUID
    made.file_meta.TransferSyntaxUID = transfer_syntax
    made.file_meta.ImplementationClassUID = UID(_IMPLEMENTATION)
    made.file_meta.ImplementationVersionName = "MAMMOMETRY"
