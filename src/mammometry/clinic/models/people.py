"""Tables of people, rigs, calibrations and daily checks."""

import uuid
from typing import Any, ClassVar, TypeVar

from django.conf import settings
from django.contrib.auth.models import AbstractUser
from django.core.exceptions import ValidationError
from django.db import models
from django.http import HttpRequest

from mammometry.clinic.rig_results import CalibrationResult, CheckResult
from mammometry.clinic.roles import Role
from mammometry.clinic.site import the_clinic

Row = TypeVar("Row", bound=models.Model)


class Keyed(models.Model):
    """A row with a random key."""

    id = models.UUIDField(primary_key=True, default=uuid.uuid4, editable=False)

    class Meta:
        abstract: ClassVar[bool] = True


class InUse(models.Manager[Row]):
    """Rows that are not in the bin.

    This is the default, so that pages do not show the bin. Backup, export, erasure and corrections use ``everything``.
    """

    def get_queryset(self) -> models.QuerySet[Row]:
        """Rows that are not in the bin."""
        return super().get_queryset().filter(binned_at=None)


def require_roles(value: Any) -> None:
    """Require a list of roles without duplicates."""
    known = {role.value for role in Role}
    if not isinstance(value, list) or not set(value) <= known or len(set(value)) != len(value):
        raise ValidationError("Roles are some of " + ", ".join(sorted(known)) + ".")


class Person(AbstractUser):
    """A person who logs in. People are never deleted, because the audit refers to them, but made inactive."""

    id = models.UUIDField(primary_key=True, default=uuid.uuid4, editable=False)
    full_name = models.CharField(max_length=200, blank=True)
    roles = models.JSONField(default=list, validators=[require_roles], blank=True)
    """Values of `Role`."""

    class Meta:
        ordering = ("username",)
        verbose_name_plural = "people"

    def __str__(self) -> str:
        return self.full_name or self.username

    def get_full_name(self) -> str:
        """The name shown on pages."""
        return str(self)

    def has_role(self, *roles: Role) -> bool:
        """Whether this person has one of the roles."""
        return not set(self.roles).isdisjoint(roles)

    @property
    def waits_for_password(self) -> bool:
        """Whether this person has not set a password yet and has never logged in otherwise."""
        return not self.has_usable_password() and self.last_login is None

    def lacks_second_factor(self, request: HttpRequest) -> bool:
        """Whether a required second factor is missing, here or at the hospital's own login."""
        from allauth.account.authentication import get_authentication_records
        from allauth.mfa.models import Authenticator

        if the_clinic().people.second_factor != "required":
            return False
        if any(record.get("method") == "socialaccount" for record in get_authentication_records(request, self)):
            return False
        return not Authenticator.objects.filter(user=self, type=Authenticator.Type.TOTP).exists()


class Rig(Keyed):
    """Cameras that are used together."""

    name = models.CharField(max_length=100, unique=True)
    note = models.TextField(max_length=2000, blank=True)
    created = models.DateTimeField(auto_now_add=True)
    definition = models.JSONField(default=dict)
    """The tables rig, target and intrinsics of session.toml."""
    active = models.BooleanField(default=True)

    class Meta:
        ordering = ("name",)

    def __str__(self) -> str:
        return self.name


class Calibration(Keyed):
    """One calibration of a rig."""

    class State(models.TextChoices):
        """State of a calibration."""

        UPLOADING = "uploading"
        QUEUED = "queued"
        RUNNING = "running"
        DONE = "done"
        FAILED = "failed"

    rig = models.ForeignKey(Rig, on_delete=models.PROTECT, related_name="calibrations")
    taken_at = models.DateTimeField()
    folder = models.CharField(max_length=200)
    """Folder of its photographs, relative to the clinic's folder."""
    state = models.CharField(max_length=12, choices=State.choices, default=State.UPLOADING)
    figures = models.JSONField(default=dict, blank=True)
    """Figures, with units in the names: rms_px, worst_pair_mm, …"""
    verdict = models.CharField(max_length=500, blank=True)
    """One sentence: the calibration may be used, or why not."""
    current = models.BooleanField(default=False)
    """Whether it is used for new visits."""
    created_by = models.ForeignKey(settings.AUTH_USER_MODEL, null=True, on_delete=models.PROTECT, related_name="+")

    class Meta:
        ordering = ("-taken_at",)
        constraints = (
            models.UniqueConstraint(fields=("rig",), condition=models.Q(current=True), name="one_current_calibration"),
        )

    def __str__(self) -> str:
        return f"{self.rig}, {self.taken_at:%Y-%m-%d}"

    @property
    def result(self) -> CalibrationResult:
        """The calibration's result. It has no verdict before the calibration has finished."""
        return CalibrationResult.from_table(self.figures)


class DailyCheck(Keyed):
    """Photographs of a board, one per camera, to check whether a camera has moved."""

    rig = models.ForeignKey(Rig, on_delete=models.PROTECT, related_name="checks")
    calibration = models.ForeignKey(Calibration, null=True, on_delete=models.PROTECT, related_name="checks")
    taken_at = models.DateTimeField()
    folder = models.CharField(max_length=200, blank=True)
    """Folder of its photographs, relative to the clinic's folder."""
    figures = models.JSONField(default=dict, blank=True)
    """Drift of each camera, mm and px."""
    verdict = models.CharField(max_length=500, blank=True)
    """One sentence: whether the rig may be used today."""
    passed = models.BooleanField(null=True)
    """None: not evaluated yet."""
    by = models.ForeignKey(settings.AUTH_USER_MODEL, null=True, on_delete=models.PROTECT, related_name="+")

    class Meta:
        ordering = ("-taken_at",)

    def __str__(self) -> str:
        return f"{self.rig}, {self.taken_at:%Y-%m-%d}"

    @property
    def result(self) -> CheckResult | None:
        """The check's result. None: not evaluated yet."""
        return CheckResult.from_table(self.figures) if self.figures else None


class AuditLink(models.Model):
    """One entry of the audit in the chain of digests (`clinic.audit_chain`). It is never changed."""

    place = models.BigIntegerField(primary_key=True)
    """Position in the chain, from 1."""
    entry = models.BigIntegerField(unique=True)
    """Key of the audit's entry. Not a foreign key, so that removing an entry changes nothing here."""
    digest = models.CharField(max_length=64)
    """SHA-256 of the previous digest and the entry."""

    class Meta:
        ordering = ("place",)

    def __str__(self) -> str:
        return f"link {self.place}"


class FormToken(models.Model):
    """The token of a submitted form, and its answer (`web.once`)."""

    person = models.ForeignKey(Person, on_delete=models.CASCADE, related_name="+")
    token = models.UUIDField()
    at = models.DateTimeField(auto_now_add=True, db_index=True)
    answer = models.JSONField(default=dict)
    """Address to which the form redirects, or status and JSON. Empty: not answered yet."""

    class Meta:
        constraints = (models.UniqueConstraint(fields=("person", "token"), name="one_form_a_token"),)

    def __str__(self) -> str:
        return f"form {self.token}"
