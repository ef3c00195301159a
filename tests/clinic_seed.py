"""Makes a small clinic in a process of its own: a rig, people by role, and a login for each, as JSON.

Under ``python -m tests.postgresql`` the clinic's rows are in a database of that server.
"""

import json
import os
import sys
import uuid
from pathlib import Path

from tests.postgresql import VARIABLE

PAIR = {"name": "front", "left": "front_left", "right": "front_right"}
PASSWORD = "nine plain teaspoons"
"""Of everybody."""
DEFINITION = {
    "rig": {"name": "pair", "pairs": [PAIR]},
    "target": {
        "kind": "charuco", "squares": [14, 10], "square_mm": 25.0, "marker_mm": 18.0, "dictionary": "DICT_5X5_250",
    },
}  # fmt: skip


def logins(folder: Path) -> dict[str, str]:
    """Role → value of the session's cookie, of somebody who has just logged in with this role."""
    from mammometry.clinic.config import read_config
    from mammometry.clinic.site import configure

    configure(read_config(folder))
    from django.conf import settings
    from django.test import Client

    from mammometry.clinic.models import Person
    from mammometry.clinic.roles import Role

    made = {}
    for role in Role:
        person, _ = Person.objects.get_or_create(
            username=f"{role}-1", defaults={"roles": [str(role)], "full_name": f"{role.label} One"}
        )
        person.set_password(PASSWORD)
        person.save()
        client = Client()
        client.force_login(person, backend="allauth.account.auth_backends.AuthenticationBackend")
        made[str(role)] = client.cookies[settings.SESSION_COOKIE_NAME].value
    return made


def make(folder: Path) -> None:
    """Make a clinic with a rig."""
    from mammometry.clinic.config import new_clinic
    from mammometry.clinic.web.server import migrate

    migrate(new_clinic(folder, name="Test clinic", second_factor="offered", database=_database()))
    from mammometry.clinic.models import Rig

    Rig.objects.create(name="Room 1", definition=DEFINITION)


def _database() -> str:
    """SQLite, or a new database of the tests' server, which ends with it."""
    server = os.environ.get(VARIABLE)
    if not server:
        return "sqlite"
    import psycopg

    name = f"seed-{uuid.uuid4()}"
    with psycopg.connect(server, autocommit=True) as connection:
        connection.execute(f'CREATE DATABASE "{name}"')
    return server.replace("/postgres?", f"/{name}?")


if __name__ == "__main__":
    place = Path(sys.argv[1])
    if not (place / "clinic.toml").exists():
        make(place)
    json.dump(logins(place), sys.stdout)
