"""Verdicts on the change between two visits, as the patient's and the visit's page show them.

What is due and not yet in the queue is put there when somebody looks.
"""

from __future__ import annotations

from typing import Any

from django import template
from django.utils.html import format_html
from django.utils.safestring import SafeString

from mammometry.clinic.jobs import queue
from mammometry.clinic.models import Patient, Visit
from mammometry.clinic.study import comparing
from mammometry.clinic.study.comparing import Verdict

register = template.Library()
_COVERAGE_95 = 1.96  # standard deviations on either side that hold 95 %


@register.simple_tag
def change_since_the_visit_before(visit: Visit) -> Verdict | None:
    """The verdict against the visit before. None: there is none."""
    pair = next((pair for pair in comparing.neighbours(visit) if pair[1] == visit), None)
    return None if pair is None else queued(comparing.verdict(*pair))


@register.simple_tag
def changes_of(patient: Patient) -> list[Verdict]:
    """The verdicts from visit to visit, the newest first."""
    visits = Visit.objects.filter(patient=patient).prefetch_related("measurements__volumes")
    return [queued(verdict) for verdict in comparing.changes(visits)]


@register.filter
def length_change(length: dict[str, Any]) -> SafeString:
    """A change of a length with its 95 % half-width, in bold where it is more than the error."""
    words = f"{length['change_mm']:+.1f} ± {_COVERAGE_95 * length['sigma_mm']:.1f}".replace("-", "−")
    return format_html("<strong>{}</strong>", words) if length["beyond_error"] else format_html("{}", words)


def queued(verdict: Verdict) -> Verdict:
    """The same verdict, with its comparison in the queue where it is due."""
    if verdict.state != "busy":
        return verdict
    queue.compare(verdict.before, verdict.after, None)
    return comparing.verdict(verdict.before, verdict.after)
