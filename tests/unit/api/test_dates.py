"""Two sessions compared, from folders to the page: order, protocol, privacy, and what is refused."""

import json
import re
import shutil
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import trimesh
from benchmarks.accuracy.dates import TrueVisit, grown, true_visit
from dated_session import put_results, write_session
from playwright.sync_api import sync_playwright
from tests.patience import patient

import mammometry
from mammometry.api import dates
from mammometry.api.dates import Comparison, compare
from mammometry.api.job import Job, open_session
from mammometry.base.errors import MeasureError, SessionError, StorageError
from mammometry.base.notices import Notice
from mammometry.cli.main import run
from mammometry.io.meshes.scans import ScanFacts, import_scan
from mammometry.measure.volume import boundary_jitter
from mammometry.measure.volume.uncertainty import VolumeEvidence
from mammometry.report.documents import change_page
from mammometry.report.documents.change_page import ChangeReport
from mammometry.report.privacy import Privacy
from mammometry.settings import Settings
from mammometry.simulate.subjects.torso_shape import torso_shape

pytestmark = pytest.mark.slow

NAME = "torso_2"
MARKS = ("sternal_notch", "nipple_left", "nipple_right")


@cache
def body(place: int, growth: float = 1.0) -> TrueVisit:
    return true_visit(grown(torso_shape(NAME, 0), {"left": growth}), NAME, place, edge_mm=3.5)


CHROMIUM = shutil.which("chromium")
FLAGS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--disable-background-networking"]
BEFORE, AFTER = (2, 1.0), (3, 1.35)


def codes(found: Comparison) -> set[str]:
    return {notice.code for notice in found.notices}


@pytest.fixture
def reports(monkeypatch: pytest.MonkeyPatch) -> list[ChangeReport]:
    """What would be drawn; pictures and page, the slow part, are left out."""
    seen: list[ChangeReport] = []

    def kept(report: ChangeReport) -> dict[str, bytes]:
        seen.append(report)
        return {change_page.PAGE: b"", change_page.NUMBERS: b"{}"}

    monkeypatch.setattr(change_page, "change_files", kept)
    return seen


@pytest.fixture(autouse=True)
def _nothing_is_matched(monkeypatch: pytest.MonkeyPatch) -> None:
    """The store holds what a comparison reads; no stage is made."""
    monkeypatch.setattr(Job, "ensure", lambda self, stage, *, drawn=True: None)
    monkeypatch.setattr(dates, "_evidence", lambda job: VolumeEvidence())
    # The slow part of an interval, with tests of its own; its rule of thumb stands in.
    monkeypatch.setattr(boundary_jitter, "boundary_std_cc", lambda *_, **__: None)


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """The later one named first would be found out by its date."""
    root = tmp_path_factory.mktemp("dates")
    made = []
    for name, how, date in (("mueller-vernal", BEFORE, "2026-03-01"), ("mueller-fall", AFTER, "2026-10-02")):
        folder = write_session(root / name, body(*how), how[0], date=date, landmarks=MARKS)
        put_results(folder, body(*how))
        made.append(folder)
    return made[0], made[1]


@pytest.fixture(scope="module")
def found(folders: tuple[Path, Path]) -> Comparison:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Job, "ensure", lambda self, stage, *, drawn=True: None)
        return compare(folders[1], folders[0])


def test_dates_of_the_manifests_decide_the_order(found: Comparison, folders: tuple[Path, Path]) -> None:
    assert (found.before, found.after) == folders
    assert "dates-exchanged" in codes(found)
    assert found.table["dates"] == "2026-03-01 → 2026-10-02: 215 days apart"
    assert found.folder == folders[1] / "results" / "compare" / "mueller-vernal"


def test_change_and_verdicts_are_those_of_the_bodies(found: Comparison) -> None:
    left, right = found.change.breasts
    true_cc = body(*AFTER).volume_cc("left") - body(*BEFORE).volume_cc("left")
    # The rounded wall takes 2 to 6 % off what stands before a chest as straight as this one (decision 29).
    assert left.volume.difference_cc == pytest.approx(true_cc, rel=0.04)
    assert left.volume.beyond_error
    assert not right.volume.beyond_error
    # The cameras came ready-made: nothing is known of a scale that both would share.
    assert "scale" not in left.volume.terms_cc
    table = json.loads((found.folder / "compare.json").read_text())
    assert table == json.loads(json.dumps(found.table))
    assert table["breasts"]["left"]["change_cc"] == pytest.approx(true_cc, rel=0.04)
    assert table["registration"]["pairing"] == "same pose"


