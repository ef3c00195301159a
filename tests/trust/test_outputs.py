"""Every command that writes leaves what it did not write: files in its way, its inputs, and whatever lies beside.

What is slow to compute is replaced: by something small where a command is to write, and by an error of ours (exit code
70) where it is to refuse before it computes.
"""

import hashlib
import json
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import click
import numpy as np
import pytest
import trimesh
from PIL import Image
from tests.unit.hospital import exports
from tests.unit.io.scan_files import scanned
from tests.unit.measure.solids import dome
from typer.main import get_command

from mammometry.api import acceptance, dates, mesh, truth
from mammometry.api import observers as drawn_alike
from mammometry.api.job import Job
from mammometry.base.progress import map_in_sequence
from mammometry.batch import batch as batches
from mammometry.batch.record import BatchRow
from mammometry.calibration.detection import detect as detecting
from mammometry.calibration.judge import check as checking
from mammometry.calibration.judge.check import RigCheck
from mammometry.calibration.targets import pdf as sheets
from mammometry.cli import main, study
from mammometry.geometry.camera import Camera
from mammometry.geometry.transform import Transform
from mammometry.hospital import gather as gathering
from mammometry.io.cameras.own import cameras_table
from mammometry.io.meshes import scans as scan_files
from mammometry.io.outputs import RECORD
from mammometry.io.sealed import sealed, unsealed
from mammometry.measure import change
from mammometry.report.documents import acceptance_page, change_page, html, pdf, rendering
from mammometry.report.figures import catalogue
from mammometry.simulate import session as simulated
from mammometry.simulate.recipe import SessionRecipe
from mammometry.study import agreement as agreeing
from mammometry.study import evaluation_tables
from mammometry.study.acceptance.artefacts import POSITIONS, Cast, Limits
from mammometry.study.acceptance.evaluate import Outcome, evaluate_volume

MANIFEST = """\
format = 1
units = "mm"
[rig]
name = "two"
pairs = [ { name = "front", left = "left", right = "right" } ]
[subject]
kind = "torso"
[target]
kind = "chessboard"
squares = [10, 7]
square_mm = 20.0
"""


@dataclass(frozen=True)
class Case:
    """A command that is ready to run."""

    arguments: list[object]
    folder: Path
    """Where it writes."""
    names: tuple[str, ...]
    """All files that it writes there, beside the record."""
    within: list[list[object]] = field(default_factory=list)
    """Arguments by which it would write to where it reads."""


# --- the commands ---


def _photograph(path: Path, seed: int) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(np.random.default_rng(seed).integers(0, 255, (20, 30, 3), dtype=np.uint8)).save(path)


def _cameras() -> dict[str, Camera]:
    """One pair in front of the patient, upright, 900 mm away."""
    turn = np.diag([1.0, -1.0, -1.0])
    return {
        name: Camera(
            name=name,
            size_wh=(30, 20),
            matrix=np.array([[40.0, 0, 15], [0, 40.0, 10], [0, 0, 1]]),
            distortion=np.zeros(5),
            camera_from_world=Transform(rotation=turn, translation_mm=-turn @ np.array([x, 0.0, 900.0])),
        )
        for name, x in (("left", -60.0), ("right", 60.0))
    }


def _session(folder: Path, *, seed: int = 0, cameras: bool = True) -> Path:
    """A session with two photographs of noise, and ready-made cameras."""
    for number, name in enumerate(("left", "right")):
        _photograph(folder / "capture" / f"{name}.png", 2 * seed + number)
    (folder / "session.toml").write_text(MANIFEST)
    if cameras:
        (folder / "cameras.json").write_text(json.dumps(cameras_table(_cameras())))
    return folder


