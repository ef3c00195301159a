"""Every route says who may open it, and nobody else gets in."""

import re
import uuid
from collections.abc import Callable, Iterator

import pytest
from django.core.exceptions import PermissionDenied
from django.http import HttpResponse, HttpResponseBase
from django.test import Client, RequestFactory
from django.urls import URLPattern, URLResolver, get_resolver, resolve, reverse
from pytest_django import Settings
from tests.first_cases import first

from mammometry.clinic.models import Person
from mammometry.clinic.roles import Role
from mammometry.clinic.views import responses
from mammometry.clinic.web.access import Access
from mammometry.clinic.web.security import DeniedByDefault

SCRIPT = {"Accept": "application/json"}
"""What every script of ours sends."""


def all_patterns(of: URLResolver | None = None, path: str = "") -> Iterator[tuple[str, URLPattern]]:
    for each in (of or get_resolver()).url_patterns:
        if isinstance(each, URLResolver):
            yield from all_patterns(each, path + str(each.pattern))
        else:
            yield path + str(each.pattern), each


@pytest.mark.requirement("R-SEC-1")
def test_every_mounted_view_says_who_may_open_it() -> None:
    found = list(all_patterns())
    assert len(found) > 25
    assert [path for path, each in found if not hasattr(each.callback, "access")] == []


def sample(path: str, pattern: URLPattern) -> str:
    """A path that the pattern matches, naming objects that do not exist."""
    for name, converter in pattern.pattern.converters.items():
        value = {"UUIDConverter": str(uuid.uuid4()), "IntConverter": "7"}.get(type(converter).__name__, "x")
        path = re.sub(rf"<(\w+:)?{name}>", value, path)
    path = re.sub(r"\^account/invitation/.*\$", "account/invitation/1-x/", path)
    return "/" + path.replace("^", "").replace("$", "").replace("\\Z", "")


def reached(answer: HttpResponseBase) -> str:
    """What became of a request: to the login, refused, or let in, whatever was found there."""
    if answer.status_code == 302 and answer.headers["Location"].startswith(reverse("account_login") + "?next="):
        return "login"
    return "refused" if answer.status_code == 403 else "in"


def table() -> list[tuple[str, Access]]:
    return [(sample(path, each), each.callback.access) for path, each in all_patterns()]  # type: ignore[attr-defined]


@pytest.mark.parametrize("role", first(2, [None, Role.RESEARCHER, *(role for role in Role if role != Role.RESEARCHER)]))
@pytest.mark.requirement("R-SEC-1")
def test_the_whole_table_for_each_role(
    clinic: object, client_of: Callable[..., Client], monkeypatch: pytest.MonkeyPatch, role: Role | None
) -> None:
    # The page of a refusal takes half the time. Other tests here and the crawl show it.
    monkeypatch.setattr(responses, "_page", lambda request, status, *_: HttpResponse(status=status))
    wrong = []
    client = Client(raise_request_exception=False) if role is None else client_of(role)
    for path, access in table():
        resolve(path)  # the sample is of this table
        for method in (client.get, client.post):
            if access.roles is None:
                expected = "in"
            elif role is None:
                expected = "login"
            else:
                expected = "in" if role in access.roles else "refused"
            if expected == "in" and method != client.get:
                continue
            if (found := reached(method(path))) != expected:
                if path == reverse("account_reauthenticate"):
                    continue  # these people have no password that could be asked
                wrong.append(f"{method.__name__} {path}: {found}, not {expected}")
    assert wrong == []


@pytest.mark.requirement("R-SEC-1")
def test_nobody_reaches_anything_but_the_way_in_without_a_login() -> None:
    """The list of what is open, by hand: a new open route is a decision."""
    opened = {each.name for _, each in all_patterns() if each.callback.access.roles is None}  # type: ignore[attr-defined]
    assert opened == {
        "account_login", "account_logout", "account_inactive", "mfa_authenticate", "alive", "account-token",
        "account_reset_password_from_key", "account_reset_password_from_key_done",
        "openid_connect_login", "openid_connect_callback", "socialaccount_login_error",
        "socialaccount_login_cancelled", "socialaccount_signup",
    }  # fmt: skip


