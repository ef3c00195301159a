"""Jobs: what is computed, by whom, how far it is. The row is the truth. Workers hold it on a lease."""

from __future__ import annotations

from django.conf import settings
from django.db import models

from mammometry.clinic.models.comparisons import Comparison
from mammometry.clinic.models.keyed import Keyed
from mammometry.clinic.models.rigs import Calibration, DailyCheck
from mammometry.clinic.models.visits import Visit


class Job(Keyed):
    """One thing to compute."""

    class Kind(models.TextChoices):
        """What is computed."""

        MEASURE = "measure"
        CALIBRATE = "calibrate"
        CHECK = "check"
        COMPARE = "compare"

    class State(models.TextChoices):
        """How far it is."""

        QUEUED = "queued"
        RUNNING = "running"
        DONE = "done"
        FAILED = "failed"
        CANCELLED = "cancelled"

    visit = models.ForeignKey(Visit, null=True, on_delete=models.CASCADE, related_name="jobs")
    calibration = models.ForeignKey(Calibration, null=True, on_delete=models.CASCADE, related_name="jobs")
    check_of_day = models.ForeignKey(DailyCheck, null=True, on_delete=models.CASCADE, related_name="jobs")
    comparison = models.ForeignKey(Comparison, null=True, on_delete=models.CASCADE, related_name="jobs")
    kind = models.CharField(max_length=10, choices=Kind.choices)
    state = models.CharField(max_length=10, choices=State.choices, default=State.QUEUED, db_index=True)
    attempt = models.PositiveIntegerField(default=0)
    stage = models.CharField(max_length=60, blank=True)
    fraction = models.FloatField(default=0.0)
    """Of the whole, 0 to 1."""
    message = models.CharField(max_length=1500, blank=True)
    """What a failure said, without a patient's name."""
    exit_code = models.IntegerField(null=True)
    lease_owner = models.CharField(max_length=100, blank=True)
    lease_until = models.DateTimeField(null=True)
    digest = models.CharField(max_length=64, blank=True)
    """Of its results."""
    created = models.DateTimeField(auto_now_add=True)
    started = models.DateTimeField(null=True)
    ended = models.DateTimeField(null=True)
    created_by = models.ForeignKey(settings.AUTH_USER_MODEL, null=True, on_delete=models.PROTECT, related_name="+")

    class Meta:
        ordering = ("created",)
        constraints = tuple(
            models.UniqueConstraint(
                fields=[field],
                condition=models.Q(state__in=("queued", "running")),
                name=f"one_open_job_a_{field}",
            )
            for field in ("visit", "calibration", "check_of_day", "comparison")
        )

    def __str__(self) -> str:
        return f"{self.kind} {self.id}"
