"""How long a browser test waits before it fails."""

from typing import TypeVar

from playwright.sync_api import BrowserContext, Page, expect

PATIENCE_MS = 120_000
"""A page answers in a second on a quiet machine, and has taken 30 s on two cores beside ten busy processes. A test that
waits asserts what a page shows, not how fast it is."""

_Opened = TypeVar("_Opened", Page, BrowserContext)


def patient(opened: _Opened) -> _Opened:
    """The same page or context, whose actions and assertions wait for `PATIENCE_MS`."""
    opened.set_default_timeout(PATIENCE_MS)
    expect.set_options(timeout=PATIENCE_MS)
    return opened
