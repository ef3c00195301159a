"""A run that ends in a refusal shows what was seen, until it ends otherwise."""

import json
from pathlib import Path

import pytest

from mammometry.api.job import open_session
from mammometry.base.errors import MeasureError
from mammometry.cli import main
from mammometry.settings import Settings

ALL_AROUND = "measure.base_rim.minimum_sectors=73"  # of 72: no rim is seen so well


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
    with pytest.raises(MeasureError, match="base of the model") as refused:
        open_session(tiny_finished, Settings.load(tiny_settings).overridden([ALL_AROUND])).measure()
    assert refused.value.page is None
    assert mine.read_text() == "somebody's own"
