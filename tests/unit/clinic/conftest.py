"""One clinic a process: settings, folder and database; each test's changes of the database are undone."""

import atexit
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path

import pytest

from mammometry.clinic.config import ClinicConfig, new_clinic
from mammometry.clinic.site import configure

_FOLDER = Path(tempfile.mkdtemp(prefix="mammometry-clinic-"))
atexit.register(shutil.rmtree, _FOLDER, ignore_errors=True)
CONFIG = new_clinic(_FOLDER, name="Test clinic", second_factor="offered").model_copy(
    update={"hosts": ("testserver", "localhost", "127.0.0.1")}
)
# Before test modules import models. Other tests never open a clinic in their process.
configure(CONFIG)

from django.test import Client  # noqa: E402

from mammometry.clinic.models import Patient, Person, Rig, Visit  # noqa: E402
from mammometry.clinic.roles import Role  # noqa: E402


@pytest.fixture
def clinic(db: None) -> ClinicConfig:
    """The open clinic, with an empty database."""
    return CONFIG


@pytest.fixture
def person_of(clinic: ClinicConfig) -> Callable[..., Person]:
    """Makes somebody with these roles."""

    def make(*roles: Role, name: str | None = None) -> Person:
        username = name or "-".join(roles) or "nobody"
        person, _ = Person.objects.get_or_create(username=username, defaults={"roles": [str(each) for each in roles]})
        return person

    return make


@pytest.fixture
def client_of(person_of: Callable[..., Person]) -> Callable[..., Client]:
    """Makes a browser in which somebody with these roles is logged in."""

    def make(*roles: Role, name: str | None = None) -> Client:
        client = Client()
        client.force_login(person_of(*roles, name=name), backend="allauth.account.auth_backends.AuthenticationBackend")
        return client

    return make


@pytest.fixture
def visit(clinic: ClinicConfig) -> Visit:
    """A new visit of a patient whose name occurs nowhere else."""
    from django.utils import timezone

    patient = Patient.objects.create(
        family_name="Zypernkatze", given_name="Quirina", record_number="KIS-4711", born="1980-02-29"
    )
    rig = Rig.objects.create(name="Four cameras")
    return Visit.objects.create(patient=patient, rig=rig, taken_at=timezone.now())
