"""Tables of patients, of their visits and of photographs. Only they contain patients' names."""

from __future__ import annotations

import datetime
import secrets
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from django.conf import settings
from django.db import models
from django.utils import timezone

from mammometry.clinic.models.people import Calibration, DailyCheck, InUse, Keyed, Rig
from mammometry.clinic.records.search_words import words_of
from mammometry.clinic.site import the_clinic

TELEPHONE = "Telephone"
"""Shown as the device of a visit with a telephone."""
ALPHABET = "ACDEFGHJKLMNPQRTUVWXY34679"
"""Letters and digits that cannot be confused: without B and 8, I and 1, O and 0, S and 5, Z and 2."""


def new_pseudonym() -> str:
    """P- and six random characters: 26^6 = 309 million values. Drawn again if taken."""
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
        """Add many patients, each with its search words."""
        patients = list(objs)
        for patient in patients:
            patient.search_words = words_of(patient.own_words)
        return super().bulk_create(patients, *args, **options)


class Patient(Keyed):
    """A patient."""

    family_name = models.CharField(max_length=100)
    given_name = models.CharField(max_length=100)
    born = models.DateField(null=True, blank=True)
    record_number = models.CharField(max_length=64, unique=True)
    """The hospital's record number."""
    pseudonym = models.CharField(max_length=8, unique=True, default=new_pseudonym, editable=False)
    """The patient's identifier outside this table."""
    note = models.TextField(max_length=2000, blank=True)
    search_words = models.TextField(default="", blank=True, editable=False)
    """Normalised names and numbers for the search, including those of merged records (`search_words.words_of`)."""
    merged_into = models.ForeignKey("self", null=True, on_delete=models.CASCADE, related_name="merged", editable=False)
    """The record that has this patient's visits after a merge. None: this one."""
    binned_at = models.DateTimeField(null=True, editable=False)
    """Time when it was put into the bin. None: it is in use."""
    created = models.DateTimeField(auto_now_add=True)

    objects = PatientsInUse()
    everything = models.Manager()
    """Including merged records and those in the bin."""

    class Meta:
        ordering = ("family_name", "given_name", "record_number")

    def __str__(self) -> str:
        return self.pseudonym

    def save(self, *args: Any, **options: Any) -> None:
        """Save with updated search words."""
        texts = list(self.own_words)
        if not self._state.adding:
            texts += [word for other in Patient.everything.filter(merged_into=self) for word in other.own_words]
        self.search_words = words_of(texts)
        if options.get("update_fields") is not None:
            options["update_fields"] = {*options["update_fields"], "search_words"}
        super().save(*args, **options)

    @property
    def own_words(self) -> tuple[str, ...]:
        """Search words of this record."""
        return self.family_name, self.given_name, self.record_number, self.pseudonym

    @property
    def name(self) -> str:
        """Family name, given name."""
        return f"{self.family_name}, {self.given_name}"


class Consent(Keyed):
    """A patient's consent and its duration."""

    class Purpose(models.TextChoices):
        """Allowed use of the pictures."""

        PICTURES = "pictures", "Photographs and measurement"
        RESEARCH = "research", "Research, by pseudonym"

    patient = models.ForeignKey(Patient, on_delete=models.CASCADE, related_name="consents")
    purpose = models.CharField(max_length=10, choices=Purpose.choices)
    given_on = models.DateField()
    withdrawn_on = models.DateField(null=True, blank=True)
    """None: the consent is valid."""
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
        """Kind of the operation."""

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
    """Volume of the implant, of the expander's total filling, or of the injected fat, on each side."""
    resected_g = models.FloatField(null=True, blank=True)
    """Weight of the removed tissue on each side."""
    words = models.CharField(max_length=300, blank=True)
    """Free text: the flap, the implant's type, description of "other"."""
    entered_at = models.DateTimeField(auto_now_add=True)
    entered_by = models.ForeignKey(settings.AUTH_USER_MODEL, null=True, on_delete=models.PROTECT, related_name="+")

    class Meta:
        ordering = ("-day", "kind")

    def __str__(self) -> str:
        return f"{self.patient.pseudonym}, {self.kind}"

    def is_after(self, visit: Visit) -> bool:
        """Whether this operation was done after a visit.

        On the same day, the visit's occasion decides.
        """
        day = timezone.localtime(visit.taken_at).date()
        return day < self.day or (day == self.day and visit.occasion == Visit.Occasion.BEFORE)


