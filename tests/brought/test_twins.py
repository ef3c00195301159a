"""A scan's mirror image is warned of until somebody confirms the sides, and every unit gives the same volume."""

import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from tests.brought.scan_twins import in_unit, mirrored, scaled, written
from tests.first_cases import first
from tests.unit.measure.trunks import LEFT, RIGHT, edge_of, trunk_mesh

from mammometry.api.job import open_session
from mammometry.api.mesh import MeshFiles, MeshJob
from mammometry.base.errors import MammometryError, SessionError
from mammometry.base.notices import Notice
from mammometry.base.units import MM_PER_UNIT, unit_in_comment, unit_named
from mammometry.cli import main
from mammometry.geometry.mesh import TriangleMesh
from mammometry.io.meshes.foreign import read_foreign
from mammometry.io.meshes.scans import ABOUT, ScanFacts, confirm_sides, import_scan, read_scan, scan_text
from mammometry.io.outputs import write_outputs
from mammometry.measure.scan_repair import repair_scan

SHARED = Path(__file__).parents[3] / "shared" / "data" / "scans"
BODIES = [f"body_{number}" for number in range(1, 7)] + [f"hanging_{number}" for number in range(1, 4)]


@cache
def front() -> TriangleMesh:
    mesh = trunk_mesh(12.0)
    return mesh.submesh(mesh.corners().mean(axis=1)[:, 2] > -40)


@cache
def closed() -> TriangleMesh:
    return trunk_mesh(8.0)


def job(mesh: Path, folder: Path, **more: object) -> MeshJob:
    return MeshJob(MeshFiles(mesh=mesh, automatic=True, head="y", ahead="z", **more), folder)  # type: ignore[arg-type]


def drawn_job(mesh: Path, folder: Path, sign: float, **more: object) -> MeshJob:
    """With one drawn breast, near which alone edges are split: it takes a tenth of the time."""
    curve = edge_of(LEFT, "left").points_world * [sign, 1, 1]
    path = mesh.with_suffix(".json")
    path.write_text(json.dumps({"boundaries": {"left" if sign > 0 else "right": {"points": curve.tolist()}}}))
    return MeshJob(MeshFiles(mesh=mesh, boundary=path, head="y", ahead="z", **more), folder)  # type: ignore[arg-type]


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("whole", [False, True], ids=["open", "closed"])
@pytest.mark.requirement("R-SIDE-4")
def test_a_mirror_image_is_inside_out(axis: int, whole: bool) -> None:
    mesh = closed() if whole else front()
    assert not repair_scan(mesh).inside_out
    assert repair_scan(mirrored(mesh, axis)).inside_out
    turned = mirrored(mesh, axis)
    some = np.arange(len(turned.faces)) % 7 == 0  # and some of its faces look to the other side
    faces = np.where(some[:, None], turned.faces[:, ::-1], turned.faces)
    assert repair_scan(TriangleMesh(vertices=turned.vertices, faces=np.ascontiguousarray(faces))).inside_out
    faces = np.where(some[:, None], mesh.faces[:, ::-1], mesh.faces)
    assert not repair_scan(TriangleMesh(vertices=mesh.vertices, faces=np.ascontiguousarray(faces))).inside_out


@pytest.mark.slow
@pytest.mark.parametrize(
    "suffix", ["obj", *(pytest.param(each, marks=pytest.mark.slow) for each in ("ply", "stl", "glb"))]
)
@pytest.mark.requirement("R-SIDE-4")
def test_a_mirrored_scan_is_warned_of_until_somebody_compared_its_sides(tmp_path: Path, suffix: str) -> None:
    mesh = front() if suffix != "glb" else in_unit(front(), "m")
    units = None if suffix == "glb" else "mm"
    right, wrong = (written(twin, tmp_path / f"{name}.{suffix}") for name, twin in
                    (("right", mesh), ("wrong", mirrored(mesh))))  # fmt: skip
    assert not drawn_job(right, tmp_path / "right", 1.0, units=units).sides_doubtful
    doubtful = drawn_job(wrong, tmp_path / "wrong", -1.0, units=units)
    assert doubtful.sides_doubtful
    assert doubtful.notices[0].code == "sides-doubtful"
    checked = drawn_job(wrong, tmp_path / "wrong", -1.0, units=units, sides_checked=True)
    assert not checked.sides_doubtful
    assert "mesh-inside-out" in {notice.code for notice in checked.notices}