def test_lengths_change_as_the_landmarks_do(found: Comparison) -> None:
    straight = {each.name: each for each in found.change.lengths if not each.along}
    marks = [body(*how).torso.solid.landmarks for how in (BEFORE, AFTER)]
    true_mm = [np.linalg.norm(each["nipple_left"][0] - each["sternal_notch"][0]) for each in marks]
    assert straight["SN-N left"].change_mm == pytest.approx(true_mm[1] - true_mm[0], abs=1.0)
    assert straight["SN-N right"].beyond_error is False


def test_the_page_is_led_by_the_change_and_needs_nothing_else(found: Comparison) -> None:
    page = found.page.read_text(encoding="utf-8")
    assert sorted(path.name for path in found.folder.iterdir()) == [
        ".mammometry.json",
        "change.png",
        "compare.html",
        "compare.json",
        "compare.pdf",
        "scene.json",
        "sections.png",
    ]
    first = page.index('class="volume"')
    assert page.index("<h1") < first < page.index("<figure>")
    left, right = (breast["verdict"] for breast in found.table["breasts"].values())
    assert re.search(r"^Left .* cc larger .*1 March 2026 \(95 %: ", left)
    assert left.partition("): ")[2] != right.partition("): ")[2]
    said = page.replace("\xa0", " ")
    for sentence in (left, right):
        assert sentence in said
    assert re.search(r"% .*trunk", page)
    assert 'src="http' not in page
    assert "<link" not in page
    assert len(page) < 8 * 2**20
    assert (found.folder / "compare.pdf").read_bytes().startswith(b"%PDF")


@pytest.mark.slow
@pytest.mark.xdist_group("two dates")
@pytest.mark.skipif(CHROMIUM is None, reason="no chromium on this machine: apt-get install chromium")
def test_the_page_opens_on_both_dates_coloured_by_the_change(found: Comparison) -> None:
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        page = patient(browser.new_page(viewport={"width": 360, "height": 740}))
        asked: list[str] = []
        page.on("request", lambda request: asked.append(request.url))
        page.goto(found.page.as_uri())
        page.wait_for_function("document.getElementById('mm-viewer').dataset.ready === '2'")
        assert page.evaluate("document.documentElement.scrollWidth") == 360
        assert page.locator("#mm-viewer canvas").count() == 2
        assert page.locator("#mm-viewer figcaption").all_inner_texts() == ["Before", "After"]
        assert page.get_by_role("button", name="Change between the dates").get_attribute("aria-pressed") == "true"
        assert page.locator(".mm-legend").inner_text().split("mm")[0].split() == ["−15.0", "15.0"]
        assert [url for url in asked if not url.startswith(("file:", "data:", "blob:"))] == []
        browser.close()


@pytest.mark.slow
@pytest.mark.xdist_group("two dates")
def test_a_page_for_others_gives_no_name_and_no_date(folders: tuple[Path, Path], tmp_path: Path) -> None:
    shared = compare(*folders, out=tmp_path / "given", privacy=Privacy(deidentify=True))
    for path in shared.folder.glob("compare.*"):
        said = path.read_bytes()
        assert not any(word in said for word in (b"mueller", b"vernal", b"2026-03", b"2026-10", b"215 days")), path
    assert b"De-identified case" in shared.page.read_bytes()
    assert "sternal" in shared.page.read_text()


def test_a_page_in_a_folder_that_was_renamed_is_stale(
    folders: tuple[Path, Path], found: Comparison, tmp_path: Path
) -> None:
    page = "compare/mueller-vernal/compare.html"
    assert open_session(folders[1]).pages() == {page: "current"}
    huber = Path(shutil.copytree(folders[1], tmp_path / "huber"))
    assert open_session(huber).pages() == {page: "stale"}


def test_a_page_of_shapes_has_no_photographic_colours(folders: tuple[Path, Path], reports: list[ChangeReport]) -> None:
    bare = compare(*folders, privacy=Privacy(geometry_only=True))
    assert bare.folder.name == "mueller-vernal-geometry-only"
    assert "colour" in reports[0].contains
    for one in reports[0].dates:
        assert np.ptp(one.textured.colours) == 0


