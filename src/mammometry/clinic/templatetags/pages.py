"""What every page of the clinic shows. Its ways, its name, numbers in clinical words."""

from __future__ import annotations

import datetime
from dataclasses import dataclass, replace
from typing import Any

from django import template
from django.http import HttpRequest
from django.urls import resolve, reverse
from django.utils import timezone

import mammometry
from mammometry.clinic import page_words
from mammometry.clinic.records.confirmations import CHANGED
from mammometry.clinic.roles import Role
from mammometry.clinic.study.charts import Event, Reading, time_line

register = template.Library()
register.filter(page_words.on_pages)
_BYTES = ((1e12, "TB"), (1e9, "GB"), (1e6, "MB"), (1e3, "kB"))

_MENU = {
    Role.CLINICIAN: ("home", "patients", "worklist", "study", "rigs", "jobs-page", "corrections"),
    Role.TECHNICIAN: ("home", "patients", "worklist", "rigs", "jobs-page", "corrections"),
    Role.RESEARCHER: ("study",),
    Role.ADMINISTRATOR: ("administration", "rigs"),
}
"""Role → names of its pages in the menu, those first that it uses most. Somebody with several roles sees all once."""
_TITLES = {
    "home": "Today", "patients": "Patients", "worklist": "Worklist", "rigs": "Rigs", "jobs-page": "Jobs",
    "study": "Study", "administration": "Administration", "corrections": "Corrections", "help": "Help",
}  # fmt: skip
_ADMINISTRATION = (
    ("administration", "Overview"),
    ("people", "People"),
    ("audit", "Audit"),
    ("backups", "Backups"),
    ("disk", "Disk"),
    ("destinations", "Archives"),
    ("corrections", "Bin"),
    ("erase", "Erase"),
    ("settings", "Settings"),
)
"""Name → title of the administrators' pages, which are tabs of one another."""
_CHIPS = {
    "new": ("", "photographs missing"),
    "uploading": ("", "photographs missing"),
    "ready": ("care", "ready to measure"),
    "queued": ("busy", "being measured"),
    "running": ("busy", "running"),
    "changed": ("care", CHANGED),
    "measured": ("care", "to be confirmed"),
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
    """The pages that this person may open, those first that the role uses most."""
    request: HttpRequest = context["request"]
    person: Any = request.user
    names = dict.fromkeys(name for role, pages in _MENU.items() if person.has_role(role) for name in pages)
    places = _places(request, tuple((name, _TITLES[name]) for name in (*names, "help")))
    within = any(place.here for place in _places(request, _ADMINISTRATION))
    return [replace(place, here=place.here or (within and place.title == "Administration")) for place in places]


@register.simple_tag(takes_context=True)
def administration_ways(context: Any) -> list[Place]:
    """The administrators' pages."""
    return _places(context["request"], _ADMINISTRATION)


@register.simple_tag(takes_context=True)
def may(context: Any, name: str, *parameters: Any) -> bool:
    """Whether this person may open a page. Links to others are not shown."""
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
def size(number: float | None) -> str:
    """Bytes as people read them."""
    if number is None:
        return "–"
    for unit, name in _BYTES:
        if number >= unit:
            return f"{number / unit:.{0 if number >= 100 * unit else 1}f} {name}"
    return f"{number:.0f} bytes"


@register.filter
def role_names(values: list[str]) -> str:
    """Roles in words."""
    return ", ".join(Role(value).label.lower() for value in values if value in set(Role))


@register.filter
def day(at: datetime.datetime | datetime.date | None) -> str:
    """A date as everybody reads it alike: 3 Nov 2026."""
    if at is None:
        return "–"
    local = timezone.localtime(at) if isinstance(at, datetime.datetime) else at
    return f"{local.day} {local:%b %Y}"


@register.filter
def moment(at: datetime.datetime | None) -> str:
    """Date and time of the clinic's zone."""
    return "–" if at is None else f"{day(at)}, {timezone.localtime(at):%H:%M}"


@register.inclusion_tag("clinic/time_line.html")
def volumes_over_time(readings: list[Reading], events: list[Event], words: str) -> dict[str, Any]:
    """Volumes with their intervals over dates, once for narrow and once for wide screens."""
    charts = [
        ("narrow", time_line(readings, width=340, height=250, events=events)),
        ("broad", time_line(readings, width=760, height=300, events=events)),
    ]
    return {"charts": charts, "words": words, "sides": sorted({reading.series for reading in readings})}


def allowed(request: HttpRequest, address: str) -> bool:
    """Whether the table of routes lets this person open an address."""
    access = getattr(resolve(address).func, "access", None)
    if access is None:
        return False
    return access.roles is None or not access.roles.isdisjoint(getattr(request.user, "roles", ()))


def _places(request: HttpRequest, named: tuple[tuple[str, str], ...]) -> list[Place]:
    places = []
    for name, title in named:
        address = reverse(name)
        if allowed(request, address):
            here = request.path == address or (address.count("/") > 1 and request.path.startswith(address))
            places.append(Place(title=title, address=address, here=here))
    return places
