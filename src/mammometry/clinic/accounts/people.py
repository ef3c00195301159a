"""Entry of people by an administrator. They set their own password through a link that works once."""

from __future__ import annotations

from collections.abc import Sequence

from django.core.exceptions import ValidationError
from django.urls import reverse

from mammometry.clinic.config import ClinicError
from mammometry.clinic.models import Person
from mammometry.clinic.roles import Role
from mammometry.hospital.exported import person_name
from mammometry.hospital.representations import require_text


def add_person(username: str, roles: Sequence[Role], *, full_name: str = "", email: str = "") -> Person:
    """Enter somebody, who cannot log in before having set a password.

    Raises:
        ClinicError: the name is taken, or something in it cannot be.
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
    """Path of the page on which this person sets a password. It works once, for three days."""
    from allauth.account.forms import default_token_generator
    from allauth.account.utils import user_pk_to_url_str

    key = default_token_generator.make_token(person)
    return reverse("account_reset_password_from_key", kwargs={"uidb36": user_pk_to_url_str(person), "key": key})


def find_person(username: str) -> Person:
    """Somebody by the name to log in with.

    Raises:
        ClinicError: there is nobody of that name.
    """
    person = Person.objects.filter(username=username).first()
    if person is None:
        remedy = "See `mammometry clinic people list`"
        raise ClinicError(username, found="nobody of that name", expected="somebody who may log in", remedy=remedy)
    return person