def test_the_command_says_change_and_verdict(
    folders: tuple[Path, Path], reports: list[ChangeReport], capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["compare", *map(str, folders), "--json"]) == 0
    table = json.loads(capsys.readouterr().out)
    assert table["breasts"]["left"]["beyond_error"] is True
    assert Path(table["page"]).is_file()
    assert run(["compare", *map(str, folders), "-q"]) == 0
    assert run(["compare", *map(str, folders)]) == 0
    said = capsys.readouterr().out
    assert all(breast["verdict"] in said for breast in table["breasts"].values())
    assert mammometry.compare is compare


@pytest.mark.slow
@pytest.mark.xdist_group("two dates")
def test_boundaries_made_in_two_ways_are_found_anew_at_both_dates(
    folders: tuple[Path, Path], reports: list[ChangeReport], tmp_path: Path
) -> None:
    later = write_session(tmp_path / "automatic", body(*AFTER), 9, drawn=False)
    put_results(later, body(*AFTER))
    mixed = compare(folders[0], later)
    assert codes(mixed) & {"drawn-at-one-date", "drawn-at-one-date-replaced"}
    methods = {each.boundary_method.split(":")[0] for pair in mixed.change.breasts for each in (pair.before,)}
    again = "drawn-at-one-date-replaced" in codes(mixed)
    assert methods == ({"automatic"} if again else {"given"})
    assert "date-missing" in codes(mixed)


@pytest.mark.slow
@pytest.mark.xdist_group("two dates")
def test_walls_of_two_kinds_are_named_and_made_one(
    folders: tuple[Path, Path], reports: list[ChangeReport], tmp_path: Path
) -> None:
    true = body(*AFTER)
    wall = true.torso.solid.chest_wall("left")
    other = true.torso.solid.chest_wall("right")
    both = type(wall)(
        vertices=np.concatenate([wall.vertices, other.vertices]),
        faces=np.concatenate([wall.faces, other.faces + len(wall.vertices)]).astype(np.int32),
    )
    later = write_session(tmp_path / "measured-wall", true, 11, back=both)
    put_results(later, true)
    found = compare(folders[0], later)
    assert {"walls": "rounded-membrane and measured", "wall": "rounded-membrane"} in [
        one.values for one in found.notices
    ]
    kinds = {wall for pair in found.change.breasts for wall in (pair.before.wall_kind, pair.after.wall_kind)}
    assert kinds == {"rounded-membrane"}


def scan_of(folder: Path, how: tuple[int, float], posture: str = "") -> Path:
    """The body's own surface as the scan of another device."""
    folder.mkdir()
    mesh = body(*how).torso.solid.mesh
    trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).export(folder / "scanner.ply")
    about = ScanFacts(scanner="Vectra M5", units="mm", head="y", ahead="z", posture=posture)
    files = import_scan(folder / "scanner.ply", about, units="mm")
    (folder / "scanner.ply").unlink()
    for name, content in files.items():
        (folder / name).write_bytes(content)
    curves = {each.name: {"points": each.points_world.tolist()} for each in body(*how).torso.boundaries}
    (folder / "boundaries.json").write_text(json.dumps({"units": "mm", "frame": "world", "boundaries": curves}))
    return folder


def test_scans_are_compared_with_scans_and_with_photographs(
    folders: tuple[Path, Path], reports: list[ChangeReport], tmp_path: Path
) -> None:
    scans = [scan_of(tmp_path / name, how) for name, how in (("before", BEFORE), ("after", AFTER))]
    true_cc = body(*AFTER).volume_cc("left") - body(*BEFORE).volume_cc("left")
    for one, other in (scans, (folders[0], scans[1])):
        compared = compare(one, other)
        left = compared.change.breasts[0]
        assert left.volume.difference_cc == pytest.approx(true_cc, abs=0.1 * true_cc)
        assert left.volume.beyond_error
        assert "scale" in left.volume.terms_cc  # each device has a scale of its own
        assert compared.folder.parent == other / "results" / "compare"