def agreement(place: Path, patch: pytest.MonkeyPatch) -> Case:
    table = place / "data" / "table.csv"
    table.parent.mkdir()
    table.write_text("reference_cc,measured_cc\n1,2\n3,3.5\n5,5.75\n8,8\n")
    patch.chdir(place)  # where the folder goes that nobody names
    out = place / "out"
    (place / "agreement").mkdir()
    (place / "agreement" / "table.csv").write_text(table.read_text())
    return Case(
        ["study", "agreement", table, "--out", out],
        out,
        ("report.html", "agreement.json", "bland-altman.png", "scatter.png"),
        [["study", "agreement", table, "--out", table.parent], ["study", "agreement", "agreement/table.csv"]],
    )


def repeatability(place: Path, patch: pytest.MonkeyPatch) -> Case:
    table = place / "data" / "table.csv"
    table.parent.mkdir()
    table.write_text("woman,volume_cc\n" + "".join(f"{w},{300 + 9 * w + k}\n" for w in range(3) for k in (0, 2)))
    out = place / "out"
    names = ("report.html", "repeatability.json", "volumes.csv", "captures.png", "variances.png")
    return Case(
        ["study", "repeatability", table, "--out", out],
        out,
        names,
        [["study", "repeatability", table, "--out", table.parent]],
    )


def validation(place: Path, patch: pytest.MonkeyPatch) -> Case:
    table = place / "data" / "table.csv"
    table.parent.mkdir()
    rows = (f"{w},{300 + 9 * w},{301 + 9 * w + w % 2}\n" for w in range(4))
    table.write_text("woman,truth_cc,measured_cc\n" + "".join(rows))
    out = place / "out"
    names = ("report.html", "validation.json", "volumes.csv", "definitions.png", "bland-altman-1.png")
    return Case(
        ["study", "validation", table, "--out", out],
        out,
        names,
        [["study", "validation", table, "--out", table.parent]],
    )


def nine_models(place: Path, patch: pytest.MonkeyPatch) -> Case:
    def write_session(out: Path, recipe: SessionRecipe, **_: object) -> None:
        (out / "truth").mkdir(parents=True)
        (out / "session.toml").write_text("")
        (out / "truth" / "truth.json").write_text(
            json.dumps({"volumes_cc": {"model": 100.0 * int(recipe.subject[-1])}})
        )

    def open_session(session: Path, settings: object) -> SimpleNamespace:
        measured = SimpleNamespace(
            volume_cc=100.0 * int(session.name[-1]) + int(session.name[-1]) % 3, interval_cc=None
        )
        return SimpleNamespace(run=lambda report: SimpleNamespace(measurements={"model": measured}))

    patch.setattr(truth, "write_session", write_session)
    patch.setattr(truth, "open_session", open_session)
    patch.setattr(study, "_tasks_side_by_side", lambda bars, count, scale: nullcontext(map_in_sequence))
    out = place / "study"
    (place / "settings.toml").write_text("")
    return Case(
        ["study", "phantoms", out],
        out / "report",
        ("report.html", "agreement.json", "bland-altman.png", "scatter.png", "table.csv"),
        [["study", "phantoms", place, "--settings", place / "settings.toml"]],
    )


def evaluate(place: Path, patch: pytest.MonkeyPatch) -> Case:
    session = _session(place / "session")
    (session / "evaluation" / "truth").mkdir(parents=True)
    found = SimpleNamespace(as_table=dict, error_map=None, frame="the target")
    patch.setattr(truth, "read_truth", lambda *_: None)
    patch.setattr(truth, "current_results", lambda job: None)
    patch.setattr(truth, "evaluate", lambda *_, **__: found)
    for module in (truth, evaluation_tables):
        patch.setattr(module, "evaluation_tables", lambda found: [])
    return Case(
        ["evaluate", session],
        session / "evaluation",
        ("evaluation.json", "evaluation.md"),
        [["evaluate", session, "--truth", session / "evaluation" / "truth"]],
    )


