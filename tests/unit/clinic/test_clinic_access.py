"""Every route says who may open it, and nobody else gets in."""

from collections.abc import Callable, Iterator

import pytest
from django.test import Client
from django.urls import URLPattern, URLResolver, get_resolver, reverse

from mammometry.clinic.models import Person
from mammometry.clinic.roles import Role

SINGLE = [frozenset({role}) for role in Role]


def all_patterns(of: URLResolver | None = None, path: str = "") -> Iterator[tuple[str, URLPattern]]:
    for each in (of or get_resolver()).url_patterns:
        if isinstance(each, URLResolver):
            yield from all_patterns(each, path + str(each.pattern))
        else:
            yield path + str(each.pattern), each


def test_every_mounted_view_says_who_may_open_it() -> None:
    found = list(all_patterns())
    assert len(found) > 25
    assert [path for path, each in found if not hasattr(each.callback, "access")] == []


def test_home_needs_a_login(clinic: object, client: Client) -> None:
    answer = client.get("/")
    assert answer.status_code == 302
    assert answer["Location"] == reverse("account_login") + "?next=%2F"


@pytest.mark.parametrize("role", list(Role))
def test_home_opens_for_each_role(client_of: Callable[..., Client], role: Role) -> None:
    assert client_of(role).get("/").status_code == 200


def test_somebody_without_a_role_opens_nothing(client_of: Callable[..., Client]) -> None:
    assert client_of().get("/").status_code == 403


def test_administration_is_for_administrators(
    client_of: Callable[..., Client], person_of: Callable[..., Person]
) -> None:
    assert client_of(Role.ADMINISTRATOR).get(reverse("admin:index")).status_code == 200
    assert client_of(Role.CLINICIAN).get(reverse("admin:index")).status_code == 403
