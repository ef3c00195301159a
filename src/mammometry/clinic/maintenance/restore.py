"""A clinic out of a backup. Checked file by file, then whole or not at all."""

from __future__ import annotations

import hashlib
import json
import re
import shutil
import tarfile
from pathlib import Path
from typing import Any

from mammometry.clinic.config import FILE, FOLDERS, ClinicConfig, ClinicError, quoted, read_config, write_private
from mammometry.clinic.maintenance.format import DATABASE, FORMAT, MANIFEST

_CHUNK = 1 << 20  # bytes


def unpack(archive: Path, folder: Path, database: str | None = None) -> tuple[ClinicConfig, dict[str, Any]]:
    """Unpack a backup beside the folder that is to be. Nothing is opened yet.

    Args:
        archive: what `backup` wrote.
        folder: the new clinic's folder, which must not be there or be empty.
        database: another database than the backup's settings name.

    Returns:
        Settings of the clinic in its temporary folder ``<folder>.restoring``, and the archive's manifest.

    Raises:
        ClinicError: no backup, a damaged one, or something is in the folder.
    """
    if folder.exists() and any(folder.iterdir()):
        raise ClinicError(str(folder), found="files", expected="a new or empty folder", remedy="Name another folder")
    staging = folder.with_name(folder.name + ".restoring")
    if staging.exists():
        shutil.rmtree(staging)  # of a restore that was killed
    staging.mkdir(mode=0o700, parents=True)
    try:
        with tarfile.open(archive, "r:") as tar:
            tar.extractall(staging, filter="data")
        manifest: dict[str, Any] = json.loads((staging / MANIFEST).read_text(encoding="utf-8"))
        damaged = [name for name, digest in manifest["sha256"].items() if _digest(staging / name) != digest]
    except (OSError, tarfile.TarError, ValueError, KeyError) as error:
        raise ClinicError(
            archive.name, found=f"no whole backup ({type(error).__name__})", expected="a backup that can be read",
            remedy="Take another backup",
        ) from None  # fmt: skip
    if damaged:
        found = f"{len(damaged)} damaged files, {damaged[0]} among them"
        raise ClinicError(archive.name, found=found, expected="files as they were", remedy="Take another backup")
    if manifest.get("format") != FORMAT:
        found, expected = f"format {manifest.get('format')}", f"format {FORMAT}"
        raise ClinicError(archive.name, found=found, expected=expected, remedy="Use the version that made it")
    for kept in FOLDERS:
        (staging / kept).mkdir(mode=0o700, exist_ok=True)
    if database is not None:
        text = (staging / FILE).read_text(encoding="utf-8")
        line = f"database = {quoted(database)}"
        write_private(staging / FILE, re.sub(r"(?m)^database\s*=.*$", lambda _: line, text, count=1))
    return read_config(staging), manifest


def fill(config: ClinicConfig, manifest: dict[str, Any], folder: Path) -> int:
    """Fill an unpacked clinic's database and put it into its place. Returns the number of its people.

    Raises:
        ClinicError: the backup is of another version, or the database is not empty.
    """
    from django.db import connections

    from mammometry.clinic.models import Person

    load(config, manifest)
    number = Person.objects.count()
    connections.close_all()
    (config.folder / DATABASE).unlink()
    (config.folder / MANIFEST).unlink()
    if folder.exists():
        folder.rmdir()  # empty, as was looked at
    config.folder.rename(folder)
    return number


def load(config: ClinicConfig, manifest: dict[str, Any]) -> None:
    """Load the rows of an unpacked backup into its empty database.

    Raises:
        ClinicError: the backup is of another version, or the database is not empty.
    """
    from django.core.management import call_command

    from mammometry.clinic.maintenance.backup import known_migrations
    from mammometry.clinic.models import Person
    from mammometry.clinic.web.server import migrate

    migrate(config)
    if Person.objects.exists():
        raise ClinicError(
            "the database", found="a clinic in it", expected="an empty database", remedy="Give another with --database"
        )
    if known_migrations() != manifest["migrations"]:
        found, expected = f"a backup of version {manifest['software']}", "one of this version"
        remedy = f"Restore it with version {manifest['software']}, then upgrade"
        raise ClinicError("the backup", found=found, expected=expected, remedy=remedy)
    call_command("loaddata", str(config.folder / DATABASE), verbosity=0)


def _digest(path: Path) -> str:
    digest = hashlib.sha256()
    with path.open("rb") as file:
        while chunk := file.read(_CHUNK):
            digest.update(chunk)
    return digest.hexdigest()
