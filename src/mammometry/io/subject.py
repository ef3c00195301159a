"""Check that all files of a session or mesh are of the same subject, and correct a wrong subject."""

import datetime
import json
import re
import shutil
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from mammometry.base.errors import SessionError
from mammometry.base.identity import one_subject
from mammometry.base.listing import visible
from mammometry.base.parse import json_value, read_text
from mammometry.io.manifest import MANIFEST
from mammometry.io.meshes.scans import ABOUT
from mammometry.io.results.stamp import subject_of_mesh
from mammometry.io.write import disk_errors, write_text

_DRAWN = ("boundaries.json", "landmarks.json")
_IN_MANIFEST = re.compile(r'(?ms)^(\[subject\]\n(?:(?!\[).)*?)(?:^id = "[^"\n]*"\n|\Z)')
_IN_SCAN = re.compile(r'(?m)^subject = "[^"\n]*"\n')
_DATE = re.compile(r"(?m)^date = \d{4}-\d{2}-\d{2}\n")


def check_session(session: Path, subject: str | None) -> None:
    """Refuse drawings or results of another subject than the one in session.toml.

    Cameras and priors belong to the rig and are not checked.

    Raises:
        SessionError: two identifiers differ. It names both files.
    """
    files = [*(session / name for name in _DRAWN), *_history(session)]
    sources = [*_drawn(files), *_in_results(session / "results")]
    named = [(path.relative_to(session).as_posix(), name) for path, name in sources]
    one_subject(
        [(MANIFEST, subject), *named],
        remedy="If these are new photographs, delete results/ and the earlier subject's drawings, and run "
        f"again. Otherwise correct subject.id in {MANIFEST}",
    )


def check_mesh(mesh: Path, files: Iterable[Path | None], folder: Path, subject: str | None) -> None:
    """Refuse a mesh, drawings or earlier results of another subject than `subject`.

    Raises:
        SessionError: two identifiers differ. It names both files.
    """
    sources = [(mesh, subject_of_mesh(mesh)), *_drawn(filter(None, files)), *_in_results(folder)]
    one_subject(
        [("--id", subject), *((str(path), name) for path, name in sources)],
        remedy="If this is another subject's mesh, give its own drawings and another --out. Otherwise correct --id",
    )


def rename_subject(folder: Path, subject: str, taken: datetime.date) -> bool:
    """Change subject and date of a session or scan, and remove results of the former subject.

    Photographs, mesh and drawn points remain unchanged, so the same numbers will be measured again.

    Args:
        folder: a session made by `capture.sessions`, or a scan. Other folders are not changed.
        subject: the right identifier.
        taken: date of the photographs.

    Returns:
        Whether anything was changed.

    Raises:
        StorageError: the disk is full or reports an error.
    """
    path = folder / (ABOUT if (folder / ABOUT).is_file() else MANIFEST)
    if not path.is_file():
        return False
    with disk_errors(folder):
        text = path.read_text(encoding="utf-8")
        if path.name == ABOUT:
            dated = text
            named = _IN_SCAN.sub(f'subject = "{subject}"\n', text)
        else:
            dated = _DATE.sub(f"date = {taken.isoformat()}\n", text)
            named = _IN_MANIFEST.sub(rf'\g<1>id = "{subject}"\n', dated, count=1)
        if named == text:
            return False
        # Results are removed first, so that none shows the former subject after a power failure.
        gone = folder / "results" if named != dated else folder / "results" / "report"
        if gone.exists():
            shutil.rmtree(gone)
        for drawn in (*(folder / name for name in _DRAWN), *_history(folder)):
            table = _table(drawn)
            if _subject(table) not in (None, subject):
                write_text(drawn, json.dumps({**table, "subject": subject}, indent=1, ensure_ascii=False) + "\n")
        write_text(path, named)
    return True


def _history(session: Path) -> list[Path]:
    return [path for path in visible(session / "history") if path.suffix == ".json"]


def _drawn(files: Iterable[Path]) -> Iterator[tuple[Path, str | None]]:
    """Each drawn file with its subject. Other content is not checked here."""
    return ((path, _subject(_table(path))) for path in files)


def _in_results(folder: Path) -> Iterator[tuple[Path, str]]:
    """Each record in a results folder, with the subject of its products."""
    for path in sorted(folder.glob("*/provenance.json")):
        products = _table(path).get("products")
        records = products.values() if isinstance(products, dict) else ()
        for subject in sorted({found for found in map(_subject, records) if found is not None}):
            yield path, subject


def _table(path: Path) -> dict[str, Any]:
    try:
        table = json_value(read_text(path, path.name, "JSON"), path.name, "JSON", finite=False)
    except SessionError:
        return {}
    return table if isinstance(table, dict) else {}


def _subject(table: object) -> str | None:
    subject = table.get("subject") if isinstance(table, dict) else None
    return subject if isinstance(subject, str) else None
