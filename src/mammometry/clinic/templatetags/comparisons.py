"""Verdicts on the change between two visits, as the patient's and the visit's page show them.

What is due and not yet in the queue is put there when somebody looks.
"""

from __future__ import annotations

from django import template

from mammometry.clinic import comparing
from mammometry.clinic.comparing import Verdict
from mammometry.clinic.jobs import queue
from mammometry.clinic.models import Patient, Visit

register = template.Library()


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


def queued(verdict: Verdict) -> Verdict:
    """The same verdict, with its comparison in the queue where it is due."""
    if verdict.state != "busy":
        return verdict
    queue.compare(verdict.before, verdict.after, None)
    return comparing.verdict(verdict.before, verdict.after)
