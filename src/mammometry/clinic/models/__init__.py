"""Tables of the clinic. Keys are random (UUID 4), times are UTC."""

from mammometry.clinic.models.comparisons import Comparison
from mammometry.clinic.models.corrections import Correction
from mammometry.clinic.models.deliveries import Delivery, Destination, VisitOrder
from mammometry.clinic.models.jobs import Job
from mammometry.clinic.models.patients import Consent, Operation, Patient
from mammometry.clinic.models.people import Person
from mammometry.clinic.models.results import Conclusion, Confirmation, Drawing, Measurement, Volume
from mammometry.clinic.models.rigs import Calibration, DailyCheck, Rig
from mammometry.clinic.models.visits import Scan, Upload, Visit

__all__ = [
    "Calibration", "Comparison", "Conclusion", "Confirmation", "Consent", "Correction", "DailyCheck", "Delivery",
    "Destination", "Drawing", "Job", "Measurement", "Operation", "Patient", "Person", "Rig", "Scan", "Upload", "Visit",
    "VisitOrder", "Volume",
]  # fmt: skip
