"""Subject of one session's or one mesh's files.

Two different subjects are refused.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from mammometry.base.errors import SessionError
from mammometry.base.identity import one_subject
from mammometry.base.parse import json_value, read_text
from mammometry.io.manifest import MANIFEST
from mammometry.io.results.stamp import subject_of_mesh

_DRAWN = ("boundaries.json", "landmarks.json")


def check_session(session: Path, subject: str | None) -> None:
    """Refuse drawings or results of another subject than session.toml names.

    Cameras and priors are the rig's, and may come from anybody's session.

    Raises:
        SessionError: two different identifiers; names both files.
    """
    files = [*(session / name for name in _DRAWN), *sorted((session / "history").glob("*.json"))]
    sources = [*_drawn(files), *_in_results(session / "results")]
    named = [(path.relative_to(session).as_posix(), found) for path, found in sources]
    one_subject(
        [(MANIFEST, subject), *named],
        remedy="If these are new photographs, delete results/ and what was drawn on the earlier subject, and run "
        f"again; if not, correct subject.id in {MANIFEST}",
    )


def check_mesh(mesh: Path, files: Iterable[Path | None], folder: Path, subject: str | None) -> None:
    """Refuse mesh, drawings or earlier results of another subject than `subject`.

    Raises:
        SessionError: two different identifiers; names both files.
    """
    sources = [(mesh, subject_of_mesh(mesh)), *_drawn(filter(None, files)), *_in_results(folder)]
    one_subject(
        [("--subject", subject), *((str(path), found) for path, found in sources)],
        remedy="If this is another subject's mesh, give its own drawings and another --out; if not, correct --subject",
    )


def _drawn(files: Iterable[Path]) -> Iterator[tuple[Path, str | None]]:
    """Each file that was drawn with its subject.

    Whoever reads the whole file judges the rest.
    """
    return ((path, _subject(_table(path))) for path in files)


def _in_results(folder: Path) -> Iterator[tuple[Path, str]]:
    """Every record file of a results folder, with its products' subjects."""
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
    found = table.get("subject") if isinstance(table, dict) else None
    return found if isinstance(found, str) else None
