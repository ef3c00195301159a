"""Django's admin, for administrators: people and the audit."""

from __future__ import annotations

from typing import Any

from django.contrib import admin
from django.http import HttpRequest

from mammometry.clinic.roles import Role


class Administration(admin.AdminSite):
    """Open to active administrators.

    Its login is everybody's.
    """

    site_header = site_title = "Administration"
    index_title = "People and audit"
    site_url = "/"

    def register(self, model_or_iterable: Any, admin_class: Any = None, **options: Any) -> None:
        """Show our own tables and the audit.

        What other applications would show here stays out.
        """
        models = model_or_iterable if isinstance(model_or_iterable, list | tuple) else [model_or_iterable]
        for model in models:
            if model._meta.label in ("clinic.Person", "auditlog.LogEntry"):
                super().register(model, admin_class, **options)

    def has_permission(self, request: HttpRequest) -> bool:
        """Whether an active administrator asks."""
        person: Any = request.user
        return bool(person.is_active and person.is_authenticated and person.has_role(Role.ADMINISTRATOR))