def compare(place: Path, patch: pytest.MonkeyPatch) -> Case:
    sessions = [_session(place / name, seed=seed) for seed, name in enumerate(("before", "after"))]
    nothing = SimpleNamespace(breasts=(), lengths=(), fit=SimpleNamespace(within_mm=0.0, turned_deg=0.0))
    patch.setattr(dates, "_one_protocol", lambda jobs, progress: ([(), ()], []))
    patch.setattr(dates, "_visit", lambda job, volumes: None)
    patch.setattr(dates, "_common_scale", lambda jobs: False)
    patch.setattr(dates, "_warnings", lambda *_: [])
    patch.setattr(dates, "_report", lambda *_: None)
    patch.setattr(dates, "replace", lambda report, **_: report)
    patch.setattr(change, "compare", lambda *_, **__: nothing)
    patch.setattr(change_page, "change_files", lambda report: dict.fromkeys(change_page.FILES, b"page"))
    patch.setattr(change_page, "as_table", lambda report: {})
    patch.setattr(study, "_lines", lambda found: [])
    command: list[object] = ["compare", *sessions, "--out"]
    inside = [sessions[0], place, sessions[0] / "capture", sessions[1] / "capture" / "new"]
    return Case([*command, place / "out"], place / "out", change_page.FILES, [[*command, out] for out in inside])


def report(place: Path, patch: pytest.MonkeyPatch) -> Case:
    session = _session(place / "session")
    patch.setattr(Job, "_report_content", lambda *_: None)
    rendered = SimpleNamespace(html=b"page", pdf=b"document")
    patch.setattr(rendering, "render", lambda *_, **__: rendered)
    command: list[object] = ["report", session, "--deidentify", "--out"]
    inside = [session, place, session / "capture", session / "capture" / "new"]
    return Case(
        [*command, place / "out"], place / "out", (html.PAGE, pdf.DOCUMENT), [[*command, out] for out in inside]
    )


def figure(place: Path, patch: pytest.MonkeyPatch) -> Case:
    session = _session(place / "session")
    assert len(catalogue.PAPER_FIGURES)  # all are entered, before one is replaced
    patch.setitem(
        catalogue.PAPER_FIGURES._entries, "4", lambda source: SimpleNamespace(printed=lambda form, subject: b"figure")
    )
    return Case(
        ["figure", 4, session, "--out", place / "figure.pdf"],
        place,
        ("figure.pdf",),
        [["figure", 4, session, "--out", session / "capture" / "figure.pdf"]],
    )


def graph(place: Path, patch: pytest.MonkeyPatch) -> Case:
    session = _session(place / "session")
    inside = session / "capture" / "products.svg"
    return Case(
        ["graph", session, "--out", place / "products.svg"], place, ("products.svg",),
        [["graph", session, "--out", inside]],
    )  # fmt: skip


def target(place: Path, patch: pytest.MonkeyPatch) -> Case:
    session = _session(place / "session")
    inside = session / "capture" / "board.pdf"
    return Case(["target", place / "board.pdf"], place, ("board.pdf",), [["target", inside, "--session", session]])


def export_cameras(place: Path, patch: pytest.MonkeyPatch) -> Case:
    session = _session(place / "session")
    command: list[object] = ["export-cameras", session]
    inside = [session, session / "capture", place]
    return Case(
        [*command, place / "out"],
        place / "out",
        ("left.yml", "right.yml"),
        [[*command, out, "--format", "json"] for out in inside],
    )


def import_cameras(place: Path, patch: pytest.MonkeyPatch) -> Case:
    session = _session(place / "session", cameras=False)
    given = place / "given.json"
    given.write_text(json.dumps(cameras_table(_cameras())))
    other = _session(place / "other")
    inside: list[list[object]] = [["import-cameras", other, other / "cameras.json"]]
    return Case(["import-cameras", session, given], session, ("cameras.json",), inside)


def import_scan_mesh(place: Path, patch: pytest.MonkeyPatch) -> Case:
    given = scanned(place / "given", step_mm=20.0)
    command: list[object] = ["import", "mesh", given, "--scanner", "Vectra", "--units", "cm", "--out"]
    names = ("scan.toml", "scan.ply", "scan.obj", "scan.mtl", "texture-1.jpg")
    return Case([*command, place / "out"], place / "out", names, [[*command, given]])


