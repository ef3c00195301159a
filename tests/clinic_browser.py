"""What browser tests of the clinic share: logins, and judges of a page."""

import json
import subprocess
import sys
from pathlib import Path

from playwright.sync_api import Browser, Page
from tests.patience import patient

AXE = Path(__file__).resolve().parents[1] / "build" / "axe.min.js"
"""axe-core, as `hatch_build.py` puts it there."""
CHROMIUM_FLAGS = [
    *("--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"),
    *("--disable-background-networking", "--disable-component-update", "--disable-sync", "--no-first-run"),
]
_RULES = ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa", "best-practice"]


def cookies(folder: Path) -> dict[str, str]:
    """Role → a login of a clinic, which is made where there is none."""
    words = [sys.executable, "-m", "tests.clinic_seed", str(folder)]
    done = subprocess.run(words, capture_output=True, text=True, check=False, timeout=120, cwd=AXE.parents[1])
    assert done.returncode == 0, done.stderr
    found: dict[str, str] = json.loads(done.stdout)
    return found


def opened(browser: Browser, address: str, login: str, *, width: int, height: int = 900) -> Page:
    """A window of somebody who is logged in; ``page.wrong`` holds what goes wrong in its scripts."""
    # Without motion: a button that fades from one state to the next has neither state's contrast.
    context = patient(
        browser.new_context(viewport={"width": width, "height": height}, base_url=address, reduced_motion="reduce")
    )
    context.add_cookies([{"name": "clinic-session", "value": login, "url": address}])
    page = context.new_page()
    wrong: list[str] = []
    page.wrong = wrong  # type: ignore[attr-defined]
    page.on("pageerror", lambda error: wrong.append(str(error)))
    page.on("console", lambda said: wrong.append(said.text) if "Content Security Policy" in said.text else None)
    return page


def require_accessible(page: Page) -> None:
    """Fail where axe-core finds a violation of WCAG 2.2 AA on the page."""
    wrong = list(page.wrong)  # type: ignore[attr-defined]
    session = page.context.new_cdp_session(page)  # a script tag would be against the page's policy
    session.send("Runtime.evaluate", {"expression": AXE.read_text(encoding="utf-8")})
    found = page.evaluate(
        "rules => axe.run(document, {runOnly: rules}).then(told => told.violations.map("
        "each => `${each.id}: ${each.help}: ${each.nodes.map(node => node.target.join(' ')).join(', ')}`))",
        _RULES,
    )
    session.detach()
    page.wrong[:] = wrong  # type: ignore[attr-defined] # axe itself tries inline styles on some pages
    assert found == [], f"{page.url}: {found}"


def require_fitting(page: Page) -> None:
    """Fail where the page is wider than the window."""
    assert page.evaluate("document.documentElement.scrollWidth <= window.innerWidth"), page.url
