"""A scan of another device is drawn on as a session is."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.unit.io.scan_files import scanned

from mammometry.api.job import drawable, open_session
from mammometry.base.errors import CrossingError
from mammometry.cli.main import run
from mammometry.editor.messages import PlaceChange, Save, SentHandle, Sketch, SketchChange
from mammometry.editor.page import EditorPage
from mammometry.editor.session import DrawingSession
from mammometry.io.meshes.scans import ScanFacts, import_scan
from mammometry.io.outputs import write_outputs
from mammometry.measure.volume.attribution import curve_digest


@pytest.fixture
def scan(tmp_path: Path) -> Path:
    """An imported scan of a torso."""
    mesh = scanned(tmp_path / "in", step_mm=2.0)
    folder = tmp_path / "scan"
    write_outputs(folder, import_scan(mesh, ScanFacts(scanner="Vectra", units=""), units="cm"), command="import mesh")
    return folder


@pytest.mark.slow
def test_all_commands_find_a_scans_results_in_one_place(
    scan: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def answer(*arguments: object) -> dict[str, Any]:
        assert run([*map(str, arguments), "--json"]) == 0
        table: dict[str, Any] = json.loads(capsys.readouterr().out)
        return table

    assert answer("info", scan)["stages"]["measure"]["state"] == "absent"
    assert answer("report", scan)["report"] == str(scan / "results" / "report" / "report.html")
    assert [path.name for path in scan.iterdir() if path.is_dir()] == ["results"]
    about = answer("info", scan)
    assert {stage: table["state"] for stage, table in about["stages"].items()} == dict.fromkeys(
        ("measure", "report"), "current"
    )
    assert about["scanner"] == "Vectra"
    for again in (("measure", scan), ("measure", scan / "scan.ply"), ("report", scan)):
        assert answer(*again)["made"] == []
    assert answer("verify", scan)["damaged"] == []
    open_session(scan).ensure("measure", drawn=False)  # as `compare` does
    assert answer("info", scan)["stages"]["measure"]["state"] == "current"

    shared = tmp_path / "for-others"
    page = Path(answer("report", scan, "--deidentify", "--out", shared)["report"]).read_text()
    assert "sternal" in page
    assert run(["report", str(scan), "--geometry-only", "--out", str(scan)]) != 0


@pytest.mark.slow
def test_a_scan_is_exported_as_a_session_is(scan: Path, tmp_path: Path) -> None:
    assert run(["export", "fhir", str(scan), "--out", str(tmp_path / "fhir")]) == 0
    bundle = json.loads((tmp_path / "fhir" / "bundle.json").read_text())
    kinds = [entry["resource"]["resourceType"] for entry in bundle["entry"]]
    assert "DiagnosticReport" in kinds
    assert kinds.count("Observation") > 4
    assert run(["export", "table", str(scan), "--out", str(tmp_path / "table")]) == 0
    assert "volume" in (tmp_path / "table" / "measurements.csv").read_text()


@pytest.mark.slow
def test_a_scan_measured_elsewhere_says_whose_line_it_uses(
    scan: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    page = EditorPage(drawable(scan))
    left = page.drawing("C. Eye")["boundaries"]["left"]
    sketch = Sketch(of=left["of"], handles=[SentHandle.model_validate(each) for each in left["handles"]])
    page.drawing_session.save(
        Save(author="A. Nurse", boundaries={"left": SketchChange(base=left["base"], sketch=sketch)})
    )
    capsys.readouterr()
    assert run(["measure", str(scan / "scan.ply"), "--out", str(tmp_path / "mine")]) == 0
    (line,) = [line for line in capsys.readouterr().out.splitlines() if line.startswith("Boundary left, from ")]
    assert str(scan / "boundaries.json") in line
    assert "A. Nurse" in line


@pytest.mark.slow
def test_a_scan_is_drawn_on_measured_and_shown(scan: Path) -> None:
    first = open_session(scan).run()
    page = EditorPage(drawable(scan))
    drawing = page.drawing("C. Eye")
    (model,) = drawing["scene"]["models"]
    assert model["texture"] or model["colours"]  # the report's, with the scanner's picture
    left = drawing["boundaries"]["left"]
    assert left["measured"]["volumeCc"] == first.volumes_cc["left"]
    assert left["measured"]["of"] == left["of"]

    # What is proposed is offered until somebody picks it.
    places = drawing["places"]
    assert {name for name, place in places.items() if place["proposed"]} >= {"medial_left", "lateral_right"}
    assert not any(place["points"] for place in places.values())

    # One breast is changed: the other stays automatic, and its number the same but for the trunk's plane.
    sketch = Sketch(of=left["of"], handles=[SentHandle.model_validate(each) for each in left["handles"]])
    moved = np.add(sketch.handles[0].point, [0.0, 12.0, 0.0])
    sketch.handles[0] = SentHandle(point=tuple(moved.tolist()))
    page.drawing_session.save(Save(author="A", boundaries={"left": SketchChange(base=left["base"], sketch=sketch)}))
    assert set(json.loads((scan / "boundaries.json").read_text())["boundaries"]) == {"left", "right"}
    again = open_session(scan)
    second = again.run()
    assert second.volumes_cc["left"] != first.volumes_cc["left"]
    low, high = first.intervals_cc["right"]  # the trunk's own plane is fitted beside both borders, and moves a little
    assert second.volumes_cc["right"] == pytest.approx(first.volumes_cc["right"], abs=0.01 * (high - low) / 2)
    state = DrawingSession(drawable(scan)).state()["boundaries"]
    assert state["left"]["measured"]["of"] == state["left"]["of"] != left["of"]
    assert state["right"]["automatic"]

    # A line that crosses itself is refused; a landmark that the measurement refuses can be corrected.
    desk = DrawingSession(drawable(scan))
    places = np.array([handle["point"] for handle in state["left"]["handles"]])
    places[[1, 5]] = places[[5, 1]]
    crossed = Sketch(handles=[SentHandle(point=tuple(point)) for point in places.tolist()])
    with pytest.raises(CrossingError):
        desk.save(Save(author="A", boundaries={"left": SketchChange(base=state["left"]["base"], sketch=crossed)}))
    right = np.array(state["right"]["curve"]).mean(axis=0)
    wrong = Save(author="A", landmarks={"nipple_left": PlaceChange(base=None, points=[tuple(right.tolist())])})
    desk.save(wrong)
    opened = DrawingSession(drawable(scan)).state()
    assert opened["places"]["nipple_left"]["points"]
    assert curve_digest(np.array(opened["boundaries"]["left"]["curve"])) == state["left"]["of"]