@pytest.mark.xdist_group("two dates")
def test_a_standing_scan_is_compared_with_photographs_only_on_request(
    folders: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scan = scan_of(tmp_path / "after", AFTER, posture="standing")
    assert run(["compare", str(folders[0]), str(scan)]) == 3
    assert "compare.other_posture=true" in capsys.readouterr().err
    found = compare(folders[0], scan, Settings().overridden(["compare.other_posture=true"]))
    assert found.notices[0].values == {"before": "leaning", "after": "standing"}


def session_of(folder: Path, subject: str) -> Path:
    """The folder, made again for a subject."""
    path = folder / "session.toml"
    path.write_text(path.read_text().replace("[subject]\n", f'[subject]\nid = "{subject}"\n'))
    return folder


@pytest.mark.slow
@pytest.mark.xdist_group("two dates")
def test_the_page_is_called_after_the_subject(
    tmp_path: Path, reports: list[ChangeReport], monkeypatch: pytest.MonkeyPatch
) -> None:
    dates = []
    for name, how in (("spring", BEFORE), ("autumn", AFTER)):
        dates.append(session_of(write_session(tmp_path / name, body(*how), how[0]), "P-1"))
        put_results(dates[-1], body(*how))
    found = compare(*dates)
    assert reports[0].keys == tuple(open_session(date).content_key.digest for date in dates)
    assert (found.table["title"], found.table["subject"]) == ("P-1", "P-1")
    assert reports[0].subtitle == "spring → autumn · date not given → date not given"
    compare(*dates, privacy=Privacy(deidentify=True))
    assert "P-1" not in repr(change_page.as_table(reports[1]))
    shutil.rmtree(dates[1] / "results")
    path = dates[1] / "session.toml"
    path.write_text(path.read_text().replace("P-1", "P-2"))
    with pytest.raises(SessionError, match=r"autumn: subject\.id: .*'P-2', .*'P-1'"):
        compare(*dates)


@pytest.mark.parametrize(
    ("which", "message"),
    [
        ("itself", "twice"),
        ("copy", "photographs"),
        ("cast", "subject.kind: .*'model', .*'torso'"),
        ("nothing", "nothing: "),
    ],
)
def test_what_are_not_two_dates_of_one_torso_is_refused(
    folders: tuple[Path, Path], tmp_path: Path, which: str, message: str
) -> None:
    other = folders[0]
    if which == "copy":
        other = write_session(tmp_path / "copy", body(*BEFORE), BEFORE[0])
    if which == "cast":
        other = write_session(tmp_path / "cast", body(*BEFORE), 12, kind="model", drawn=False)
    if which == "nothing":
        other = tmp_path / "nothing"
    with pytest.raises(SessionError, match=message):
        compare(folders[0], other)


def one_breast(folder: Path, place: int, name: str) -> Path:
    """A later session in which one breast alone has a boundary."""
    true = body(*AFTER)
    later = write_session(folder, true, place)
    (later / "boundaries.json").unlink()
    boundary = next(each for each in true.torso.boundaries if each.name == name)
    table = {"units": "mm", "frame": "world", "boundaries": {name: {"points": boundary.points_world.tolist()}}}
    (later / "boundaries.json").write_text(json.dumps(table))
    put_results(later, true, (boundary,))
    return later


def test_a_breast_with_a_volume_at_one_date_only_is_named_and_the_other_compared(
    folders: tuple[Path, Path], found: Comparison, reports: list[ChangeReport], tmp_path: Path
) -> None:
    part = compare(folders[0], one_breast(tmp_path / "one", 13, "left"))
    assert [breast.name for breast in part.change.breasts] == ["left"]
    assert Notice(code="volume-at-one-date", about=("right",), values={"date": "earlier"}) in part.notices
    assert part.table["at_one_date"] == {"right": "earlier"}
    whole = found.change.breasts[0].volume.difference_cc
    # Not the same to the last digit: the chest is fitted beside one breast or both.
    assert part.change.breasts[0].volume.difference_cc == pytest.approx(whole, rel=1e-3)
    # The breast without a boundary is no part of the trunk by which both dates are laid onto one another.
    assert part.change.fit.within_mm == pytest.approx(found.change.fit.within_mm, abs=0.1)


def test_dates_without_a_breast_in_common_are_refused(folders: tuple[Path, Path], tmp_path: Path) -> None:
    one = one_breast(tmp_path / "one", 13, "left")
    other = one_breast(tmp_path / "other", 14, "right")
    with pytest.raises(MeasureError, match=r"dates: .*left .*right"):
        compare(one, other)


def test_files_of_somebody_else_are_left_alone(
    folders: tuple[Path, Path], reports: list[ChangeReport], tmp_path: Path
) -> None:
    (tmp_path / "letters.txt").write_text("mine")
    compare(*folders, out=tmp_path)
    (tmp_path / "compare.pdf").write_text("mine")
    with pytest.raises(StorageError, match=r"compare\.pdf: "):
        compare(*folders, out=tmp_path)
    assert [(tmp_path / name).read_text() for name in ("letters.txt", "compare.pdf")] == ["mine", "mine"]
