"""Entries of the audit's table cannot be changed: triggers refuse it (`audit.seal`)."""

from django.apps.registry import Apps
from django.db import migrations
from django.db.backends.base.schema import BaseDatabaseSchemaEditor

from mammometry.clinic import audit


def _seal(apps: Apps, schema_editor: BaseDatabaseSchemaEditor) -> None:
    audit.seal()


class Migration(migrations.Migration):
    """Adds the triggers.

    They are added again after each migration, because SQLite recreates changed tables.
    """

    dependencies = [("clinic", "0001_initial"), ("auditlog", "0017_add_actor_email")]
    operations = [migrations.RunPython(_seal, migrations.RunPython.noop)]
