"""Who a page is about, and numbers that surgeons plan with."""

from __future__ import annotations

from typing import Any

from django import template
from django.utils import timezone

from mammometry.clinic.intake.thumbnail import thumbnail_path
from mammometry.clinic.models import Patient, Upload, Visit
from mammometry.clinic.records.operations import sides_of
from mammometry.clinic.records.results import age
from mammometry.report.words.lengths import Length, length_words

register = template.Library()


@register.inclusion_tag("clinic/banner.html")
def banner(patient: Patient, visit: Visit | None = None) -> dict[str, Any]:
    """Who the page is about, with the visit's photographs in small."""
    shots = () if visit is None else visit.uploads.filter(state=Upload.State.PLACED).order_by("camera")
    return {
        **patient_facts(patient),
        "visit": visit,
        "shots": [upload for upload in shots if thumbnail_path(upload).is_file()],
    }


@register.inclusion_tag("clinic/patient_facts.html")
def patient_facts(patient: Patient) -> dict[str, Any]:
    """Birthday, numbers and sides of surgery of a patient."""
    today = timezone.localdate()
    surgery = sides_of(list(patient.operations.all()), today)
    return {"patient": patient, "age": age(patient.born, today), "surgery": surgery}


@register.filter
def camera_words(camera: str) -> str:
    """Name of a camera as a title: "Front left"."""
    return camera.replace("_", " ").capitalize()


@register.filter
def length_mm(value: Length | None) -> str:
    """A length in mm with its interval: "212.3 ± 4.1"."""
    return _breaking_once(length_words(value))


@register.filter
def signed_length_mm(value: Length | None) -> str:
    """A difference of lengths: "+4.2 ± 5.8"."""
    return _breaking_once(length_words(value, "+"))


def _breaking_once(words: str) -> str:
    """On a phone the line breaks before the sign and not after it."""
    return words.replace("± ", "±\u00a0")


@register.filter
def whole_percent(value: float) -> str:
    """A per cent without decimals: "62 %"."""
    return f"{value:.0f} %".replace("-", "−")
