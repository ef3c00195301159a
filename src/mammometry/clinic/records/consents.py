"""Consents: what a patient agreed to, and whether it holds."""

from __future__ import annotations

from django.db.models import Exists, OuterRef

from mammometry.clinic.models import Consent, Patient


def holds(patient: Patient, purpose: Consent.Purpose) -> bool:
    """Whether a patient's consent was given and not withdrawn."""
    return patient.consents.filter(purpose=purpose, withdrawn_on=None).exists()


def pictures_caution(patient: Patient) -> str:
    """Why photographs should not be taken yet, in a sentence. Empty: the consent holds."""
    if holds(patient, Consent.Purpose.PICTURES):
        return ""
    if patient.consents.filter(purpose=Consent.Purpose.PICTURES).exists():
        return "The patient has withdrawn the consent to photographs and measurement."
    return "No consent to photographs and measurement is entered."


def research_consent() -> Exists:
    """Condition on visits: the patient's consent to research holds."""
    return Exists(
        Consent.objects.filter(patient=OuterRef("patient"), purpose=Consent.Purpose.RESEARCH, withdrawn_on__isnull=True)
    )
