"""Filters and tags for the clinic's pages: navigation, banner, numbers and verdicts as text."""

import datetime
import re
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any
from uuid import uuid4

from django import template
from django.http import HttpRequest
from django.urls import resolve, reverse
from django.utils import timezone
from django.utils.html import format_html
from django.utils.safestring import SafeString

import mammometry
from mammometry.base import letters
from mammometry.base.rounding import at_95
from mammometry.clinic.intake.photographs import thumbnail_path
from mammometry.clinic.jobs import queue
from mammometry.clinic.models import Patient, Upload, Visit
from mammometry.clinic.records import comparing
from mammometry.clinic.records.charts import ChartEvent, ChartReading, time_line
from mammometry.clinic.records.comparing import ComparisonVerdict
from mammometry.clinic.records.confirmations import CHANGED
from mammometry.clinic.records.operations import sides_of
from mammometry.clinic.records.results import VisitResult, age
from mammometry.clinic.roles import Role
from mammometry.clinic.web.access import Access
from mammometry.clinic.web.once import FIELD
from mammometry.report.words.anthropometry import Length, length_words

register = template.Library()


@register.inclusion_tag("clinic/banner.html")
def banner(patient: Patient, visit: Visit | None = None) -> dict[str, Any]:
    """The patient's banner, with thumbnails of the visit's photographs."""
    by_rig = visit is not None and visit.rig_id is not None  # telephone photographs are deleted when they are prepared
    shots = () if visit is None or not by_rig else visit.uploads.filter(state=Upload.State.PLACED).order_by("camera")
    return {
        **patient_facts(patient),
        "visit": visit,
        "shots": [upload for upload in shots if thumbnail_path(upload).is_file()],
    }


@register.inclusion_tag("clinic/patient_facts.html")
def patient_facts(patient: Patient) -> dict[str, Any]:
    """Birthday, numbers and operated sides of a patient."""
    today = timezone.localdate()
    surgery = sides_of(list(patient.operations.all()), today)
    return {"patient": patient, "age": age(patient.born, today), "surgery": surgery}


@register.filter
def camera_words(camera: str) -> str:
    """Name of a camera as a title, such as "Front left"."""
    return camera.replace("_", " ").capitalize()


@register.filter
def isolated(person: object) -> str:
    """A person's name, isolated so that a right-to-left name does not reorder the line around it."""
    return letters.isolated(str(person))


@register.filter
def length_mm(value: Length | None) -> str:
    """A length in mm with its interval, such as "212.3 ± 4.1"."""
    return _breaking_once(length_words(value))


@register.filter
def signed_length_mm(value: Length | None) -> str:
    """A difference of lengths, such as "+4.2 ± 2.8"."""
    return _breaking_once(length_words(value, sign=True))


def _breaking_once(words: str) -> str:
    """Let a line on a phone break before the sign, not after it."""
    return words.replace("± ", "±\u00a0")


@register.filter
def whole_percent(value: float) -> str:
    """A percentage without decimals, such as "62 %"."""
    return f"{value:.0f} %".replace("-", "−")


@register.simple_tag
def change_since_the_visit_before(visit: Visit) -> ComparisonVerdict | None:
    """Verdict on the change since the previous visit. None if there is none."""
    pair = next((pair for pair in comparing.neighbours(visit) if pair[1] == visit), None)
    return None if pair is None else queued(comparing.verdict(*pair))


@register.simple_tag
def changes_of(patient: Patient) -> list[ComparisonVerdict]:
    """Verdicts on the changes between visits, newest first."""
    visits = Visit.objects.filter(patient=patient).prefetch_related("measurements__volumes")
    return [queued(verdict) for verdict in comparing.changes(visits)]


@register.filter
def length_change(length: dict[str, Any]) -> SafeString:
    """A change of a length with its 95 % half-width, in bold if larger than the error."""
    words = at_95(length["change_mm"], length["sigma_mm"], sign=True)
    return format_html("<strong>{}</strong>", words) if length["beyond_error"] else format_html("{}", words)