@pytest.mark.requirement("R-SIDE-4")
def test_a_cast_has_no_sides(tmp_path: Path) -> None:
    from tests.unit.measure.solids import dome

    angle = np.linspace(0, 2 * np.pi, 60, endpoint=False)
    rim = 60 * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    (tmp_path / "rim.json").write_text(json.dumps({"boundaries": {"model": {"points": rim.tolist()}}}))
    path = written(mirrored(dome(sink_mm=10.0, rings=10, around=40)), tmp_path / "a.ply")
    made = MeshJob(MeshFiles(mesh=path, units="mm", boundary=tmp_path / "rim.json"), tmp_path / "out")
    assert not made.sides_doubtful


def test_a_scans_text_is_read_back_whole(tmp_path: Path) -> None:
    notices = (
        Notice(code="mesh-animated", level="note"),
        Notice(code="mesh-unit-doubtful", level="note", values={"unit": "m", "mm": 500.5, "others": "5 “mm”"}),
    )
    scan = ScanFacts(scanner="A", units="mm, as stated", head="y", posture="standing", sha256="0", notices=notices)
    (tmp_path / ABOUT).write_text(scan_text(scan))
    assert read_scan(tmp_path) == scan
    confirm_sides(tmp_path)
    assert read_scan(tmp_path) == replace(scan, sides="checked")


@pytest.mark.parametrize(
    ("line", "codes"),
    [
        ('remarks = ["One.", "Two."]', ["sentence", "sentence"]),  # of version 1.0
        ('notices = [{code = "mesh-animated"}, {code = "of-a-later-version"}]', ["mesh-animated"]),
        ('notices = [{code = "mesh-lids-removed", values = {}}, 5, {}]', []),
        ("notices = 5", []),
    ],
)
def test_notices_of_other_versions_and_by_hand_are_read_or_left_out(
    tmp_path: Path, line: str, codes: list[str]
) -> None:
    (tmp_path / ABOUT).write_text(f'format = 1\nscanner = "A"\nunits = "mm"\n{line}\n')
    assert [notice.code for notice in read_scan(tmp_path).notices] == codes


@pytest.mark.slow
@pytest.mark.requirement("R-SIDE-4")
def test_an_imported_scan_keeps_that_its_sides_were_compared(tmp_path: Path) -> None:
    mesh = written(mirrored(front()), tmp_path / "a.ply")
    folder = tmp_path / "scan"
    write_outputs(folder, import_scan(mesh, ScanFacts(scanner="A", units=""), units="mm"), command="import mesh")
    assert open_session(folder).sides_doubtful
    assert read_scan(folder).sides == ""
    confirm_sides(folder)
    assert read_scan(folder).sides == "checked"
    assert not open_session(folder).sides_doubtful


@pytest.mark.slow
@pytest.mark.requirement("R-SIDE-4")
def test_measure_keeps_the_confirmation_in_an_imported_scans_folder(tmp_path: Path) -> None:
    mesh, folder = written(mirrored(front()), tmp_path / "a.ply"), tmp_path / "scan"
    write_outputs(folder, import_scan(mesh, ScanFacts(scanner="A", units=""), units="mm"), command="import mesh")
    confirm = ["measure", str(folder), "--sides-checked", "--out", str(tmp_path / "out")]
    assert main.run([*confirm, "--quiet"]) in (0, 8)  # what the measurement says is not asked here
    assert read_scan(folder).sides == "checked"


