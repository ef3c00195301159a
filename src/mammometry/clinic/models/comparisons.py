"""Comparisons of two visits."""

from __future__ import annotations

from django.db import models

from mammometry.clinic.models.keyed import Keyed
from mammometry.clinic.models.visits import Visit


class Comparison(Keyed):
    """Two visits of one patient, laid onto one another."""

    class State(models.TextChoices):
        """How far it is."""

        QUEUED = "queued"
        DONE = "done"
        REFUSED = "refused"

    before = models.ForeignKey(Visit, on_delete=models.CASCADE, related_name="comparisons_as_before")
    after = models.ForeignKey(Visit, on_delete=models.CASCADE, related_name="comparisons")
    of = models.CharField(max_length=200, blank=True)
    """Digests of both measurements. Where they are others now, the comparison is of the past."""
    state = models.CharField(max_length=10, choices=State.choices, default=State.QUEUED)
    table = models.JSONField(default=dict)
    """Content of compare.json."""
    message = models.CharField(max_length=1500, blank=True)
    """Why the two cannot be compared."""
    made_at = models.DateTimeField(null=True)

    class Meta:
        ordering = ("-made_at",)
        constraints = (models.UniqueConstraint(fields=("before", "after"), name="one_comparison_each"),)

    def __str__(self) -> str:
        return f"{self.before} and {self.after}"
