"""One clinic a process: settings, folder and database; each test's changes of the database are undone."""

import atexit
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from pytest_django import DjangoDbBlocker

from mammometry.clinic.config import FOLDERS, ClinicConfig, new_clinic, read_config
from mammometry.clinic.site import configure

_FOLDER = Path(tempfile.mkdtemp(prefix="mammometry-clinic-"))
atexit.register(shutil.rmtree, _FOLDER, ignore_errors=True)
# `make test-services` runs the same tests with a PostgreSQL server.
new_clinic(
    _FOLDER, name="Test clinic", second_factor="offered", database=os.environ.get("MAMMOMETRY_TEST_DATABASE", "sqlite")
)
_FILE = _FOLDER / "clinic.toml"
_FILE.write_text(_FILE.read_text().replace('hosts = ["localhost"', 'hosts = ["testserver", "localhost"'))
CONFIG = read_config(_FOLDER)
# Before test modules import models. Other tests never open a clinic in their process.
configure(CONFIG)

from django.conf import settings  # noqa: E402
from django.contrib.auth.hashers import Argon2PasswordHasher  # noqa: E402
from django.core.cache import cache  # noqa: E402
from django.test import Client  # noqa: E402

from mammometry.clinic import audit  # noqa: E402
from mammometry.clinic.models import Patient, Person, Rig, Visit  # noqa: E402
from mammometry.clinic.roles import Role  # noqa: E402

if settings.DATABASES["default"]["ENGINE"].endswith("sqlite3"):
    # A file: threads of a test wait for one another there, as in use; a database in memory refuses the second.
    settings.DATABASES["default"].setdefault("TEST", {})["NAME"] = str(_FOLDER / "test.sqlite3")
# Each new browser of a test begins a new server, which would look through all of Django's static files.
settings.WHITENOISE_AUTOREFRESH = True
Argon2PasswordHasher.memory_cost, Argon2PasswordHasher.time_cost = 64, 1  # KiB; the same algorithm, in a millisecond


@pytest.fixture(scope="session")
def django_db_use_migrations() -> bool:
    """With SQLite, tables are made from the models at once, which `test_clinic_migrations` shows to be the same."""
    return "MAMMOMETRY_TEST_DATABASE" in os.environ


@pytest.fixture(scope="session")
def django_db_setup(django_db_setup: None, django_db_blocker: DjangoDbBlocker) -> Iterator[None]:
    """Ends what threads of tests left connected: PostgreSQL drops no database that somebody uses."""
    yield
    from django.db import connection

    if connection.vendor == "postgresql":
        with django_db_blocker.unblock(), connection.cursor() as cursor:
            cursor.execute(
                "SELECT pg_terminate_backend(pid) FROM pg_stat_activity "
                "WHERE datname = current_database() AND pid <> pg_backend_pid()"
            )


@pytest.fixture
def clinic(db: None) -> ClinicConfig:
    """The open clinic, with an empty database and empty folders."""
    for each in FOLDERS:
        (_FOLDER / each).mkdir(exist_ok=True)
        if any((_FOLDER / each).iterdir()):
            shutil.rmtree(_FOLDER / each, ignore_errors=True)
            (_FOLDER / each).mkdir()
    cache.clear()  # holds how often something was tried
    return CONFIG


@pytest.fixture
def shared_database(transactional_db: None) -> Iterator[None]:
    """A database that the threads of a test share. It is emptied afterwards, which the sealed audit would refuse."""
    yield
    from django.db import connection

    with connection.cursor() as cursor:
        if connection.vendor == "sqlite":
            cursor.execute("SELECT name FROM sqlite_master WHERE type = 'trigger'")
            for (name,) in cursor.fetchall():
                cursor.execute(f'DROP TRIGGER "{name}"')
        else:
            for table, name in audit._NAMES.items():
                for what in ("change", "truncate"):
                    cursor.execute(f"DROP TRIGGER {name}_no_{what} ON {table}")


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
