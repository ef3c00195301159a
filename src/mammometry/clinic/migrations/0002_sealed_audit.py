"""The audit's table is only added to. Triggers of the database refuse changes (`audit.seal`)."""

from django.apps.registry import Apps
from django.db import migrations
from django.db.backends.base.schema import BaseDatabaseSchemaEditor

from mammometry.clinic import audit


def _seal(apps: Apps, schema_editor: BaseDatabaseSchemaEditor) -> None:
    audit.seal()


class Migration(migrations.Migration):
    """Puts the triggers there.

    They are put there again after each migration, as SQLite makes changed tables anew.
    """

    dependencies = [("clinic", "0001_initial"), ("auditlog", "0017_add_actor_email")]
    operations = [migrations.RunPython(_seal, migrations.RunPython.noop)]
