"""Make the pictures of the documentation from what our own commands drew.

    mammometry demo CAST
    mammometry simulate TORSO --subject torso_2 --seed 7
    mammometry run TORSO
    mammometry demo SCAN --scan
    python -m tools.gallery CAST TORSO SCAN

writes docs/img/demo-overview.jpg, docs/img/demo-scan.jpg (the head of the scan's report, in Chromium) and the ten
pictures of "How a volume comes about" to docs/img/volume/.
"""

from __future__ import annotations

import argparse
import io
import shutil
from pathlib import Path

from PIL import Image
from playwright.sync_api import sync_playwright

PICTURES = Path(__file__).resolve().parents[1] / "docs" / "img"
WIDTH_PX, QUALITY = 1000, 72
"""Of a picture: letters stay readable, and it takes 40 to 90 kB."""
REPORT_WH = (1220, 900)
"""Window in which the scan's report is opened."""
TEN = (
    "calibrate/rig",
    "calibrate/detections",
    "match/foreground",
    "match/rectified",
    "match/disparity",
    "surface/range",
    "surface/dents",
    "surface/repair",
    "measure/overview",
    "measure/closed-left",
)
"""Pictures of a session's results, in the order of the page."""


def write(picture: Image.Image, path: Path) -> None:
    """Write a small JPEG without tags."""
    picture = picture.convert("RGB")
    picture.thumbnail((WIDTH_PX, WIDTH_PX * 2), Image.Resampling.LANCZOS)
    path.parent.mkdir(parents=True, exist_ok=True)
    picture.save(path, quality=QUALITY, optimize=True)


def head_of_report(page: Path) -> Image.Image:
    """What a report shows first, in a browser, with its surface turned to the front."""
    with sync_playwright() as playwright:
        flags = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=flags)
        tab = browser.new_page(viewport={"width": REPORT_WH[0], "height": REPORT_WH[1]})
        tab.goto(page.resolve().as_uri())
        tab.wait_for_function("document.getElementById('mm-viewer').dataset.ready === '1'", timeout=120_000)
        picture = Image.open(io.BytesIO(tab.screenshot()))
        browser.close()
    return picture


def main() -> None:
    """Make all pictures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("cast", type=Path, help="session of the demo")
    parser.add_argument("torso", type=Path, help="session of a virtual patient")
    parser.add_argument("scan", type=Path, help="scan of the demo")
    arguments = parser.parse_args()
    write(Image.open(arguments.cast / "results" / "measure" / "overview.png"), PICTURES / "demo-overview.jpg")
    for number, name in enumerate(TEN, 1):
        picture = Image.open(arguments.torso / "results" / f"{name}.png")
        write(picture, PICTURES / "volume" / f"{number:02}-{name.partition('/')[2]}.jpg")
    write(head_of_report(arguments.scan / "results" / "report" / "report.html"), PICTURES / "demo-scan.jpg")


if __name__ == "__main__":
    main()
