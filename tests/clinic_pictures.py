"""Takes pictures of every page of a clinic, at three widths, to be looked at: by hand.

``mammometry clinic demo DIR --no-serve``, then ``python -m tests.clinic_pictures DIR OUT``. With ``--guides`` those of
the how-to pages are made anew as well. The clinic gets a login for each role, so take a demo.
"""

import argparse
import io
import shutil
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from PIL import Image
from playwright.sync_api import Browser, Page, sync_playwright
from tests.clinic_browser import CHROMIUM_FLAGS, cookies, opened
from tests.clinic_server import served
from tests.telephone_pictures import drop

from mammometry.simulate.walk import PHOTOGRAPHS, WalkRecipe, write_walk

WIDTHS = (360, 820, 1440)
GUIDES = Path(__file__).resolve().parents[1] / "docs" / "how-to" / "pictures" / "clinic"
GUIDE_WH = (1000, 1150)
"""Window of the how-to pages' pictures: their text is read at the width of a page."""
QUALITY = 60  # of WebP: letters stay clear, and a picture takes about 40 kB
_SKIPPED = ("/static", ".pdf", ".csv", ".json", ".png", "/report/", "logout")


def kind_of(path: str) -> str:
    """A path without keys and numbers: pages of one kind look alike."""
    parts = path.partition("?")[0].split("/")
    return "/".join("x" if len(part) == 36 or part.isdigit() else part for part in parts)


def walk(page: Page) -> Iterator[tuple[str, str]]:
    """Kind and path of every page that links lead to, one of each kind."""
    kinds, waiting = {""}, ["/"]
    while waiting:
        path = waiting.pop(0)
        page.goto(path)
        yield path, kind_of(path)
        for link in page.locator("a[href^='/']").evaluate_all("all => all.map(each => each.getAttribute('href'))"):
            kind = kind_of(link)
            if kind not in kinds and not any(each in kind for each in _SKIPPED):
                kinds.add(kind)
                waiting.append(link)


def settle(page: Page) -> None:
    """Wait until the surface is drawn, where there is one."""
    page.wait_for_load_state("networkidle")
    if page.locator("#mm-viewer").count():
        page.locator("#mm-viewer[data-ready]:not([data-ready='0'])").wait_for(timeout=120_000)


def pictures(browser: Browser, address: str, logins: dict[str, str], out: Path) -> int:
    """Take every page for every role; how many pictures."""
    taken = 0
    for role, login in logins.items():
        page = opened(browser, address, login, width=WIDTHS[-1])
        for _, kind in walk(page):
            settle(page)
            for width in WIDTHS:
                page.set_viewport_size({"width": width, "height": 900})
                name = kind.strip("/").replace("/", "-") or "home"
                page.screenshot(path=out / f"{role}-{name}-{width}.png", full_page=True)
                taken += 1
        if page.wrong:  # type: ignore[attr-defined]
            sys.stderr.write(f"{role}: {page.wrong}\n")  # type: ignore[attr-defined]
        page.context.close()
    return taken


def guides(browser: Browser, address: str, logins: dict[str, str]) -> None:
    """Make the how-to pages' pictures anew."""
    width, height = GUIDE_WH

    def take(page: Page, name: str) -> None:
        settle(page)
        shot = Image.open(io.BytesIO(page.screenshot()))
        shot.convert("RGB").save(GUIDES / f"{name}.webp", quality=QUALITY, method=6)

    page = opened(browser, address, logins["technician"], width=width, height=height)
    page.goto("/")
    take(page, "today")
    page.get_by_role("link", name="Room 1").first.click()
    take(page, "rig")
    page.goto("/patients/?q=ahrens")
    page.locator("#rows a").first.click()
    take(page, "patient")
    page.get_by_role("main").locator("tbody a").first.click()
    take(page, "result")
    page.goto(f"{page.url}?photographs=1")
    take(page, "photographs")
    telephone(page)
    take(page, "telephone")
    page.context.close()
    page = opened(browser, address, logins["researcher"], width=width, height=height)
    page.goto("/study/")
    take(page, "study")
    page.context.close()
    page = opened(browser, address, logins["administrator"], width=width, height=height)
    page.goto("/people/new/")
    take(page, "person")
    page.context.close()


def telephone(page: Page) -> None:
    """Begin a visit with a telephone, and send the photographs of a virtual walk."""
    page.goto("/visits/telephone/?q=ahrens")
    page.locator("#rows a").first.click()
    page.get_by_role("button", name="Go on to the photographs").click()
    with tempfile.TemporaryDirectory() as folder:
        write_walk(Path(folder) / "walk", WalkRecipe(seed=0, scale=0.3))
        files = sorted((Path(folder) / "walk" / PHOTOGRAPHS).glob("*.jpg"))
        drop(page, [path.rename(path.with_name(f"IMG_41{path.stem}.JPG")) for path in files])
        page.locator(".place.good").nth(len(files) - 1).wait_for()
    page.locator("#h-shots").evaluate("heading => heading.scrollIntoView()")


def main() -> None:
    """Serve the clinic, and take its pictures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("clinic", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--guides", action="store_true", help="make those of the how-to pages anew")
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    logins = cookies(given.clinic)
    with served(given.clinic, "--no-jobs") as (address, _), sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=CHROMIUM_FLAGS)
        if given.guides:
            guides(browser, f"http://{address}", logins)
        taken = pictures(browser, f"http://{address}", logins, given.out)
        browser.close()
    sys.stdout.write(f"{taken} pictures in {given.out}\n")


if __name__ == "__main__":
    main()