def test_a_view_that_was_mounted_past_the_table_is_refused(clinic: object, rf: RequestFactory) -> None:
    with pytest.raises(PermissionDenied):
        DeniedByDefault(lambda request: HttpResponse()).process_view(rf.get("/"), lambda request: None, (), {})


@pytest.mark.slow
def test_a_script_is_answered_in_json_whatever_it_sends(clinic: object, client: Client) -> None:
    bodies = {"application/json": b"{}", "application/offset+octet-stream": b"photograph", "text/plain": b""}
    for path, access in table():
        if access.roles is None:
            continue
        answers = [client.get(path, headers=SCRIPT), client.delete(path, headers=SCRIPT)]
        answers += [client.post(path, body, content_type=kind, headers=SCRIPT) for kind, body in bodies.items()]
        assert [answer.status_code for answer in answers] == [401] * len(answers), path
        assert {answer.json()["error"] for answer in answers} == {"Log in first."}, path
    assert client.get("/", headers={"HX-Request": "true"}).status_code == 401


def test_what_is_refused_elsewhere_is_json_for_a_script_too(
    client_of: Callable[..., Client], monkeypatch: pytest.MonkeyPatch
) -> None:
    client = client_of(Role.RESEARCHER)
    answers = [client.get(path, headers=SCRIPT) for path in ("/administration/", "/nowhere/")]
    client.raise_request_exception = False

    def fail(*_: object) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr("mammometry.clinic.views.responses.get_token", fail)
    answers.append(client.get(reverse("account-token"), headers=SCRIPT))
    assert [answer.status_code for answer in answers] == [403, 404, 500]
    assert {answer["Content-Type"] for answer in answers} == {"application/json"}
    assert [set(answer.json()) for answer in answers] == [{"error"}] * 3
    assert "ZeroDivisionError" not in answers[-1].json()["error"]


def test_a_script_gets_a_token_for_one_that_is_out_of_date(person_of: Callable[..., Person]) -> None:
    client = Client(enforce_csrf_checks=True)
    client.force_login(
        person_of(Role.TECHNICIAN, name="anna"), backend="allauth.account.auth_backends.AuthenticationBackend"
    )
    refused = client.post(reverse("upload-new"), b"{}", content_type="application/json", headers=SCRIPT)
    assert refused.status_code == 403
    assert refused.json()["stale"] is True
    session = client.get(reverse("account-token"), headers=SCRIPT).json()
    assert session["person"] == "anna"
    token = {**SCRIPT, "X-CSRFToken": session["token"]}
    heard = client.post(reverse("upload-new"), b"{}", content_type="application/json", headers=token)
    assert heard.status_code not in (401, 403)
    assert Client().get(reverse("account-token"), headers=SCRIPT).json()["person"] is None


def test_without_its_second_factor_nobody_goes_on(client_of: Callable[..., Client], settings: Settings) -> None:
    people = settings.CLINIC.people.model_copy(update={"second_factor": "required"})
    settings.CLINIC = settings.CLINIC.model_copy(update={"people": people})
    client = client_of(Role.CLINICIAN)
    for path, access in table():
        if access.roles is not None and Role.CLINICIAN in access.roles and not access.first_factor:
            assert client.get(path)["Location"] == reverse("mfa_activate_totp"), path


def test_home_needs_a_login(clinic: object, client: Client) -> None:
    answer = client.get("/")
    assert answer.status_code == 302
    assert answer["Location"] == reverse("account_login") + "?next=%2F"


@pytest.mark.parametrize("role", list(Role))
def test_home_opens_for_each_role(client_of: Callable[..., Client], role: Role) -> None:
    answer = client_of(role).get("/", follow=True)
    assert answer.status_code == 200
    assert "account" not in answer.request["PATH_INFO"]


def test_somebody_without_a_role_opens_nothing(client_of: Callable[..., Client]) -> None:
    assert client_of().get("/").status_code == 403


def test_administration_is_for_administrators(
    client_of: Callable[..., Client], person_of: Callable[..., Person]
) -> None:
    assert client_of(Role.ADMINISTRATOR).get(reverse("administration")).status_code == 200
    assert client_of(Role.CLINICIAN).get(reverse("administration")).status_code == 403
