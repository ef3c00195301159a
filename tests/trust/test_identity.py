"""Nobody confused: whatever a result shows belongs to its key, and one folder is one subject's."""

import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest
import tifffile
import trimesh
from PIL import Image
from pydantic import BaseModel
from pypdf import PdfReader
from tests.scenes.conftest import TINY, TINY_SETTINGS, tiny_demo, tiny_finished_original, tiny_settings  # noqa: F401

from mammometry.api.job import open_session
from mammometry.base.errors import SessionError
from mammometry.cli import main, simulation
from mammometry.io.manifest import Manifest
from mammometry.io.outputs import RECORD
from mammometry.job.stages import match, surface
from mammometry.report.words.describe import settings_facts
from mammometry.settings import Settings, names

ID, OTHER = "P-7731", "P-8842"
STRANGE = os.fsdecode(b"M\xfcller A")
"""A folder's name in an encoding of the last century."""


def whole_run(test: Callable[..., None]) -> Callable[..., None]:
    """Marks what looks at a second end-to-end run: slow, and all by one worker."""
    return pytest.mark.slow(pytest.mark.xdist_group("identified session")(test))


def edit(folder: Path, before: str, after: str) -> Path:
    """Change the folder's manifest; a copy of it that is linked stays as it is."""
    path = folder / "session.toml"
    text = path.read_text(encoding="utf-8")
    path.unlink()
    path.write_text(text.replace(before, after, 1), encoding="utf-8")
    return folder


def tell(folder: Path, subject: str | None) -> Path:
    """Have the folder's manifest tell a subject, or none."""
    if subject is None:
        return edit(folder, f'id = "{ID}"\n', "")
    return edit(folder, "[subject]\n", f'[subject]\nid = "{subject}"\n')


@pytest.fixture
def options(tmp_path: Path) -> list[str]:
    """The tiny session's settings."""
    path = tmp_path / "tiny.toml"
    path.write_text(TINY_SETTINGS)
    return ["--settings", str(path)]


def answer(capsys: pytest.CaptureFixture[str], *arguments: object) -> dict[str, Any]:
    capsys.readouterr()
    main.run([*map(str, arguments), "--json"])
    table: dict[str, Any] = json.loads(capsys.readouterr().out)
    return table


def shown(folder: Path) -> str:
    """All that page and document of a folder say, with the document's metadata."""
    document = PdfReader(folder / "report.pdf")
    words = [page.extract_text() for page in document.pages] + list(map(str, (document.metadata or {}).values()))
    return "\n".join([(folder / "report.html").read_text(encoding="utf-8"), *words])


# --- names ---


@pytest.mark.slow
@pytest.mark.requirement("R-WHO-1")
def test_a_copied_folder_shows_its_own_name(
    tmp_path: Path,
    options: list[str],
    tiny_finished_original: Path,  # noqa: F811
    capsys: pytest.CaptureFixture[str],
) -> None:
    mueller = Path(shutil.copytree(tiny_finished_original, tmp_path / "Müller A"))
    assert main.run(["run", str(mueller), *options]) == 0
    assert "Müller A" in shown(mueller / "results" / "report")
    huber = Path(shutil.copytree(mueller, tmp_path / "Huber B"))
    edit(huber, "[rig]", "date = 2025-05-06\n[rig]")

    before = answer(capsys, "info", huber, *options)["stages"]
    assert before["report"]["state"] == "stale"
    assert {before[stage]["state"] for stage in ("calibrate", "match", "surface", "measure")} == {"current"}
    assert main.run(["info", str(huber), *options]) == 0
    assert "(Müller A)" in capsys.readouterr().out

    assert answer(capsys, "run", huber, *options)["made"] == ["report/content", "report/report"]
    assert "Müller" not in shown(huber / "results" / "report")
    assert "Huber B" in shown(huber / "results" / "report")
    assert "photographed 2025-05-06" in shown(huber / "results" / "report")
    assert answer(capsys, "info", huber, *options)["stages"]["report"]["state"] == "current"


