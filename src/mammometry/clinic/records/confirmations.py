"""Confirmations: statements of people about one measured result.

A confirmation changes no number. It holds for the newest measurement of a visit, while nothing that was drawn later
waits to be measured.
"""

from __future__ import annotations

import datetime
from collections.abc import Mapping

from mammometry.clinic.models import Confirmation, Drawing, Job, Measurement, Person, Upload, Visit

CHANGED = "changed, not yet measured"
"""What pages, tables and exports say of a visit whose newest drawing is not measured."""
CHANGED_SENTENCE = "A boundary, landmark or photograph of this visit was changed and is not measured yet. Measure it."


def has_unmeasured_drawing(visit: Visit) -> bool:
    """Whether somebody drew since the last finished measurement began."""
    drawn = visit.drawings.exclude(action=Drawing.Action.CONFIRMED).order_by("-at").first()
    if drawn is None:
        return False
    measured_at = _measured_at(visit)
    return measured_at is None or drawn.at > measured_at


def has_unmeasured_photographs(visit: Visit) -> bool:
    """Whether photographs came in, or came back, since the last finished measurement began."""
    measured_at = _measured_at(visit)
    if measured_at is None:
        return False
    return visit.uploads.filter(state=Upload.State.PLACED, created__gt=measured_at).exists()


def _measured_at(visit: Visit) -> datetime.datetime | None:
    """When the last finished measurement began. It may have come to the numbers of an earlier one."""
    job = visit.jobs.filter(kind=Job.Kind.MEASURE, state=Job.State.DONE).order_by("-started").first()
    if job is not None and job.started is not None:
        return job.started
    measurement = visit.measurements.first()
    return None if measurement is None else measurement.made_at


def _has_unmeasured(visit: Visit) -> bool:
    return has_unmeasured_drawing(visit) or has_unmeasured_photographs(visit)


def is_changed(visit: Visit) -> bool:
    """Whether the visit's numbers are of an earlier drawing or earlier photographs."""
    return visit.state == Visit.State.CHANGED or (visit.state == Visit.State.QUEUED and _has_unmeasured(visit))


def confirmation_of(measurement: Measurement) -> Confirmation | None:
    """Newest confirmation of exactly the boundaries that were measured."""
    return next((row for row in measurement.confirmations.all() if row.curves == measurement.curves), None)


def valid_confirmation(visit: Visit) -> Confirmation | None:
    """Confirmation of the visit's newest measurement, if nothing was changed since."""
    measurement = visit.measurements.first()
    return None if measurement is None or is_changed(visit) else confirmation_of(measurement)


def settled_state(visit: Visit) -> Visit.State:
    """State of a visit for which no measurement waits."""
    measurement = visit.measurements.first()
    if _has_unmeasured(visit):
        return Visit.State.CHANGED
    if measurement is None:
        return Visit.State.READY
    return Visit.State.MEASURED if confirmation_of(measurement) is None else Visit.State.CONFIRMED


def refusal(visit: Visit, curves: Mapping[str, str]) -> str | None:
    """Why these boundaries of a visit cannot be confirmed, in a sentence. None: they can be."""
    measurement = visit.measurements.first()
    if is_changed(visit):
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
