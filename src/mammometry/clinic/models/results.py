"""Tables of jobs, results, comparisons, corrections and deliveries."""

from django.conf import settings
from django.db import models
from django.utils import timezone

from mammometry.clinic.models.patients import Patient, Visit
from mammometry.clinic.models.people import Calibration, DailyCheck, Keyed


class Comparison(Keyed):
    """Comparison of two visits of one patient."""

    class State(models.TextChoices):
        """State of its progress."""

        QUEUED = "queued"
        DONE = "done"
        REFUSED = "refused"

    before = models.ForeignKey(Visit, on_delete=models.CASCADE, related_name="comparisons_as_before")
    after = models.ForeignKey(Visit, on_delete=models.CASCADE, related_name="comparisons")
    of = models.CharField(max_length=200, blank=True)
    """Digests of both measurements. If they change, the comparison is out of date."""
    state = models.CharField(max_length=10, choices=State.choices, default=State.QUEUED)
    table = models.JSONField(default=dict)
    """Content of compare.json."""
    message = models.CharField(max_length=1500, blank=True)
    """Reason why the two visits cannot be compared."""
    made_at = models.DateTimeField(null=True)

    class Meta:
        ordering = ("-made_at",)
        constraints = (models.UniqueConstraint(fields=("before", "after"), name="one_comparison_each"),)

    def __str__(self) -> str:
        return f"{self.before} and {self.after}"


class Job(Keyed):
    """One piece of background work."""

    class Kind(models.TextChoices):
        """Kind of work."""

        MEASURE = "measure"
        CALIBRATE = "calibrate"
        CHECK = "check"
        COMPARE = "compare"
        SEND = "send"
        BACKUP = "backup"
        RESTORE = "restore"

    class State(models.TextChoices):
        """State of its progress."""

        QUEUED = "queued"
        RUNNING = "running"
        DONE = "done"
        FAILED = "failed"
        CANCELLED = "cancelled"

    OPEN = (State.QUEUED, State.RUNNING)
    """States of a job that has not finished."""

    visit = models.ForeignKey(Visit, null=True, on_delete=models.CASCADE, related_name="jobs")
    calibration = models.ForeignKey(Calibration, null=True, on_delete=models.CASCADE, related_name="jobs")
    check_of_day = models.ForeignKey(DailyCheck, null=True, on_delete=models.CASCADE, related_name="jobs")
    comparison = models.ForeignKey(Comparison, null=True, on_delete=models.CASCADE, related_name="jobs")
    delivery = models.ForeignKey("Delivery", null=True, on_delete=models.CASCADE, related_name="jobs")
    kind = models.CharField(max_length=10, choices=Kind.choices)
    state = models.CharField(max_length=10, choices=State.choices, default=State.QUEUED, db_index=True)
    attempt = models.PositiveIntegerField(default=0)
    due = models.DateTimeField(default=timezone.now)
    """Time before which no runner takes it."""
    stage = models.CharField(max_length=60, blank=True)
    fraction = models.FloatField(default=0.0)
    """Progress, 0 to 1."""
    message = models.CharField(max_length=1500, blank=True)
    """Error message, without a patient's name."""
    exit_code = models.IntegerField(null=True)
    lease_owner = models.CharField(max_length=100, blank=True)
    lease_until = models.DateTimeField(null=True)
    digest = models.CharField(max_length=64, blank=True)
    """Digest of its results."""
    created = models.DateTimeField(auto_now_add=True)
    started = models.DateTimeField(null=True)
    ended = models.DateTimeField(null=True)
    created_by = models.ForeignKey(settings.AUTH_USER_MODEL, null=True, on_delete=models.PROTECT, related_name="+")

    class Meta:
        ordering = ("created",)
        constraints = (
            *(
                models.UniqueConstraint(
                    fields=[field], condition=models.Q(state__in=("queued", "running")), name=f"one_open_job_a_{field}"
                )
                for field in ("visit", "calibration", "check_of_day", "comparison", "delivery")
            ),
            models.UniqueConstraint(
                fields=["kind"],
                condition=models.Q(state__in=("queued", "running"), kind__in=("backup", "restore")),
                name="one_open_job_a_kind",
            ),
        )

    def __str__(self) -> str:
        return f"{self.kind} {self.id}"


