"""The clinic's only Django application."""

from django.apps import AppConfig
from django.db.models.signals import post_migrate


class ClinicApp(AppConfig):
    """Registers the audited models, and seals the audit after each migration."""

    name = "mammometry.clinic"
    label = "clinic"
    default_auto_field = "django.db.models.BigAutoField"

    def ready(self) -> None:
        """Called by Django when all models are loaded."""
        from mammometry.clinic import audit

        audit.watch_models()
        post_migrate.connect(_seal_audit, sender=self)


def _seal_audit(**_: object) -> None:
    from django.db import connection

    from mammometry.clinic import audit

    if audit.TABLE in connection.introspection.table_names():
        audit.seal()
