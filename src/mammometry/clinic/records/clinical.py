"""Clinical records of a visit: consents, operations, conclusions."""

from __future__ import annotations

from typing import TYPE_CHECKING

from django.db.models import Exists, OuterRef, QuerySet
from django.utils import timezone

from mammometry.clinic.models import Consent, Operation, Patient, Visit
from mammometry.clinic.records.comparing import verdicts
from mammometry.clinic.records.confirmations import valid_confirmation
from mammometry.report.content import Clinical, Signed

if TYPE_CHECKING:
    from mammometry.clinic.models import Conclusion, Confirmation


_VOLUMES = {
    Operation.Kind.GRAFT: "{} cc of fat injected",
    Operation.Kind.EXPANDER: "filled with {} cc",
    Operation.Kind.FILLING: "{} cc in all",
}
"""Kind → how its volume is worded. Others: "300 cc"."""
_EARLIER = "(Written before the visit was measured again.)"


def clinical_of(visit: Visit) -> Clinical:
    """Gather a visit's clinical data for reports and exports."""
    confirmation, measurement = valid_confirmation(visit), visit.measurements.first()
    patient = visit.patient
    return Clinical(
        patient=patient.name,
        born=patient.born,
        record=patient.record_number,
        taken=timezone.localtime(visit.taken_at),
        occasion=visit.get_occasion_display(),
        posture=visit.get_posture_display().lower(),
        operations=tuple(operation_words(operation) for operation in operations_before(visit)),
        change=verdicts(visit),
        confirmed=None if confirmation is None else _signed(confirmation),
        conclusions=tuple(
            _signed(row, row.text if row.measurement == measurement else f"{row.text}\n{_EARLIER}")
            for row in visit.conclusions.select_related("by", "measurement")
        ),
    )


def operations_before(visit: Visit) -> QuerySet[Operation]:
    """Operations whose effect a visit's pictures show, newest first.

    An operation on the day of the visit is included, unless the visit was before it.
    """
    day = timezone.localtime(visit.taken_at).date()
    rows = Operation.objects.filter(patient=visit.patient_id)
    return rows.filter(day__lt=day) if visit.occasion == Visit.Occasion.BEFORE else rows.filter(day__lte=day)


def operation_words(operation: Operation) -> str:
    """One operation in a sentence: "Implant inserted, left, 2026-03-02, 300 cc"."""
    side = "both sides" if operation.side == Operation.Side.BOTH else operation.side
    return ", ".join((operation.get_kind_display(), side, operation.day.isoformat(), *operation_details(operation)))


def operation_details(operation: Operation) -> tuple[str, ...]:
    """Volume, resected weight and free text of an operation, if entered."""
    each_side = " each side" if operation.side == Operation.Side.BOTH else ""
    details = []
    if operation.volume_cc is not None:
        volume = f"{operation.volume_cc:g}"
        details.append(_VOLUMES.get(Operation.Kind(operation.kind), "{} cc").format(volume) + each_side)
    if operation.resected_g is not None:
        details.append(f"{operation.resected_g:g} g taken out{each_side}")
    if operation.words:
        details.append(operation.words)
    return tuple(details)


def _signed(row: Confirmation | Conclusion, text: str = "") -> Signed:
    return Signed(by="" if row.by is None else str(row.by), at=timezone.localtime(row.at), text=text)


def holds(patient: Patient, purpose: Consent.Purpose) -> bool:
    """Whether a patient's consent is valid."""
    return patient.consents.filter(purpose=purpose, withdrawn_on=None).exists()


def pictures_caution(patient: Patient) -> str:
    """Reason for not taking photographs yet, one sentence. Empty: the consent is valid."""
    if holds(patient, Consent.Purpose.PICTURES):
        return ""
    if patient.consents.filter(purpose=Consent.Purpose.PICTURES).exists():
        return "The patient has withdrawn the consent to photographs and measurement."
    return "No consent to photographs and measurement is entered."


def research_consent() -> Exists:
    """Condition on visits: the patient's consent to research is valid."""
    return Exists(
        Consent.objects.filter(patient=OuterRef("patient"), purpose=Consent.Purpose.RESEARCH, withdrawn_on__isnull=True)
    )
