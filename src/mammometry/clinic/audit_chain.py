"""The chain of the audit: each entry has a digest of itself and of the previous digest.

A changed, removed or inserted entry breaks the chain from there on. Entries are chained some seconds after they are
written, and before each backup. Every backup contains the last digest, so that even a database administrator cannot
start a new chain unnoticed (docs/dossier/security.md).
"""

import datetime
import hashlib
import json
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import islice
from typing import Any, TypeVar

from auditlog.models import LogEntry
from django.contrib.contenttypes.models import ContentType
from django.db import connection, transaction
from django.db.models import Exists, Max, OuterRef

from mammometry.clinic.config import ClinicError
from mammometry.clinic.models import AuditLink

_AT_ONCE = 1000  # entries read at a time
_LATE = 10_000  # number of latest entries that are searched: far more than are written at the same time
_LOCK = 7_013_311  # key of PostgreSQL's advisory lock: any number that is not used elsewhere
_Row = TypeVar("_Row")


@dataclass(frozen=True, slots=True)
class ChainEnd:
    """Last link of the chain."""

    place: int
    """Number of links. 0: none."""
    digest: str


def extend(*, every: bool = True) -> ChainEnd:
    """Chain all entries that are not chained yet. Return the last link.

    Args:
        every: search all entries. False: only the latest ones, which is always quick.
    """
    new = LogEntry.objects.filter(~Exists(AuditLink.objects.filter(entry=OuterRef("pk")))).order_by("pk")
    if not every:
        latest = AuditLink.objects.aggregate(latest=Max("entry"))["latest"] or 0
        new = new.filter(pk__gt=latest - _LATE)  # a number may be assigned long before its entry is visible
    if not new.exists():
        return _end()
    with transaction.atomic():
        if connection.vendor == "postgresql":  # SQLite allows only one writing transaction
            with connection.cursor() as cursor:
                cursor.execute("SELECT pg_advisory_xact_lock(%s)", [_LOCK])
        end = _end()
        for some in _batched(_contents(new)):
            links = []
            for key, content in some:
                end = ChainEnd(end.place + 1, _next(end.digest, content))
                links.append(AuditLink(place=end.place, entry=key, digest=end.digest))
            AuditLink.objects.bulk_create(links)
        return end


def verify(expected: ChainEnd | None = None) -> ChainEnd:
    """Check every link against its entry. Return the last link.

    Args:
        expected: a link that must be in the chain, such as the last one of a backup.

    Raises:
        ClinicError: an entry was changed or removed, or links are missing.
    """
    found = ChainEnd(0, "")
    is_there = expected is None or expected.place == 0
    for some in _batched(AuditLink.objects.order_by("place").iterator(chunk_size=_AT_ONCE)):
        contents = dict(_contents(LogEntry.objects.filter(pk__in=[link.entry for link in some])))
        for link in some:
            content = contents.get(link.entry)
            if link.place != found.place + 1:
                raise _broken(f"no link {found.place + 1}")
            if content is None:
                raise _broken(f"entry {link.entry} is gone")
            if link.digest != _next(found.digest, content):
                raise _broken(f"entry {link.entry}, or an earlier one, was changed")
            found = ChainEnd(link.place, link.digest)
            is_there = is_there or found == expected
    if not is_there:
        raise _broken("a different chain from the newest backup")
    return found


def _end() -> ChainEnd:
    last = AuditLink.objects.order_by("-place").first()
    return ChainEnd(0, "") if last is None else ChainEnd(last.place, last.digest)


def _next(before: str, content: bytes) -> str:
    return hashlib.sha256(before.encode() + content).hexdigest()


def _contents(entries: Any) -> Iterator[tuple[int, bytes]]:
    """Key and canonical bytes of entries, the same for both kinds of database and after a restore."""
    kinds: dict[int, str] = {}
    fields = [field.attname for field in LogEntry._meta.concrete_fields]
    for values in entries.values(*fields).iterator(chunk_size=_AT_ONCE):
        kind = values.pop("content_type_id")  # this number differs between databases
        if kind not in kinds:
            kinds[kind] = ".".join(ContentType.objects.get_for_id(kind).natural_key())
        content = json.dumps({**values, "content_type": kinds[kind]}, sort_keys=True, default=_plain)
        yield values["id"], content.encode()


def _batched(rows: Iterable[_Row]) -> Iterator[list[_Row]]:
    iterator = iter(rows)
    while some := list(islice(iterator, _AT_ONCE)):
        yield some


def _plain(value: object) -> str:
    if isinstance(value, datetime.datetime):
        return value.astimezone(datetime.UTC).isoformat(timespec="microseconds")
    return str(value)


def _broken(found: str) -> ClinicError:
    return ClinicError(
        "the audit", found=found, expected="unchanged entries in an unbroken chain",
        remedy="The database was changed by other means: find out by whom, and compare with the backups",
    )  # fmt: skip
