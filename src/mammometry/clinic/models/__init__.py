"""Tables of the clinic. Keys are random (UUID 4), times are UTC."""

from mammometry.clinic.models.patients import Consent, NoteChange, Operation, Patient, Scan, Upload, Visit, Walk
from mammometry.clinic.models.people import AuditLink, Calibration, DailyCheck, FormToken, Person, Rig
from mammometry.clinic.models.results import (
    Comparison,
    Conclusion,
    Confirmation,
    Correction,
    Delivery,
    Destination,
    Drawing,
    Job,
    Measurement,
    VisitOrder,
    Volume,
)

__all__ = [
    "AuditLink", "Calibration", "Comparison", "Conclusion", "Confirmation", "Consent", "Correction", "DailyCheck",
    "Delivery", "Destination", "Drawing", "FormToken", "Job", "Measurement", "NoteChange", "Operation", "Patient",
    "Person", "Rig", "Scan", "Upload", "Visit", "VisitOrder", "Volume", "Walk",
]  # fmt: skip