class Measurement(Keyed):
    """Results of one visit, from one job."""

    visit = models.ForeignKey(Visit, on_delete=models.CASCADE, related_name="measurements")
    job = models.ForeignKey(Job, null=True, on_delete=models.SET_NULL, related_name="measurements")
    digest = models.CharField(max_length=64)
    made_at = models.DateTimeField()
    software = models.CharField(max_length=40)
    """Version of mammometry."""
    curves = models.JSONField(default=dict)
    """Breast → digest of the measured boundary (`measure.volume.attribution.curve_digest`)."""
    how = models.JSONField(default=dict, blank=True)
    """Data for `records.comparability`: settings, and for each breast the wall and the origin of its boundary."""
    quantities = models.JSONField(default=list)
    """All measured numbers, with the names of `hospital.exported.Quantity`."""

    class Meta:
        ordering = ("-made_at",)

    def __str__(self) -> str:
        return f"{self.visit}, {self.digest[:12]}"


class Volume(Keyed):
    """One volume of a measurement, or the reason for having none."""

    class Side(models.TextChoices):
        """The patient's own sides."""

        LEFT = "left"
        RIGHT = "right"
        DIFFERENCE = "difference"
        MODEL = "model"

    measurement = models.ForeignKey(Measurement, on_delete=models.CASCADE, related_name="volumes")
    side = models.CharField(max_length=10, choices=Side.choices)
    definition = models.CharField(max_length=60)
    """Definition of the breast."""
    volume_cc = models.FloatField(null=True)
    low_cc = models.FloatField(null=True)
    """Lower end of the 95 % interval, cc."""
    high_cc = models.FloatField(null=True)
    """Upper end of the 95 % interval, cc."""
    refused = models.CharField(max_length=1500, blank=True)
    """Reason for having no volume; empty: there is one."""
    leads = models.BooleanField(default=False)
    """Whether the page of the visit shows this definition first for its side (`clinic.records.results.add_volumes`)."""

    class Meta:
        ordering = ("definition", "side")
        constraints = (models.UniqueConstraint(fields=("measurement", "side", "definition"), name="one_volume_each"),)
        indexes = (
            models.Index(
                fields=("measurement", "side", "definition", "volume_cc"),
                condition=models.Q(leads=True),
                name="leading_volumes",
            ),
        )

    def __str__(self) -> str:
        return f"{self.side}, {self.definition}"


class Drawing(Keyed):
    """Who drew, changed or confirmed a boundary or landmark. The curve itself is in the session folder."""

    class Action(models.TextChoices):
        """Kind of change to a boundary or landmark."""

        DRAWN = "drawn"
        CONFIRMED = "confirmed"
        REMOVED = "removed"

    visit = models.ForeignKey(Visit, on_delete=models.CASCADE, related_name="drawings")
    item = models.CharField(max_length=60)
    """Name of the boundary or landmark."""
    action = models.CharField(max_length=10, choices=Action.choices)
    by = models.ForeignKey(settings.AUTH_USER_MODEL, null=True, on_delete=models.PROTECT, related_name="+")
    at = models.DateTimeField(auto_now_add=True)
    digest = models.CharField(max_length=64, blank=True)
    """Digest of the file at that time."""

    class Meta:
        ordering = ("-at",)

    def __str__(self) -> str:
        return f"{self.item} {self.action}"


class Confirmation(Keyed):
    """Confirmation of a measured result after a visual check. It does not change numbers."""

    measurement = models.ForeignKey(Measurement, on_delete=models.CASCADE, related_name="confirmations")
    curves = models.JSONField(default=dict)
    """Breast → digest of the checked boundary."""
    at = models.DateTimeField(auto_now_add=True)
    by = models.ForeignKey(settings.AUTH_USER_MODEL, null=True, on_delete=models.PROTECT, related_name="+")

    class Meta:
        ordering = ("-at",)

    def __str__(self) -> str:
        return f"{self.measurement} confirmed"


class Conclusion(Keyed):
    """Signed conclusion of a clinician on a visit. Later ones amend it and overwrite nothing."""

    visit = models.ForeignKey(Visit, on_delete=models.CASCADE, related_name="conclusions")
    measurement = models.ForeignKey(Measurement, null=True, on_delete=models.SET_NULL, related_name="conclusions")
    """The result that it is about."""
    text = models.TextField(max_length=4000)
    at = models.DateTimeField(auto_now_add=True)
    by = models.ForeignKey(settings.AUTH_USER_MODEL, null=True, on_delete=models.PROTECT, related_name="+")

    class Meta:
        ordering = ("-at",)

    def __str__(self) -> str:
        return f"conclusion of {self.visit}"


