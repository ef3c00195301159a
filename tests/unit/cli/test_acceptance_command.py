"""`acceptance` from the command line: files in, a decision and its exit code out, mistakes as sentences."""

import datetime
import json
import tomllib
from pathlib import Path

import numpy as np
import pytest
import trimesh
from tests.unit.measure.solids import dome

from mammometry.api.acceptance import NUMBERS, past_tests, read_past, run_acceptance
from mammometry.base.errors import SessionError
from mammometry.cli import main
from mammometry.cli.acceptance import REJECT, UNDECIDED
from mammometry.geometry.mesh import TriangleMesh
from mammometry.io.acceptance_file import DESCRIPTION, position_files, read_test, template
from mammometry.io.meshes.scans import ScanFacts, import_scan
from mammometry.io.outputs import write_outputs
from mammometry.report.documents.acceptance_page import DOCUMENT, PAGE
from mammometry.simulate.artefacts import DeviceErrors, measured_mesh
from mammometry.simulate.subjects.artefacts import artefact_mesh
from mammometry.study.acceptance.artefacts import POSITIONS, Cast, Sphere

ABOUT = """\
format = 1
[device]
name = "Scanner"
person = "ab"
date = 2026-11-29
units = "mm"
"""
SPHERE = """\
[sphere]
diameter_mm = 145.0
diameter_std_mm = 0.01
form_std_mm = 0.01
source = "drawn"
"""
CAST = '[cast]\nvolume_cc = 400.0\nvolume_std_cc = 0.5\nsource = "drawn"\n'
BALL = Sphere(diameter_mm=145.0, diameter_std_mm=0.01, form_std_mm=0.01, source="drawn")
BODY = Cast(volume_cc=400.0, volume_std_cc=0.5, source="drawn")


def written(path: Path, mesh: TriangleMesh) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).export(path)
    return path


def casts(folder: Path, *, scale: float = 0.0, places: int = 3, text: str = ABOUT + CAST) -> Path:
    """A test with a cast only, whose evaluation is quick."""
    for position in POSITIONS["cast"][:places]:
        mesh = artefact_mesh(BODY, position, edge_mm=6.0)
        written(
            folder / "cast" / f"{position.name}.stl",
            measured_mesh(mesh, DeviceErrors(scale=scale), np.random.default_rng(0)),
        )
    (folder / DESCRIPTION).write_text(text)
    return folder


def answered(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, dict]:
    code = main.run([*map(str, arguments), "--json"])
    return code, json.loads(capsys.readouterr().out)


@pytest.fixture
def without_page(monkeypatch: pytest.MonkeyPatch) -> None:
    """Page, document and pictures are left out: most of the time of a run."""
    monkeypatch.setattr("mammometry.api.acceptance.acceptance_page_files", lambda *_: {})


def test_results_are_stored_with_page_and_document(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, table = answered(capsys, "acceptance", "run", casts(tmp_path / "test", places=1))
    assert code == UNDECIDED
    assert {PAGE, DOCUMENT, NUMBERS, "acceptance.csv", "history.csv"} <= {
        path.name for path in Path(table["results"]).iterdir()
    }


@pytest.mark.usefixtures("without_page")
@pytest.mark.requirement("R-ACCEPT-2")
@pytest.mark.parametrize(
    ("scale", "places", "code", "decision"),
    [(0.0, 3, 0, "accept"), (0.0, 2, UNDECIDED, "undecided"), (0.01, 3, REJECT, "reject"),
     (0.0031, 3, UNDECIDED, "undecided")],
)  # fmt: skip
def test_each_decision_has_its_exit_code(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], scale: float, places: int, code: int, decision: str
) -> None:
    folder = casts(tmp_path / "test", scale=scale, places=places)
    found, table = answered(capsys, "acceptance", "run", folder)
    assert (found, table["decision"]) == (code, decision)
    assert table["missing"] == ({} if places == 3 else {"cast": ["3"]})
    stored = json.loads((folder / "results" / NUMBERS).read_text(encoding="utf-8"))
    assert stored["findings"] == table["findings"]
    for one in table["findings"]:
        assert one["error"] == pytest.approx(400.0 * ((1 + scale) ** 3 - 1), abs=0.01)
        assert one["expanded_uncertainty"] == pytest.approx(1.0)