@pytest.mark.slow
@pytest.mark.requirement("R-SIDE-4")
def test_a_mirrored_scan_exchanges_the_volumes_and_its_first_page_says_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    boundaries = {side: edge_of(breast, side).points_world for side, breast in (("left", LEFT), ("right", RIGHT))}

    def measured(mesh: TriangleMesh, name: str, sign: float, *more: str) -> dict[str, object]:
        names = {"left": "left", "right": "right"} if sign > 0 else {"left": "right", "right": "left"}
        curves = {side: {"points": (boundaries[names[side]] * [sign, 1, 1]).tolist()} for side in names}
        (tmp_path / f"{name}.json").write_text(json.dumps({"boundaries": curves}))
        path = written(mesh, tmp_path / f"{name}.obj")
        call = ["measure", str(path), "--units", "mm", "--boundary", str(tmp_path / f"{name}.json"), "--json"]
        assert main.run([*call, "--out", str(tmp_path / name), *more]) == 0
        found: dict[str, object] = json.loads(capsys.readouterr().out)
        return found

    right = measured(front(), "right", 1.0)
    wrong = measured(mirrored(front()), "wrong", -1.0)
    assert wrong["volumes_cc"]["left"] == pytest.approx(right["volumes_cc"]["right"], rel=0.01)  # type: ignore[index]
    assert "sides-doubtful" not in {notice["code"] for notice in right["notices"]}  # type: ignore[operator]
    assert "sides-doubtful" in {notice["code"] for notice in wrong["notices"]}  # type: ignore[operator]
    said = "Left and right may be exchanged"
    assert said not in (tmp_path / "right" / "report" / "report.html").read_text()
    assert (tmp_path / "wrong" / "report" / "report.html").read_text().count(said) >= 2  # first page, and the warning
    measured(mirrored(front()), "wrong", -1.0, "--sides-checked")
    assert said not in (tmp_path / "wrong" / "report" / "report.html").read_text()


# --- units ---

SPELLINGS = {
    "mm": ("mm", "MM", "millimetre", "millimeters", "Millimeter"), "cm": ("cm", "centimetres", "Centimeter"),
    "m": ("m", "metre", "meters", "METERS"), "in": ("in", "inch", "Inches"), "ft": ("ft", "foot", "Feet"),
}  # fmt: skip
COMMENTS = ("units: {}", "unit {}", "Units = {}", "File units = {}", "units are in {}")


@pytest.mark.parametrize("unit", first(2, MM_PER_UNIT))
@pytest.mark.requirement("R-UNIT-1")
def test_every_unit_and_every_spelling_is_the_same_scan(tmp_path: Path, unit: str) -> None:
    twin = in_unit(front(), unit)
    expected = np.ptp(front().vertices, axis=0)
    for suffix in ("ply", "obj", "stl", "glb"):
        read = read_foreign(written(twin, tmp_path / f"a.{suffix}"), unit)
        assert np.ptp(read.mesh.vertices, axis=0) == pytest.approx(expected, rel=1e-5)
        assert read.assumed is None
    for number, word in enumerate(SPELLINGS[unit]):
        assert unit_named(word) == unit
        for suffix in ("ply", "obj"):
            comment = COMMENTS[number % len(COMMENTS)].format(word)
            read = read_foreign(written(twin, tmp_path / f"b.{suffix}", comment))
            assert read.units == f"{unit}, as the file says", comment
            assert np.ptp(read.mesh.vertices, axis=0) == pytest.approx(expected, rel=1e-5)
    if len(SPELLINGS[unit][-1]) > 2:
        assert unit_in_comment(SPELLINGS[unit][-1]) == unit  # the word alone


@pytest.mark.parametrize(
    "comment", ["made in Germany", "unit vectors m", "Größe", "a 12 m room", "exported by Meter 2.0", "units unknown"]
)
def test_a_comment_about_something_else_states_no_unit(comment: str) -> None:
    assert unit_in_comment(comment) is None


def test_comments_that_contradict_one_another_are_refused(tmp_path: Path) -> None:
    path = written(front(), tmp_path / "a.obj", "units: mm")
    path.write_bytes(b"# unit inches\n" + path.read_bytes())
    with pytest.raises(SessionError, match=r"\bin and mm.*--units"):
        read_foreign(path)
    assert read_foreign(path, "mm").units == "mm, as stated"


@pytest.mark.slow
@pytest.mark.requirement("R-UNIT-1")
def test_a_refusal_says_which_unit_was_assumed_and_what_else_would_fit(tmp_path: Path) -> None:
    """A flat torso of 600 mm in inches: its size is one in cm, and it is refused for another reason."""
    places = front().vertices
    side = np.maximum(np.hypot(places[:, 0], places[:, 2]), 1.0)
    flat = TriangleMesh(
        vertices=1.5 * places * np.stack([125 / side, np.ones(len(side)), 125 / side], axis=1), faces=front().faces
    )
    path = written(in_unit(flat, "in"), tmp_path / "a.ply")
    with pytest.raises(MammometryError) as refused:
        job(path, tmp_path / "out").run()
    sentence = str(refused.value)
    assert all(fact in sentence for fact in (" cm", "260 mm", "660 mm in inches", "--units"))
    assert "\n" not in sentence


