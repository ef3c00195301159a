"""Every command takes a folder, whatever is in it: an imported scan, or what `measure MESH` left."""

import json
import shutil
from functools import partialmethod
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.first_cases import first
from tests.made_once import made_once
from tests.unit.api.test_mesh_job import RIM, curves, export
from tests.unit.io.scan_files import scanned
from tests.unit.measure.solids import dome

import mammometry as mm
from mammometry.api.job import drawable
from mammometry.api.mesh import MeshJob
from mammometry.base.errors import MeasureError, SessionError, StorageError
from mammometry.batch.record import stats_of
from mammometry.cli.main import run
from mammometry.editor.session import DrawingSession
from mammometry.io.drawn import BOUNDARIES
from mammometry.io.meshes.measured import ABOUT_MESH, read_measured
from mammometry.io.meshes.scans import ScanFacts, import_scan
from mammometry.io.outputs import write_outputs
from mammometry.io.results.records import RECORDS

FOLDERS = ("imported", "measured")
_RUN_WITHOUT_REPORT = partialmethod(MeshJob.run, report=False)


def _fill(folder: Path) -> None:
    """A cast of few faces: imported, and measured from its file in cm into a folder; no report, which takes longest."""
    given = curves(folder / "b.json", model=RIM / 10)  # in the mesh's own unit
    mesh = export(dome(sink_mm=10.0, rings=30, around=120), folder / "dome.ply", 0.1)
    write_outputs(
        folder / "imported", import_scan(mesh, ScanFacts(scanner="Vectra", units=""), units="cm"), command="import mesh"
    )
    curves(folder / "imported" / BOUNDARIES, model=RIM)
    asked = [str(mesh), "--units", "cm", "--boundary", str(given), "--out", str(folder / "measured")]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(MeshJob, "run", _RUN_WITHOUT_REPORT)
        assert run(["measure", *asked, "-q"]) == 0
    mm.open_session(folder / "imported").run(report=False)


@pytest.fixture
def place(tmp_path_factory: pytest.TempPathFactory, tmp_path: Path) -> Path:
    """Both folders, with the mesh beside them."""
    shutil.copytree(made_once(tmp_path_factory, "folders-of-scans", _fill), tmp_path / "place")
    return tmp_path / "place"


@pytest.fixture
def without_report(monkeypatch: pytest.MonkeyPatch) -> None:
    """Commands measure and draw no report, which takes most of their time."""
    monkeypatch.setattr(MeshJob, "run", _RUN_WITHOUT_REPORT)


def _answer(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, dict[str, Any]]:
    capsys.readouterr()
    code = run([*map(str, arguments), "--json"])
    table: dict[str, Any] = json.loads(capsys.readouterr().out)
    return code, table


@pytest.mark.requirement("R-FOLDER-1")
@pytest.mark.parametrize("name", first(1, FOLDERS))
def test_commands_answer_on_a_scans_folder(place: Path, name: str, capsys: pytest.CaptureFixture[str]) -> None:
    folder = place / name
    if name == "measured":
        assert run(["report", str(folder), "-q"]) == 0
    _, about = _answer(capsys, "info", folder)
    assert {stage: known["state"] for stage, known in about["stages"].items()} == {
        "measure": "current",
        "report": "current" if name == "measured" else "absent",
    }
    for command in ("run", "report") if name == "measured" else ():
        code, table = _answer(capsys, command, folder)
        assert (code, table["made"]) == (0, []), command
    for command, out in (("graph", place / "g.svg"), ("export table", place / "table")):
        assert run([*command.split(), str(folder), "--out", str(out), "-q"]) == 0, command
        assert out.exists()
    code, checked = _answer(capsys, "verify", folder)
    assert (code, checked["damaged"], checked["changed"], checked["refused"]) == (0, [], [], "")