_WALK = """[walk]
region_mm = [[-300.0, -300.0, -300.0], [300.0, 300.0, 300.0]]
board_mm = [[-120.0, 350.0], [120.0, 500.0]]
scale_std = 0.01
point_std_mm = 0.1
"""
FIELDS = {
    "rig.name": ('name = "', 'name = "another '),
    "rig.mounting": ("[rig]\n", '[rig]\nmounting = "upside-down"\n'),
    "rig.pairs.name": ('name = "front"', 'name = "before"'),
    "rig.pairs.left": ('left = "front_left", right = "front_right"', 'left = "front_right", right = "front_left"'),
    "rig.pairs.right": ('left = "front_left", right = "front_right"', 'left = "front_left", right = "third"'),
    "subject.kind": ('kind = "model"', 'kind = "surface"'),
    "subject.id": ("[subject]\n", f'[subject]\nid = "{ID}"\n'),
    "subject.rim_radius_mm": ("[subject]\n", "[subject]\nrim_radius_mm = 0.5\n"),
    "subject.posture": ('kind = "torso"', 'kind = "torso"\nposture = "standing"'),
    "date": ("[rig]\n", "date = 2026-01-31\n[rig]\n"),
    "target": ("square_mm = ", "edge_std_mm = 0.05\nedge_mm = 350.5\nsquare_mm = "),
    **{
        f"walk.{name}": ("[subject]\n", f"{_WALK}[subject]\n")
        for name in ("region_mm", "board_mm", "scale_std", "point_std_mm")
    },
    "walk.card_scale": ("[subject]\n", f"{_WALK}card_scale = 0.99\n[subject]\n"),
    "intrinsics.target": (
        "[subject]\n",
        '[intrinsics]\ntarget = { kind = "chessboard", squares = [10, 7], square_mm = 25.0 }\n[subject]\n',
    ),
}
"""Field of session.toml → what is replaced in the tiny session's to change it. The folder has photographs for all."""


def fields(model: type[BaseModel], prefix: str = "") -> Iterator[str]:
    """Dotted names of all that a manifest tells."""
    for name, info in model.model_fields.items():
        inner = [part for kind in (info.annotation, *get_args(info.annotation)) for part in (kind, *get_args(kind))]
        models = [part for part in inner if isinstance(part, type) and issubclass(part, BaseModel)]
        if models:
            yield from fields(models[0], f"{prefix}{name}.")
        else:
            yield prefix + name


@pytest.fixture(scope="module")
def linked(tmp_path_factory: pytest.TempPathFactory, tiny_finished_original: Path) -> Path:  # noqa: F811
    """The tiny session, its photographs linked, with photographs for whatever a manifest may name."""
    folder = tmp_path_factory.mktemp("linked") / "session"
    shutil.copytree(tiny_finished_original, folder, ignore=shutil.ignore_patterns("results", "truth"))
    manifest = folder / "session.toml"
    text = manifest.read_text(encoding="utf-8")
    manifest.write_text(re.sub(r"^rim_radius_mm.*\n", "", text, flags=re.MULTILINE), encoding="utf-8")
    for camera in ("front_left", "front_right", "third"):
        photograph = folder / "capture" / ("front_left.jpg" if camera == "third" else f"{camera}.jpg")
        (folder / "intrinsics" / camera).mkdir(parents=True)
        shutil.copy(photograph, folder / "intrinsics" / camera / "1.jpg")
    return folder


def test_every_field_of_a_manifest_is_changed_here() -> None:
    """A new field needs a line in FIELDS, and with it a thought on whether a page shows it."""
    assert set(FIELDS) == set(fields(Manifest)) - {"format", "units"}  # which have one value


@pytest.mark.parametrize("field", FIELDS)
@pytest.mark.requirement("R-WHO-2")
def test_whatever_a_manifest_tells_is_in_the_reports_key(linked: Path, tmp_path: Path, field: str) -> None:
    text = (linked / "session.toml").read_text(encoding="utf-8")
    if field == "subject.posture":  # a cast has none
        text = text.replace('kind = "model"', 'kind = "torso"')
    before, after = FIELDS[field]
    assert before in text
    folders = tmp_path / "before" / linked.name, tmp_path / "after" / linked.name
    for folder, manifest in zip(folders, (text, text.replace(before, after, 1)), strict=True):
        shutil.copytree(linked, folder, copy_function=os.symlink)
        (folder / "session.toml").unlink()
        (folder / "session.toml").write_text(manifest, encoding="utf-8")
    unchanged, changed = folders
    if field == "rig.pairs.right":
        for path in [changed / "capture", *(changed / "calibration").iterdir()]:
            (path / "third.jpg").symlink_to(linked / path.relative_to(changed) / "front_right.jpg")
    job = open_session(changed)
    assert job.identity.name == linked.name
    assert job.content_key.digest != open_session(unchanged).content_key.digest


@pytest.mark.requirement("R-WHO-2")
def test_every_setting_that_a_page_lists_is_in_its_key(linked: Path) -> None:
    everything = {fact.label for fact in settings_facts(Settings())[1]}
    assert everything == set(names(Settings()))

    def digest(*assignments: str) -> str:
        return open_session(linked, Settings().overridden(assignments)).content_key.digest

    # No product depends on these, and the page lists them.
    for assignment in ("compare.doubt_mm=1.5", "calibration.check.refuse_mm=0.9"):
        assert digest(assignment) != digest()


# --- the subject's identifier ---


@dataclass(frozen=True)
class Run:
    """A session measured by the command line."""

    folder: Path
    answer: dict[str, Any]
    log: str


