"""What all tables share: a key that cannot be guessed."""

from __future__ import annotations

import uuid
from typing import ClassVar, TypeVar

from django.db import models

Row = TypeVar("Row", bound=models.Model)


class Keyed(models.Model):
    """A row with a random key."""

    id = models.UUIDField(primary_key=True, default=uuid.uuid4, editable=False)

    class Meta:
        abstract: ClassVar[bool] = True


class InUse(models.Manager[Row]):
    """Rows that are not in the bin.

    It is the default, so that no page shows what is in the bin. Backup, export, erasure and corrections take
    ``everything``.
    """

    def get_queryset(self) -> models.QuerySet[Row]:
        """Leave out the bin."""
        return super().get_queryset().filter(binned_at=None)
