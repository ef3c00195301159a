"""Confirmations of measured results, and the one thing to do next with a visit."""

from collections.abc import Mapping
from dataclasses import dataclass

from django.urls import reverse

from mammometry.clinic.models import Confirmation, Drawing, Job, Measurement, Person, Visit
from mammometry.clinic.roles import Role

CHANGED = "changed, not yet measured"
"""What pages, tables and exports say of a visit whose newest drawing is not measured."""
CHANGED_SENTENCE = "A boundary, landmark or photograph of this visit was changed and is not measured yet. Measure it."


def confirmation_of(measurement: Measurement) -> Confirmation | None:
    """Newest confirmation of exactly the boundaries that were measured."""
    return next((row for row in measurement.confirmations.all() if row.curves == measurement.curves), None)


def valid_confirmation(visit: Visit) -> Confirmation | None:
    """Confirmation of the visit's newest measurement, if nothing was changed since."""
    measurement = visit.measurements.first()
    return None if measurement is None or visit.is_changed else confirmation_of(measurement)


def settled_state(visit: Visit) -> Visit.State:
    """State of a visit for which no measurement waits."""
    measurement = visit.measurements.first()
    if visit.has_unmeasured:
        return Visit.State.CHANGED
    if measurement is None:
        return Visit.State.READY
    return Visit.State.MEASURED if confirmation_of(measurement) is None else Visit.State.CONFIRMED


def refusal(visit: Visit, curves: Mapping[str, str]) -> str | None:
    """Reason why a visit's boundaries cannot be confirmed, in a sentence. None: they can be."""
    measurement = visit.measurements.first()
    if visit.is_changed:
        return CHANGED_SENTENCE
    if visit.state == Visit.State.QUEUED:
        return "This visit is being measured. Wait until it is."
    if measurement is None or visit.state not in (Visit.State.MEASURED, Visit.State.CONFIRMED):
        return "This visit is not measured. Measure it first."
    if dict(curves) != measurement.curves:
        return "The boundaries on this page are not those that were measured. Load the page again and look at them."
    return None


def confirm(visit: Visit, by: Person) -> Confirmation:
    """Keep that somebody looked at the newest measurement and found it right. Once is enough."""
    measurement = visit.measurements.first()
    assert measurement is not None  # `refusal` says so
    confirmation = confirmation_of(measurement)
    if confirmation is None:
        confirmation = Confirmation.objects.create(measurement=measurement, curves=measurement.curves, by=by)
        items = [*((f"boundary {name}", digest) for name, digest in measurement.curves.items()), ("landmarks", "")]
        for item, digest in items:
            Drawing.objects.create(visit=visit, item=item, action=Drawing.Action.CONFIRMED, by=by, digest=digest)
    Visit.objects.filter(pk=visit.pk).update(state=Visit.State.CONFIRMED)
    return confirmation


def next_to_confirm(after: Visit) -> Visit | None:
    """The visit that waits longest for its confirmation, beside this one."""
    waiting = Visit.objects.filter(state=Visit.State.MEASURED, binned_at=None, patient__binned_at=None)
    return waiting.exclude(pk=after.pk).order_by("taken_at").first()


_OPEN = (Job.State.QUEUED, Job.State.RUNNING)


@dataclass(frozen=True, slots=True, kw_only=True)
class NextStep:
    """The next step, and the button that does it."""

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
    """Next step of a measured visit: a clinician's, or what others wait for."""
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