@pytest.mark.slow
@pytest.mark.parametrize("name", FOLDERS)
def test_pages_figures_and_batches_of_a_scans_folder(
    place: Path, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, out = place / name, place / "out"
    for command in ("figure 7 {} --out {}.png", "report {} --deidentify --out {}-others", "export dicom {} --out {}-d"):
        assert run([*command.format(folder, out).split(), "-q"]) == 0, command
    for state in ("measured", "current"):
        code, table = _answer(capsys, "batch", folder, "--out", out / "batch")
        assert (code, table[state], table["failed"]) == (0, 1, 0)
    assert run(["verify", str(folder), "-q"]) == 0


@pytest.mark.requirement("R-FOLDER-1")
@pytest.mark.parametrize("name", FOLDERS)
@pytest.mark.parametrize("command", first(2, ["evaluate", "figure 1", "calibrate", "match", "surface"]))
def test_what_needs_photographs_is_refused(
    place: Path, name: str, command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    code, table = _answer(capsys, *command.split(), place / name)
    assert (code, table["kind"]) == (SessionError.exit_code, "SessionError")
    assert not (place / name / "evaluation").exists()


@pytest.mark.parametrize("command", ["import-cameras {} a.yml", "target {}.pdf --session {}"])
def test_what_reads_only_the_description_is_refused_too(
    place: Path, command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in FOLDERS:
        code, table = _answer(capsys, *command.format(place / name, place / name).split())
        assert (code, table["found"]) == (SessionError.exit_code, "a scan, whose surface is given")


def test_photos_names_the_command_that_measures_a_folder(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name in FOLDERS:
        code, table = _answer(capsys, "photos", place / name)
        assert (code, table["found"]) == (SessionError.exit_code, "a session or a scan")
        assert str(place / name) in table["remedy"]


@pytest.mark.parametrize("name", FOLDERS)
def test_python_opens_a_scans_folder(place: Path, name: str) -> None:
    job = mm.open_session(place / name)
    assert isinstance(job, mm.Job)
    assert job.stages == ("measure", "report")
    results = job.run(report=False)
    assert results.made == ()
    assert results.volumes_cc["model"] == pytest.approx(2 / 3 * np.pi * 60**2 * 50 / 1000, rel=4e-3)  # 2/3 π r² h
    with pytest.raises(SessionError):
        _ = job.session


@pytest.mark.parametrize("name", first(1, FOLDERS))
def test_a_scans_folder_is_drawn_on(place: Path, name: str) -> None:
    """The page shows the boundary that was given, in mm, and what is drawn is measured."""
    desk = DrawingSession(drawable(place / name))
    shown = np.array(desk.state()["boundaries"]["model"]["curve"])
    assert np.abs(shown).max() == pytest.approx(60.0, abs=1e-6)
    curves(place / name / BOUNDARIES, model=RIM * 0.999)
    job = mm.open_session(place / name)
    assert "measure/measurement" in job.run(report=False).made
    assert job.inputs.boundaries["model"] == pytest.approx(RIM * 0.999)


@pytest.mark.slow
def test_a_refused_drawing_can_be_corrected(place: Path) -> None:
    folder = place / "measured"
    curves(folder / BOUNDARIES, model=RIM * 1.5)  # off the mesh
    with pytest.raises(MeasureError):
        mm.open_session(folder)
    desk = DrawingSession(drawable(folder))
    assert len(desk.job.surface().repaired.mesh.faces) > 0


@pytest.mark.usefixtures("without_report")
@pytest.mark.requirement("R-FOLDER-2")
def test_another_drawing_never_replaces_an_edited_one(place: Path) -> None:
    folder, given = place / "measured", place / "b.json"
    asked = ["measure", str(place / "dome.ply"), "--units", "cm", "--boundary", str(given), "--out", str(folder), "-q"]
    curves(given, model=RIM * 0.0999)  # nobody edited the copy: it follows
    assert run(asked) == 0
    assert mm.open_session(folder).inputs.boundaries["model"] == pytest.approx(RIM * 0.999)
    edited = curves(folder / BOUNDARIES, model=RIM * 0.998).read_bytes()
    assert run(asked) == StorageError.exit_code
    assert (folder / BOUNDARIES).read_bytes() == edited


@pytest.mark.requirement("R-FOLDER-2")
def test_a_mesh_that_is_gone_or_another_one_is_noticed(place: Path) -> None:
    folder, mesh = place / "measured", place / "dome.ply"
    before = stats_of(folder)
    export(dome(sink_mm=9.0, rings=30, around=120), mesh, 0.1)
    assert stats_of(folder) != before  # a batch measures it again
    mesh.unlink()
    with pytest.raises(SessionError, match="no such file"):
        mm.open_session(folder)


@pytest.mark.slow  # makes a report
@pytest.mark.requirement("R-FOLDER-2")
def test_results_of_another_mesh_are_named(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = place / "measured"
    assert run(["report", str(folder), "-q"]) == 0
    export(dome(sink_mm=9.0, rings=30, around=120), place / "dome.ply", 0.1)
    code, checked = _answer(capsys, "verify", folder)
    assert (code, len(checked["changed"])) == (StorageError.exit_code, 1)


def test_both_are_moved_together(place: Path) -> None:
    moved = place.rename(place.with_name("moved"))
    assert mm.open_session(moved / "measured").run(report=False).made == ()


@pytest.mark.usefixtures("without_report")
def test_results_of_1_0_are_described_when_they_are_measured_again(place: Path) -> None:
    """Version 1.0 left no description. Nothing is computed again."""
    folder = place / "measured"
    for name in (ABOUT_MESH, BOUNDARIES):
        (folder / name).unlink()
    with pytest.raises(SessionError, match=r"mammometry measure MESH --out"):
        mm.open_session(folder)
    records = (folder / "measure" / RECORDS).read_bytes()
    asked = ["--units", "cm", "--boundary", str(place / "b.json"), "--out", str(folder), "-q"]
    assert run(["measure", str(place / "dome.ply"), *asked]) == 0
    assert (folder / "measure" / RECORDS).read_bytes() == records
    assert mm.open_session(folder).run(report=False).made == ()


@pytest.mark.parametrize(
    "text", ["", "format = 2\n", "format = 1\nmesh = 3\n", 'format = 1\nmesh = "a.ply"\nscale_std = "x"\n', "["]
)
def test_a_spoilt_description_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / ABOUT_MESH).write_text(text)
    with pytest.raises(SessionError):
        read_measured(tmp_path)


@pytest.mark.slow
def test_scans_of_two_dates_are_compared_from_either_folder(tmp_path: Path) -> None:
    for name, step_mm in (("first", 4.0), ("second", 4.2)):
        mesh = scanned(tmp_path / f"in-{name}", step_mm=step_mm, name=name)
        asked = ["measure", str(mesh), "--units", "cm", "--automatic", "--out", str(tmp_path / name), "-q"]
        assert run(asked) == 0
    assert mm.compare(tmp_path / "first", tmp_path / "second").page.is_file()
