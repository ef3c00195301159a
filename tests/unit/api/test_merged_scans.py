"""A hanging breast scanned from the front and from below: both merged give the clean mesh's volume, and say so."""

import json
import zipfile
from pathlib import Path

import pytest
from benchmarks.accuracy.merged import hanging_woman, measured, write_scans

from mammometry.cli import main

WOMAN = 7002


@pytest.mark.slow
@pytest.mark.requirement("R-MERGE-4")
def test_two_scans_of_a_hanging_breast_give_its_clean_meshs_volume_and_the_report_shows_both(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    paths = write_scans(hanging_woman(WOMAN), tmp_path)
    clean = measured(paths["clean"])["sides"]
    given = ["--also", str(paths["below"]), "--automatic", "--out", str(tmp_path / "out"), "--json"]
    assert main.run(["measure", str(paths["front"]), *given]) == 0
    made = json.loads(capsys.readouterr().out)
    (fit,) = made["merged_scans"]
    assert fit["within_mm"] < 1.0  # a telephone's noise, averaged over patches
    assert fit["overlap"] > 0.5
    assert made["volumes_cc"].keys() == clean.keys()
    for side, volume_cc in made["volumes_cc"].items():
        low_cc, high_cc = made["intervals_cc"][side]
        assert low_cc < clean[side]["volume_cc"] < high_cc
        assert volume_cc == pytest.approx(clean[side]["volume_cc"], rel=0.1)  # the worst
    with zipfile.ZipFile(tmp_path / "out" / "report" / "content.zip") as content:
        assert "measure/merged.webp" in content.namelist()
    assert "merged" in (tmp_path / "out" / "report" / "report.html").read_text()
