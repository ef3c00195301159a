"""Corrections of records: a visit moved to another patient, a date, a merge, the bin."""

from __future__ import annotations

from django.conf import settings
from django.db import models

from mammometry.clinic.models.keyed import Keyed
from mammometry.clinic.models.patients import Patient
from mammometry.clinic.models.visits import Visit


class Correction(Keyed):
    """One change of a record, with its reason. It can be undone for 30 days."""

    class Kind(models.TextChoices):
        """What was changed."""

        MOVED = "moved", "Visit moved to another patient"
        DATED = "dated", "Date of a visit corrected"
        MERGED = "merged", "Two records of one patient merged"
        BINNED = "binned", "Put into the bin"

    kind = models.CharField(max_length=8, choices=Kind.choices)
    visit = models.ForeignKey(Visit, null=True, on_delete=models.CASCADE, related_name="corrections")
    patient = models.ForeignKey(Patient, null=True, on_delete=models.CASCADE, related_name="corrections")
    """The patient who was merged or put into the bin, or whose visit was moved."""
    before = models.JSONField(default=dict)
    """What was there before, patients by their keys. The audit does not hold it, since notes may hold names."""
    after = models.JSONField(default=dict)
    reason = models.CharField(max_length=500)
    at = models.DateTimeField(auto_now_add=True)
    by = models.ForeignKey(settings.AUTH_USER_MODEL, null=True, on_delete=models.PROTECT, related_name="+")
    undone_at = models.DateTimeField(null=True)
    undone_by = models.ForeignKey(settings.AUTH_USER_MODEL, null=True, on_delete=models.PROTECT, related_name="+")

    class Meta:
        ordering = ("-at",)

    def __str__(self) -> str:
        return f"{self.get_kind_display()}"
