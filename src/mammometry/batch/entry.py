"""One session of a batch, and what its task takes of a worker."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field

MEMORY = "mammometry_mb"
"""Resource of a worker: memory that its tasks may take together, MB."""
CORES = "mammometry_cores"
"""Resource of a worker: cores that its tasks may take together."""
_ADDRESS = re.compile(r"[a-z][a-z0-9+]*://")


@dataclass(frozen=True, slots=True, kw_only=True)
class Entry:
    """One session of a batch."""

    address: str
    """Folder, absolute. Or address of a folder on other storage, as ``s3://bucket/patients/17``."""
    assignments: tuple[str, ...] = ()
    """Settings of this session alone, ``NAME=VALUE``."""
    reference_cc: Mapping[str, float] = field(default_factory=dict)
    """``model``, ``left`` or ``right`` → volume by another method, cc."""
    results: str | None = None
    """Address of the folder that holds its results. None: in the session."""

    @property
    def remote(self) -> bool:
        """Whether photographs are fetched and results sent back. Workers cannot see such a folder."""
        return is_address(self.address) or self.results is not None

    @property
    def name(self) -> str:
        """The last part of its address."""
        return self.address.rstrip("/").rpartition("/")[2]


def is_address(text: str) -> bool:
    """Whether this is storage by fsspec, not a folder."""
    return _ADDRESS.match(text) is not None
