"""Rows of a clinic's database as text, one per line: write, load into another database, compare.

The rows of an earlier version's backup are loaded into that version's tables, which are then migrated.
"""

import datetime
import hashlib
import io
import json
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any, BinaryIO, cast

from django.apps import apps as current
from django.apps.registry import Apps
from django.contrib.contenttypes.management import create_contenttypes
from django.core import serializers
from django.core.management.color import no_style
from django.core.serializers.json import DjangoJSONEncoder
from django.core.serializers.python import Deserializer
from django.db import connection, transaction
from django.db.migrations.executor import MigrationExecutor
from django.db.migrations.loader import MigrationLoader
from django.db.models import Model

from mammometry.clinic.config import ClinicError

_LEFT_OUT = ("sessions", "contenttypes", "axes")
"""Applications whose rows belong to the running server, such as logins and wrong passwords."""
_TIME = re.compile(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d(\.\d+)?(Z|[+-]\d\d:\d\d)")
_NATURAL = ("natural_key", "get_username", "USERNAME_FIELD")
"""Attributes of models that Django uses for natural keys, by which rows refer to people and tables."""
_READ_AT_ONCE = 500  # rows
_SHOWN_ROWS = 3  # number of different rows that the error lists


class RowEncoder(DjangoJSONEncoder):
    """Encodes a row's values as JSON. Unlike Django's own encoder, it keeps microseconds."""

    def default(self, o: Any) -> Any:
        """Encode types that JSON does not have."""
        return o.isoformat() if isinstance(o, datetime.datetime | datetime.time) else super().default(o)


def known_migrations() -> list[str]:
    """All migrations of this version, which create the tables for a backup's rows."""
    return sorted(f"{app} {name}" for app, name in MigrationLoader(None).disk_migrations)


def write_database(file: BinaryIO, tables: Apps = current) -> None:
    """Write all rows of a clinic, one per line, from one snapshot."""
    text = io.TextIOWrapper(file, encoding="utf-8", write_through=True)
    with _snapshot():
        for model in _kept_models(tables):
            rows = model._base_manager.order_by("pk").iterator(chunk_size=_READ_AT_ONCE)
            serializers.serialize("jsonl", rows, stream=text, use_natural_foreign_keys=True, cls=RowEncoder)
    text.detach()


def load_database(lines: Iterable[bytes], migrations: list[str], software: str) -> Apps:
    """Load rows into an empty database, with the tables of the version that wrote them.

    Args:
        lines: rows written by `write_database`, of this version or an earlier one.
        migrations: those that version knew (`known_migrations`).
        software: name of that version.

    Returns:
        The tables of that version, for `write_database`. `web.server.migrate` then upgrades them to this version.

    Raises:
        ClinicError: the rows are from a later version, or the database is not empty.
    """
    if later := sorted(set(migrations) - set(known_migrations())):
        raise ClinicError(
            "the backup", found=f"one of version {software}, with tables that are unknown here ({later[0]})",
            expected="one of this version or an earlier one", remedy=f"Restore it with version {software}",
        )  # fmt: skip
    tables = _tables_of(migrations)
    if tables.get_model("clinic", "Person")._base_manager.exists():
        raise _not_empty("a clinic in it")
    # The readers of natural keys look for them.
    for config in current.get_app_configs():
        create_contenttypes(config, verbosity=0, interactive=False)
    with transaction.atomic():  # references are checked when it ends
        late = []
        for row in _Reader(map(json.loads, lines), tables):
            row.save(force_insert=True)
            if row.deferred_fields:
                late.append(row)
        for row in late:
            row.save_deferred_fields()
        with connection.cursor() as cursor:
            for statement in connection.ops.sequence_reset_sql(no_style(), _kept_models(tables)):
                cursor.execute(statement)
    return tables


def digests_of(lines: Iterable[bytes]) -> dict[str, dict[str, bytes]]:
    """Table → key of each row → digest of its values."""
    found: dict[str, dict[str, bytes]] = {}
    for line in lines:
        row = json.loads(line)
        fields = {name: _same_time(value) for name, value in row["fields"].items()}
        content = json.dumps(fields, sort_keys=True).encode()
        found.setdefault(row["model"], {})[str(row["pk"])] = hashlib.sha256(content).digest()
    return found


def require_same(expected: Mapping[str, Mapping[str, bytes]], restored: Mapping[str, Mapping[str, bytes]]) -> None:
    """Refuse rows that differ from those of the backup.

    Args:
        expected: rows of the backup, from `digests_of`.
        restored: restored rows, from `digests_of`.

    Raises:
        ClinicError: names the first table that differs and some of its rows.
    """
    for table in sorted({*expected, *restored}):
        before, after = expected.get(table, {}), restored.get(table, {})
        wrong = sorted(key for key in {*before, *after} if before.get(key) != after.get(key))
        if wrong:
            counted = Counter(
                "lost" if key not in after else "new" if key not in before else "changed" for key in wrong
            )
            words = ", ".join(f"{number} {what}" for what, number in sorted(counted.items()))
            named = ", ".join(wrong[:_SHOWN_ROWS])
            raise ClinicError(
                "the restored clinic", found=f"other rows of {table}: {words}, such as {named}",
                expected=f"the {len(before)} of the backup",
                remedy="Make another backup, test it, and report it to the authors if it differs again",
            )  # fmt: skip


class _Reader(Deserializer):
    """Rows as objects of given tables."""

    def __init__(self, rows: Iterable[Any], tables: Apps) -> None:
        super().__init__(rows, handle_forward_references=True)
        self._tables = tables

    def _get_model_from_node(self, model_identifier: str) -> type[Model]:
        return self._tables.get_model(model_identifier)


def _tables_of(migrations: list[str]) -> Apps:
    """Create the tables of some migrations. Return their models."""
    executor = MigrationExecutor(connection)
    wanted = {(app, name) for app, _, name in (word.partition(" ") for word in migrations)}
    if set(executor.loader.applied_migrations) - wanted:
        raise _not_empty("tables of another version")
    nodes = executor.loader.graph.node_map
    last = [
        key
        for key in sorted(wanted)
        if not any(child.key in wanted and child.key[0] == key[0] for child in nodes[key].children)
    ]
    state = executor.migrate(last)
    if wanted == set(nodes):
        return current
    for model in state.apps.get_models():  # models of migrations have no methods for natural keys
        ours = current.get_model(model._meta.label) if _is_known(model) else None
        for name in _NATURAL if ours is not None else ():
            if hasattr(ours, name):
                setattr(model, name, getattr(ours, name))
    return cast(Apps, state.apps)


def _is_known(model: type[Model]) -> bool:
    return model._meta.model_name in current.all_models[model._meta.app_label]


def _not_empty(found: str) -> ClinicError:
    expected, remedy = "an empty database", "Give another with --database"
    return ClinicError("the database", found=found, expected=expected, remedy=remedy)


def _kept_models(tables: Apps) -> list[type[Model]]:
    chosen = [
        (config, list(config.get_models())) for config in tables.get_app_configs() if config.label not in _LEFT_OUT
    ]
    models = serializers.sort_dependencies(cast(Any, chosen), allow_cycles=True)
    return [model for model in models if model._meta.label != "auth.Permission" and not model._meta.proxy]


def _same_time(value: Any) -> Any:
    """A time in one format. Backups of earlier versions have 12:00:00.000Z for 12:00:00+00:00."""
    if isinstance(value, str) and _TIME.fullmatch(value):
        return datetime.datetime.fromisoformat(value).astimezone(datetime.UTC).isoformat()
    return value


@contextmanager
def _snapshot() -> Iterator[None]:
    """Context for reading one snapshot, without blocking writers."""
    if connection.in_atomic_block:
        yield
        return
    begin = "BEGIN ISOLATION LEVEL REPEATABLE READ READ ONLY" if connection.vendor == "postgresql" else "BEGIN"
    with connection.cursor() as cursor:
        cursor.execute(begin)
    try:
        yield
    finally:
        with connection.cursor() as cursor:
            cursor.execute("ROLLBACK")
