"""Identifiers derived from content: the same session always has the same ones."""

from __future__ import annotations

import hashlib
import uuid

_NAMESPACE = uuid.UUID("6d616d6d-6f6d-5574-8279-646963006f6d")  # drawn once; never change it


def identifier(*parts: str) -> str:
    """Return a UUID of these words."""
    return str(_uuid(parts))


def uid(*parts: str) -> str:
    """Return a DICOM UID of these words. It lies below 2.25, the root for UUIDs (PS3.5, B.2)."""
    return f"2.25.{_uuid(parts).int}"


def _uuid(parts: tuple[str, ...]) -> uuid.UUID:
    return uuid.uuid5(_NAMESPACE, hashlib.sha256("\0".join(parts).encode()).hexdigest())
