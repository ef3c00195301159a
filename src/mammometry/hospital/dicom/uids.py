"""Identifiers derived from content: the same session always has the same ones."""

from __future__ import annotations

import hashlib
import uuid

_NAMESPACE = uuid.UUID("6d616d6d-6f6d-5574-8279-646963006f6d")  # "mammometrydicom" with a UUID's version and variant


def uid(*parts: str) -> str:
    """Return a UID below 2.25, the root for UUIDs (PS3.5, B.2), of these words."""
    name = hashlib.sha256("\0".join(parts).encode()).hexdigest()
    return f"2.25.{uuid.uuid5(_NAMESPACE, name).int}"
