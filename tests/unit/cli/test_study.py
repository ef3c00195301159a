"""`study` from the command line: the page stands alone, the numbers are there, mistakes are sentences."""

import json
from pathlib import Path

import pytest

from mammometry.cli import main
from mammometry.report.figures.canvas import caption_of


def answered(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, dict]:
    code = main.run([*arguments, "--json"])
    return code, json.loads(capsys.readouterr().out)


@pytest.mark.slow
def test_the_papers_table_without_any_argument(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    code, table = answered(capsys, "study", "agreement")
    assert code == 0
    assert table["mean_difference"]["value"] == pytest.approx(11.1222, abs=1e-4)
    assert [each["published"] for each in table["published"] if not each["follows"]] == ["11.22", "21.85"]
    page = (tmp_path / "agreement" / "report.html").read_text(encoding="utf-8")
    for said in (
        "11.12",
        "23.23",
        "7.742",
        "1.4365",
        "0.1888",
        "0.99450",
        "3.355",
        "16.42",
        "45.5",
        "−34.40",
        "0.0783",
    ):
        assert said in page
    assert "21.46" in page
    assert page.count("data:image/") == 2
    assert "http://" not in page
    assert "https://" not in page
    assert "<script" not in page
    assert json.loads((tmp_path / "agreement" / "agreement.json").read_text())["sd"] == table["sd"]
    for name in ("bland-altman.png", "scatter.png"):
        assert caption_of((tmp_path / "agreement" / name).read_bytes()).text
    assert main.run(["study", "agreement"]) == 0  # an earlier report of ours is replaced
    said = capsys.readouterr().out
    assert "Bland" not in said
    assert "ICC(2,1)" in said


@pytest.mark.slow
def test_a_table_of_ones_own(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    table = tmp_path / "mine.csv"
    table.write_text("who,old_mm,new_mm\na<b>,1,2\nb,3,3.5\nc,5,5.75\nd,8,8\n", encoding="utf-8")
    out = tmp_path / "deep" / "report"
    arguments = ["study", "agreement", str(table), "--reference", "old_mm", "--measured", "new_mm", "--out", str(out)]
    code, answer = answered(capsys, *arguments)
    assert code == 0
    assert (answer["unit"], answer["subjects"], answer["published"]) == ("mm", 4, [])
    assert "a&lt;b&gt;" in (out / "report.html").read_text(encoding="utf-8")


def test_mistakes_are_sentences_and_nothing_is_overwritten(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    table = tmp_path / "mine.csv"
    table.write_text("reference_cc,measured_cc\n1,2\n3,x\n5,6\n", encoding="utf-8")
    code, answer = answered(capsys, "study", "agreement", str(table), "--out", str(tmp_path / "out"))
    assert (code, answer["kind"]) == (3, "TableError")
    assert "row 3, column measured_cc" in answer["error"]
    assert not (tmp_path / "out").exists()
    full = tmp_path / "full"
    full.mkdir()
    (full / "report.html").write_text("mine")
    code, answer = answered(capsys, "study", "agreement", "--out", str(full))
    assert (code, answer["kind"]) == (9, "StorageError")
    assert [path.name for path in full.iterdir()] == ["report.html"]
    wrong = tmp_path / "published.toml"
    wrong.write_text('[[figure]]\nwhat = "x"\nfigure = "nonsense"\npublished = "1"\n')
    code, answer = answered(capsys, "study", "agreement", "--published", str(wrong), "--out", str(tmp_path / "out"))
    assert code == 2
    assert "nonsense" in answer["error"]


def test_a_folder_of_something_else_is_no_study(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    code, answer = answered(capsys, "study", "phantoms", str(tmp_path))
    assert (code, answer["kind"]) == (3, "SessionError")
    study = tmp_path / "study"
    study.mkdir()
    (study / "study.json").write_text('{"scale": 0.25, "seed": 2}')
    code, answer = answered(capsys, "study", "phantoms", str(study))
    assert code == 3
    assert "seed 2" in answer["error"]
    (study / "study.json").write_text('["mine"]')
    code, answer = answered(capsys, "study", "phantoms", str(study))
    assert code == 3
    assert "study.json" in answer["error"]
    assert [path.name for path in study.iterdir()] == ["study.json"]


@pytest.mark.parametrize("command", ["agreement", "phantoms"])
def test_help_has_examples(capsys: pytest.CaptureFixture[str], command: str) -> None:
    assert main.run(["study", command, "--help"]) == 0
    assert f"mammometry study {command}" in capsys.readouterr().out