@register.filter
def length_alone(length: dict[str, Any], date: str) -> str:
    """A length at one of two dates (``before`` or ``after``), rounded by the uncertainty of its change."""
    return at_95(length[f"{date}_mm"], length["sigma_mm"], alone=True)


def queued(verdict: ComparisonVerdict) -> ComparisonVerdict:
    """Queue the comparison of a verdict if it is due. Return the verdict."""
    if verdict.state != "busy":
        return verdict
    queue.compare(verdict.before, verdict.after, None)
    return comparing.verdict(verdict.before, verdict.after)


@register.simple_tag
def form_token() -> SafeString:
    """The hidden field that prevents a form from being processed twice (`web.once`)."""
    return format_html('<input type="hidden" name="{}" value="{}">', FIELD, uuid4())


_INSTEAD = (
    (r": found (.+?), expected (.+?)\. (?=[A-Z])", r": \1. Expected: \2. "),
    (r"with `mammometry edit`", "(a clinician, on the page of boundaries)"),
    (r"; compare\.refuse_mm sets the limit", ""),
    (r": --(?:head|ahead) -?[xyz], for example", ""),
    (r", or measure the largest alone with --largest", ""),
    (r" If they are right: --sides-checked\.", ""),
    (r", and then measure it with --sides-checked", ", and confirm them on the visit’s page"),
    (r", import the scanner's file again with --units", ", begin a new visit with this scan and choose its unit"),
    (r", and enter their length in board\.toml \(edge_mm\)", ", and enter their length for the next visit"),
    (r", and describe it in board\.toml as it was printed", ""),
    (r"--units(?: mm, cm, m, in or ft)?", "the unit of the mesh"),
    (r"--head", "the axis towards the head"),
    (r"--ahead", "the axis straight ahead"),
)


@register.filter(is_safe=True)
def on_pages(sentence: str) -> str:
    """A message for the clinic's users: pages and fields instead of commands and options.

    >>> on_pages("front_left.jpg: found a truncated image, expected the whole file. Copy it again.")
    'front_left.jpg: a truncated image. Expected: the whole file. Copy it again.'
    """
    for pattern, words in _INSTEAD:
        sentence = re.sub(pattern, words, sentence)
    return sentence


_BYTES = ((1e12, "TB"), (1e9, "GB"), (1e6, "MB"), (1e3, "kB"))

