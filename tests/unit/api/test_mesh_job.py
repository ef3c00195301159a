"""A scanner's mesh from its file to the result on disk, by the command line; every thing that can be wrong with it."""

import json
import re
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from tests.unit.measure.solids import dome
from tests.unit.measure.trunks import LEFT, RIGHT, edge_of, trunk_mesh, volume_cc

from mammometry.api import mesh as api_mesh
from mammometry.api.mesh import MeshFiles, MeshJob
from mammometry.api.stored_report import CONTENT, unpacked
from mammometry.base.child_process import CallError
from mammometry.base.errors import MeasureError
from mammometry.cli import main
from mammometry.geometry.mesh import TriangleMesh
from mammometry.job.stages import measure
from mammometry.measure.wall import chest_wall
from mammometry.measure.wall.chest_wall import ChestWall
from mammometry.measure.wall.open_breast import OpenBreast

DOME_CC = 2 / 3 * np.pi * 60**2 * 50 / 1000
ANGLES = np.linspace(0, 2 * np.pi, 120, endpoint=False)
RIM = 60 * np.stack([np.cos(ANGLES), np.sin(ANGLES), 0 * ANGLES], axis=1)


def export(mesh: TriangleMesh, path: Path, scale: float = 1.0) -> Path:
    trimesh.Trimesh(mesh.vertices * scale, mesh.faces, process=False).export(path)
    return path


def curves(path: Path, **points: np.ndarray) -> Path:
    path.write_text(json.dumps({"boundaries": {name: {"points": each.tolist()} for name, each in points.items()}}))
    return path


def answer(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, dict[str, object]]:
    code = main.run(["measure", *map(str, arguments), "--json"])
    return code, json.loads(capsys.readouterr().out)


