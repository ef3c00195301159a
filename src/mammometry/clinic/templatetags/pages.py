"""What every page of the clinic shows.

Its ways, its name, numbers in clinical words.
"""

from __future__ import annotations

import datetime
from dataclasses import dataclass
from typing import Any

from django import template
from django.http import HttpRequest
from django.urls import NoReverseMatch, resolve, reverse
from django.utils import timezone

import mammometry
from mammometry.clinic.charts import Event, Reading, time_line

register = template.Library()

_WAYS = (
    ("home", "Today"),
    ("patients", "Patients"),
    ("worklist", "Worklist"),
    ("corrections", "Corrections"),
    ("rigs", "Rigs"),
    ("jobs-page", "Jobs"),
    ("study", "Study"),
    ("admin:clinic_person_changelist", "People"),
    ("destinations", "Archives"),
    ("settings", "Settings"),
    ("admin:index", "Administration"),
    ("help", "Help"),
)
_OWN = (("mfa_index", "Second factor"), ("account_change_password", "Password"))
_CHIPS = {
    "new": ("", "photographs missing"),
    "uploading": ("", "photographs missing"),
    "ready": ("care", "ready to measure"),
    "queued": ("busy", "being measured"),
    "running": ("busy", "running"),
    "changed": ("care", "changed, not measured"),
    "measured": ("care", "to be confirmed"),
    "scanned": ("good", "measured"),
    "refused": ("bad", "✕ no volume"),
    "confirmed": ("good", "✓ confirmed"),
    "done": ("good", "✓ done"),
    "failed": ("bad", "✕ failed"),
    "cancelled": ("", "cancelled"),
    "yes": ("good", "✓ ready"),
    "care": ("care", "! with care"),
    "no": ("bad", "✕ not today"),
}


@dataclass(frozen=True, slots=True)
class Place:
    """A way on every page."""

    title: str
    address: str
    here: bool


@register.simple_tag(takes_context=True)
def ways(context: Any) -> list[Place]:
    """The pages that this person may open."""
    request: HttpRequest = context["request"]
    # Who sees no patients has no day: the first page leads such a person to a page that has a way of its own.
    return _places(request, _WAYS if allowed(request, reverse("patients")) else _WAYS[1:])


@register.simple_tag(takes_context=True)
def account_ways(context: Any) -> list[Place]:
    """The pages of one's own account."""
    return _places(context["request"], _OWN)


@register.simple_tag(takes_context=True)
def may(context: Any, name: str, *parameters: Any) -> bool:
    """Whether this person may open a page.

    Links to others are not shown.
    """
    return allowed(context["request"], reverse(name, args=parameters))


@register.simple_tag
def software() -> str:
    """Version of mammometry."""
    return mammometry.__version__


@register.inclusion_tag("clinic/chip.html")
def chip(state: str) -> dict[str, str]:
    """A state in a word and a colour."""
    kind, words = _CHIPS.get(str(state), ("", str(state)))
    return {"kind": kind, "words": words}


@register.filter
def on_pages(sentence: str) -> str:
    """A sentence of the report with the clinic's page in place of a command."""
    return sentence.replace("`mammometry edit`", "the page of boundaries, which clinicians open")


@register.filter
def cc(value: float | None) -> str:
    """A volume as clinics write it."""
    return "–" if value is None else f"{value:.0f} cc"


@register.filter
def signed_cc(value: float | None) -> str:
    """A change of a volume."""
    return "–" if value is None else f"{value:+.0f} cc".replace("-", "−")


@register.filter
def span_cc(interval: tuple[float, float] | None) -> str:
    """An interval of volumes."""
    if not interval or interval[0] is None or interval[1] is None:
        return "not known"
    return f"{interval[0]:.0f} to {interval[1]:.0f} cc".replace("-", "−")


@register.filter
def mm(value: float | None) -> str:
    """A length."""
    return "–" if value is None else f"{value:.1f} mm".replace("-", "−")


@register.filter
def percent(fraction: float | None) -> str:
    """A fraction as a percentage."""
    return f"{100 * (fraction or 0.0):.0f} %"


@register.filter
def day(at: datetime.datetime | datetime.date | None) -> str:
    """A date as everybody reads it alike: 3 Nov 2026."""
    if at is None:
        return "–"
    return (timezone.localtime(at) if isinstance(at, datetime.datetime) else at).strftime("%-d %b %Y")


@register.filter
def moment(at: datetime.datetime | None) -> str:
    """Date and time of the clinic's zone."""
    return "–" if at is None else timezone.localtime(at).strftime("%-d %b %Y, %H:%M")


@register.inclusion_tag("clinic/time_line.html")
def volumes_over_time(readings: list[Reading], events: list[Event], words: str) -> dict[str, Any]:
    """Volumes with their intervals over dates, once for narrow and once for wide screens."""
    charts = [
        ("narrow", time_line(readings, width=340, height=250, events=events)),
        ("broad", time_line(readings, width=760, height=300, events=events)),
    ]
    return {"charts": charts, "words": words, "sides": sorted({each.series for each in readings})}


def allowed(request: HttpRequest, address: str) -> bool:
    """Whether the table of routes lets this person open an address."""
    access = getattr(resolve(address).func, "access", None)
    if access is None:
        return False
    return access.roles is None or not access.roles.isdisjoint(getattr(request.user, "roles", ()))


def _places(request: HttpRequest, named: tuple[tuple[str, str], ...]) -> list[Place]:
    found = []
    for name, title in named:
        try:
            address = reverse(name)
        except NoReverseMatch:  # a clinic may leave a part out
            continue
        if allowed(request, address):
            found.append(Place(title=title, address=address, here=request.path == address))
    return found
