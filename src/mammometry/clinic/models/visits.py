"""Visits, and the photographs that come in for them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from django.conf import settings
from django.db import models

from mammometry.clinic.models.keyed import InUse, Keyed
from mammometry.clinic.models.patients import Patient
from mammometry.clinic.models.rigs import Calibration, DailyCheck, Rig
from mammometry.clinic.site import the_clinic


class Visit(Keyed):
    """One patient before one rig on one day."""

    class State(models.TextChoices):
        """How far it is."""

        NEW = "new"
        UPLOADING = "uploading"
        READY = "ready"
        QUEUED = "queued"
        CHANGED = "changed"
        """A boundary or landmark was changed and not measured yet."""
        MEASURED = "measured"
        REFUSED = "refused"
        CONFIRMED = "confirmed"
        """The newest measurement was confirmed (`Confirmation`)."""

    class Occasion(models.TextChoices):
        """Why the patient came."""

        BEFORE = "before", "Before the operation"
        FILLING = "filling", "Filling of an expander"
        WEEKS_6 = "6 weeks", "6 weeks after"
        MONTHS_3 = "3 months", "3 months after"
        MONTHS_6 = "6 months", "6 months after"
        YEAR_1 = "1 year", "1 year after"
        LATER = "later", "Later"
        OTHER = "other", "Other"

    class Posture(models.TextChoices):
        """How the patient held herself. Volumes of different postures are not to be compared."""

        LEANING = "leaning", "Leaning forward"
        STANDING = "standing", "Standing"
        LYING = "lying", "Lying"

    class Subject(models.TextChoices):
        """What is photographed."""

        TORSO = "torso"
        MODEL = "model"

    patient = models.ForeignKey(Patient, on_delete=models.PROTECT, related_name="visits")
    rig = models.ForeignKey(Rig, null=True, on_delete=models.PROTECT, related_name="visits")
    """None: another device made a mesh (`Scan`)."""
    calibration = models.ForeignKey(Calibration, null=True, on_delete=models.PROTECT, related_name="visits")
    taken_at = models.DateTimeField()
    subject_kind = models.CharField(max_length=8, choices=Subject.choices, default=Subject.TORSO)
    state = models.CharField(max_length=12, choices=State.choices, default=State.NEW)
    occasion = models.CharField(max_length=10, choices=Occasion.choices, blank=True, default="")
    posture = models.CharField(max_length=10, choices=Posture.choices, blank=True, default="")
    """Empty: nobody said."""
    note = models.TextField(max_length=2000, blank=True)
    binned_at = models.DateTimeField(null=True, editable=False)
    """When it was put into the bin. None: it is in use."""
    created = models.DateTimeField(auto_now_add=True)
    created_by = models.ForeignKey(settings.AUTH_USER_MODEL, null=True, on_delete=models.PROTECT, related_name="+")

    objects = InUse["Visit"]()
    everything = models.Manager()
    """Those in the bin, too."""

    class Meta:
        ordering = ("-taken_at",)

    def __str__(self) -> str:
        return f"{self.patient.pseudonym}, {self.taken_at:%Y-%m-%d}"

    def save(self, *args: Any, **options: Any) -> None:
        """Save. A new visit of a patient has the posture of its device, where nobody said another."""
        if self._state.adding and not self.posture and self.subject_kind == Visit.Subject.TORSO:
            self.posture = Visit.Posture.STANDING if self.rig_id is None else Visit.Posture.LEANING
        super().save(*args, **options)

    @property
    def folder(self) -> Path:
        """Its session folder, named by this row's key."""
        return the_clinic().folder / "sessions" / str(self.id)

    @property
    def device(self) -> str:
        """Name of the rig, or of the other device."""
        if self.rig is not None:
            return self.rig.name
        scan = Scan.objects.filter(visit=self).first()
        return "" if scan is None else scan.scanner

    @property
    def shown_state(self) -> str:
        """Its state, as pages say it."""
        from mammometry.clinic.records.confirmations import is_changed

        return Visit.State.CHANGED if is_changed(self) else self.state

    @property
    def is_scan(self) -> bool:
        """Whether another device made it: it has a mesh and no photographs."""
        return self.rig_id is None


class Scan(Keyed):
    """Where a visit without photographs has its mesh from."""

    visit = models.OneToOneField(Visit, on_delete=models.CASCADE, related_name="scan")
    scanner = models.CharField(max_length=100)
    """Name of the device, as entered."""
    units = models.CharField(max_length=40)
    """Unit of the device's file, and who says so."""
    textured = models.BooleanField(default=False)
    """Whether it came with pictures."""
    sha256 = models.CharField(max_length=64)
    """Of the device's own mesh file."""

    def __str__(self) -> str:
        return f"scan of {self.visit}"


class Upload(Keyed):
    """One photograph that comes in, whole or in pieces."""

    class State(models.TextChoices):
        """How far it is."""

        RECEIVING = "receiving"
        CHECKED = "checked"
        REFUSED = "refused"
        PLACED = "placed"
        SET_ASIDE = "set aside"
        """Its file lies beside the others and is not measured. It can come back."""

    visit = models.ForeignKey(Visit, null=True, on_delete=models.CASCADE, related_name="uploads")
    calibration = models.ForeignKey(Calibration, null=True, on_delete=models.CASCADE, related_name="uploads")
    check_of_day = models.ForeignKey(DailyCheck, null=True, on_delete=models.CASCADE, related_name="uploads")
    camera = models.CharField(max_length=100)
    name = models.CharField(max_length=100, blank=True)
    """Its name in the folder, made by us; the sender's own name is not kept."""
    size_bytes = models.BigIntegerField()
    received_bytes = models.BigIntegerField(default=0)
    sha256 = models.CharField(max_length=64, blank=True, db_index=True)
    state = models.CharField(max_length=12, choices=State.choices, default=State.RECEIVING)
    checks = models.JSONField(default=list, blank=True)
    """What was looked at: {check, ok, sentence} each."""
    created = models.DateTimeField(auto_now_add=True)
    created_by = models.ForeignKey(settings.AUTH_USER_MODEL, null=True, on_delete=models.PROTECT, related_name="+")

    class Meta:
        ordering = ("created",)

    def __str__(self) -> str:
        return f"upload {self.id}"

    @property
    def path(self) -> Path:
        """Where its bytes come in, named by this row's key."""
        return the_clinic().folder / "uploads" / str(self.id)