class Visit(Keyed):
    """One patient, photographed on one day."""

    class State(models.TextChoices):
        """State of a visit."""

        NEW = "new"
        UPLOADING = "uploading"
        READY = "ready"
        QUEUED = "queued"
        CHANGED = "changed"
        """A boundary or landmark has changed since the last measurement."""
        MEASURED = "measured"
        REFUSED = "refused"
        CONFIRMED = "confirmed"
        """The newest measurement was confirmed (`Confirmation`)."""

    class Occasion(models.TextChoices):
        """Occasion of the visit."""

        BEFORE = "before", "Before the operation"
        FILLING = "filling", "Filling of an expander"
        WEEKS_6 = "6 weeks", "6 weeks after"
        MONTHS_3 = "3 months", "3 months after"
        MONTHS_6 = "6 months", "6 months after"
        YEAR_1 = "1 year", "1 year after"
        LATER = "later", "Later"
        OTHER = "other", "Other"

    class Posture(models.TextChoices):
        """The patient's posture. Volumes in different postures must not be compared."""

        LEANING = "leaning", "Leaning forward"
        STANDING = "standing", "Standing"
        LYING = "lying", "Lying"

    class Subject(models.TextChoices):
        """Whether a patient or a model is photographed."""

        TORSO = "torso"
        MODEL = "model"

    patient = models.ForeignKey(Patient, on_delete=models.PROTECT, related_name="visits")
    rig = models.ForeignKey(Rig, null=True, on_delete=models.PROTECT, related_name="visits")
    """None: another device made a mesh (`Scan`), or a telephone took the photographs (`Walk`)."""
    calibration = models.ForeignKey(Calibration, null=True, on_delete=models.PROTECT, related_name="visits")
    taken_at = models.DateTimeField()
    subject_kind = models.CharField(max_length=8, choices=Subject.choices, default=Subject.TORSO)
    state = models.CharField(max_length=12, choices=State.choices, default=State.NEW)
    occasion = models.CharField(max_length=10, choices=Occasion.choices, blank=True, default="")
    posture = models.CharField(max_length=10, choices=Posture.choices, blank=True, default="")
    """Empty: unknown."""
    repeat_of = models.ForeignKey("self", null=True, blank=True, on_delete=models.SET_NULL, related_name="repeats")
    """The visit that this one repeats, for studies of agreement. None: it is not a repeat."""
    note = models.TextField(max_length=2000, blank=True)
    binned_at = models.DateTimeField(null=True, editable=False)
    """Time when it was put into the bin. None: it is in use."""
    created = models.DateTimeField(auto_now_add=True)
    created_by = models.ForeignKey(settings.AUTH_USER_MODEL, null=True, on_delete=models.PROTECT, related_name="+")

    objects = InUse["Visit"]()
    everything = models.Manager()
    """Including those in the bin."""

    class Meta:
        ordering = ("-taken_at",)

    def __str__(self) -> str:
        return f"{self.patient.pseudonym}, {self.taken_at:%Y-%m-%d}"

    @property
    def repeated(self) -> Visit | None:
        """The visit that this one repeats, if both are the same patient's."""
        return self.repeat_of if self.repeat_of is not None and self.repeat_of.patient_id == self.patient_id else None

    @property
    def folder(self) -> Path:
        """The visit's session folder, named by the row's key."""
        return the_clinic().folder / "sessions" / str(self.id)

    @property
    def device(self) -> str:
        """Name of the rig, or of the other device."""
        if self.rig is not None:
            return self.rig.name
        if self.is_walk:
            return TELEPHONE
        scan = Scan.objects.filter(visit=self).first()
        return "" if scan is None else scan.scanner

    @property
    def shown_state(self) -> str:
        """The visit's state, as shown on pages."""
        return Visit.State.CHANGED if self.is_changed else self.state

    @property
    def is_changed(self) -> bool:
        """Whether its numbers are from an earlier drawing or from earlier photographs."""
        return self.state == Visit.State.CHANGED or (self.state == Visit.State.QUEUED and self.has_unmeasured)

    @property
    def has_unmeasured(self) -> bool:
        """Whether drawings or photographs were added or restored since the last finished measurement started."""
        began = self._measured_at
        if began is None:
            return self.has_unmeasured_drawing
        placed = self.uploads.filter(state=Upload.State.PLACED, created__gt=began)
        return self.has_unmeasured_drawing or placed.exists()

    @property
    def has_unmeasured_drawing(self) -> bool:
        """Whether boundaries or landmarks were drawn since the last finished measurement started."""
        drawn = self.drawings.exclude(action="confirmed").order_by("-at").first()
        began = self._measured_at
        return drawn is not None and (began is None or drawn.at > began)

    @property
    def _measured_at(self) -> datetime.datetime | None:
        """Start of the last finished measurement, whose numbers may equal an earlier one's."""
        job = self.jobs.filter(kind="measure", state="done").order_by("-started").first()
        if job is not None and job.started is not None:
            return job.started
        measurement = self.measurements.first()
        return None if measurement is None else measurement.made_at

    @property
    def is_scan(self) -> bool:
        """Whether it is a scan of another device: a mesh without photographs."""
        return self.rig_id is None and not self.is_walk

    @property
    def is_walk(self) -> bool:
        """Whether its photographs were taken by one telephone, with a printed board."""
        return self.rig_id is None and Walk.objects.filter(visit=self).exists()