@pytest.fixture(scope="module")
def identified(tmp_path_factory: pytest.TempPathFactory, tiny_finished_original: Path) -> Run:  # noqa: F811
    """The tiny session with a subject, measured from the beginning in a folder whose name is not UTF-8."""
    root = tmp_path_factory.mktemp("identified")
    ignored = shutil.ignore_patterns("results")
    folder = tell(Path(shutil.copytree(tiny_finished_original, root / STRANGE, ignore=ignored)), ID)
    (root / "tiny.toml").write_bytes(b"\xef\xbb\xbf" + TINY_SETTINGS.encode())
    command = [sys.executable, "-m", "mammometry", "run", str(folder), "--settings", str(root / "tiny.toml"), "--json"]
    done = subprocess.run([*command, "-vv"], capture_output=True, check=False)
    assert done.returncode == 0, done.stderr
    return Run(folder=folder, answer=json.loads(done.stdout), log=done.stderr.decode())


@whole_run
def test_a_folder_whose_name_is_not_utf_8_is_measured_to_the_end(identified: Run) -> None:
    assert Path(identified.answer["report"]) == identified.folder / "results" / "report" / "report.html"
    page = shown(identified.folder / "results" / "report")
    assert f"<h1>{ID}</h1>" in page
    assert "M\\xfcller A" in page


@whole_run
@pytest.mark.requirement("R-SENT-5")
def test_no_log_tells_a_name(identified: Run) -> None:
    assert "making surface/mesh" in identified.log
    assert ID not in identified.log
    assert "ller A" not in identified.log


@whole_run
@pytest.mark.requirement("R-WHO-3")
def test_every_file_of_the_results_carries_the_subject(identified: Run) -> None:
    files = [path for path in (identified.folder / "results").rglob("*") if path.is_file() and path.name != ".lock"]
    endings = {path.suffix for path in files}
    assert endings == {".json", ".npz", ".tif", ".ply", ".glb", ".obj", ".mtl", ".jpg", ".png", ".html", ".pdf", ".zip"}
    without = [path.name for path in files if ID.encode() not in path.read_bytes()]
    assert without == []


@whole_run
def test_other_programs_find_the_subject_and_read_the_rest(identified: Run) -> None:
    results = identified.folder / "results"
    with Image.open(results / "surface" / "views.png") as picture:
        assert picture.text["Subject"] == ID  # type: ignore[attr-defined]
    with Image.open(results / "surface" / "model.jpg") as picture:
        assert picture.info["comment"].decode() == f"subject {ID}"
    assert json.loads((results / "measure" / "measurement.json").read_text())["subject"] == ID
    assert bytes(np.load(results / "surface" / "repaired.npz")["subject"]).decode() == ID
    with tifffile.TiffFile(results / "surface" / "range" / "front.tif") as tiff:
        assert json.loads(tiff.pages.first.description)["subject"] == ID
        assert tiff.pages.first.asarray().dtype == np.float32
    assert f"comment subject {ID}\n".encode() in (results / "surface" / "mesh.ply").read_bytes()[:200]
    meshes = [trimesh.load(results / "surface" / "mesh.ply", process=False, force="mesh")]
    meshes += [trimesh.load(results / "surface" / f"model.{ending}", force="mesh") for ending in ("glb", "obj")]
    assert all(len(mesh.faces) for mesh in meshes)
    document = PdfReader(results / "report" / "report.pdf")
    assert ID in str((document.metadata or {})["/Title"])


@whole_run
def test_results_are_read_back_and_nothing_is_made_again(identified: Run, options: list[str]) -> None:
    job = open_session(identified.folder, Settings.load(Path(options[1])))
    job.run()
    assert job.store.made == []
    assert job.plan[match.disparity]["front"]().valid.any()
    assert job.plan[surface.model]().mesh.faces.size


@pytest.fixture
def copied(identified: Run, tmp_path: Path) -> Path:
    return Path(shutil.copytree(identified.folder, tmp_path / "Huber B", copy_function=os.link))


@pytest.fixture
def claimed(linked: Path, tiny_finished_original: Path, tmp_path: Path) -> Path:  # noqa: F811
    """A session of one subject, whose results say that they are another's."""
    folder = tell(Path(shutil.copytree(linked, tmp_path / "Huber B")), OTHER)
    shutil.copytree(tiny_finished_original / "results", folder / "results")
    for path in (folder / "results").glob("*/provenance.json"):
        table = json.loads(path.read_text())
        for record in table["products"].values():
            record["subject"] = ID
        path.write_text(json.dumps(table))
    return folder