def check(place: Path, patch: pytest.MonkeyPatch) -> Case:
    session = _session(place / "session")
    found = RigCheck(
        verdict="unmoved", reasons=(), cameras={}, unseen=(), alternatives=(), pairs={}, world_from_target={}
    )
    patch.setattr(detecting, "detect", lambda *_, **__: None)
    patch.setattr(checking, "check", lambda *_: found)
    _photograph(place / "monday" / "left.png", 5)
    _photograph(session / "checks" / "monday" / "left.png", 5)
    return Case(
        ["check", session, "--image-set", place / "monday"],
        session / "checks",
        ("drift.png",),
        [["check", session, "--image-set", session / "checks" / "monday"]],
    )


def _dome(path: Path) -> Path:
    solid = dome(sink_mm=10.0)
    path.parent.mkdir()
    trimesh.Trimesh(solid.vertices, solid.faces, process=False).export(path)
    return path


def measure(place: Path, patch: pytest.MonkeyPatch) -> Case:
    """Of another scanner's mesh: results lie in a folder of their own, which is laid out as a session's."""
    scan = _dome(place / "data" / "dome.ply")
    angles = np.linspace(0, 2 * np.pi, 120, endpoint=False)
    rim = 60 * np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=1)
    boundary = place / "data" / "b.json"
    boundary.write_text(json.dumps({"boundaries": {"model": {"points": rim.tolist()}}}))
    patch.setattr(mesh.MeshJob, "_write_report", lambda self, gathered: None)
    command: list[object] = ["measure", scan, "--units", "mm", "--boundary", boundary, "--out"]
    return Case(
        [*command, place / "out"], place / "out", (), [[*command, out] for out in (scan.parent, place, boundary)]
    )


def observers(place: Path, patch: pytest.MonkeyPatch) -> Case:
    """Two drawings of one dome, which stands for a breast on a trunk."""
    patch.setattr(drawn_alike, "find_body", lambda *_, **__: SimpleNamespace(frame=np.eye(3)))
    scan = _dome(place / "data" / "dome.ply")
    for name, radius in (("anna", 55.0), ("ben", 52.0)):
        angles = np.linspace(0, 2 * np.pi, 120, endpoint=False)
        rim = np.stack(
            [radius * np.cos(angles), radius * np.sin(angles), 0 * angles + (60**2 - radius**2) ** 0.5], axis=1
        )
        drawn = place / "data" / "curves" / f"{name}.json"
        drawn.parent.mkdir(exist_ok=True)
        drawn.write_text(json.dumps({"boundaries": {"left": {"points": rim.tolist()}}}))
    curves = place / "data" / "curves"
    command: list[object] = [
        "study",
        "observers",
        curves,
        "--mesh",
        scan,
        "--units",
        "mm",
        "--head",
        "y",
        "--ahead",
        "z",
    ]
    command += ["--set", "measure.wall=plane", "--out"]
    names = ("report.html", "observers.json", "volumes.png", "regions.png", "curves-1.png")
    inside = [[*command, out] for out in (curves, scan.parent, curves / "anna.json")]
    return Case([*command, place / "out"], place / "out", names, inside)


def batch(place: Path, patch: pytest.MonkeyPatch) -> Case:
    session = _session(place / "archive" / "one")
    row = BatchRow(
        session="one",
        subject=None,
        date=None,
        measured=(),
        made_at=None,
        seconds=1.0,
        peak_memory_mb=None,
        megapixels=1.0,
        page="report/report.html",
    )
    known = {str(session.resolve()): row}
    patch.setattr(batches, "look", lambda *_: batches.Looked(current=known, known=known))
    table = place / "data" / "sessions.csv"
    table.parent.mkdir()
    table.write_text("session,set\n../archive/one,measure.wall=plane\n")
    inside = [["batch", session, "--out", out] for out in (session, place / "archive", session / "capture")]
    return Case(
        ["batch", table, "--out", place / "out"],
        place / "out",
        ("batch.html", "batch.csv"),
        [*inside, ["batch", table, "--out", table.parent]],
    )


