"""All objects of a session's study."""

from __future__ import annotations

from pydicom import Dataset

from mammometry.hospital.dicom import documents, photographs, structured
from mammometry.hospital.dicom.frame import Study, encoded
from mammometry.hospital.exported import Exported, Order, Patient, as_patient_id, person_name


def objects(exported: Exported, patient: Patient = Patient(), order: Order = Order()) -> list[Dataset]:
    """Make the objects of a session, one series a kind.

    The same session, patient and order give the same bytes.

    Args:
        exported: what leaves mammometry. If it is de-identified, patient and order are left out.
        patient: as other systems call the patient. Without an id, the session's subject is taken.
        order: what was ordered.
    """
    if exported.deidentified:
        patient, order = Patient(id=f"anonymous-{exported.source[:12]}", name="Anonymous^"), Order()
    elif not patient.id:
        patient = Patient(
            id=as_patient_id(exported.subject),
            name=patient.name or person_name(exported.subject)[:64],
            born=patient.born,
            sex=patient.sex,
        )
    study = Study(exported=exported, patient=patient, order=order)
    report = documents.report(study, series=1)
    models = documents.models(study, series=3)
    texture = photographs.texture(study, series=5)
    covered = [] if texture is None else [*documents.covered(study, texture, series=4), texture]
    pictures = photographs.photographs(study, series=6)
    measured = structured.report(study, pictures or models or report, series=2)
    return [*report, *measured, *models, *covered, *pictures]


def possible_names(photographs: int) -> list[str]:
    """Names of all files that a session may have."""
    counts = (("01-DOC", 1), ("02-SR", 1), ("03-M3D", 4), ("04-M3D", 4), ("05-XC", 1), ("06-XC", photographs))
    return [f"{kind}-{number:03d}.dcm" for kind, count in counts for number in range(1, count + 1)]


def files(made: list[Dataset]) -> dict[str, bytes]:
    """Name of a file → its content. Names say series and instance."""
    return {
        f"{dataset.SeriesNumber:02d}-{dataset.Modality}-{dataset.InstanceNumber:03d}.dcm": encoded(dataset)
        for dataset in made
    }