class NoteChange(Keyed):
    """A note about a patient, before and after a change.

    The audit's entry has author and time, but not the text. Rows are erased with the patient.
    """

    patient = models.ForeignKey(Patient, null=True, on_delete=models.CASCADE, related_name="note_changes")
    """None: the note is about a visit, which may be moved to another patient."""
    visit = models.ForeignKey(Visit, null=True, on_delete=models.CASCADE, related_name="note_changes")
    entry = models.BigIntegerField(db_index=True)
    """Key of the audit's entry."""
    field = models.CharField(max_length=20)
    before = models.TextField(blank=True)
    after = models.TextField(blank=True)

    class Meta:
        ordering = ("-entry",)

    def __str__(self) -> str:
        return f"{self.field} of entry {self.entry}"


class Scan(Keyed):
    """Origin of the mesh of a visit without photographs."""

    visit = models.OneToOneField(Visit, on_delete=models.CASCADE, related_name="scan")
    scanner = models.CharField(max_length=100)
    """Name of the device, as entered."""
    units = models.CharField(max_length=40)
    """Unit of the device's file, and where it was stated."""
    textured = models.BooleanField(default=False)
    """Whether it has pictures."""
    sha256 = models.CharField(max_length=64)
    """Digest of the device's own mesh file."""

    def __str__(self) -> str:
        return f"scan of {self.visit}"


class Walk(Keyed):
    """Printed board of a visit that was photographed with one telephone."""

    visit = models.OneToOneField(Visit, on_delete=models.CASCADE, related_name="walk")
    edge_mm = models.FloatField(null=True, blank=True)
    """Measured length of the eleven columns of the printed board, mm. None: not measured."""
    edge_std_mm = models.FloatField(null=True, blank=True)
    """Standard uncertainty of that length, mm."""

    def __str__(self) -> str:
        return f"walk of {self.visit}"


class Upload(Keyed):
    """One uploaded photograph, complete or in part."""

    class State(models.TextChoices):
        """State of an upload."""

        RECEIVING = "receiving"
        CHECKED = "checked"
        REFUSED = "refused"
        PLACED = "placed"
        SET_ASIDE = "set aside"
        """Its file is kept but not measured, and can be restored."""
        PREPARED = "prepared"
        """Its file was deleted after the walk's session, which contains what is measured, was prepared."""

    visit = models.ForeignKey(Visit, null=True, on_delete=models.CASCADE, related_name="uploads")
    calibration = models.ForeignKey(Calibration, null=True, on_delete=models.CASCADE, related_name="uploads")
    check_of_day = models.ForeignKey(DailyCheck, null=True, on_delete=models.CASCADE, related_name="uploads")
    camera = models.CharField(max_length=100)
    name = models.CharField(max_length=100, blank=True)
    """File name in the folder, chosen by us. The sender's name is not stored."""
    size_bytes = models.BigIntegerField()
    received_bytes = models.BigIntegerField(default=0)
    sha256 = models.CharField(max_length=64, blank=True, db_index=True)
    state = models.CharField(max_length=12, choices=State.choices, default=State.RECEIVING)
    checks = models.JSONField(default=list, blank=True)
    """Results of checks: {check, ok, sentence} each."""
    created = models.DateTimeField(auto_now_add=True)
    created_by = models.ForeignKey(settings.AUTH_USER_MODEL, null=True, on_delete=models.PROTECT, related_name="+")

    class Meta:
        ordering = ("created",)

    def __str__(self) -> str:
        return f"upload {self.id}"

    @property
    def path(self) -> Path:
        """File with the received bytes, named by this row's key."""
        return the_clinic().folder / "uploads" / str(self.id)