_MENU = {
    Role.CLINICIAN: ("home", "patients", "worklist", "study", "rigs", "jobs-page", "corrections"),
    Role.TECHNICIAN: ("home", "patients", "worklist", "rigs", "jobs-page", "corrections"),
    Role.RESEARCHER: ("study",),
    Role.ADMINISTRATOR: ("administration", "rigs"),
}
"""Role → names of its pages in the menu, most used first. A person with several roles sees each page once."""
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
"""Name → title of the administrators' pages, which are shown as tabs."""
_CHIPS = {
    "new": ("", "photographs missing"),
    "uploading": ("", "photographs missing"),
    "collecting": ("", "not calibrated yet"),
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
    """An entry of the menu on every page."""

    title: str
    address: str
    here: bool


@register.simple_tag(takes_context=True)
def ways(context: Any) -> list[Place]:
    """Menu entries of the pages that this person may open, most used first."""
    request: HttpRequest = context["request"]
    person: Any = request.user
    names = dict.fromkeys(name for role, pages in _MENU.items() if person.has_role(role) for name in pages)
    places = _places(request, tuple((name, _TITLES[name]) for name in (*names, "help")))
    if any(place.here for place in administration_ways(context)):
        overview = reverse("administration")
        places = [replace(place, here=place.here or place.address == overview) for place in places]
    return places


@register.simple_tag(takes_context=True)
def administration_ways(context: Any) -> list[Place]:
    """Tabs of the administrators' pages."""
    return _places(context["request"], _ADMINISTRATION)


@register.simple_tag(takes_context=True)
def may(context: Any, name: str, *parameters: Any) -> bool:
    """Whether this person may open a page. Links to other pages are not shown."""
    return allowed(context["request"], reverse(name, args=parameters))


@register.simple_tag
def software() -> str:
    """Version of mammometry."""
    return mammometry.__version__


@register.inclusion_tag("clinic/chip.html")
def chip(state: str) -> dict[str, str]:
    """A state as a word with a colour."""
    kind, words = _CHIPS.get(str(state), ("", str(state)))
    return {"kind": kind, "words": words}


@register.filter
def cc(value: float | None) -> str:
    """A volume as text."""
    return "–" if value is None else f"{value:.0f} cc"


@register.filter
def signed_cc(value: float | None) -> str:
    """A change of a volume in cc, with its sign."""
    return "–" if value is None else f"{value:+.0f} cc".replace("-", "−")


@register.simple_tag
def rounding_note(result: VisitResult) -> str:
    """Reason why a printed difference differs from that of the printed volumes. Empty if it does not."""
    values = [side.volume_cc for side in (*result.sides, result.difference) if side is not None]
    if len(values) != 3 or None in values:
        return ""
    left, right, apart = (int(f"{value:.0f}") for value in values if value is not None)
    return "" if left - right == apart else "Difference of the unrounded volumes."


@register.filter
def span_cc(interval: tuple[float, float] | None) -> str:
    """An interval of volumes in cc."""
    if not interval or interval[0] is None or interval[1] is None:
        return "not known"
    return f"{interval[0]:.0f} to {interval[1]:.0f} cc".replace("-", "−")


@register.filter
def mm(value: float | None) -> str:
    """A length in mm."""
    return "–" if value is None else f"{value:.1f} mm".replace("-", "−")


@register.filter
def percent(fraction: float | None) -> str:
    """A fraction as a percentage."""
    return f"{100 * (fraction or 0.0):.0f} %"


@register.filter
def size(number: float | None) -> str:
    """Bytes in suitable units."""
    if number is None:
        return "–"
    for unit, name in _BYTES:
        if number >= unit:
            return f"{number / unit:.{0 if number >= 100 * unit else 1}f} {name}"
    return f"{number:.0f} bytes"


@register.filter
def role_names(values: list[str]) -> str:
    """Roles as text."""
    return ", ".join(Role(value).label.lower() for value in values if value in set(Role))


@register.filter
def day(at: datetime.datetime | datetime.date | None) -> str:
    """An unambiguous date, such as 3 Nov 2026."""
    if at is None:
        return "–"
    local = timezone.localtime(at) if isinstance(at, datetime.datetime) else at
    return f"{local.day} {local:%b %Y}"


@register.filter
def moment(at: datetime.datetime | None) -> str:
    """Date and time in the clinic's time zone."""
    return "–" if at is None else f"{day(at)}, {timezone.localtime(at):%H:%M}"


@register.inclusion_tag("clinic/time_line.html")
def volumes_over_time(readings: list[ChartReading], events: list[ChartEvent], words: str) -> dict[str, Any]:
    """Chart of volumes with their intervals over dates, for narrow and wide screens."""
    charts = [
        ("narrow", time_line(readings, width=340, height=250, events=events)),
        ("broad", time_line(readings, width=760, height=300, events=events)),
    ]
    apart = [reading for reading in readings if reading.is_apart]
    sides = sorted({reading.series for reading in readings})
    return {"charts": charts, "words": words, "sides": sides, "apart": apart}


def allowed(request: HttpRequest, address: str) -> bool:
    """Whether this person may open an address."""
    access = _access(address)
    if access is None:
        return False
    return access.roles is None or not access.roles.isdisjoint(getattr(request.user, "roles", ()))


@lru_cache(maxsize=1000)  # each page checks every entry of its menu
def _access(address: str) -> Access | None:
    """Who may open an address. None if the clinic has no view for it."""
    found: Access | None = getattr(resolve(address).func, "access", None)
    return found


def _places(request: HttpRequest, named: tuple[tuple[str, str], ...]) -> list[Place]:
    places = []
    for name, title in named:
        address = reverse(name)
        if allowed(request, address):
            here = request.path == address or (address.count("/") > 1 and request.path.startswith(address))
            places.append(Place(title=title, address=address, here=here))
    return places
