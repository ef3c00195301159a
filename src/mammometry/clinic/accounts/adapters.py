"""What allauth asks us. Nobody signs up alone. Codes are kept encrypted."""

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

_MESSAGES = {
    "account/messages/password_changed.txt": "Your password is changed. Log in with the new one.",
    "mfa/messages/recovery_codes_generated.txt": "New codes are made. The old ones do not work any more.",
    "mfa/messages/totp_activated.txt": "The second factor is set up.",
    "mfa/messages/totp_deactivated.txt": "The second factor is removed.",
}
"""Template of allauth's message → our sentence. All other messages are left out: the page itself says it."""
FRESH_S = 600
"""How long after a login the password is not asked again, s."""


class Accounts(DefaultAccountAdapter):
    """Accounts are made by an administrator."""

    error_messages = {  # noqa: RUF012
        **DefaultAccountAdapter.error_messages,
        "username_password_mismatch": "The name or the password is wrong.",
        "incorrect_password": "The password is wrong.",
        "enter_current_password": "This is not your password now.",
        "too_many_login_attempts": "Too many tries. Wait a minute, then try again.",
        "rate_limited": "Too many tries. Wait a minute, then try again.",
    }

    def is_open_for_signup(self, request: HttpRequest) -> bool:
        """No."""
        return False

    def add_message(
        self, request: HttpRequest, level: int, message_template: str | None = None, *args: Any, **kwargs: Any
    ) -> None:
        """Show our sentence in place of allauth's."""
        sentence = _MESSAGES.get(message_template or "")
        if sentence is not None:
            super().add_message(request, level, message=sentence)

    def is_reauthentication_required(self, *, app: str, **kwargs: Any) -> bool:
        """Whether the password is asked again. Not for a first second factor, just after the login."""
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
    """Secrets of authenticators are kept encrypted. A copy of the database alone opens nothing."""

    error_messages = {  # noqa: RUF012
        **DefaultMFAAdapter.error_messages,
        "incorrect_code": "The code is wrong. It changes every 30 seconds: enter the one that is shown now.",
        "cannot_delete_authenticator": "The second factor cannot be removed: this clinic requires it.",
    }

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
