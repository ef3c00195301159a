"""What all tables share: a key that cannot be guessed."""

from __future__ import annotations

import uuid
from typing import ClassVar

from django.db import models


class Keyed(models.Model):
    """A row with a random key."""

    id = models.UUIDField(primary_key=True, default=uuid.uuid4, editable=False)

    class Meta:
        abstract: ClassVar[bool] = True
