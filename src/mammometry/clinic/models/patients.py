"""Tables of patients, whose names are here and nowhere else, of their visits and photographs."""

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

ALPHABET = "ACDEFGHJKLMNPQRTUVWXY34679"
"""Letters and digits that are not taken for one another: no B and 8, I and 1, O and 0, S and 5, Z and 2."""


def new_pseudonym() -> str:
    """P- and six random letters. 26^6 = 309 million, drawn again where one is taken."""
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

    def is_after(self, visit: Visit) -> bool:
        """Whether a visit's pictures were taken before this operation.

        On the day of the operation, the visit's occasion decides.
        """
        day = timezone.localtime(visit.taken_at).date()
        return day < self.day or (day == self.day and visit.occasion == Visit.Occasion.BEFORE)


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
    repeat_of = models.ForeignKey("self", null=True, blank=True, on_delete=models.SET_NULL, related_name="repeats")
    """The visit that this one measures once more, to learn how well both agree. None: it is no repeat."""
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

    @property
    def repeated(self) -> Visit | None:
        """The visit that this one repeats, while both are the same patient's."""
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
        scan = Scan.objects.filter(visit=self).first()
        return "" if scan is None else scan.scanner

    @property
    def shown_state(self) -> str:
        """The visit's state, as pages say it."""
        return Visit.State.CHANGED if self.is_changed else self.state

    @property
    def is_changed(self) -> bool:
        """Whether its numbers are of an earlier drawing or earlier photographs."""
        return self.state == Visit.State.CHANGED or (self.state == Visit.State.QUEUED and self.has_unmeasured)

    @property
    def has_unmeasured(self) -> bool:
        """Whether drawings or photographs came in, or came back, since the last finished measurement began."""
        began = self._measured_at
        if began is None:
            return self.has_unmeasured_drawing
        placed = self.uploads.filter(state=Upload.State.PLACED, created__gt=began)
        return self.has_unmeasured_drawing or placed.exists()

    @property
    def has_unmeasured_drawing(self) -> bool:
        """Whether somebody drew since the last finished measurement began."""
        drawn = self.drawings.exclude(action="confirmed").order_by("-at").first()
        began = self._measured_at
        return drawn is not None and (began is None or drawn.at > began)

    @property
    def _measured_at(self) -> datetime.datetime | None:
        """When the last finished measurement began. It may have come to the numbers of an earlier one."""
        job = self.jobs.filter(kind="measure", state="done").order_by("-started").first()
        if job is not None and job.started is not None:
            return job.started
        measurement = self.measurements.first()
        return None if measurement is None else measurement.made_at

    @property
    def is_scan(self) -> bool:
        """Whether another device made it: it has a mesh and no photographs."""
        return self.rig_id is None


class NoteChange(Keyed):
    """What a note about a patient said before and after a change.

    The audit's entry says who changed it and when, and holds no text. This goes when the patient is erased.
    """

    patient = models.ForeignKey(Patient, null=True, on_delete=models.CASCADE, related_name="note_changes")
    """None: it is of a visit, which may be moved to another patient."""
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
