"""What the tests of lost power, full disks and killed runs share."""

import os

import pytest
from tests.scenes.conftest import (
    tiny,
    tiny_demo,
    tiny_finished,
    tiny_finished_original,
    tiny_original,
    tiny_settings,
)

__all__ = ["tiny", "tiny_demo", "tiny_finished", "tiny_finished_original", "tiny_original", "tiny_settings"]


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Sync nothing really: the recording alone says what was synced."""
    monkeypatch.setattr(os, "fsync", lambda descriptor: None)