def test_scans_meshes_and_obj_files_are_read(tmp_path: Path) -> None:
    """A sphere as PLY, as OBJ, and as an imported scan."""
    mesh = artefact_mesh(BALL, POSITIONS["sphere"][0], edge_mm=4.0)
    sphere = tmp_path / "test" / "sphere"
    written(sphere / "01.ply", mesh)
    written(sphere / "2 upper left.obj", mesh)
    (sphere / "material.mtl").write_text("newmtl any\n")
    made = import_scan(sphere / "01.ply", ScanFacts(scanner="Vectra", units=""), units="mm")
    write_outputs(sphere / "3", made, command="import mesh")
    (tmp_path / "test" / DESCRIPTION).write_text(ABOUT + SPHERE)
    outcome = run_acceptance(tmp_path / "test")
    assert [result.position for result in outcome.results] == ["1", "2", "3"]
    for result in outcome.results:
        assert abs(result.findings[1].error) < 0.01


@pytest.mark.usefixtures("without_page")
def test_the_results_beside_a_test_are_its_history(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for day, scale in ((3, 0.001), (1, 0.0), (2, 0.002)):
        text = (ABOUT + CAST).replace("2026-11-29", f"2026-11-0{day}")
        folder = casts(tmp_path / f"test-{day}", scale=scale, text=text)
        answered(capsys, "acceptance", "run", folder)
    other = casts(tmp_path / "other", text=(ABOUT + CAST).replace("Scanner", "Rig"))
    answered(capsys, "acceptance", "run", other)
    (tmp_path / "broken" / "results").mkdir(parents=True)
    (tmp_path / "broken" / "results" / NUMBERS).write_text("{")
    past = past_tests(tmp_path / "test-4", "Scanner")
    assert [test.date.day for test in past] == [1, 2, 3]
    assert [test.worst["cast/volume"][0] for test in past] == pytest.approx([0.0, 2.402, 1.201], abs=0.01)
    rows = (tmp_path / "test-2" / "results" / "history.csv").read_text(encoding="utf-8").splitlines()
    assert [row.split(",")[1] for row in rows[1:]] == ["2026-11-01", "2026-11-02", "2026-11-03"]


def test_the_error_that_decides_is_the_worst_of_a_past_test(tmp_path: Path) -> None:
    """0.25 ± 0.1 mm is undecided at a limit of 0.3 mm; 0.28 ± 0.01 mm is accepted, and 0.35 mm at a limit of 0.5 mm."""
    values = [(0.28, 0.01, 0.3), (-0.25, 0.1, 0.3), (0.35, 0.01, 0.5)]
    names = ("error", "expanded_uncertainty", "limit")
    findings = [{"artefact": "bar", "quantity": "spacing", **dict(zip(names, own, strict=True))} for own in values]
    table = {"format": 1, "device": "Rig", "date": "2026-11-29", "decision": "undecided", "findings": findings}
    (tmp_path / NUMBERS).write_text(json.dumps(table))
    past = read_past(tmp_path / NUMBERS, "Rig")
    assert past is not None
    assert past.worst == {"bar/spacing": (-0.25, 0.1, 0.3)}


@pytest.mark.parametrize("name", ['Rig "3"', "two\nlines", "back\\slash", "tab\t", "Größe 1"])
def test_any_name_of_a_device_gives_a_description_that_can_be_read(name: str) -> None:
    described = tomllib.loads(template(name, name, datetime.date(2026, 11, 29)).decode())
    assert described["device"]["name"] == " ".join(name.split())
    assert described["device"]["person"] == " ".join(name.split())


@pytest.mark.slow
def test_a_new_test_is_refused_until_it_is_filled_in(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "test"
    code, table = answered(capsys, "acceptance", "new", folder, "--device", 'Rig "3"', "--person", "ab")
    assert code == 0
    assert all((folder / kind).is_dir() for kind in table["artefacts"])
    code, table = answered(capsys, "acceptance", "run", folder)
    assert (code, table["subject"]) == (3, str(folder / DESCRIPTION))
    text = (folder / DESCRIPTION).read_text(encoding="utf-8")
    values = {"diameter_mm = 0.0": "diameter_mm = 100.0", "distance_mm = 0.0": "distance_mm = 300.0"}
    values |= {"volume_cc = 0.0": "volume_cc = 400.0", 'source = ""': 'source = "calliper"'}
    for old, new in values.items():
        text = text.replace(old, new)
    (folder / DESCRIPTION).write_text(text, encoding="utf-8")
    assert set(read_test(folder).artefacts) == {"sphere", "bar", "plane", "cast"}


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("format = 1", "format = 2"),
        ("format = 1", "format = 1\nextra = 3"),
        ("2026-11-29", '"yesterday"'),
        ('"mm"', '"parsec"'),
        ('name = "Scanner"\n', ""),
        ('name = "Scanner"', "name = 3"),
        ("diameter_mm = 145.0", "diameter_mm = 1e300"),
        ("diameter_mm = 145.0", "diameter_mm = nan"),
        ("diameter_mm = 145.0", "diameter_mm = -145.0"),
        ("diameter_mm = 145.0", "diameter_mm = true"),
        ("diameter_mm = 145.0\n", ""),
        ("diameter_std_mm = 0.01", "diameter_std_mm = 0.0"),
        ("[sphere]", "[ball]"),
        ('source = "drawn"', 'source = ""'),
        (SPHERE, ""),
        ("[sphere]", "[limits]\nform_mm = 0\n[sphere]"),
        ("[device]", "[device"),
    ],
)
def test_a_wrong_description_is_one_sentence(tmp_path: Path, old: str, new: str) -> None:
    text = ABOUT + SPHERE
    assert old in text
    (tmp_path / DESCRIPTION).write_text(text.replace(old, new))
    with pytest.raises(SessionError) as error:
        read_test(tmp_path)
    assert error.value.subject.startswith(str(tmp_path))


