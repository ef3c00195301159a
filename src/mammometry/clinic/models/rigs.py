"""Rigs, their calibrations and their daily checks."""

from __future__ import annotations

from django.conf import settings
from django.db import models

from mammometry.clinic.models.keyed import Keyed


class Rig(Keyed):
    """Cameras that stand together."""

    name = models.CharField(max_length=100, unique=True)
    note = models.TextField(max_length=2000, blank=True)
    created = models.DateTimeField(auto_now_add=True)
    definition = models.JSONField(default=dict)
    """What session.toml says of the rig: its tables rig, target and intrinsics."""
    active = models.BooleanField(default=True)

    class Meta:
        ordering = ("name",)

    def __str__(self) -> str:
        return self.name


class Calibration(Keyed):
    """One calibration of a rig."""

    class State(models.TextChoices):
        """How far it is."""

        UPLOADING = "uploading"
        QUEUED = "queued"
        RUNNING = "running"
        DONE = "done"
        FAILED = "failed"

    rig = models.ForeignKey(Rig, on_delete=models.PROTECT, related_name="calibrations")
    taken_at = models.DateTimeField()
    folder = models.CharField(max_length=200)
    """Where its photographs lie, relative to the clinic's folder."""
    state = models.CharField(max_length=12, choices=State.choices, default=State.UPLOADING)
    figures = models.JSONField(default=dict, blank=True)
    """What was found, with units in the names: rms_px, worst_pair_mm, …"""
    verdict = models.CharField(max_length=500, blank=True)
    """One sentence: may be used, or why not."""
    current = models.BooleanField(default=False)
    """Whether new visits use it."""
    created_by = models.ForeignKey(settings.AUTH_USER_MODEL, null=True, on_delete=models.PROTECT, related_name="+")

    class Meta:
        ordering = ("-taken_at",)
        constraints = (
            models.UniqueConstraint(fields=("rig",), condition=models.Q(current=True), name="one_current_calibration"),
        )

    def __str__(self) -> str:
        return f"{self.rig}, {self.taken_at:%Y-%m-%d}"


class DailyCheck(Keyed):
    """Photographs of a board, one a camera, to see whether one moved."""

    rig = models.ForeignKey(Rig, on_delete=models.PROTECT, related_name="checks")
    calibration = models.ForeignKey(Calibration, null=True, on_delete=models.PROTECT, related_name="checks")
    taken_at = models.DateTimeField()
    folder = models.CharField(max_length=200, blank=True)
    """Where its photographs lie, relative to the clinic's folder."""
    figures = models.JSONField(default=dict, blank=True)
    """Drift by camera, mm and px."""
    verdict = models.CharField(max_length=500, blank=True)
    """One sentence: may we measure today?"""
    passed = models.BooleanField(null=True)
    """None: not judged yet."""
    by = models.ForeignKey(settings.AUTH_USER_MODEL, null=True, on_delete=models.PROTECT, related_name="+")

    class Meta:
        ordering = ("-taken_at",)

    def __str__(self) -> str:
        return f"{self.rig}, {self.taken_at:%Y-%m-%d}"