def _exported(place: Path, patch: pytest.MonkeyPatch) -> Path:
    """A session whose results are made up."""
    made = exports.exported(place / "made")
    patch.setattr(gathering, "gather", lambda *_, **__: made)
    return _session(place / "session")


def _export(kind: str, names: tuple[str, ...]) -> Callable[[Path, pytest.MonkeyPatch], Case]:
    def case(place: Path, patch: pytest.MonkeyPatch) -> Case:
        session = _exported(place, patch)
        command: list[object] = ["export", kind, session, "--out"]
        return Case([*command, place / "out"], place / "out", names, [[*command, session / "capture" / "new"]])

    return case


def acceptance_run(place: Path, patch: pytest.MonkeyPatch) -> Case:
    folder = place / "test"
    (folder / "cast").mkdir(parents=True)
    body = Cast(volume_cc=400.0, volume_std_cc=0.5, source="drawn")
    results = []
    for position in POSITIONS["cast"]:
        shape = dome(rings=10, around=30)
        trimesh.Trimesh(shape.vertices, shape.faces).export(folder / "cast" / f"{position.name}.ply")
        results.append(evaluate_volume(400.0, position.name, body, Limits()))
    (folder / "acceptance.toml").write_text(
        'format = 1\n[device]\nname = "Rig"\nperson = "ab"\ndate = 2026-11-29\n'
        '[cast]\nvolume_cc = 400.0\nvolume_std_cc = 0.5\nsource = "drawn"\n'
    )
    outcome = Outcome(test=acceptance.read_test(folder), results=tuple(results))
    patch.setattr(acceptance, "run_acceptance", lambda *_, **__: outcome)
    command: list[object] = ["acceptance", "run", folder]
    names = ("acceptance.html", "acceptance.pdf", "acceptance.json", "acceptance.csv", "positions-cast.png")
    return Case([*command, "--out", place / "out"], place / "out", names, [[*command, "--out", folder / "cast"]])


def acceptance_new(place: Path, patch: pytest.MonkeyPatch) -> Case:
    patch.setattr(acceptance_page, "protocol_page", lambda device: b"page")
    return Case(["acceptance", "new", place / "test"], place / "test", ("acceptance.toml", "protocol.html"))


CASES: dict[str, Callable[[Path, pytest.MonkeyPatch], Case]] = {
    "acceptance new": acceptance_new,
    "acceptance run": acceptance_run,
    "study agreement": agreement,
    "study observers": observers,
    "study repeatability": repeatability,
    "study validation": validation,
    "study phantoms": nine_models,
    "evaluate": evaluate,
    "compare": compare,
    "report": report,
    "figure": figure,
    "graph": graph,
    "target": target,
    "export-cameras": export_cameras,
    "import-cameras": import_cameras,
    "import mesh": import_scan_mesh,
    "check": check,
    "measure": measure,
    "batch": batch,
    "export dicom": _export("dicom", ("01-DOC-001.dcm", "02-SR-001.dcm", "03-M3D-003.dcm", "06-XC-002.dcm")),
    "export fhir": _export("fhir", ("bundle.json",)),
    "export redcap": _export("redcap", ("data-dictionary.csv", "records.csv")),
    "export table": _export("table", ("measurements.csv", "codebook.csv")),
}
NEW_FOLDERS = {
    "new": ["new"], "simulate": ["simulate"], "demo": ["demo"], "study phantoms": ["study", "phantoms"],
    "photos": ["photos", "photographs", "--out"],
}  # fmt: skip
"""Commands that only write into a folder that is new or empty, or go on with the one that they made."""
ONLY_IN_THE_SESSION = {"capture", "skew", "run", "calibrate", "match", "surface", "edit"}
"""They write SESSION/results, and what is drawn, by the memo's and the editor's own rules; no place is named."""
READ_ONLY = {"doctor", "info", "settings", "study landmarks", "verify"}
IN_THE_CLINIC = {
    f"clinic {name}"
    for name in (
        "init", "serve", "upgrade", "people add", "people list", "people invite", "backup", "restore", "export",
        "erase", "audit", "demo", "work", "test-restore",
    )
}  # fmt: skip
"""They write into the clinic's folder; elsewhere new files and folders only, which `test_clinic_keep` shows."""


