"""Tables: made by migrations that fit the models, and whole although a migration was killed."""

import json
import os
import signal
import sqlite3
import subprocess
import sys
from pathlib import Path

import pytest
from django.core.management import call_command
from pytest_django import Settings

from mammometry.clinic.config import new_clinic

# Migrates, and is killed by SIGKILL before the n-th statement that changes a table; n < 0: is not.
_MIGRATE = """
import os, signal, sys
from pathlib import Path
from mammometry.clinic.config import read_config
from mammometry.clinic.site import configure
config = read_config(Path(sys.argv[1]))
configure(config)
from django.db import connection
from mammometry.clinic.web.server import migrate
for number in map(int, sys.argv[2].split(",")):
    child = os.fork()
    if child == 0:
        left = number
        def watch(execute, sql, params, many, context):
            global left
            if sql.lstrip().upper().startswith(("CREATE", "ALTER", "DROP", "INSERT")):
                left -= 1
                if left == 0:
                    os.kill(os.getpid(), signal.SIGKILL)
            return execute(sql, params, many, context)
        with connection.execute_wrapper(watch):
            migrate(config)
        os._exit(0)
    _, status = os.waitpid(child, 0)
    print(os.WTERMSIG(status) if os.WIFSIGNALED(status) else 0)
"""

# Makes the tables of 1.0.0, with deliveries in each state, and brings them to this version.
_DELIVERIES = """
import datetime, json, sys
from pathlib import Path
from mammometry.clinic.config import read_config
from mammometry.clinic.site import configure
config = read_config(Path(sys.argv[1]))
configure(config)
from django.core.management import call_command
from django.db import connection
from django.db.migrations.executor import MigrationExecutor
from django.utils import timezone
from mammometry.clinic.web.server import migrate
then = [("clinic", "0004_once_and_notes")]
call_command("migrate", "clinic", "0004", verbosity=0)
m = MigrationExecutor(connection).loader.project_state(then).apps.get_model
later = timezone.now() + datetime.timedelta(hours=1)
patient = m("clinic", "Patient").objects.create(pseudonym="P-1")
visit = m("clinic", "Visit").objects.create(patient=patient, taken_at=later)
archive = m("clinic", "Destination").objects.create(name="PACS", address="PACS@h:104")
for state in ("queued", "sending", "sent", "failed"):
    m("clinic", "Delivery").objects.create(
        visit=visit, destination=archive, state=state, tries=3, next_try=later, message=state
    )
migrate(config)
from mammometry.clinic.jobs import queue
from mammometry.clinic.models import Delivery, Job
due = [(job.message, job.attempt) for job in queue.claim("runner", 9, [Job.Kind.SEND])]
waiting = [(job.message, job.attempt, job.due == later) for job in Job.objects.filter(state="queued")]
print(json.dumps([due, waiting, [row.state for row in Delivery.objects.order_by("created")]]))
"""


def migrated(folder: Path, stops: list[int]) -> list[int]:
    """Migrate once for each stop; the signals that ended them."""
    words = [sys.executable, "-c", _MIGRATE, str(folder), ",".join(map(str, stops))]
    done = subprocess.run(words, capture_output=True, text=True, timeout=300, check=False, env=os.environ)
    assert done.returncode == 0, done.stderr
    return [int(line) for line in done.stdout.split()]


def schema(folder: Path) -> list[tuple[str, str, str]]:
    with sqlite3.connect(folder / "clinic.sqlite3") as connection:
        rows = connection.execute("SELECT type, name, sql FROM sqlite_master WHERE sql IS NOT NULL ORDER BY type, name")
        return rows.fetchall()


def test_every_change_of_a_model_has_its_migration(clinic: object, settings: Settings) -> None:
    settings.MIGRATION_MODULES = {}  # which the tests leave out to be quick
    call_command("makemigrations", "clinic", check=True, dry_run=True, verbosity=0)


@pytest.mark.slow
@pytest.mark.requirement("R-KEEP-4")
def test_deliveries_of_1_0_become_jobs(tmp_path: Path) -> None:
    """One that waits keeps its tries and its time; one that was being sent is sent again."""
    new_clinic(tmp_path / "clinic", name="Clinic")
    words = [sys.executable, "-c", _DELIVERIES, str(tmp_path / "clinic")]
    done = subprocess.run(words, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    due, waiting, states = json.loads(done.stdout)
    assert due == [["sending", 4]]
    assert waiting == [["queued", 3, True]]
    assert states == ["queued", "queued", "sent", "failed"]


@pytest.mark.slow
@pytest.mark.requirement("R-KEEP-4")
def test_a_killed_migration_leaves_nothing_half_done(tmp_path: Path) -> None:
    whole, killed = tmp_path / "whole", tmp_path / "killed"
    for folder in (whole, killed):
        new_clinic(folder, name="Clinic")
    assert migrated(whole, [-1]) == [0]
    stops = [1, 17, 40, 60, 60, 60, 60]
    signals = migrated(killed, [*stops, -1])
    assert signals[: len(stops)].count(signal.SIGKILL) >= 4  # later ones find fewer statements left than they wait for
    assert signals[-1] == 0
    assert schema(killed) == schema(whole)
    assert len([row for row in schema(killed) if row[0] == "trigger"]) == 6  # of entries and links
