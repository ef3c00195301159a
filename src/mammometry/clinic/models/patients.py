"""Patients. Their names are here and nowhere else."""

from __future__ import annotations

import secrets
from collections.abc import Iterable
from typing import Any

from django.conf import settings
from django.db import models

from mammometry.clinic.models.keyed import InUse, Keyed
from mammometry.clinic.records.search_words import words_of

ALPHABET = "ACDEFGHJKLMNPQRTUVWXY34679"
"""Letters and digits that are not taken for one another: no B and 8, I and 1, O and 0, S and 5, Z and 2."""


def new_pseudonym() -> str:
    """P- and six random letters.

    26^6 = 309 million, drawn again where one is taken.
    """
    while True:
        drawn = "P-" + "".join(secrets.choice(ALPHABET) for _ in range(6))
        if not Patient.everything.filter(pseudonym=drawn).exists():
            return drawn


class PatientsInUse(InUse["Patient"]):
    """Patients who are neither in the bin nor merged into another record."""

    def get_queryset(self) -> models.QuerySet[Patient]:
        """Leave out the bin and merged records."""
        return super().get_queryset().filter(merged_into=None)

    def bulk_create(self, objs: Iterable[Patient], *args: Any, **options: Any) -> list[Patient]:
        """Enter many, each with its words for the search."""
        patients = list(objs)
        for patient in patients:
            patient.search_words = words_of(patient.own_words)
        return super().bulk_create(patients, *args, **options)


class Patient(Keyed):
    """Somebody who is photographed."""

    family_name = models.CharField(max_length=100)
    given_name = models.CharField(max_length=100)
    born = models.DateField(null=True, blank=True)
    record_number = models.CharField(max_length=64, unique=True)
    """As the hospital calls this patient."""
    pseudonym = models.CharField(max_length=8, unique=True, default=new_pseudonym, editable=False)
    """As everything outside this table calls this patient."""
    note = models.TextField(max_length=2000, blank=True)
    search_words = models.TextField(default="", blank=True, editable=False)
    """Names and numbers as a search compares them, those of merged records too: `search_words.words_of`."""
    merged_into = models.ForeignKey("self", null=True, on_delete=models.CASCADE, related_name="merged", editable=False)
    """The record that holds this patient's visits now. None: this one."""
    binned_at = models.DateTimeField(null=True, editable=False)
    """When it was put into the bin. None: it is in use."""
    created = models.DateTimeField(auto_now_add=True)

    objects = PatientsInUse()
    everything = models.Manager()
    """Those in the bin and merged ones, too."""

    class Meta:
        ordering = ("family_name", "given_name", "record_number")

    def __str__(self) -> str:
        return self.pseudonym

    def save(self, *args: Any, **options: Any) -> None:
        """Save, with the words for the search."""
        texts = list(self.own_words)
        if not self._state.adding:
            texts += [word for other in Patient.everything.filter(merged_into=self) for word in other.own_words]
        self.search_words = words_of(texts)
        if options.get("update_fields") is not None:
            options["update_fields"] = {*options["update_fields"], "search_words"}
        super().save(*args, **options)

    @property
    def own_words(self) -> tuple[str, ...]:
        """What a search finds this record by."""
        return self.family_name, self.given_name, self.record_number, self.pseudonym

    @property
    def name(self) -> str:
        """Family name, given name."""
        return f"{self.family_name}, {self.given_name}"


class Consent(Keyed):
    """What a patient agreed to, and until when."""

    class Purpose(models.TextChoices):
        """What the pictures may be used for."""

        PICTURES = "pictures", "Photographs and measurement"
        RESEARCH = "research", "Research, by pseudonym"

    patient = models.ForeignKey(Patient, on_delete=models.CASCADE, related_name="consents")
    purpose = models.CharField(max_length=10, choices=Purpose.choices)
    given_on = models.DateField()
    withdrawn_on = models.DateField(null=True, blank=True)
    """None: it holds."""
    note = models.CharField(max_length=300, blank=True)
    entered_at = models.DateTimeField(auto_now_add=True)
    entered_by = models.ForeignKey(settings.AUTH_USER_MODEL, null=True, on_delete=models.PROTECT, related_name="+")

    class Meta:
        ordering = ("purpose", "-given_on")

    def __str__(self) -> str:
        return f"{self.patient.pseudonym}, {self.purpose}"


class Operation(Keyed):
    """One operation on one or both breasts."""

    class Kind(models.TextChoices):
        """What was done."""

        MASTECTOMY = "mastectomy", "Mastectomy"
        CONSERVING = "conserving", "Breast-conserving surgery"
        EXPANDER = "expander", "Tissue expander inserted"
        FILLING = "filling", "Tissue expander filled"
        IMPLANT = "implant", "Implant inserted"
        FLAP = "flap", "Reconstruction with a flap"
        GRAFT = "graft", "Fat graft"
        REDUCTION = "reduction", "Reduction or lift"
        AUGMENTATION = "augmentation", "Augmentation"
        OTHER = "other", "Other"

    class Side(models.TextChoices):
        """The patient's own side."""

        LEFT = "left", "Left"
        RIGHT = "right", "Right"
        BOTH = "both", "Both"

    patient = models.ForeignKey(Patient, on_delete=models.CASCADE, related_name="operations")
    kind = models.CharField(max_length=12, choices=Kind.choices)
    side = models.CharField(max_length=5, choices=Side.choices)
    day = models.DateField()
    volume_cc = models.FloatField(null=True, blank=True)
    """Of the implant, of the expander's filling in all, or of the injected fat, each side."""
    resected_g = models.FloatField(null=True, blank=True)
    """Weight of the tissue that was taken out, each side."""
    words = models.CharField(max_length=300, blank=True)
    """In free text: the flap, the implant's type, what "other" is."""
    entered_at = models.DateTimeField(auto_now_add=True)
    entered_by = models.ForeignKey(settings.AUTH_USER_MODEL, null=True, on_delete=models.PROTECT, related_name="+")

    class Meta:
        ordering = ("-day", "kind")

    def __str__(self) -> str:
        return f"{self.patient.pseudonym}, {self.kind}"
