"""The account's pages are ours, in look and words, whatever somebody does."""

import datetime
import html
import re
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import allauth
import pytest
from allauth.account.adapter import DefaultAccountAdapter
from auditlog.models import LogEntry
from django.contrib import messages
from django.template import TemplateDoesNotExist
from django.template.loader import get_template
from django.test import Client, RequestFactory
from django.urls import URLPattern, get_resolver, reverse
from pytest_django import Settings
from test_clinic_login import PASSWORD, anna, code, login  # noqa: F401

from mammometry.clinic import audit
from mammometry.clinic.accounts import Accounts, add_person, invitation
from mammometry.clinic.models import Person
from mammometry.clinic.roles import Role

OURS = Path(audit.__file__).parent
FRAMEWORK_WORDS = ("Sign In", "Sign Out", "Bad Token", "Change Password", "Two-Factor", "Authenticator App", "Reauth")


def words_of(client: Client, path: str) -> str:
    answer = client.get(path, follow=True)
    assert answer.status_code in (200, 401, 403), path
    page = html.unescape(answer.content.decode())
    assert "clinic/clinic.css" in page, path
    for words in FRAMEWORK_WORDS:
        assert words.lower() not in page.lower(), (path, words)
    return page


def test_every_template_that_a_mounted_page_names_is_ours() -> None:
    seen = 0
    for pattern in get_resolver().url_patterns:
        assert isinstance(pattern, URLPattern)
        view_class = getattr(pattern.callback, "view_class", None)
        if view_class is None or not view_class.__module__.startswith("allauth"):
            continue
        name = getattr(view_class, "template_name", None)
        if name is None or name.endswith(".txt") or pattern.name == "socialaccount_signup":  # closed: see below
            continue
        seen += 1
        assert Path(get_template(name).origin.name).is_relative_to(OURS), (pattern.name, name)
    assert seen >= 14
    for name in ("account/signup_closed.html", "429.html", "socialaccount/authentication_error.html"):
        assert Path(get_template(name).origin.name).is_relative_to(OURS)


def test_no_page_of_ours_includes_one_of_the_framework() -> None:
    """What our templates extend and include is ours, too."""
    folder = Path(allauth.__file__).parent / "templates"
    for path in (OURS / "templates").rglob("*.html"):
        for name in re.findall(r"{% (?:extends|include) \"([^\"]+)\"", path.read_text(encoding="utf-8")):
            try:
                assert not Path(get_template(name).origin.name).is_relative_to(folder), (path.name, name)
            except TemplateDoesNotExist as error:  # pragma: no cover
                raise AssertionError(path) from error


def test_pages_without_a_login(clinic: object, client: Client) -> None:
    for name in (
        "account_login", "account_inactive", "account_reset_password_from_key_done", "socialaccount_login_error",
        "socialaccount_login_cancelled", "mfa_authenticate", "socialaccount_signup", "account_logout",
    ):  # fmt: skip
        words_of(client, reverse(name))


def test_a_whole_account(anna: Person, client: Client) -> None:  # noqa: F811
    """Password, second factor, its codes, and their removal."""
    assert login(client) == 302
    assert 'method="post"' in words_of(client, reverse("account_logout"))
    assert 'name="oldpassword"' in words_of(client, reverse("account_change_password"))
    assert reverse("mfa_activate_totp") in words_of(client, reverse("mfa_index"))
    words_of(client, reverse("account_reauthenticate"))
    page = client.get(reverse("mfa_activate_totp"), follow=True)
    assert set(page.context["form"].fields) == {"password"}
    client.post(page.redirect_chain[-1][0], {"password": PASSWORD})
    page = client.get(reverse("mfa_activate_totp"))
    secret = page.context["form"].secret
    assert secret in page.content.decode()
    client.post(reverse("mfa_activate_totp"), {"code": code(secret)})
    assert reverse("mfa_deactivate_totp") in words_of(client, reverse("mfa_index"))
    assert re.search(r"\b10 of 10\b", words_of(client, reverse("mfa_view_recovery_codes")))
    words_of(client, reverse("mfa_generate_recovery_codes"))
    words_of(client, reverse("mfa_reauthenticate"))
    words_of(client, reverse("mfa_deactivate_totp"))
    fresh = Client()
    login(fresh)
    assert 'name="code"' in words_of(fresh, reverse("mfa_authenticate"))
    fresh.post(reverse("mfa_authenticate"), {"code": "000000"})
    entry = LogEntry.objects.get(additional_data__kind=audit.FAILED_LOGIN)
    assert (entry.additional_data["page"], entry.actor) == ("wrong code", anna)
    client.post(reverse("mfa_deactivate_totp"))
    assert reverse("mfa_activate_totp") in words_of(client, reverse("mfa_index"))


