"""A PostgreSQL server for tests, which they start and end themselves.

``python -m tests.postgresql COMMAND`` runs a command while there is one; its address is in MAMMOMETRY_TEST_DATABASE.
"""

import os
import pwd
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

VARIABLE = "MAMMOMETRY_TEST_DATABASE"
ABSENT = "no PostgreSQL server is installed (apt-get install postgresql): tests with one are left out"


def binaries() -> Path | None:
    """The folder of ``initdb`` and ``postgres``; Debian does not put it on the path."""
    on_path = shutil.which("initdb")
    if on_path and shutil.which("postgres"):
        return Path(on_path).parent
    found = sorted(Path("/usr/lib/postgresql").glob("*/bin/initdb"), key=lambda path: int(path.parts[-3]))
    return found[-1].parent if found else None


@contextmanager
def server() -> Iterator[str]:
    """Address of a new, empty server on a socket that nobody else knows; durable only while it runs."""
    folder = Path(tempfile.mkdtemp(prefix="mammometry-postgresql-"))
    owner = _owner()
    bin_folder = binaries()
    assert bin_folder is not None, ABSENT
    if owner:
        shutil.chown(folder, owner)
    data = folder / "data"
    initdb = [
        bin_folder / "initdb",
        "-D",
        data,
        "-U",
        "clinic",
        "--auth=trust",
        "-E",
        "UTF8",
        "--locale=C",
        "--no-sync",
    ]
    postgres = [bin_folder / "postgres", "-D", data, "-k", folder, "-c", "listen_addresses=", "-c", "fsync=off"]
    try:
        subprocess.run(initdb, check=True, stdout=subprocess.DEVNULL, user=owner, cwd=folder)
        with (folder / "log").open("w") as log:
            running = subprocess.Popen(postgres, stdout=log, stderr=log, user=owner, cwd=folder)
        try:
            _await(bin_folder, folder, running)
            yield f"postgresql://clinic@/postgres?host={folder}"
        finally:
            running.terminate()
            running.wait(30)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


@contextmanager
def new_database(address: str, name: str) -> Iterator[str]:
    """Address of another, empty database on the same server."""
    import psycopg

    with psycopg.connect(address, autocommit=True) as connection:
        connection.execute(f'CREATE DATABASE "{name}"')
    try:
        yield address.replace("/postgres?", f"/{name}?")
    finally:
        with psycopg.connect(address, autocommit=True) as connection:
            connection.execute(f'DROP DATABASE "{name}" WITH (FORCE)')


def _owner() -> str | None:
    """PostgreSQL does not run as root."""
    if os.geteuid() != 0:
        return None
    names = {entry.pw_name for entry in pwd.getpwall()}
    return "postgres" if "postgres" in names else "nobody"


def _await(bin_folder: Path, folder: Path, running: "subprocess.Popen[bytes]") -> None:
    import time

    import psycopg

    for _ in range(300):
        try:
            psycopg.connect(f"postgresql://clinic@/postgres?host={folder}", connect_timeout=2).close()
            return
        except psycopg.OperationalError:
            assert running.poll() is None, (folder / "log").read_text()
            time.sleep(0.1)
    raise AssertionError("PostgreSQL did not start")


if __name__ == "__main__":
    if binaries() is None:
        print(ABSENT)  # noqa: T201
        sys.exit(0)
    with server() as address:
        sys.exit(subprocess.run(sys.argv[1:], env={**os.environ, VARIABLE: address}, check=False).returncode)
