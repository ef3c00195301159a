"""Tables of what a clinic has before its first patient: people, rigs, calibrations and daily checks."""

import uuid
from typing import Any, ClassVar, TypeVar

from django.conf import settings
from django.contrib.auth.models import AbstractUser
from django.core.exceptions import ValidationError
from django.db import models
from django.http import HttpRequest

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

    It is the default, so that no page shows what is in the bin. Backup, export, erasure and corrections take
    ``everything``.
    """

    def get_queryset(self) -> models.QuerySet[Row]:
        """Rows that are not in the bin."""
        return super().get_queryset().filter(binned_at=None)


def require_roles(value: Any) -> None:
    """Refuse what is no list of different roles."""
    known = {role.value for role in Role}
    if not isinstance(value, list) or not set(value) <= known or len(set(value)) != len(value):
        raise ValidationError("Roles are some of " + ", ".join(sorted(known)) + ".")


class Person(AbstractUser):
    """Somebody who logs in. Never deleted, since the audit names them: set inactive instead."""

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
        """The name as pages say it."""
        return str(self)

    def has_role(self, *roles: Role) -> bool:
        """Whether this person has one of the roles."""
        return not set(self.roles).isdisjoint(roles)

    @property
    def waits_for_password(self) -> bool:
        """Whether this person has not used the link that sets a password, and never came in otherwise."""
        return not self.has_usable_password() and self.last_login is None

    def lacks_second_factor(self, request: HttpRequest) -> bool:
        """Whether a second factor is required and missing.

        It may be set up here or at the hospital's own login.
        """
        from allauth.account.authentication import get_authentication_records
        from allauth.mfa.models import Authenticator

        if the_clinic().people.second_factor != "required":
            return False
        if any(record.get("method") == "socialaccount" for record in get_authentication_records(request, self)):
            return False
        return not Authenticator.objects.filter(user=self, type=Authenticator.Type.TOTP).exists()


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


class AuditLink(models.Model):
    """One entry of the audit in the chain of digests (`clinic.audit_chain`). It is never changed."""

    place = models.BigIntegerField(primary_key=True)
    """1 for the first."""
    entry = models.BigIntegerField(unique=True)
    """Key of the audit's entry. No foreign key: nothing may be done here when an entry goes."""
    digest = models.CharField(max_length=64)
    """SHA-256 of the digest before and the entry."""

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
    """Address that the form led to, or status and JSON. Empty: the answer is being made."""

    class Meta:
        constraints = (models.UniqueConstraint(fields=("person", "token"), name="one_form_a_token"),)

    def __str__(self) -> str:
        return f"form {self.token}"
