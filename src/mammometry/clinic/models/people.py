"""People who work in the clinic."""

from __future__ import annotations

import uuid
from typing import Any

from django.contrib.auth.models import AbstractUser
from django.core.exceptions import ValidationError
from django.db import models
from django.http import HttpRequest

from mammometry.clinic.roles import Role
from mammometry.clinic.site import the_clinic


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
