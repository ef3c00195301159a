"""What the tests of lost power, full disks and killed runs share."""

import os

import pytest


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Sync nothing really: the recording alone says what was synced."""
    monkeypatch.setattr(os, "fsync", lambda descriptor: None)
