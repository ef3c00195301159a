"""Who a page is about, and numbers that surgeons plan with."""

from __future__ import annotations

from typing import Any

from django import template
from django.utils import timezone

from mammometry.clinic.intake.uploads import thumbnail_path
from mammometry.clinic.lengths import Length
from mammometry.clinic.models import Patient, Upload, Visit
from mammometry.clinic.operations import sides_of
from mammometry.clinic.results import age

register = template.Library()


@register.inclusion_tag("clinic/banner.html")
def banner(patient: Patient, visit: Visit | None = None) -> dict[str, Any]:
    """Who the page is about: name, birthday, numbers, sides of surgery, and the visit's photographs in small."""
    today = timezone.localdate()
    shots = () if visit is None else visit.uploads.filter(state=Upload.State.PLACED).order_by("camera")
    return {
        "patient": patient,
        "visit": visit,
        "age": age(patient.born, today),
        "surgery": sides_of(list(patient.operations.all()), today),
        "shots": [upload for upload in shots if thumbnail_path(upload).is_file()],
    }


@register.filter
def camera_words(camera: str) -> str:
    """Name of a camera as a title: "Front left"."""
    return camera.replace("_", " ").capitalize()


@register.filter
def length_mm(value: Length | None) -> str:
    """A length with its interval: "212.3 ± 4.1 mm"."""
    return _words(value, "")


@register.filter
def signed_length_mm(value: Length | None) -> str:
    """A difference of lengths: "+4.2 ± 5.8 mm"."""
    return _words(value, "+")


@register.filter
def whole_percent(value: float) -> str:
    """A per cent without decimals: "62 %"."""
    return f"{value:.0f} %".replace("-", "−")


def _words(value: Length | None, sign: str) -> str:
    if value is None:
        return "–"
    half = "" if value.half_mm is None else f" ± {value.half_mm:.1f}"
    return f"{value.value_mm:{sign}.1f}{half} mm".replace("-", "−")
