"""Confirmations of measured results, and a visit's next step."""

from collections.abc import Mapping
from dataclasses import dataclass

from django.urls import reverse

from mammometry.clinic.models import Confirmation, Drawing, Job, Measurement, Person, Visit
from mammometry.clinic.roles import Role

CHANGED = "changed, not yet measured"
"""Text on pages, in tables and in exports for a visit with changes that are not measured yet."""
CHANGED_SENTENCE = "A boundary, landmark or photograph of this visit has changed and is not measured yet. Measure it."


def confirmation_of(measurement: Measurement) -> Confirmation | None:
    """Newest confirmation of exactly the boundaries that were measured."""
    return next((row for row in measurement.confirmations.all() if row.curves == measurement.curves), None)


def valid_confirmation(visit: Visit) -> Confirmation | None:
    """Confirmation of the visit's newest measurement, if nothing has changed since."""
    measurement = visit.measurements.first()
    return None if measurement is None or visit.is_changed else confirmation_of(measurement)


def settled_state(visit: Visit) -> Visit.State:
    """State of a visit that does not wait for a measurement."""
    measurement = visit.measurements.first()
    if visit.has_unmeasured:
        return Visit.State.CHANGED
    if measurement is None:
        return Visit.State.READY
    return Visit.State.MEASURED if confirmation_of(measurement) is None else Visit.State.CONFIRMED


def refusal(visit: Visit, curves: Mapping[str, str]) -> str | None:
    """Reason why a visit's boundaries cannot be confirmed, in one sentence. None if they can be."""
    measurement = visit.measurements.first()
    if visit.is_changed:
        return CHANGED_SENTENCE
    if visit.state == Visit.State.QUEUED:
        return "This visit is being measured. Wait until it is done."
    if measurement is None or visit.state not in (Visit.State.MEASURED, Visit.State.CONFIRMED):
        return "This visit is not measured. Measure it first."
    if dict(curves) != measurement.curves:
        return "The boundaries on this page are not the measured ones. Reload the page and check them."
    return None


def confirm(visit: Visit, by: Person) -> Confirmation:
    """Store a confirmation of the newest measurement, unless there is one."""
    measurement = visit.measurements.first()
    assert measurement is not None  # `refusal` refuses visits without one
    confirmation = confirmation_of(measurement)
    if confirmation is None:
        confirmation = Confirmation.objects.create(measurement=measurement, curves=measurement.curves, by=by)
        items = [*((f"boundary {name}", digest) for name, digest in measurement.curves.items()), ("landmarks", "")]
        for item, digest in items:
            Drawing.objects.create(visit=visit, item=item, action=Drawing.Action.CONFIRMED, by=by, digest=digest)
    Visit.objects.filter(pk=visit.pk).update(state=Visit.State.CONFIRMED)
    return confirmation


def next_to_confirm(after: Visit) -> Visit | None:
    """The visit that has waited longest for confirmation, except this one."""
    waiting = Visit.objects.filter(state=Visit.State.MEASURED, binned_at=None, patient__binned_at=None)
    return waiting.exclude(pk=after.pk).order_by("taken_at").first()


@dataclass(frozen=True, slots=True, kw_only=True)
class NextStep:
    """The next step, and the button that does it."""

    words: str
    """State of the visit, one sentence."""
    button: str = ""
    """Label of the button. Empty: no button."""
    address: str = ""
    starts_job: bool = False
    """Whether the button starts a job. Otherwise it opens a page."""


def next_step(visit: Visit, job: Job | None, measurement: Measurement | None, person: Person) -> NextStep | None:
    """Choose the next step of a visit. None if the page shows it already.

    Args:
        visit: any visit.
        job: the visit's newest job.
        measurement: the visit's newest measurement.
        person: person who views the page.
    """
    if job is not None and job.state in Job.OPEN:
        return None
    if job is not None and job.state in (Job.State.FAILED, Job.State.CANCELLED):
        return None  # the page shows the reason and a button to retry
    measure = reverse("visit-measure", args=[visit.pk])
    if visit.state == Visit.State.CHANGED:
        words = "A boundary, landmark or photograph has changed. There are no numbers until it is measured."
        return NextStep(words=words, button="Measure", address=measure, starts_job=True)
    if measurement is None:
        if not visit.is_scan:
            return None  # the button is next to the photographs
        return NextStep(words="The scan is here.", button="Measure", address=measure, starts_job=True)
    return _judgement(visit, measurement, clinician=person.has_role(Role.CLINICIAN))


def _judgement(visit: Visit, measurement: Measurement, *, clinician: bool) -> NextStep:
    """Next step of a measured visit, for clinicians and others."""
    if visit.state != Visit.State.CONFIRMED:
        if not clinician:
            return NextStep(words="Measured. A clinician checks the boundaries and confirms them.")
        words = "Measured. Check the boundaries, and confirm or correct them."
        return NextStep(words=words, button="Confirm boundaries", address=reverse("draw", args=[visit.pk]))
    newest = visit.conclusions.first()
    if newest is None or newest.measurement_id != measurement.pk:
        confirmed = "The boundaries are confirmed."
        if not clinician:
            return NextStep(words=f"{confirmed} A clinician writes the conclusion.")
        return NextStep(words=confirmed, button="Write the conclusion", address="#conclusion")
    return NextStep(words="Confirmed and concluded.")