def commands(group: click.Group, above: str = "") -> Iterator[tuple[str, click.Command]]:
    for name, command in group.commands.items():
        if hasattr(command, "commands"):
            yield from commands(command, f"{above}{name} ")  # type: ignore[arg-type]
        else:
            yield above + name, command


@pytest.mark.requirement("R-LOSS-7")
def test_every_command_is_covered() -> None:
    """A new command, or a new place to write to, has to come here."""
    found = dict(commands(get_command(main.app)))  # type: ignore[arg-type]
    assert set(found) == {*CASES, *NEW_FOLDERS, *ONLY_IN_THE_SESSION, *READ_ONLY, *IN_THE_CLINIC}
    for name in (*ONLY_IN_THE_SESSION, *READ_ONLY):
        for parameter in found[name].params:
            assert "out" not in parameter.name.split("_"), f"{name} writes to {parameter.name}"
            assert "OUT" not in str(parameter.metavar), f"{name} writes to {parameter.metavar}"


# --- what they promise ---


def tree(place: Path) -> dict[str, bytes | None]:
    return {str(path.relative_to(place)): path.read_bytes() if path.is_file() else None for path in place.rglob("*")}


def run(arguments: list[object], capsys: pytest.CaptureFixture[str]) -> tuple[int, dict[str, Any]]:
    code = main.run([*map(str, arguments), "--json"])
    return code, json.loads(capsys.readouterr().out)


def computing_is_a_mistake(patch: pytest.MonkeyPatch) -> None:
    """From now on whoever computes before refusing has a defect (exit code 70)."""

    def compute(*_: object, **__: object) -> None:
        raise AssertionError("computed before it refused")

    for owner, name in (
        (Job, "ensure"),
        (truth, "write_session"),
        (detecting, "detect"),
        (change, "compare"),
        (truth, "evaluate"),
        (mesh, "read_foreign"),
        (scan_files, "read_foreign"),
        (simulated, "build_rig"),
        (batches, "measure_batch"),
        (sheets, "target_pdf"),
        (agreeing, "agreement"),
        (gathering, "gather"),
    ):
        patch.setattr(owner, name, compute)


