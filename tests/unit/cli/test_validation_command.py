"""`study validation` from the command line: templates, truths, folders, refusals."""

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import trimesh

from mammometry.api import validation as cases
from mammometry.cli import main
from mammometry.io.truth_tables import KINDS, read_truths


def answered(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, dict[str, Any]]:
    code = main.run([*map(str, arguments), "--json"])
    return code, json.loads(capsys.readouterr().out)


def written(place: Path, *rows: str) -> Path:
    table = place / "table.csv"
    table.write_text("\n".join(rows) + "\n", encoding="utf-8")
    return table


def specimens(women: int = 8) -> list[str]:
    rng = np.random.default_rng(4)
    return [
        f"<{woman}>,{side},{truth:.0f},20,{truth + 6 + rng.normal(0, 8):.1f},{1.08 * truth:.1f}"
        for woman in range(women)
        for side in ("left", "right")
        for truth in [rng.uniform(250, 800)]
    ]


@pytest.mark.requirement("R-TRUTH-2")
def test_a_table_of_specimens_becomes_a_page(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    table = written(tmp_path, "patient,side,displaced_g,water_c,flat_chest_cc,muscle_cc", *specimens())
    out = tmp_path / "out"
    code, answer = answered(capsys, "study", "validation", table, "--out", out, "--sem", "6cc")
    assert code == 0
    assert (answer["truth"], answer["women"], answer["breasts"]) == ("water", 8, 16)
    assert list(answer["definitions"]) == ["flat chest", "muscle"]
    assert answer["definitions"]["muscle"]["deming"]["slope"]["value"] == pytest.approx(1.08 * 0.9982, abs=0.01)
    assert len(answer["offsets"]) == 1
    page = (out / "report.html").read_text(encoding="utf-8")
    assert page.count("data:image/") == 3
    assert "&lt;0&gt;" in page
    assert json.loads((out / "validation.json").read_text(encoding="utf-8"))["ratio"] == answer["ratio"]
    code, again = answered(
        capsys, "study", "validation", out / "volumes.csv", "--out", tmp_path / "again", "--sem", "6cc"
    )
    assert code == 0
    for name, one in answer["definitions"].items():
        assert again["definitions"][name]["deming"]["slope"]["value"] == pytest.approx(
            one["deming"]["slope"]["value"], abs=1e-5
        )
    assert again["ratio"] == pytest.approx(answer["ratio"], rel=1e-3)


def test_templates_of_several_truths_stay_beside_one_another(tmp_path: Path) -> None:
    for kind in KINDS:
        assert main.run(["study", "validation", "--template", kind, "--out", str(tmp_path)]) == 0
    assert {path.name for path in tmp_path.glob("*.csv")} == {f"{kind}.csv" for kind in KINDS}


@pytest.mark.parametrize("kind", KINDS)
def test_templates_are_read_again(tmp_path: Path, capsys: pytest.CaptureFixture[str], kind: str) -> None:
    assert main.run(["study", "validation", "--template", kind, "--out", str(tmp_path)]) == 0
    if kind == "segmentation":
        (tmp_path / "segmentations").mkdir()
        for side in ("left", "right"):
            trimesh.creation.icosphere(radius=50.0).export(tmp_path / "segmentations" / f"W1-{side}.stl")
    found, rows = read_truths(tmp_path / f"{kind}.csv")
    assert (found, [row.side for row in rows]) == (kind, ["left", "right"])
    assert all(450 < row.truth.volume_cc < 560 for row in rows)


@pytest.mark.slow
@pytest.mark.requirement("R-TRUTH-2")
def test_folders_give_every_definition(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def opened(folder: Path, _: object) -> SimpleNamespace:
        size = 300.0 + 50 * int(folder.name)
        shares = {"flat chest": 1.0, "muscle": 1.2}
        defined = tuple(SimpleNamespace(meaning=name, volume_cc=share * size) for name, share in shares.items())
        one = SimpleNamespace(definitions=defined, alternatives_cc={"plane": 0.9 * size}, wall_kind="x", volume_cc=size)
        return SimpleNamespace(ensure=lambda stage: None, measure=lambda: {"left": one, "right": one})

    monkeypatch.setattr(cases, "open_session", opened)
    table = written(tmp_path, "woman,side,truth_cc,folder", *(f"w{n},left,{300 + 51 * n},{n}" for n in range(5)))
    code, answer = answered(capsys, "study", "validation", table, "--out", tmp_path / "out")
    assert code == 0
    assert list(answer["definitions"]) == ["flat chest", "muscle", "wall plane"]
    assert len(answer["offsets"]) == 3
    wrong = written(tmp_path, "woman,truth_cc,folder", *(f"w{n},{300 + 51 * n},{n}" for n in range(5)))
    assert answered(capsys, "study", "validation", wrong, "--out", tmp_path / "no")[1]["kind"] == "SessionError"


@pytest.mark.parametrize(
    "rows",
    [
        ("woman,measured_cc", "a,1", "b,2", "c,3"),
        ("woman,displaced_g,weight_g,measured_cc", "a,1,1,1", "b,2,2,2", "c,3,3,3"),
        ("woman,displaced_g", "a,1", "b,2", "c,3"),
        ("woman,displaced_g,measured_cc", "a,1,1", "b,0,2", "c,3,3"),
        ("woman,displaced_g,measured_cc", "a,100,100", "a,200,200", "c,300,310"),
        ("woman,side,displaced_g,measured_cc", "a,up,100,100", "b,left,200,200", "c,left,300,310"),
        ("woman,displaced_g,skin_left_cm2,measured_cc", "a,100,-3,100", "b,200,,200", "c,300,,310"),
        ("woman,displaced_g,measured_cc", "a,100,100", "b,200,200"),
        ("woman,displaced_g,measured_cc", "a,100,0", "b,200,200", "c,300,310", "d,400,400"),
        ("woman,displaced_g,measured_cc", "a,100,-5", "b,200,200", "c,300,310", "d,400,400"),
        ("woman,displaced_g,water_c,measured_cc", "a,100,68,100", "b,200,20,200", "c,300,20,310"),
        ("woman,weight_g,glandular_percent,measured_cc", "a,100,150,100", "b,200,20,200", "c,300,20,310"),
        ("woman,weight_g,age,measured_cc", "a,100,1969,100", "b,200,20,200", "c,300,20,310"),
    ],
)
def test_what_cannot_be_compared_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], rows: tuple[str, ...]
) -> None:
    code, answer = answered(capsys, "study", "validation", written(tmp_path, *rows), "--out", tmp_path / "out")
    assert (code, answer["kind"]) == (3, "TableError")
    assert not (tmp_path / "out").exists()


def test_an_open_segmentation_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    ball = trimesh.creation.icosphere(radius=50.0)
    ball.update_faces(np.arange(len(ball.faces)) > 5)
    ball.export(tmp_path / "open.stl")
    table = written(tmp_path, "woman,segmentation,units,measured_cc", *(f"{n},open.stl,mm,500" for n in range(3)))
    code, answer = answered(capsys, "study", "validation", table, "--out", tmp_path / "out")
    assert (code, answer["kind"]) == (3, "SessionError")
    assert main.run(["study", "validation"]) == 2
    assert main.run(["study", "validation", "--template", "tape"]) == 2
