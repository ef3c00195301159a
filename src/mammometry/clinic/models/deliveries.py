"""Where results are sent to, and what is on its way there.

A row is the truth; whoever sends holds it on a lease.
"""

from __future__ import annotations

from django.conf import settings
from django.db import models

from mammometry.clinic.models.keyed import Keyed
from mammometry.clinic.models.visits import Visit


class Destination(Keyed):
    """An archive."""

    class Kind(models.TextChoices):
        """How it is spoken to."""

        DICOM = "dicom", "DICOM (C-STORE)"
        STOW = "stow", "DICOMweb (STOW-RS)"
        WORKLIST = "worklist", "Worklist (C-FIND)"

    name = models.CharField(max_length=100, unique=True)
    kind = models.CharField(max_length=8, choices=Kind.choices, default=Kind.DICOM)
    address = models.CharField(max_length=200)
    """``AE@host:port``, or an address of the web."""
    own_title = models.CharField(max_length=16, default="MAMMOMETRY")
    encrypted = models.BooleanField(default=False)
    authorities = models.CharField(max_length=300, blank=True)
    """File with the certificates that the archive's is signed by. Empty: those that the system trusts."""
    certificate = models.CharField(max_length=300, blank=True, default="")
    """File with our own certificate, where the archive asks for one."""
    key = models.CharField(max_length=300, blank=True, default="")
    """File with its key. Empty: in the certificate's file."""
    commitment = models.BooleanField(default=False)
    """Whether its promise to keep what was sent is awaited."""
    promise_port = models.PositiveIntegerField(null=True, blank=True)
    """Where it sends that promise. None: on the connection that asked."""
    active = models.BooleanField(default=True)

    class Meta:
        ordering = ("name",)

    def __str__(self) -> str:
        return self.name


class VisitOrder(Keyed):
    """What was ordered for a visit, as the worklist said."""

    visit = models.OneToOneField(Visit, on_delete=models.CASCADE, related_name="order")
    accession = models.CharField(max_length=64, blank=True)
    study_uid = models.CharField(max_length=64, blank=True)
    referring = models.CharField(max_length=200, blank=True)
    procedure_id = models.CharField(max_length=64, blank=True)
    procedure = models.CharField(max_length=200, blank=True)

    def __str__(self) -> str:
        return f"order of {self.visit}"


class Delivery(Keyed):
    """One visit's results on their way to an archive."""

    class State(models.TextChoices):
        """How far it is."""

        QUEUED = "queued"
        SENDING = "sending"
        SENT = "sent"
        FAILED = "failed"

    visit = models.ForeignKey(Visit, on_delete=models.CASCADE, related_name="deliveries")
    destination = models.ForeignKey(Destination, on_delete=models.PROTECT, related_name="deliveries")
    state = models.CharField(max_length=8, choices=State.choices, default=State.QUEUED, db_index=True)
    tries = models.PositiveIntegerField(default=0)
    next_try = models.DateTimeField()
    """When it is tried, at the earliest. While it is being sent: until when nobody else tries."""
    message = models.CharField(max_length=1500, blank=True)
    """What the last try said, without a patient's name."""
    sent = models.PositiveIntegerField(default=0)
    """Objects that were sent, of all tries."""
    kept = models.BooleanField(null=True)
    """Whether the archive promised to keep them all. None: it was not asked, or gave no answer."""
    created = models.DateTimeField(auto_now_add=True)
    ended = models.DateTimeField(null=True)
    created_by = models.ForeignKey(settings.AUTH_USER_MODEL, null=True, on_delete=models.PROTECT, related_name="+")

    class Meta:
        ordering = ("-created",)

    def __str__(self) -> str:
        return f"{self.visit.patient.pseudonym} to {self.destination}"