@pytest.mark.parametrize(
    "command", ["run", "info", "calibrate", "match", "surface", "measure", "report", "edit", "evaluate", "figure 5"]
)
@pytest.mark.requirement("R-WHO-4")
def test_results_of_another_subject_are_refused_by_every_command(
    claimed: Path, options: list[str], command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    before = sorted(path.stat().st_mtime_ns for path in claimed.rglob("*"))
    assert main.run([*command.split(), str(claimed), *options]) == SessionError.exit_code
    printed = capsys.readouterr().err
    assert f"subject '{ID}', expected '{OTHER}'" in printed
    assert "results/" in printed
    assert sorted(path.stat().st_mtime_ns for path in claimed.rglob("*")) == before


@pytest.mark.parametrize("file", ["boundaries.json", "landmarks.json", "history/boundaries-20260101T000000Z.json"])
@pytest.mark.requirement("R-WHO-4")
def test_what_was_drawn_on_another_subject_is_refused(linked: Path, tmp_path: Path, file: str) -> None:
    folder = tell(Path(shutil.copytree(linked, tmp_path / "drawn")), ID)
    (folder / "history").mkdir()
    (folder / file).write_text(json.dumps({"subject": OTHER}))
    with pytest.raises(SessionError, match=rf"{file}: .*'{OTHER}', .*'{ID}'"):
        open_session(folder)
    tell(folder, None)
    (folder / "results" / "match").mkdir(parents=True)
    record = {"format": 1, "products": {"disparity/front": {"subject": ID}}}
    (folder / "results" / "match" / "provenance.json").write_text(json.dumps(record))
    with pytest.raises(SessionError, match=r"^results/match/provenance\.json: .*subject"):
        open_session(folder)


@whole_run
@pytest.mark.parametrize("subject", [None, ID])
def test_results_are_stale_where_their_subject_was_told_later_or_no_longer(
    copied: Path,
    tmp_path: Path,
    options: list[str],
    tiny_finished_original: Path,  # noqa: F811
    subject: str | None,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """That is no contradiction, so that nothing is refused; and nothing shows the old state as current."""
    plain = Path(shutil.copytree(tiny_finished_original, tmp_path / "plain"))
    folder = tell(copied if subject is None else plain, subject)
    stages = answer(capsys, "info", folder, *options)["stages"]
    states = {product["state"] for stage in stages.values() for product in stage["products"].values()}
    assert states == {"stale"}


@whole_run
@pytest.mark.requirement("R-SENT-4")
def test_a_report_for_others_tells_neither_subject_nor_folder_nor_date(
    copied: Path, options: list[str], tmp_path: Path
) -> None:
    edit(copied, "[rig]", "date = 2025-05-06\n[rig]")
    assert main.run(["report", str(copied), *options, "--deidentify"]) == 0
    shutil.copytree(copied / "results" / "deidentified", tmp_path / "given")
    renamed = copied.rename(tmp_path / "Gruber C")
    job = open_session(renamed, Settings.load(Path(options[1])))
    assert job.pages() == {"deidentified/report.html": "current"}  # it shows no name that could be another's
    assert open_session(renamed).pages() == {"deidentified/report.html": "stale"}  # of other settings
    for path in (tmp_path / "given").iterdir():
        for word in (ID.encode(), b"Huber", b"2025-05-06", b"provenance.json"):
            assert word not in path.read_bytes(), path
    assert "De-identified case" in shown(tmp_path / "given")


@whole_run
def test_an_evaluation_carries_the_subject(copied: Path, options: list[str]) -> None:
    assert main.run(["evaluate", str(copied), *options]) == 0
    files = [path.read_bytes() for path in (copied / "evaluation").iterdir() if path.name != RECORD]
    assert len(files) == 3
    assert all(ID.encode() in data for data in files)


# --- nothing to do ---


@whole_run
@pytest.mark.parametrize("command", ["run", "calibrate", "match", "surface", "measure", "report"])
def test_where_nothing_is_made_it_says_so_and_when_it_was(
    identified: Run, options: list[str], command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main.run([command, str(identified.folder), *options]) == 0
    said = capsys.readouterr().out
    records = json.loads((identified.folder / "results" / "calibrate" / "provenance.json").read_text())["products"]
    day = max(record["made"] for record in records.values())[:10]
    assert re.search(rf"\b({day}|\S+) \d\d:\d\d UTC\.", said)
    assert not re.search(r"\d s\b", said)  # no seconds that look like those of the work


def test_the_demo_says_when_it_was_made(
    tmp_path: Path,
    options: list[str],
    tiny_finished_original: Path,  # noqa: F811
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(simulation, "_DEMO_RECIPE", TINY)
    folder = Path(shutil.copytree(tiny_finished_original, tmp_path / tiny_finished_original.name))
    assert main.run(["demo", str(folder), *options]) == 0
    said = capsys.readouterr().out
    assert re.search(r"made 2\d\d\d-", said)
    assert not re.search(r"\d s\b", said)
