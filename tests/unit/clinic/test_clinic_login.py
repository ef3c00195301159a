"""How people come in, and how they do not."""

import re
import time

import pytest
from allauth.mfa.models import Authenticator
from allauth.mfa.totp.internal.auth import TOTP, format_hotp_value, hotp_value, yield_hotp_counters_from_time
from django.test import Client
from django.urls import reverse
from pytest_django import Settings
from tests.first_cases import first

from mammometry.clinic.accounts import add_person, invitation
from mammometry.clinic.config import ClinicError
from mammometry.clinic.models import Person
from mammometry.clinic.roles import Role

PASSWORD = "three grey herons wade"
PAGE_OF_ALL = "/account/password/"  # of every role, behind both factors


@pytest.fixture
def anna(clinic: object) -> Person:
    person = add_person("anna", [Role.TECHNICIAN], full_name="Anna Ahorn")
    person.set_password(PASSWORD)
    person.save()
    return person


def login(client: Client, name: str = "anna", password: str = PASSWORD) -> int:
    return client.post(reverse("account_login"), {"login": name, "password": password}).status_code


def is_in(client: Client) -> bool:
    return client.get("/").status_code == 200


def code(secret: str) -> str:
    return format_hotp_value(hotp_value(secret, next(yield_hotp_counters_from_time())))


def test_an_invitation_sets_a_password_once(clinic: object) -> None:
    person = add_person("bert", [Role.CLINICIAN])
    path = invitation(person)
    guest = Client()
    form = guest.get(path, follow=True)
    where = form.redirect_chain[-1][0]
    assert person.username not in where
    assert guest.post(where, {"password1": PASSWORD, "password2": PASSWORD}).status_code == 302
    assert login(guest, "bert") == 302
    assert is_in(guest)
    again = Client().get(path, follow=True)
    assert again.context["token_fail"]
    assert Person.objects.get(username="bert").password.startswith("argon2$argon2id$")


@pytest.mark.parametrize("password", ["short", "password1234", "bert-bertsen-x"])
def test_weak_passwords_are_refused(clinic: object, password: str) -> None:
    guest = Client()
    where = guest.get(invitation(add_person("bert-bertsen", [Role.CLINICIAN])), follow=True).redirect_chain[-1][0]
    guest.post(where, {"password1": password, "password2": password})
    assert not Person.objects.get().has_usable_password()


def test_nobody_signs_up_alone(clinic: object, client: Client) -> None:
    from allauth.account.adapter import get_adapter

    assert not get_adapter().is_open_for_signup(None)
    assert client.get("/account/signup/").status_code == 404


def test_the_session_gets_a_new_id_at_login(anna: Person, client: Client) -> None:
    """Session fixation: an id that somebody else planted is worth nothing afterwards."""
    client.get("/account/login/")
    session = client.session
    session["planted"] = True
    session.save()
    planted = session.session_key
    client.cookies["clinic-session"] = str(planted)
    assert login(client) == 302
    assert client.session.session_key != planted
    thief = Client()
    thief.cookies["clinic-session"] = str(planted)
    assert not is_in(thief)


def test_logout_ends_the_session_for_every_copy_of_the_cookie(anna: Person, client: Client) -> None:
    login(client)
    copy = Client()
    copy.cookies["clinic-session"] = client.cookies["clinic-session"].value
    assert is_in(copy)
    client.post(reverse("account_logout"))
    assert not is_in(copy)


def test_a_new_password_ends_other_sessions(anna: Person, client: Client) -> None:
    login(client)
    anna.set_password("another long password")
    anna.save()
    assert not is_in(client)


def test_an_inactive_person_is_out_at_once(anna: Person, client: Client) -> None:
    login(client)
    assert is_in(client)
    anna.is_active = False
    anna.save()
    assert not is_in(client)
    login(client)
    assert not is_in(client)