@pytest.mark.slow
def test_an_imported_scans_unit_is_noted_when_it_is_measured(tmp_path: Path) -> None:
    mesh = written(in_unit(front(), "cm"), tmp_path / "a.ply")
    folder = tmp_path / "scan"
    write_outputs(folder, import_scan(mesh, ScanFacts(scanner="A", units="")), command="import mesh")
    first = open_session(folder).notices[0]
    assert (first.code, first.values["unit"]) == ("mesh-unit-doubtful", "cm")
    text = (folder / ABOUT).read_text().partition("\n[[notices]]")[0]
    (folder / ABOUT).write_text(text)  # as version 1.0 wrote it
    first = open_session(folder).notices[0]
    assert (first.code, first.values) == ("mesh-unit-assumed", {"unit": "cm"})


# --- the shared bodies ---


@pytest.mark.slow
@pytest.mark.parametrize("name", [BODIES[0], *(pytest.param(name, marks=pytest.mark.slow) for name in BODIES[1:])])
@pytest.mark.requirement("R-SIDE-4")
def test_every_shared_scan_has_its_twins(tmp_path: Path, name: str) -> None:
    """As it is, without a doubt; mirrored along each axis, doubtful; in each unit, as long."""
    path = SHARED / f"{name}_scan.ply"
    if not path.exists():
        pytest.skip("the shared data are not here")
    mesh = read_foreign(path, "m").mesh
    assert not repair_scan(mesh).inside_out
    for axis in range(3):
        assert repair_scan(mirrored(mesh, axis)).inside_out
    for unit in MM_PER_UNIT:
        read = read_foreign(written(in_unit(mesh, unit), tmp_path / "a.ply", f"units: {unit}")).mesh
        assert np.ptp(read.vertices, axis=0) == pytest.approx(np.ptp(mesh.vertices, axis=0), rel=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("factor", [2.54, 1 / 2.54], ids=["cm as inches", "inches as cm"])
@pytest.mark.parametrize("name", BODIES)
@pytest.mark.requirement("R-UNIT-3")
def test_a_scan_of_a_wrong_size_is_never_silent(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str, factor: float
) -> None:
    path = SHARED / f"{name}_scan.ply"
    if not path.exists():
        pytest.skip("the shared data are not here")
    twin = written(scaled(read_foreign(path, "m").mesh, factor), tmp_path / "a.ply")
    code = main.run(["measure", str(twin), "--automatic", "--units", "mm", "--json", "--out", str(tmp_path / "out")])
    printed = capsys.readouterr()
    assert code in (0, 8)
    if code == 0:
        codes = {notice["code"] for notice in json.loads(printed.out)["notices"]}
        assert codes & {"body-size-rare", "body-size-unknown"}


@pytest.mark.slow
@pytest.mark.requirement("R-SIDE-4")
def test_nothing_of_a_doubtful_scan_is_exported_or_compared(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder, later = tmp_path / "scan", tmp_path / "later"
    for scan, factor in ((folder, 1.0), (later, 1.01)):
        mesh = written(scaled(mirrored(front()), factor), tmp_path / f"{scan.name}.ply")
        write_outputs(scan, import_scan(mesh, ScanFacts(scanner="A", units=""), units="mm"), command="import mesh")
    for call in (
        ["export", "table", str(folder), "--out", str(tmp_path / "table")],
        ["compare", str(folder), str(later), "--out", str(tmp_path / "compared")],
    ):
        assert main.run([*call, "--quiet"]) == 3
        assert "mirror" in capsys.readouterr().err


def test_an_imported_scan_is_in_mm_whatever_its_file_was_in(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    mesh, folder = written(in_unit(front(), "cm"), tmp_path / "a.ply"), tmp_path / "scan"
    write_outputs(folder, import_scan(mesh, ScanFacts(scanner="A", units="")), command="import mesh")
    assert [notice.values["unit"] for notice in read_scan(folder).notices] == ["cm"]
    assert main.run(["measure", str(folder), "--units", "in", "--out", str(tmp_path / "out")]) == 2
    assert "Import the scanner's file again" in " ".join(capsys.readouterr().err.split())