def refused(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    code, table = answer(capsys, *arguments)
    assert code in (3, 8)
    return str(table["error"])


@pytest.mark.slow
def test_a_second_process_draws_the_same_report(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    mesh = export(dome(sink_mm=10.0), tmp_path / "dome.ply")
    files = MeshFiles(mesh=mesh, units="mm", boundary=curves(tmp_path / "b.json", model=RIM))
    contents = []
    for name, least, cores in (("here", 10**9, 2), ("beside", 0, 2), ("alone", 0, 1)):
        monkeypatch.setattr(api_mesh, "_LEAST_FACES", least)
        monkeypatch.setattr(api_mesh, "available_cores", lambda cores=cores: cores)
        job = MeshJob(files, tmp_path / name)
        job.run()
        contents.append(unpacked((tmp_path / name / "report" / CONTENT).read_bytes()).pictures)
    assert contents[0] == contents[1] == contents[2]
    assert {"front", "closed-model", "sections-model"} <= set(contents[0]["measure"])


@pytest.mark.slow
def test_what_is_refused_is_measured_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whoever draws beside waits until there is something to draw, and does not try the measurement again."""
    mesh = export(dome(sink_mm=10.0), tmp_path / "dome.ply")
    files = MeshFiles(mesh=mesh, units="mm", boundary=curves(tmp_path / "b.json", model=RIM))
    tried = []

    def refuses(*arguments: object, **options: object) -> None:
        tried.append(1)
        time.sleep(0.2)
        raise MeasureError("breast", found="a knot", expected="a curve", remedy="Draw it again")

    monkeypatch.setattr(api_mesh, "_LEAST_FACES", 0)
    monkeypatch.setattr(api_mesh, "available_cores", lambda: 2)
    monkeypatch.setattr("mammometry.measure.volume.volumes.measured_or_refused", refuses)
    with pytest.raises(MeasureError, match="a knot"):
        MeshJob(files, tmp_path / "out").run()
    assert len(tried) == 1


@pytest.mark.slow
def test_what_the_second_process_cannot_draw_is_drawn_here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    mesh = export(dome(sink_mm=10.0), tmp_path / "dome.ply")
    files = MeshFiles(mesh=mesh, units="mm", boundary=curves(tmp_path / "b.json", model=RIM))

    class Failing(api_mesh.ChildProcess):
        def call(self, function: Any, *arguments: Any) -> Any:
            raise CallError("no memory")

    monkeypatch.setattr(api_mesh, "_LEAST_FACES", 0)
    monkeypatch.setattr(api_mesh, "available_cores", lambda: 2)
    monkeypatch.setattr(api_mesh, "ChildProcess", Failing)
    MeshJob(files, tmp_path / "out").run()
    assert (tmp_path / "out" / "report" / "report.pdf").is_file()


@pytest.mark.parametrize(
    ("suffix", "units", "scale"),
    [
        ("obj", "cm", 0.1),
        *(pytest.param(*each, marks=pytest.mark.slow) for each in (("ply", "mm", 1), ("stl", "m", 0.001))),
    ],
)
def test_a_dome_has_the_same_volume_in_every_format(tmp_path: Path, suffix: str, units: str, scale: float) -> None:
    """2/3 π r² h; the metres' GLB is the next test's. Its rim is sunk, so that the base cuts it."""
    mesh = export(dome(sink_mm=10.0), tmp_path / f"dome.{suffix}", scale)
    files = MeshFiles(mesh=mesh, units=units, boundary=curves(tmp_path / "b.json", model=RIM))
    results = MeshJob(files, tmp_path / "out").run(report=False)
    assert results.volumes_cc["model"] == pytest.approx(DOME_CC, rel=2e-3)  # polygons are inscribed
    assert results.watertight


@pytest.mark.slow
def test_the_result_is_as_a_sessions_and_the_mesh_untouched(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    mesh = export(dome(sink_mm=10.0), tmp_path / "dome.glb", 0.001)
    before = mesh.read_bytes()
    given = curves(tmp_path / "b.json", model=RIM)
    code, table = answer(capsys, mesh, "--boundary", given, "--scale-sd", "0.01", "--out", tmp_path / "out")
    assert code == 0
    assert mesh.read_bytes() == before
    measured = json.loads((tmp_path / "out" / "measure" / "measurement.json").read_text())["measurements"]["model"]
    assert measured["volume_cc"] == pytest.approx(DOME_CC, rel=2e-3)
    terms = measured["interval_terms_cc"]
    assert terms["scale"] == pytest.approx(1.96 * 3 * 0.01 * measured["volume_cc"], rel=1e-9)
    assert terms["scanner"] == pytest.approx(1.96 * 0.1 * measured["area_cm2"] / 10, rel=1e-6)
    assert terms["base"] == pytest.approx(1.96 * 0.5 * measured["base_area_cm2"] / 10, rel=1e-9)
    assert "distortions" in measured["interval_note"]
    page = (tmp_path / "out" / "report" / "report.html").read_text()
    assert "m, glTF&#39;s unit" in page
    assert (tmp_path / "out" / "report" / "report.pdf").stat().st_size > 10_000
    made = (tmp_path / "out" / "measure" / "measurement.json").stat().st_mtime_ns
    again, repeated = answer(capsys, mesh, "--boundary", given, "--scale-sd", "0.01", "--out", tmp_path / "out")
    assert again == 0
    assert repeated["volumes_cc"] == table["volumes_cc"]
    assert (tmp_path / "out" / "measure" / "measurement.json").stat().st_mtime_ns == made  # it was current


@pytest.mark.slow
def test_a_torso_is_measured_as_in_a_session(tmp_path: Path) -> None:
    mesh = export(trunk_mesh(4.0), tmp_path / "torso.ply")
    edges = {name: edge_of(breast, name).points_world for name, breast in (("left", LEFT), ("right", RIGHT))}
    job = MeshJob(MeshFiles(mesh=mesh, units="mm", boundary=curves(tmp_path / "b.json", **edges)), tmp_path / "out")
    results = job.run(report=False)
    for name, breast in (("left", LEFT), ("right", RIGHT)):
        measured = results.measurements[name]
        assert measured.alternatives_cc["cylinder-membrane"] == pytest.approx(volume_cc(breast), rel=0.03)
        assert measured.wall_kind == "rounded-membrane"
        assert set(measured.interval_terms_cc) == {"scale", "scanner", "boundary", "chest wall"}
    written = json.loads((tmp_path / "out" / "measure" / "dimensions.json").read_text())["dimensions"]
    assert np.allclose(np.array(written["frame"]), np.eye(3), atol=0.1)


@pytest.mark.slow
def test_a_side_whose_volume_is_refused_hinders_the_other_one_nowhere(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The boundaries are found, not drawn; the left one cannot be closed."""
    mesh = export(trunk_mesh(4.0), tmp_path / "torso.ply")
    job = MeshJob(MeshFiles(mesh=mesh, units="mm", automatic=True, head="y", ahead="z"), tmp_path / "out")
    whole = chest_wall.fit_all

    def fit_all(breast: OpenBreast) -> tuple[ChestWall, ...]:
        if breast.boundary.name == "left":
            raise MeasureError("boundary 'left'", found="a knot", expected="none", remedy="Untie it")
        return whole(breast)

    monkeypatch.setattr(chest_wall, "fit_all", fit_all)
    results = job.run(report=False)
    assert set(results.measurements) == {"right"}
    assert results.measurements["right"].volume_cc == pytest.approx(volume_cc(RIGHT), rel=0.08)
    assert "a knot" in results.no_breast["left"]
    (absent,) = job.plan[measure.absent]()
    assert (absent.unclear, absent.refused) == (True, True)


@pytest.fixture
def files(tmp_path: Path) -> tuple[Path, Path]:
    return export(dome(sink_mm=10.0), tmp_path / "dome.ply"), curves(tmp_path / "b.json", model=RIM)


def test_units_boundary_and_landmarks_are_asked_for(
    files: tuple[Path, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    mesh, given = files
    assert "--units" in refused(capsys, mesh, "--boundary", given)
    assert "boundary nor" in refused(capsys, mesh, "--units", "mm")
    assert "Check --units" in refused(capsys, mesh, "--units", "m", "--boundary", given)
    assert "absent.json" in refused(capsys, mesh, "--units", "mm", "--boundary", mesh.with_name("absent.json"))


def test_wrong_boundaries_are_named(files: tuple[Path, Path], capsys: pytest.CaptureFixture[str]) -> None:
    mesh, given = files

    def said(**points: np.ndarray) -> str:
        return refused(capsys, mesh, "--units", "mm", "--boundary", curves(given, **points))

    assert re.search(r"\d+ mm", said(model=RIM[:70]))
    turn = ANGLES + 0.01
    eight = np.stack([55 * np.sin(turn), 25 * np.sin(2 * turn), 0 * turn], axis=1)
    assert "crosses" in said(model=eight)
    away = said(model=RIM * 1.5)
    assert re.search(r"120 of 120 .*30 mm, .*5 mm", away)
    assert re.search(r"\bmodel, left\b", said(model=RIM, left=RIM))
    assert "middle" in said(middle=RIM)


@pytest.mark.slow
def test_an_inside_out_face_a_crumb_and_a_face_twice_change_no_volume(tmp_path: Path) -> None:
    given, whole = curves(tmp_path / "b.json", model=RIM), dome(sink_mm=10.0)
    apart = TriangleMesh(
        vertices=np.concatenate([whole.vertices, whole.vertices[:3] + 100]),
        faces=np.concatenate([whole.faces, np.array([[0, 1, 2]], dtype=np.int32) + len(whole.vertices)]),
    )
    twice = TriangleMesh(vertices=whole.vertices, faces=np.concatenate([whole.faces, whole.faces[:1, [0, 2, 1]]]))
    inside_out = TriangleMesh(vertices=whole.vertices, faces=np.ascontiguousarray(whole.faces[:, ::-1]))
    for name, mesh in (("turned", inside_out), ("crumb", apart), ("twice", twice)):  # mended, and said
        files = MeshFiles(mesh=export(mesh, tmp_path / f"{name}.ply"), units="mm", boundary=given)
        results = MeshJob(files, tmp_path / name).run(report=False)
        assert results.volumes_cc["model"] == pytest.approx(DOME_CC, rel=2e-3)


@pytest.mark.slow
def test_landmarks_of_the_wrong_side_are_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    mesh = export(trunk_mesh(6.0), tmp_path / "torso.ply")
    edges = {name: edge_of(breast, name).points_world for name, breast in (("left", LEFT), ("right", RIGHT))}
    marks = tmp_path / "l.json"
    marks.write_text(json.dumps({"landmarks": {"nipple_left": {"points": [edges["right"].mean(axis=0).tolist()]}}}))
    off = refused(
        capsys, mesh, "--units", "mm", "--boundary", curves(tmp_path / "b.json", **edges), "--landmarks", marks
    )
    assert "surface" in off
    marks.write_text(json.dumps({"landmarks": {"nipple_left": {"points": [edges["right"][0].tolist()]}}}))
    side = refused(
        capsys, mesh, "--units", "mm", "--boundary", curves(tmp_path / "b.json", **edges), "--landmarks", marks
    )
    assert "middle" in side


def test_a_sessions_options_and_a_meshs_do_not_mix(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, table = answer(capsys, tmp_path, "--units", "mm")
    assert code == 2
    assert "--units" in str(table["error"])


@pytest.mark.slow
def test_the_report_shows_the_mesh_and_the_subject_that_it_was_made_for(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A copy of a mesh, measured into the folder of the first: same numbers, another name."""
    given = curves(tmp_path / "b.json", model=RIM)
    out = tmp_path / "out"
    page = out / "report" / "report.html"
    for name in ("mueller.ply", "huber.ply"):
        mesh = export(dome(sink_mm=10.0), tmp_path / name)
        code, table = answer(capsys, mesh, "--units", "mm", "--boundary", given, "--out", out)
        assert code == 0
    assert table["made"] == ["report/content", "report/report"]
    assert "<h1>huber.ply</h1>" in page.read_text()
    assert "mueller" not in page.read_text()

    command = [mesh, "--units", "mm", "--boundary", given, "--out", out]
    code, table = answer(capsys, *command, "--set", "compare.doubt_mm=1.5")
    assert table["made"] == ["report/content", "report/report"]  # which lists that setting
    code, table = answer(capsys, *command, "--subject", "P-1")
    assert code == 0
    assert "<h1>P-1</h1>" in page.read_text()
    assert json.loads((out / "measure" / "measurement.json").read_text())["subject"] == "P-1"
    assert answer(capsys, *command, "--subject", "P-1")[1]["made"] == []
    assert main.run(["measure", *map(str, command), "--subject", "P-1"]) == 0
    assert re.search(r"made 2\d\d\d-", capsys.readouterr().out)

    assert "--id" in refused(capsys, *command, "--subject", "P-2")
    drawn = json.loads(given.read_text()) | {"subject": "P-3"}
    given.write_text(json.dumps(drawn))
    assert "'P-3'" in refused(capsys, *command, "--subject", "P-1")
    assert main.run(["measure", *map(str, command), "--subject", "a/b"]) == 2
    ours = out / "measure" / "model.ply"
    assert "'P-2'" in refused(capsys, ours, "--units", "mm", "--subject", "P-2")