def test_messages_are_ours_or_none(monkeypatch: pytest.MonkeyPatch, rf: RequestFactory) -> None:
    said: list[str | None] = []
    monkeypatch.setattr(
        DefaultAccountAdapter, "add_message", lambda *args, message=None, **kwargs: said.append(message)
    )
    folder = Path(allauth.__file__).parent / "templates"
    for path in sorted(folder.rglob("messages/*.txt")):
        for where in ("mfa_activate_totp", "mfa_generate_recovery_codes"):
            Accounts().add_message(rf.get(reverse(where)), messages.SUCCESS, path.relative_to(folder).as_posix())
    # New codes are announced once: not with the first factor.
    assert sorted(Counter(map(str, said)).values()) == [1, 2, 2, 2]


def test_a_new_password_is_asked_for_at_the_next_login(anna: Person, client: Client) -> None:  # noqa: F811
    login(client)
    new = "four blue kingfishers dive"
    data = {"oldpassword": PASSWORD, "password1": new, "password2": new}
    assert "changed" in client.post(reverse("account_change_password"), data, follow=True).content.decode()
    assert login(Client(), password=new) == 302


def test_somebody_of_the_hospitals_login_has_no_password_here(client_of: Callable[..., Client]) -> None:
    client = client_of(Role.CLINICIAN)
    person = Person.objects.get()
    person.set_unusable_password()
    person.save()
    client = client_of(Role.CLINICIAN)
    assert 'name="oldpassword"' not in words_of(client, reverse("account_change_password"))


def test_links_that_do_not_work_say_so(clinic: object, settings: Settings) -> None:
    person = add_person("bert", [Role.CLINICIAN])
    path = invitation(person)
    guest = Client()
    where = guest.get(path, follow=True).redirect_chain[-1][0]
    assert 'name="password1"' in words_of(guest, path)
    done = guest.post(where, {"password1": PASSWORD, "password2": PASSWORD}, follow=True)
    assert done.status_code == 200
    assert Person.objects.get(pk=person.pk).check_password(PASSWORD)
    sentence = "This link has been used or is older than three days. Ask the administrator for a new one."
    assert sentence in words_of(Client(), path)  # used
    assert sentence in words_of(Client(), path[:-3] + "x/")  # mistyped
    assert sentence in words_of(Client(), reverse("account_reset_password_from_key", args=["1", "x"]))  # of nobody
    late = invitation(add_person("carla", [Role.CLINICIAN]))
    settings.PASSWORD_RESET_TIMEOUT = -1
    assert sentence in words_of(Client(), late)  # too old


def test_failed_logins_and_lockouts_are_entered(anna: Person, settings: Settings) -> None:  # noqa: F811
    guest = Client(REMOTE_ADDR="10.0.0.7")
    login(guest, name="three grey herons wade")  # a password in the wrong field
    for number in range(10):
        login(guest, password=f"wrong {number}")
    failed = list(LogEntry.objects.filter(additional_data__kind=audit.FAILED_LOGIN).order_by("pk"))
    assert [entry.additional_data["page"] for entry in failed] == [
        *["login failed"] * 8, *["locked out"] * 3,
    ]  # fmt: skip
    assert [entry.actor for entry in failed] == [None, *[anna] * 10]
    assert {entry.remote_addr for entry in failed} == {"10.0.0.7"}
    assert "herons" not in repr(list(LogEntry.objects.values()))


def test_an_inactive_person_gets_a_plain_page(anna: Person) -> None:  # noqa: F811
    anna.is_active = False
    anna.save()
    guest = Client()
    answer = guest.post(reverse("account_login"), {"login": "anna", "password": PASSWORD}, follow=True)
    assert answer.status_code == 200
    assert "_auth_user_id" not in guest.session


@pytest.mark.parametrize("days", [2])
def test_a_link_works_for_three_days(clinic: object, monkeypatch: pytest.MonkeyPatch, days: int) -> None:
    from django.contrib.auth.tokens import PasswordResetTokenGenerator

    path = invitation(add_person("bert", [Role.CLINICIAN]))
    now = PasswordResetTokenGenerator._now
    monkeypatch.setattr(
        PasswordResetTokenGenerator, "_now", lambda self: now(self) + datetime.timedelta(days=days, hours=23)
    )
    assert 'name="password1"' in words_of(Client(), path)
