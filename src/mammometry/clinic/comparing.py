"""Comparison of two dates of one patient.

It is made once and kept beside the later visit.
"""

from __future__ import annotations

import json
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from threading import Lock
from typing import Any

from mammometry.base.errors import MammometryError
from mammometry.clinic.models import Visit
from mammometry.clinic.site import the_clinic

_KEY = "clinic.json"
"""Which measurements a comparison is of, beside its page."""


class Comparer:
    """Compares one pair of visits after the other.

    What is lost with the process is compared again when asked for.
    """

    def __init__(self) -> None:
        self._lock = Lock()
        self._pool = ThreadPoolExecutor(max_workers=1, thread_name_prefix="compare")
        self._under_way: dict[str, Future[None]] = {}

    def state(self, before: Visit, after: Visit) -> tuple[str, Any]:
        """How far the comparison is, begun now if it was not.

        Returns:
            ``("done", content of compare.json)``, ``("busy", None)`` or ``("refused", sentence)``.
        """
        key = comparison_key(before, after)
        folder = comparison_folder(before, after)
        table = _kept(folder, key)
        if table is not None:
            return "done", table
        with self._lock:
            running = self._under_way.get(key)
            if running is None:
                self._under_way[key] = self._pool.submit(_compare, before.folder, after.folder, folder, key)
                return "busy", None
            if not running.done():
                return "busy", None
            del self._under_way[key]
        error = running.exception()
        if isinstance(error, MammometryError):
            return "refused", str(error).replace(f"{the_clinic().folder}/", "")  # where it lies is nobody's business
        if error is not None:
            raise error
        table = _kept(folder, key)
        return ("busy", None) if table is None else ("done", table)


COMPARER = Comparer()


def comparison_folder(before: Visit, after: Visit) -> Path:
    """Where the comparison is kept."""
    return after.folder / "results" / "compare" / str(before.pk)


def comparison_key(before: Visit, after: Visit) -> str:
    """Changes when one of both is measured again."""
    measured = [visit.measurements.first() for visit in (before, after)]
    return " ".join(
        f"{visit.pk}:{'' if one is None else one.digest}" for visit, one in zip((before, after), measured, strict=True)
    )


def _compare(before: Path, after: Path, folder: Path, key: str) -> None:
    from mammometry.api.dates import compare
    from mammometry.io.write import write_text

    compare(before, after, the_clinic().measuring(), out=folder)
    write_text(folder / _KEY, json.dumps({"of": key}))


def _kept(folder: Path, key: str) -> Any:
    try:
        if json.loads((folder / _KEY).read_text(encoding="utf-8"))["of"] != key:
            return None
        return json.loads((folder / "compare.json").read_text(encoding="utf-8"))
    except (OSError, ValueError, KeyError, TypeError):
        return None
