"""What browser tests of the clinic share: logins, and judges of a page."""

from pathlib import Path
from typing import Any

from django.test import Client
from playwright.sync_api import Page

AXE = Path(__file__).resolve().parents[1] / "build" / "axe.min.js"
"""axe-core, as `hatch_build.py` puts it there."""
CHROMIUM_FLAGS = [
    *("--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"),
    *("--disable-background-networking", "--disable-component-update", "--disable-sync", "--no-first-run"),
]
_RULES = ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa", "best-practice"]


def cookies_of(client: Client, address: str) -> list[Any]:
    """The cookies of a client that is logged in, for a browser."""
    return [{"name": name, "value": morsel.value, "url": address} for name, morsel in client.cookies.items()]


def require_accessible(page: Page) -> None:
    """Fail where axe-core finds a violation of WCAG 2.2 AA on the page."""
    session = page.context.new_cdp_session(page)  # a script tag would be against the page's policy
    session.send("Runtime.evaluate", {"expression": AXE.read_text(encoding="utf-8")})
    found = page.evaluate(
        "rules => axe.run(document, {runOnly: rules}).then(told => told.violations.map("
        "each => `${each.id}: ${each.help}: ${each.nodes.map(node => node.target.join(' ')).join(', ')}`))",
        _RULES,
    )
    session.detach()
    assert found == [], page.url


def require_fitting(page: Page) -> None:
    """Fail where the page is wider than the window."""
    assert page.evaluate("document.documentElement.scrollWidth <= window.innerWidth"), page.url
