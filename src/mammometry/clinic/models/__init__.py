"""Tables of the clinic. Keys are random (UUID 4), times are UTC."""

from mammometry.clinic.models.deliveries import Delivery, Destination, VisitOrder
from mammometry.clinic.models.jobs import Job
from mammometry.clinic.models.patients import Patient
from mammometry.clinic.models.people import Person
from mammometry.clinic.models.results import Drawing, Measurement, Volume
from mammometry.clinic.models.rigs import Calibration, DailyCheck, Rig
from mammometry.clinic.models.visits import Scan, Upload, Visit

__all__ = [
    "Calibration", "DailyCheck", "Delivery", "Destination", "Drawing", "Job", "Measurement", "Patient", "Person", "Rig",
    "Scan", "Upload", "Visit", "VisitOrder", "Volume",
]  # fmt: skip