class Correction(Keyed):
    """One correction of a record, with its reason. It can be undone for 30 days."""

    class Kind(models.TextChoices):
        """Kind of a correction."""

        MOVED = "moved", "Visit moved to another patient"
        DATED = "dated", "Date of a visit corrected"
        MERGED = "merged", "Two records of one patient merged"
        BINNED = "binned", "Put into the bin"

    kind = models.CharField(max_length=8, choices=Kind.choices)
    visit = models.ForeignKey(Visit, null=True, on_delete=models.CASCADE, related_name="corrections")
    patient = models.ForeignKey(Patient, null=True, on_delete=models.CASCADE, related_name="corrections")
    """The patient who was merged or put into the bin, or whose visit was moved."""
    before = models.JSONField(default=dict)
    """The previous values, with patients by their keys. They are not in the audit, because notes may contain names."""
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


class Destination(Keyed):
    """An archive that results are sent to."""

    class Kind(models.TextChoices):
        """Protocol of a destination."""

        DICOM = "dicom", "DICOM (C-STORE)"
        STOW = "stow", "DICOMweb (STOW-RS)"
        WORKLIST = "worklist", "Worklist (C-FIND)"

    name = models.CharField(max_length=100, unique=True)
    kind = models.CharField(max_length=8, choices=Kind.choices, default=Kind.DICOM)
    address = models.CharField(max_length=200)
    """``AE@host:port``, or a web address."""
    own_title = models.CharField(max_length=16, default="MAMMOMETRY")
    encrypted = models.BooleanField(default=False)
    authorities = models.CharField(max_length=300, blank=True)
    """File with the certificates that the archive's must be signed by. Empty: those that the system trusts."""
    certificate = models.CharField(max_length=300, blank=True, default="")
    """File with our own certificate, if the archive requires one."""
    key = models.CharField(max_length=300, blank=True, default="")
    """File with its key. Empty: in the certificate's file."""
    commitment = models.BooleanField(default=False)
    """Whether to wait for the archive's storage commitment."""
    promise_port = models.PositiveIntegerField(null=True, blank=True)
    """Port on which the storage commitment is received. None: on the same connection."""
    active = models.BooleanField(default=True)

    class Meta:
        ordering = ("name",)

    def __str__(self) -> str:
        return self.name


class VisitOrder(Keyed):
    """A visit's order from the worklist."""

    visit = models.OneToOneField(Visit, on_delete=models.CASCADE, related_name="order")
    accession = models.CharField(max_length=64, blank=True)
    study_uid = models.CharField(max_length=64, blank=True)
    referring = models.CharField(max_length=200, blank=True)
    procedure_id = models.CharField(max_length=64, blank=True)
    procedure = models.CharField(max_length=200, blank=True)

    def __str__(self) -> str:
        return f"order of {self.visit}"


class Delivery(Keyed):
    """Delivery of one visit's results to an archive."""

    class State(models.TextChoices):
        """State of its progress."""

        QUEUED = "queued"
        SENT = "sent"
        FAILED = "failed"

    visit = models.ForeignKey(Visit, on_delete=models.CASCADE, related_name="deliveries")
    destination = models.ForeignKey(Destination, on_delete=models.PROTECT, related_name="deliveries")
    state = models.CharField(max_length=8, choices=State.choices, default=State.QUEUED, db_index=True)
    message = models.CharField(max_length=1500, blank=True)
    """Message of the last attempt, without a patient's name."""
    sent = models.PositiveIntegerField(default=0)
    """Number of sent objects, over all attempts."""
    kept = models.BooleanField(null=True)
    """Whether the archive committed to store all objects. None: not requested, or no answer."""
    created = models.DateTimeField(auto_now_add=True)
    ended = models.DateTimeField(null=True)
    created_by = models.ForeignKey(settings.AUTH_USER_MODEL, null=True, on_delete=models.PROTECT, related_name="+")

    class Meta:
        ordering = ("-created",)

    def __str__(self) -> str:
        return f"{self.visit.patient.pseudonym} to {self.destination}"

    @property
    def job(self) -> Job | None:
        """The newest job that sends it."""
        return max(self.jobs.all(), key=lambda job: job.created, default=None)
