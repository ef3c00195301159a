"""Accounts: added by an administrator, with passwords, second factor, or the hospital's own login."""

import base64
import hashlib
import time
from collections.abc import Sequence
from typing import Any, ClassVar

from allauth.account import forms as account
from allauth.account.adapter import DefaultAccountAdapter
from allauth.core import context
from allauth.mfa.adapter import DefaultMFAAdapter
from allauth.mfa.base import forms as mfa
from allauth.mfa.totp import forms as totp
from cryptography.fernet import Fernet
from django import forms
from django.conf import settings
from django.core.exceptions import ValidationError
from django.http import HttpRequest
from django.urls import reverse

from mammometry.clinic.audit import record_wrong_code
from mammometry.clinic.config import ClinicError
from mammometry.clinic.models import Person
from mammometry.clinic.roles import Role
from mammometry.hospital.codes import require_text
from mammometry.hospital.exported import person_name


def add_person(username: str, roles: Sequence[Role], *, full_name: str = "", email: str = "") -> Person:
    """Add a person, who can log in after setting a password.

    Raises:
        ClinicError: the name is taken or invalid.
    """
    require_text(person_name(full_name), "PN", "the full name", refusal=ClinicError)
    person = Person(username=username, roles=[role.value for role in roles], full_name=full_name, email=email)
    person.set_unusable_password()
    try:
        person.full_clean()
    except ValidationError as error:
        remedy = "Choose another name, or change this person in the clinic's administration"
        found = " ".join(error.messages)
        expected = "a new name of letters, digits and @ . + - _"
        raise ClinicError("people add", found=found, expected=expected, remedy=remedy) from None
    person.save()
    return person


def invitation(person: Person) -> str:
    """Path of the page for setting this person's password. It works once, for three days."""
    from allauth.account.forms import default_token_generator
    from allauth.account.utils import user_pk_to_url_str

    key = default_token_generator.make_token(person)
    return reverse("account_reset_password_from_key", kwargs={"uidb36": user_pk_to_url_str(person), "key": key})


def find_person(username: str) -> Person:
    """The person with a login name.

    Raises:
        ClinicError: there is none.
    """
    person = Person.objects.filter(username=username).first()
    if person is None:
        remedy = "See `mammometry clinic people list`"
        raise ClinicError(username, found="no person of that name", expected="a person who may log in", remedy=remedy)
    return person


_NEW_CODES = "mfa/messages/recovery_codes_generated.txt"
_MESSAGES = {
    "account/messages/password_changed.txt": "Your password is changed. Log in with the new one.",
    _NEW_CODES: "There are new codes. The old ones no longer work.",
    "mfa/messages/totp_activated.txt": "The second factor is set up.",
    "mfa/messages/totp_deactivated.txt": "The second factor is removed.",
}
"""Template of allauth's message → our sentence. Other messages are not shown, because the page shows the result."""
FRESH_S = 600
"""Time after a login without asking for the password again, s."""


class Accounts(DefaultAccountAdapter):
    """Accounts are created by administrators only."""

    error_messages = {  # noqa: RUF012
        **DefaultAccountAdapter.error_messages,
        "username_password_mismatch": "The name or the password is wrong.",
        "incorrect_password": "The password is wrong.",
        "enter_current_password": "This is not your current password.",
        "too_many_login_attempts": "Too many attempts. Wait a minute, then try again.",
        "rate_limited": "Too many attempts. Wait a minute, then try again.",
    }

    def is_open_for_signup(self, request: HttpRequest) -> bool:
        """Refuse: accounts are created by administrators."""
        return False

    def add_message(
        self, request: HttpRequest, level: int, message_template: str | None = None, *args: Any, **kwargs: Any
    ) -> None:
        """Show our sentence instead of allauth's.

        No message is shown for the first recovery codes: they are created with the factor and replace none.
        """
        sentence = _MESSAGES.get(message_template or "")
        first = message_template == _NEW_CODES and request.path != reverse("mfa_generate_recovery_codes")
        if sentence is not None and not first:
            super().add_message(request, level, message=sentence)

    def is_reauthentication_required(self, *, app: str, **kwargs: Any) -> bool:
        """Whether the password is asked for again. Not when the first second factor is set up after a login."""
        from allauth.account.authentication import get_authentication_records

        request = context.request
        records = get_authentication_records(request, request.user)
        fresh = bool(records) and time.time() - records[-1]["at"] < FRESH_S
        if app == "allauth.mfa" and fresh and request.user.lacks_second_factor(request):
            return False
        return bool(super().is_reauthentication_required(app=app, **kwargs))


class SecondFactor(DefaultMFAAdapter):
    """Stores authenticators' secrets encrypted, so that a copy of the database does not reveal them."""

    error_messages = {  # noqa: RUF012
        **DefaultMFAAdapter.error_messages,
        "incorrect_code": "The code is wrong. It changes every 30 seconds: enter the current one.",
        "cannot_delete_authenticator": "The second factor cannot be removed: this clinic requires it.",
    }

    def encrypt(self, text: str) -> str:
        """Encrypt with a key derived from the clinic's secret key."""
        return _cipher().encrypt(text.encode()).decode()

    def decrypt(self, encrypted_text: str) -> str:
        """Decrypt a text of `encrypt`."""
        return _cipher().decrypt(encrypted_text.encode()).decode()


def _cipher() -> Fernet:
    digest = hashlib.sha256(b"second factor\0" + str(settings.SECRET_KEY).encode()).digest()
    return Fernet(base64.urlsafe_b64encode(digest))


_PASSWORD = "At least 12 characters. A few words in a row are good. Your name and common passwords are refused."
_AGAIN = ("The same again", "")
_CODE = "Six digits from the app on your telephone. A code for a lost telephone also works."


class _Labelled:
    """A form of allauth whose fields have our labels and hints."""

    words: ClassVar[dict[str, tuple[str, str]]] = {}

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        for name, (label, hint) in self.words.items():
            field = self.fields[name]  # type: ignore[attr-defined]
            field.label, field.help_text = label, hint
            field.widget.attrs.pop("placeholder", None)  # it would repeat the label


class LoginForm(_Labelled, account.LoginForm):
    """Login with name and password."""

    words: ClassVar = {"login": ("Name", ""), "password": ("Password", "")}


class FirstPasswordForm(_Labelled, account.ResetPasswordKeyForm):
    """A new password, set through a link."""

    words: ClassVar = {"password1": ("New password", _PASSWORD), "password2": _AGAIN}


class ChangePasswordForm(_Labelled, account.ChangePasswordForm):
    """The current password and a new one."""

    words: ClassVar = {"oldpassword": ("Password now", ""), **FirstPasswordForm.words}


class PasswordAgainForm(_Labelled, account.ReauthenticateForm):
    """The password, asked again before a sensitive action."""

    words: ClassVar = {"password": ("Password", "")}


class CodeForm(_Labelled, mfa.AuthenticateForm):
    """The second factor's code at login."""

    words: ClassVar = {"code": ("Code", _CODE)}

    def clean_code(self) -> Any:
        """Record a wrong code in the audit, and refuse it."""
        try:
            return super().clean_code()
        except forms.ValidationError:
            record_wrong_code(self.user, context.request)
            raise


class CodeAgainForm(_Labelled, mfa.ReauthenticateForm):
    """The second factor's code, asked again before a sensitive action."""

    words: ClassVar = CodeForm.words


class SetUpForm(_Labelled, totp.ActivateTOTPForm):
    """The first code of a new authenticator."""

    words: ClassVar = {"code": ("Code", "Six digits from the app.")}
