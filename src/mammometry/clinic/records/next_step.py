"""The one thing to do next with a visit."""

from __future__ import annotations

from dataclasses import dataclass

from django.urls import reverse

from mammometry.clinic.models import Job, Measurement, Person, Visit
from mammometry.clinic.roles import Role

_OPEN = (Job.State.QUEUED, Job.State.RUNNING)


@dataclass(frozen=True, slots=True, kw_only=True)
class NextStep:
    """What to do, and the button that does it."""

    words: str
    """Where the visit stands, in a sentence."""
    button: str = ""
    """Empty: there is nothing to press."""
    address: str = ""
    starts_job: bool = False
    """Whether the button starts a job. Else it opens a page."""


def next_step(visit: Visit, job: Job | None, measurement: Measurement | None, person: Person) -> NextStep | None:
    """Choose what a person does next with a visit. None: the page shows the work itself.

    Args:
        visit: any.
        job: its newest.
        measurement: its newest.
        person: who looks at the page.
    """
    if job is not None and job.state in _OPEN:
        return None
    if job is not None and job.state in (Job.State.FAILED, Job.State.CANCELLED):
        return None  # the page says why, beside the button that tries again
    measure = reverse("visit-measure", args=[visit.pk])
    if visit.state == Visit.State.CHANGED:
        words = (
            "A boundary, landmark or photograph was changed and is not measured yet. Until then there are no numbers."
        )
        return NextStep(words=words, button="Measure", address=measure, starts_job=True)
    if measurement is None:
        if not visit.is_scan:
            return None  # the photographs have the button
        return NextStep(words="The scan is here.", button="Measure", address=measure, starts_job=True)
    return _judgement(visit, measurement, clinician=person.has_role(Role.CLINICIAN))


def _judgement(visit: Visit, measurement: Measurement, *, clinician: bool) -> NextStep:
    """What clinicians do with a measured visit, and what others wait for."""
    if visit.state != Visit.State.CONFIRMED:
        if not clinician:
            return NextStep(words="Measured. A clinician looks at the boundaries and confirms them.")
        words = "Measured. Look at the boundaries, and confirm them or draw them better."
        return NextStep(words=words, button="Confirm boundaries", address=reverse("draw", args=[visit.pk]))
    newest = visit.conclusions.first()
    if newest is None or newest.measurement_id != measurement.pk:
        confirmed = "The boundaries are confirmed."
        if not clinician:
            return NextStep(words=f"{confirmed} A clinician writes the conclusion.")
        return NextStep(words=confirmed, button="Write the conclusion", address="#conclusion")
    return NextStep(words="Confirmed and concluded.")