@pytest.fixture(autouse=True)
def _no_stage_is_made(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Job, "ensure", lambda self, stage, **_: None)


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
@pytest.mark.requirement("R-LOSS-6")
def test_a_second_run_replaces_its_own_and_nothing_else(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    case = CASES[name](tmp_path, monkeypatch)
    before = tree(tmp_path)
    assert run(case.arguments, capsys)[0] == 0
    assert set(case.names) <= set(tree(case.folder))
    (case.folder / "mine.txt").write_text("mine")
    record, _ = unsealed((case.folder / RECORD).read_bytes())
    for each in case.names:  # as if the first run had written something else
        (case.folder / each).write_bytes(b"earlier")
        record["files"][each]["sha256"] = [hashlib.sha256(b"earlier").hexdigest()]
    (case.folder / RECORD).write_bytes(sealed(record))
    assert run(case.arguments, capsys)[0] == 0
    for each in case.names:
        assert (case.folder / each).read_bytes() != b"earlier"
    assert (case.folder / "mine.txt").read_text() == "mine"
    after = tree(tmp_path)
    assert {path: after.get(path) for path in before} == before


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
@pytest.mark.requirement("R-LOSS-5")
def test_what_somebody_else_wrote_is_refused_and_stays(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    case = CASES[name](tmp_path, monkeypatch)
    computing_is_a_mistake(monkeypatch)
    case.folder.mkdir(parents=True, exist_ok=True)
    for each in case.names or ("any",):
        (case.folder / each).write_text("mine")
        before = tree(tmp_path)
        code, output_text = run(case.arguments, capsys)
        assert 3 <= code <= 9, output_text
        assert str(case.folder) in output_text["error"]
        assert tree(tmp_path) == before
        (case.folder / each).unlink()


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in CASES if name != "measure"])  # its files are the memo's
@pytest.mark.requirement("R-LOSS-5")
def test_what_was_changed_since_is_refused_and_stays(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    case = CASES[name](tmp_path, monkeypatch)
    assert run(case.arguments, capsys)[0] == 0
    computing_is_a_mistake(monkeypatch)
    (case.folder / case.names[-1]).write_text("mine")
    before = tree(tmp_path)
    code, output_text = run(case.arguments, capsys)
    assert 3 <= code <= 9, output_text
    assert f"{case.names[-1]}: " in output_text["error"]
    assert tree(tmp_path) == before


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in CASES if name != "acceptance new"])  # it reads nothing
@pytest.mark.requirement("R-LOSS-6")
def test_nothing_is_written_to_where_the_command_reads(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    case = CASES[name](tmp_path, monkeypatch)
    computing_is_a_mistake(monkeypatch)
    before = tree(tmp_path)
    assert case.within
    for arguments in case.within:
        code, output_text = run(arguments, capsys)
        assert 3 <= code <= 9, (arguments, output_text)
        assert "this command reads" in output_text["error"]
        assert tree(tmp_path) == before


@pytest.mark.parametrize(
    "name", ["study phantoms", "compare", "report", "measure", "export-cameras", "batch", "export table"]
)
def test_the_settings_are_read_too(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    case = CASES[name](tmp_path, monkeypatch)
    computing_is_a_mistake(monkeypatch)
    case.folder.mkdir(parents=True, exist_ok=True)
    (case.folder / "settings.toml").write_text("")
    before = tree(tmp_path)
    code, output_text = run([*case.arguments, "--settings", case.folder / "settings.toml"], capsys)
    assert 3 <= code <= 9, output_text
    assert "settings.toml" in output_text["error"]
    assert tree(tmp_path) == before


@pytest.mark.parametrize("name", NEW_FOLDERS)
@pytest.mark.parametrize("kind", ["folder", "file"])
def test_a_folder_with_anything_in_it_is_not_new(
    name: str, kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    computing_is_a_mistake(monkeypatch)
    out = tmp_path / "out"
    if kind == "folder":
        out.mkdir()
        (out / ".mine").write_text("mine")
    else:
        out.write_text("mine")
    before = tree(tmp_path)
    code, output_text = run([*NEW_FOLDERS[name], out], capsys)
    assert 3 <= code <= 9, output_text
    assert tree(tmp_path) == before


def test_a_bad_line_of_the_history_does_not_cost_the_verdict(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    case = check(tmp_path, monkeypatch)
    history = case.folder / "history.jsonl"
    history.write_bytes(b"{torn")
    code, output_text = run(case.arguments, capsys)
    assert (code, output_text.get("verdict")) == (0, "unmoved"), output_text
    assert [warning.partition(": ")[0] for warning in output_text["warnings"]] == ["checks/history.jsonl, line 1"]
    assert history.read_bytes().startswith(b"{torn\n{")
    assert main.run([*map(str, case.arguments)]) == 0
    assert "Warning: checks/history.jsonl, line 1" in capsys.readouterr().out
    code, output_text = run(["check", case.arguments[1], "--history"], capsys)
    assert (code, len(output_text["checks"]), len(output_text["warnings"])) == (0, 2, 1)
