"""`study repeatability` from the command line: tables, folders, plans, refusals."""

import csv
import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mammometry.api import repeatability as captures
from mammometry.cli import main
from mammometry.report.figures.canvas import caption_of


def answered(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, dict[str, Any]]:
    code = main.run([*map(str, arguments), "--json"])
    return code, json.loads(capsys.readouterr().out)


def written(place: Path, head: str, rows: list[str]) -> Path:
    table = place / "table.csv"
    table.write_text("\n".join([head, *rows]) + "\n", encoding="utf-8")
    return table


def volumes(women: int = 6, raters: int = 2, takes: int = 2) -> list[str]:
    rng = np.random.default_rng(8)
    return [
        f"W<{woman}>,r{rater},{take},{300 + 50 * woman + 3 * rater + rng.normal(0, 4):.1f}"
        for woman in range(women)
        for rater in range(raters)
        for take in range(takes)
    ]


@pytest.mark.requirement("R-REP-3")
def test_a_table_becomes_a_page_numbers_and_pictures(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    table = written(tmp_path, "Patient,operator,capture,volume_cc", volumes())
    out = tmp_path / "out"
    code, answer = answered(capsys, "study", "repeatability", table, "--out", out, "--claim", "40 ml")
    assert code == 0
    assert (answer["women"], answer["captures"], answer["balanced"]) == (6, 24, True)
    assert answer["claim"]["verdict"] == "shown"
    assert len(answer["limits"]) == 1
    kept = json.loads((out / "repeatability.json").read_text(encoding="utf-8"))
    assert kept["repetitions"] == answer["repetitions"]
    page = (out / "report.html").read_text(encoding="utf-8")
    assert page.count("data:image/") == 2
    assert "W<" not in page
    for name in ("captures.png", "variances.png"):
        assert caption_of((out / name).read_bytes()).text
    again = answered(capsys, "study", "repeatability", out / "volumes.csv", "--out", tmp_path / "again")[1]
    assert again["repetitions"] == answer["repetitions"]


@pytest.mark.slow
def test_left_and_right_in_one_row_litres_and_uncounted_captures(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = [f"{w},{300 + 40 * w + k},{310 + 40 * w - k if w else ''}" for w in range(4) for k in (0, 2, 5)]
    wide = written(tmp_path, "woman,left_cc,right_cc", rows)
    code, answer = answered(capsys, "study", "repeatability", wide, "--out", tmp_path / "wide")
    assert (code, answer["breasts"], answer["captures"], answer["readings"]) == (0, 7, 12, 21)
    litres = written(
        tmp_path, "woman,water_l", [f"{w},{0.3 + 0.04 * w + k / 1000}" for w in range(4) for k in (0, 2, 5)]
    )
    code, answer = answered(
        capsys, "study", "repeatability", litres, "--measured", "water_l", "--out", tmp_path / "litres"
    )
    assert answer["repetitions"][0]["sem_cc"]["value"] == pytest.approx(np.std([0, 2, 5], ddof=1))


@pytest.mark.parametrize(
    ("head", "rows", "kind"),
    [
        ("who,volume_cc", ["1,300"], "TableError"),
        ("woman,volume_cc", ["1,300", "1,x", "2,310", "2,311", "3,320"], "TableError"),
        ("woman,volume_cc", ["1,300", "1,-999", "2,310", "2,311", "3,320"], "TableError"),
        ("woman,volume_cc", ["1,300", "1,301", "2,310", "2,311"], "TableError"),
        ("woman,volume_cc", ["1,300", "2,301", "3,310", "4,311"], "TableError"),
        ("woman,side,volume_cc", ["1,top,300", "1,left,301", "2,left,310", "2,left,311"], "TableError"),
        ("woman,capture,volume_cc", ["1,1,300", "1,1,300", "2,1,310", "2,2,311", "3,1,9"], "TableError"),
        ("woman,length_mm", ["1,300", "1,301", "2,310", "2,311", "3,320"], "TableError"),
    ],
)
def test_what_cannot_be_analysed_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], head: str, rows: list[str], kind: str
) -> None:
    table = written(tmp_path, head, rows)
    out = tmp_path / "out"
    measured = ["--measured", "length_mm"] if "length" in head else []
    code, answer = answered(capsys, "study", "repeatability", table, "--out", out, *measured)
    assert (code, answer["kind"]) == (3, kind)
    assert not out.exists()


@pytest.mark.slow
@pytest.mark.requirement("R-REP-3")
def test_folders_of_results_by_their_levels(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    rng = np.random.default_rng(1)
    for woman in ("ada", "bea", "cho"):
        for rater in ("x", "y"):
            for take in ("1", "2"):
                (tmp_path / "women" / woman / rater / take).mkdir(parents=True)

    def opened(folder: Path, _: object) -> SimpleNamespace:
        posture = "sitting" if folder.parts[-3:] == ("bea", "y", "2") else "standing"
        length = SimpleNamespace(name="SN-N left", straight_mm=225.0 if posture == "sitting" else 210.0)
        sizes = SimpleNamespace(lengths=(length,))
        found = {side: SimpleNamespace(volume_cc=400 + rng.normal(0, 5)) for side in ("left", "right")}
        return SimpleNamespace(
            ensure=lambda stage: None, measure=lambda: found, posture=posture,
            plan=SimpleNamespace(value=lambda product: sizes),
        )  # fmt: skip

    monkeypatch.setattr(captures, "open_session", opened)
    monkeypatch.setattr(captures, "can_be_opened", lambda path: path.name in ("1", "2"))
    code, answer = answered(capsys, "study", "repeatability", tmp_path / "women", "--out", tmp_path / "out")
    assert code == 0
    assert (answer["women"], answer["breasts"], answer["captures"]) == (3, 6, 12)
    assert [(one["woman"], one["condition"]) for one in answer["changes"]] == [
        ("bea", "posture"), ("bea", "SN-N left_mm"),
    ]  # fmt: skip
    rows = list(csv.DictReader((tmp_path / "out" / "volumes.csv").read_text(encoding="utf-8").splitlines()))
    assert {row["rater"] for row in rows} == {"x", "y"}
    code, answer = answered(
        capsys, "study", "repeatability", tmp_path / "women", "--levels", "woman,capture", "--out", tmp_path / "no"
    )
    assert (code, answer["kind"]) == (3, "SessionError")


def test_a_plan_says_how_many_women(capsys: pytest.CaptureFixture[str]) -> None:
    code, answer = answered(capsys, "study", "repeatability", "--plan", "25cc", "--sem", "6cc")
    assert code == 0
    assert dict(map(tuple, answer["sizes"]))[2] == 21
    assert main.run(["study", "repeatability", "--plan", "10cc", "--sem", "6cc"]) == 2
    assert main.run(["study", "repeatability", "--plan", "much"]) == 2
    assert main.run(["study", "repeatability"]) == 2
    assert main.run(["study", "repeatability", "table.csv", "--levels", "woman,capture"]) == 2
