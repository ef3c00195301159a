"""The first day of a fresh clinic: five steps from an empty database to the first patient."""

from __future__ import annotations

from dataclasses import dataclass

from auditlog.models import LogEntry
from django.urls import reverse

from mammometry.clinic.models import Calibration, Patient, Person, Rig
from mammometry.clinic.roles import CARE, RIGS, Role


@dataclass(frozen=True, slots=True, kw_only=True)
class Step:
    """One step of the first day."""

    title: str
    sentence: str
    done: bool
    button: str
    address: str
    """Where the button leads."""
    roles: frozenset[Role]
    """Who may do it."""

    @property
    def role_words(self) -> str:
        """Who may do it, in words."""
        return " or ".join(role.label.lower() for role in Role if role in self.roles)


def steps() -> list[Step]:
    """Return the steps, or an empty list when all are done."""
    rig = Rig.objects.filter(active=True).order_by("created").first()
    calibrated = Calibration.objects.filter(current=True).exists()
    has_patient = Patient.objects.exists()
    if rig is not None and calibrated and has_patient:
        return []
    staff = any(not CARE.isdisjoint(person.roles) for person in Person.objects.filter(is_active=True))
    printed = calibrated or LogEntry.objects.filter(additional_data__page="rig-target").exists()
    rig_page = reverse("rigs") if rig is None else reverse("rig", args=[rig.pk])
    return [
        Step(
            title="People",
            sentence="Enter at least one technician or clinician, and hand over the link to set a password.",
            done=staff,
            button="Enter somebody",
            address=reverse("person-new"),
            roles=frozenset({Role.ADMINISTRATOR}),
        ),
        Step(
            title="Rig",
            sentence="Enter the cameras that stand together, and the board they are calibrated with.",
            done=rig is not None,
            button="Enter the rig",
            address=reverse("rig-new"),
            roles=RIGS,
        ),
        Step(
            title="Board to print",
            sentence="Print it at 100 %, fix it on something flat and stiff, and measure the ruler below it.",
            done=rig is not None and printed,
            button="Open the board as PDF",
            address=rig_page if rig is None else reverse("rig-target", args=[rig.pk]),
            roles=RIGS,
        ),
        Step(
            title="Calibration",
            sentence="Photograph the board in about twelve poses with all cameras, and let them be calibrated.",
            done=calibrated,
            button="To the rig",
            address=rig_page,
            roles=RIGS,
        ),
        Step(
            title="First patient",
            sentence="Enter a patient, begin a visit, and add its photographs.",
            done=has_patient,
            button="Enter a patient",
            address=reverse("patient-new"),
            roles=CARE,
        ),
    ]


@dataclass(frozen=True, slots=True, kw_only=True)
class FirstDay:
    """The steps as one person sees them."""

    steps: list[Step]
    next_step: Step
    may_do: bool
    """Whether this person may do the next step."""


def first_day_of(person: Person) -> FirstDay | None:
    """Return the first day as this person sees it, or None when it is over."""
    all_steps = steps()
    waiting = [step for step in all_steps if not step.done]
    if not waiting:
        return None
    return FirstDay(steps=all_steps, next_step=waiting[0], may_do=person.has_role(*waiting[0].roles))