@pytest.mark.slow
@pytest.mark.requirement("R-SEC-2")
def test_a_session_ends_when_idle_and_after_its_hours(
    anna: Person, client: Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    login(client)
    now = time.time()
    idle_s, most_s = 30 * 60, 12 * 3600

    def at(second: float) -> bool:
        monkeypatch.setattr("mammometry.clinic.web.security.time.time", lambda: now + second)
        return is_in(client)

    assert at(0)
    assert at(idle_s - 60)
    assert at(2 * idle_s - 200)
    assert not at(3 * idle_s)
    login(client)
    start = 3 * idle_s
    for second in range(start, start + most_s, idle_s - 60):
        assert at(second)
    assert not at(start + most_s + 1)


@pytest.mark.requirement("R-SEC-2")
def test_wrong_passwords_lock_the_name_at_that_address_for_a_while(anna: Person, client: Client) -> None:
    answers = [login(client, password=f"wrong {number}") for number in range(8)]
    assert answers == [200] * 7 + [429]
    assert login(client) == 429  # the right one too
    assert not is_in(client)
    elsewhere = Client(REMOTE_ADDR="10.9.8.7")
    login(elsewhere)
    assert is_in(elsewhere)  # else anybody could keep anna out


@pytest.mark.requirement("R-SEC-2")
def test_unknown_names_and_wrong_passwords_look_alike(anna: Person) -> None:
    pages = []
    for name in ("anna", "nobody-of-that-name"):
        page = Client().post(reverse("account_login"), {"login": name, "password": "wrong"}).content.decode()
        pages.append(re.sub(r'name="csrfmiddlewaretoken" value="\w+"|value="[^"]*"', "", page))
    assert pages[0] == pages[1]


@pytest.mark.requirement("R-SEC-2")
def test_the_second_factor_is_set_up_and_then_asked(anna: Person, client: Client, settings: Settings) -> None:
    people = settings.CLINIC.people.model_copy(update={"second_factor": "required"})
    settings.CLINIC = settings.CLINIC.model_copy(update={"people": people})
    login(client)
    page = client.get("/", follow=True)
    assert page.redirect_chain[-1][0] == reverse("mfa_activate_totp")
    secret = page.context["form"].secret
    assert client.post(reverse("mfa_activate_totp"), {"code": "000000"}).status_code == 200
    assert client.post(reverse("mfa_activate_totp"), {"code": code(secret)}).status_code == 302
    assert is_in(client)
    stored = Authenticator.objects.get(type=Authenticator.Type.TOTP)
    assert secret not in repr(stored.data)  # a copy of the database opens nothing
    fresh = Client()
    answer = fresh.post(reverse("account_login"), {"login": "anna", "password": PASSWORD})
    assert answer["Location"].startswith(reverse("mfa_authenticate"))
    assert not is_in(fresh)
    assert fresh.post(reverse("mfa_authenticate"), {"code": "000000"}).status_code == 200
    assert not is_in(fresh)


@pytest.mark.requirement("R-SEC-2")
@pytest.mark.parametrize(
    ("role", "where"),
    first(1, zip(Role, ["logged in", "waiting for the code", "new browser", "logged in long ago"], strict=True)),
)
def test_a_reset_second_factor_is_set_up_anew_in_the_same_browser(
    anna: Person, client: Client, settings: Settings, monkeypatch: pytest.MonkeyPatch, role: Role, where: str
) -> None:
    """The telephone is lost, and the administrator resets the factor: no cookie has to be deleted."""
    people = settings.CLINIC.people.model_copy(update={"second_factor": "required"})
    settings.CLINIC = settings.CLINIC.model_copy(update={"people": people})
    Person.objects.filter(pk=anna.pk).update(roles=[role.value])
    TOTP.activate(anna, "JBSWY3DPEHPK3PXP")
    if where != "new browser":
        login(client)
    if where.startswith("logged in"):
        client.post(reverse("mfa_authenticate"), {"code": code("JBSWY3DPEHPK3PXP")})
        assert client.get(PAGE_OF_ALL).status_code == 200
    if where == "logged in long ago":
        monkeypatch.setattr("mammometry.clinic.accounts.FRESH_S", -1)
        monkeypatch.setattr("allauth.account.app_settings.REAUTHENTICATION_TIMEOUT", -1, raising=False)
    Authenticator.objects.filter(user=anna).delete()
    page = client.get(PAGE_OF_ALL, follow=True)  # raises where it is sent back and forth for ever
    if page.redirect_chain[-1][0].startswith(reverse("account_login")):
        page = client.post(reverse("account_login"), {"login": "anna", "password": PASSWORD}, follow=True)
    if page.redirect_chain[-1][0].startswith(reverse("account_reauthenticate")):
        monkeypatch.undo()
        page = client.post(page.redirect_chain[-1][0], {"password": PASSWORD}, follow=True)
    assert page.redirect_chain[-1][0].startswith(reverse("mfa_activate_totp"))
    assert client.post(reverse("mfa_activate_totp"), {"code": code(page.context["form"].secret)}).status_code == 302
    assert client.get(PAGE_OF_ALL).status_code == 200


@pytest.mark.usefixtures("shared_database")
def test_first_codes_replace_no_old_ones(anna: Person, client: Client, settings: Settings) -> None:
    people = settings.CLINIC.people.model_copy(update={"second_factor": "required"})
    settings.CLINIC = settings.CLINIC.model_copy(update={"people": people})
    login(client)
    secret = client.get("/", follow=True).context["form"].secret
    client.post(reverse("mfa_activate_totp"), {"code": code(secret)})
    first = client.get(reverse("mfa_index")).content.decode()
    assert "factor" in first
    client.post(reverse("account_reauthenticate"), {"password": PASSWORD})
    client.post(reverse("mfa_generate_recovery_codes"))
    page = client.get(reverse("mfa_index"))
    (message,) = page.context["messages"]
    assert str(message) not in first


def test_a_script_logs_in_with_both_factors(anna: Person, client: Client) -> None:
    """Answers that `viewer/src/clinic/login.ts` reads."""
    script = {"Accept": "application/json"}
    TOTP.activate(anna, "JBSWY3DPEHPK3PXP")
    first = {"login": "anna", "next": reverse("account-token")}
    wrong = client.post(reverse("account_login"), {**first, "password": "wrong"}, headers=script)
    assert wrong.status_code == 400
    right = client.post(reverse("account_login"), {**first, "password": PASSWORD}, headers=script)
    assert right.json()["location"].startswith(reverse("mfa_authenticate"))
    assert client.get(reverse("account-token")).json()["person"] is None
    client.post(reverse("mfa_authenticate"), {"code": code("JBSWY3DPEHPK3PXP")}, headers=script)
    assert client.get(reverse("account-token")).json()["person"] == "anna"


def test_cookies_are_not_for_scripts(anna: Person, client: Client) -> None:
    login(client)
    for name in ("clinic-session", "clinic-csrf"):
        assert client.cookies[name]["httponly"]
        assert client.cookies[name]["samesite"] == "Lax"


@pytest.mark.parametrize("name", ["", "anna anna", "<script>", "anna\r\nSet-Cookie: x", "a" * 200])
def test_names_that_cannot_be_are_refused(clinic: object, name: str) -> None:
    with pytest.raises(ClinicError):
        add_person(name, [Role.TECHNICIAN])


def test_the_way_back_after_the_login_stays_here(anna: Person, client: Client) -> None:
    for away in ("https://evil.example/", "//evil.example/", "javascript:alert(1)"):
        answer = client.post(reverse("account_login"), {"login": "anna", "password": PASSWORD, "next": away})
        assert answer["Location"] == "/"
        client.post(reverse("account_logout"))