@pytest.mark.parametrize("names", [["11.ply"], ["upper.ply"], ["0.ply"], ["3.ply", "03.stl"]])
def test_a_wrong_name_of_a_position_is_one_sentence(tmp_path: Path, names: list[str]) -> None:
    (tmp_path / "sphere").mkdir()
    for name in names:
        (tmp_path / "sphere" / name).write_bytes(b"")
    with pytest.raises(SessionError):
        position_files(tmp_path, "sphere")


def test_wrong_measurements_are_one_sentence(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def refused(folder: Path) -> tuple[int, str]:
        code, table = answered(capsys, "acceptance", "run", folder)
        assert not (folder / "results").exists()
        return code, Path(table["subject"]).name

    assert refused(tmp_path) == (3, tmp_path.name)  # no description
    (tmp_path / DESCRIPTION).write_text(ABOUT + CAST)
    assert refused(tmp_path) == (3, tmp_path.name)  # no measurement
    written(tmp_path / "sphere" / "1.ply", artefact_mesh(BALL, POSITIONS["sphere"][0], edge_mm=6.0))
    assert refused(tmp_path) == (3, "sphere")  # of an artefact that is not described
    (tmp_path / DESCRIPTION).write_text(ABOUT + SPHERE.replace("145", "100"))
    assert refused(tmp_path) == (8, "1.ply")  # no ball of this size
    (tmp_path / "sphere" / "1.ply").write_bytes(b"ply\n")
    assert refused(tmp_path) == (3, str(Path("1.ply")))
    open_cast = dome(rings=10, around=30)
    open_cast = TriangleMesh(vertices=open_cast.vertices, faces=open_cast.faces[1:])
    (tmp_path / "sphere" / "1.ply").unlink()
    written(tmp_path / "cast" / "1.ply", open_cast)
    (tmp_path / DESCRIPTION).write_text(ABOUT + CAST)
    assert refused(tmp_path) == (8, "1.ply")
