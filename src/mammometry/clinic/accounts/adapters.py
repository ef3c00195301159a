"""What allauth asks us.

Nobody signs up alone. Codes are kept encrypted.
"""

from __future__ import annotations

import base64
import hashlib
import time
from typing import Any

from allauth.account.adapter import DefaultAccountAdapter
from allauth.core import context
from allauth.mfa.adapter import DefaultMFAAdapter
from allauth.socialaccount.adapter import DefaultSocialAccountAdapter
from cryptography.fernet import Fernet
from django.conf import settings
from django.http import HttpRequest

FRESH_S = 600
"""How long after a login the password is not asked again, s."""


class Accounts(DefaultAccountAdapter):
    """Accounts are made by an administrator."""

    def is_open_for_signup(self, request: HttpRequest) -> bool:
        """No."""
        return False

    def is_reauthentication_required(self, *, app: str, **kwargs: Any) -> bool:
        """Whether the password is asked again.

        Not for a first second factor, just after the login.
        """
        from allauth.account.authentication import get_authentication_records

        request = context.request
        records = get_authentication_records(request, request.user)
        fresh = bool(records) and time.time() - records[-1]["at"] < FRESH_S
        if app == "allauth.mfa" and fresh and request.user.lacks_second_factor(request):
            return False
        return bool(super().is_reauthentication_required(app=app, **kwargs))


class HospitalLogin(DefaultSocialAccountAdapter):
    """Logins by the hospital.

    It lets in whom an administrator has entered with the same, verified e-mail address.
    """

    def is_open_for_signup(self, request: HttpRequest, sociallogin: Any) -> bool:
        """No."""
        return False


class SecondFactor(DefaultMFAAdapter):
    """Secrets of authenticators are kept encrypted.

    A copy of the database alone opens nothing.
    """

    def encrypt(self, text: str) -> str:
        """Under a key made of the clinic's."""
        return _cipher().encrypt(text.encode()).decode()

    def decrypt(self, encrypted_text: str) -> str:
        """The text that `encrypt` was given."""
        return _cipher().decrypt(encrypted_text.encode()).decode()


def _cipher() -> Fernet:
    digest = hashlib.sha256(b"second factor\0" + str(settings.SECRET_KEY).encode()).digest()
    return Fernet(base64.urlsafe_b64encode(digest))


def tried_name(request: HttpRequest | None, credentials: dict[str, Any] | None = None) -> str | None:
    """The name of a failed login, however it was given."""
    for source in (credentials or {}, getattr(request, "POST", {})):
        for key in ("username", "login"):
            if source.get(key):
                return str(source[key])[:150]
    return None
