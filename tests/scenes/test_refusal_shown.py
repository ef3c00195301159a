"""A run that ends in a refusal shows what was seen, until it ends otherwise."""

import json
from html import unescape
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from mammometry.api.job import open_session
from mammometry.base.errors import CalibrationError, MammometryError, MatchingError, MeasureError, SurfaceError
from mammometry.cli import main
from mammometry.settings import Settings

ALL_AROUND = "measure.base_rim.minimum_sectors=72"  # of 72: no rim is seen so well


@pytest.mark.slow
def test_the_refusal_of_a_measurement_has_a_page_until_it_is_measured(
    tiny_finished: Path, tiny_settings: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    settings = Settings.load(tiny_settings)
    page = tiny_finished / "results" / "refused" / "refused.html"
    with pytest.raises(MeasureError) as refused:
        open_session(tiny_finished, settings.overridden([ALL_AROUND])).measure()
    assert refused.value.page == page
    shown = page.read_text()
    assert refused.value.found in shown
    assert shown.count("<figure>") == 2  # the surface and the silhouettes
    assert "No boundary was found on it" in shown

    arguments = ["measure", str(tiny_finished), "--settings", str(tiny_settings), "--set", ALL_AROUND, "--json"]
    assert main.run(arguments) == MeasureError.exit_code
    said = capsys.readouterr()
    assert json.loads(said.out or said.err)["page"] == str(page)

    open_session(tiny_finished, settings).measure()
    assert not page.exists()


@pytest.mark.slow
def test_what_hinders_the_page_does_not_hide_the_refusal(tiny_finished: Path, tiny_settings: Path) -> None:
    mine = tiny_finished / "results" / "refused" / "refused.html"
    mine.parent.mkdir()
    mine.write_text("somebody's own")
    with pytest.raises(MeasureError, match="model") as refused:
        open_session(tiny_finished, Settings.load(tiny_settings).overridden([ALL_AROUND])).measure()
    assert refused.value.page is None
    assert mine.read_text() == "somebody's own"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("asked", "refusal", "shown"),
    [
        # Nobody knows a focal length so well; no skin faces a camera so exactly.
        ("calibration.quality.focal_std_refuse=1e-9", CalibrationError, ["The target"]),
        ("surface.dents.angle_deg=0.001", SurfaceError, ["Foreground", "Rectified pairs", "Disparity", "Confidence"]),
    ],
)
def test_a_refusal_before_the_measurement_shows_what_its_stage_saw(
    tiny: Path, tiny_settings: Path, asked: str, refusal: type[MammometryError], shown: list[str]
) -> None:
    with pytest.raises(refusal) as refused:
        open_session(tiny, Settings.load(tiny_settings).overridden([asked])).run()
    _holds(refused.value, shown)


@pytest.mark.slow
def test_photographs_without_a_flash_are_shown_where_they_are_refused(tiny: Path, tiny_settings: Path) -> None:
    for number, path in enumerate(sorted((tiny / "capture").rglob("*.*"))):
        with Image.open(path) as photograph:
            dark = np.full_like(np.asarray(photograph), 2 + number)  # no photograph is another camera's
        Image.fromarray(dark).save(path)
    with pytest.raises(MatchingError) as refused:
        open_session(tiny, Settings.load(tiny_settings)).run()
    assert "black" in refused.value.found
    assert "flash" in refused.value.remedy
    _holds(refused.value, ["The photographs"])


def _holds(error: MammometryError, shown: list[str]) -> None:
    """The page says what was found, and has a picture of each title."""
    assert error.page is not None
    page = unescape(error.page.read_text()).replace("\u00a0", " ")
    assert error.found in page
    assert error.remedy in page
    assert page.count("<figure>") == len(shown)
    for title in shown:
        assert title in page
