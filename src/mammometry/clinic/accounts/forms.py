"""The account's forms in the clinic's words."""

from __future__ import annotations

from typing import Any

from allauth.account import forms as account
from allauth.core import context
from allauth.mfa.base import forms as mfa
from allauth.mfa.totp import forms as totp
from django import forms

from mammometry.clinic.audit import record_wrong_code

_PASSWORD = "At least 12 characters. A few words in a row are good; your name or a common password is refused."
_CODE = "Six digits, as the application on your telephone shows them now. A code for a lost telephone works, too."


def _write_labels(form: forms.Form, **labels: tuple[str, str]) -> None:
    """Give each named field its label and hint."""
    for name, (label, hint) in labels.items():
        field = form.fields[name]
        field.label, field.help_text = label, hint
        field.widget.attrs.pop("placeholder", None)  # it would say the label again


class LoginForm(account.LoginForm):
    """Name and password."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        _write_labels(self, login=("Name", ""), password=("Password", ""))


class FirstPasswordForm(account.ResetPasswordKeyForm):
    """A new password, through a link."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        _write_labels(self, password1=("New password", _PASSWORD), password2=("The same again", ""))


class ChangePasswordForm(account.ChangePasswordForm):
    """The password now, and the new one."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        _write_labels(
            self, oldpassword=("Password now", ""), password1=("New password", _PASSWORD),
            password2=("The same again", ""),
        )  # fmt: skip


class PasswordAgainForm(account.ReauthenticateForm):
    """The password, before something that needs it."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        _write_labels(self, password=("Password", ""))


class CodeForm(mfa.AuthenticateForm):
    """The second factor's code, at the login."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        _write_labels(self, code=("Code", _CODE))

    def clean_code(self) -> Any:
        """Enter a wrong code into the audit, and refuse it."""
        try:
            return super().clean_code()
        except forms.ValidationError:
            record_wrong_code(self.user, context.request)
            raise


class CodeAgainForm(mfa.ReauthenticateForm):
    """The second factor's code, before something that needs it."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        _write_labels(self, code=("Code", _CODE))


class SetUpForm(totp.ActivateTOTPForm):
    """The first code of a new authenticator."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        _write_labels(self, code=("Code", "Six digits, as the application shows them now."))
