"""Scans of other devices: what is kept, what is left out, and files that are none."""

import hashlib
import io
import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from PIL.PngImagePlugin import PngInfo
from tests.mesh_contents import read_triangles
from tests.unit.io.scan_files import DARK, SKIN, scanned, texture
from tests.unit.measure.two_scans import part

from mammometry.base.errors import ImageError, MammometryError, SessionError
from mammometry.base.parse import LimitSettings
from mammometry.cli import main
from mammometry.geometry.mesh_files.ply import write_ply
from mammometry.io.meshes.foreign import read_foreign
from mammometry.io.meshes.merged import stored_sources
from mammometry.io.meshes.own import read_ply
from mammometry.io.meshes.scans import ABOUT, MESH, MTL, OBJ, ScanFacts, import_scan, is_scan, read_scan, skin_colours

ABOUT_IT = ScanFacts(scanner="Vectra M5", units="", subject="P-1")


@pytest.fixture(scope="module")
def scan(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One that is only read."""
    return scanned(tmp_path_factory.mktemp("scan") / "in", step_mm=12.0)


def taken(mesh: Path, **changed: object) -> dict[str, bytes]:
    return import_scan(mesh, ABOUT_IT, **{"units": "cm", **changed})  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def two(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A scan from the front with one from below, imported together."""
    folder = tmp_path_factory.mktemp("two")
    for name, mesh in (("first", part(-150.0, 90.0, seed=1)), ("below", part(-90.0, 150.0, seed=2))):
        write_ply(folder / f"{name}.ply", mesh, comments=("units: mm",))
    about = ScanFacts(scanner="A", units="", head="y", ahead="z")
    return put(import_scan(folder / "first.ply", about, also=[folder / "below.ply"]), folder / "out")


def put(files: dict[str, bytes], folder: Path) -> Path:
    folder.mkdir()
    for name, content in files.items():
        (folder / name).write_bytes(content)
    return folder


def test_a_scan_is_in_mm_and_keeps_its_scanner_and_unit(scan: Path, tmp_path: Path) -> None:
    folder = put(taken(scan), tmp_path / "out")
    assert is_scan(folder)
    read = read_scan(folder)
    assert (read.scanner, read.units, read.subject) == ("Vectra M5", "cm, as stated", "P-1")
    there, original = read_foreign(folder / MESH), read_foreign(scan, "cm")
    assert there.units.startswith("mm, ")
    assert np.array_equal(there.mesh.vertices, original.mesh.vertices)
    assert np.array_equal(there.mesh.faces, original.mesh.faces)


def test_every_vertex_has_its_colour_of_the_picture(scan: Path, tmp_path: Path) -> None:
    folder = put(taken(scan), tmp_path / "out")
    vertices, _, colours = read_triangles(folder / MESH)
    height = vertices[:, 1] - (vertices[:, 1].min() + vertices[:, 1].max()) / 2
    for rows, colour in ((height > 20, SKIN), (height < -20, DARK)):
        assert np.abs(colours[rows].astype(int) - colour).max() <= 6  # JPEG


@pytest.mark.requirement("R-MERGE-4")
def test_two_scans_are_one_mesh_that_says_who_showed_what_and_how_they_fit(two: Path) -> None:
    assert {path.name for path in two.iterdir()} == {ABOUT, MESH}
    read = read_scan(two)
    (also,) = read.also
    assert also.sha256 == hashlib.sha256((two.parent / "below.ply").read_bytes()).hexdigest()
    assert also.within_mm < 0.2
    assert abs(also.scale) < 1e-3
    assert np.allclose(np.reshape(also.first_from_this, (4, 4)), np.eye(4), atol=0.05)
    assert (read.notices[-1].code, read.notices[-1].values["number"]) == ("scan-merged", 2)
    mesh, properties, _ = read_ply(two / MESH)
    assert set(properties["source"][mesh.vertices[:, 1] < -100]) == {1}
    assert set(properties["source"][mesh.vertices[:, 1] > 100]) == {2}
    assert set(stored_sources(two / MESH, np.array([[0.0, -120.0, 0.0], [0.0, 0.0, 0.0], [0.0, 120.0, 0.0]]))) == {
        1,
        2,
        3,
    }


@pytest.mark.parametrize(
    "changed", ["within_mm = 1", "scale = true", "first_from_this = [1.0]", "sha256 = 3", "overlap = nan", "more = 1"]
)
def test_a_merged_scans_table_that_is_not_as_documented_is_refused(two: Path, tmp_path: Path, changed: str) -> None:
    name = changed.partition(" ")[0]
    lines = [line for line in (two / ABOUT).read_text().splitlines() if not line.startswith(name)]
    (tmp_path / ABOUT).write_text("\n".join([*lines, changed] if name != "within_mm" else lines))
    with pytest.raises(SessionError, match="also"):
        read_scan(tmp_path)


def test_the_pictures_show_finer_colours_than_the_vertices(scan: Path, tmp_path: Path) -> None:
    folder = put(taken(scan), tmp_path / "out")
    mesh = read_foreign(folder / MESH).mesh
    a, b, c = np.moveaxis(mesh.corners(), 1, 0)
    points = np.concatenate([0.7 * a + 0.2 * b + 0.1 * c, mesh.vertices[:1] + np.array([[0, 0, 50.0]])])
    grey = np.full((len(points), 3), 7, np.uint8)
    colours = skin_colours(folder, read_scan(folder), points, grey).astype(int)
    height = (points[:-1, 1] - mesh.vertices[:, 1].min()) / np.ptp(mesh.vertices[:, 1]) * 0.98 + 0.01
    sure = np.abs(height - 0.5) > 0.02  # a picture of 64 rows
    expected = np.where((height > 0.5)[:, None], SKIN, DARK)
    assert np.abs(colours[:-1] - expected)[sure].max() < 12
    assert colours[-1].tolist() == [7, 7, 7]  # off the skin
    (folder / "texture-1.jpg").unlink()
    assert (skin_colours(folder, read_scan(folder), points, grey) == 7).all()


def test_the_files_fit_together_under_names_of_ours(scan: Path, tmp_path: Path) -> None:
    files = taken(scan)
    assert set(files) == {ABOUT, MESH, OBJ, MTL, "texture-1.jpg"}
    assert b"mtllib scan.mtl" in files[OBJ]
    assert b"usemtl m1" in files[OBJ]
    assert b"map_Kd texture-1.jpg" in files[MTL]
    assert [name for name, content in files.items() if b"Muster" in content or b"Anna" in content] == []
    folder = put(files, tmp_path / "out")
    again = taken(folder / OBJ)
    assert (again[MESH], again["texture-1.jpg"]) == (files[MESH], files["texture-1.jpg"])


@pytest.mark.parametrize("kind", ["jpg", "progressive", "png"])
def test_a_picture_keeps_its_pixels_and_loses_its_tags(scan: Path, tmp_path: Path, kind: str) -> None:
    folder = put({path.name: path.read_bytes() for path in scan.parent.iterdir()}, tmp_path / "in")
    tags = Image.Exif()
    tags[0x010E] = "Muster, Anna"
    text = PngInfo()
    text.add_text("Patient", "Muster, Anna")
    with Image.open(folder / "Muster Anna.jpg") as opened:
        opened.load()
    picture = folder / "Muster Anna.jpg"
    if kind == "png":
        opened.save(picture, "PNG", exif=tags, pnginfo=text)
    else:
        opened.save(picture, "JPEG", exif=tags, comment="Muster", quality=90, progressive=kind == "progressive")
    assert b"Muster" in picture.read_bytes()
    files = taken(folder / scan.name)
    (name,) = [name for name in files if name.startswith("texture-")]
    assert b"Muster" not in files[name]
    with Image.open(io.BytesIO(files[name])) as kept, Image.open(picture) as before:
        assert np.array_equal(np.asarray(kept), np.asarray(before))


def test_the_shape_alone_needs_no_other_file(scan: Path, tmp_path: Path) -> None:
    alone = tmp_path / "alone.obj"
    alone.write_bytes(scan.read_bytes())
    files = taken(alone, texture=False)
    assert set(files) == {ABOUT, MESH, OBJ}
    assert b"mtl" not in files[OBJ]


@pytest.mark.parametrize("suffix", [".mtl", ".jpg"])
def test_a_missing_file_is_named(scan: Path, tmp_path: Path, suffix: str) -> None:
    for path in scan.parent.iterdir():
        if path.suffix != suffix:
            (tmp_path / path.name).write_bytes(path.read_bytes())
    with pytest.raises(SessionError, match=rf"Muster( Anna{suffix})?"):
        taken(tmp_path / scan.name)


def test_a_name_with_folders_leads_nowhere(scan: Path, tmp_path: Path) -> None:
    outside = texture(tmp_path / "outside.jpg")
    inside = tmp_path / "in"
    inside.mkdir()
    (inside / "scan.obj").write_bytes(scan.read_bytes())
    (inside / "Muster Anna.mtl").write_text("newmtl skin of Muster\nmap_Kd ../outside.jpg\n")
    with pytest.raises(SessionError, match=r"'outside\.jpg'"):
        taken(inside / "scan.obj")
    assert outside.exists()


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("Muster Anna.mtl", b"", "materials"),
        ("Muster Anna.mtl", b"newmtl a\n" * 200_000, r"\b1 MiB"),
        ("Muster Anna.mtl", b"newmtl x\nmap_Kd \n" + b"\xff\x00" * 40, "skin|no"),
        ("Muster Anna.jpg", b"no picture", "picture"),
        ("Muster Anna.obj", b"v 0 0\n", "."),
        ("Muster Anna.obj", b"v 0 0 0\nf 1 2 3\n", "."),
        ("Muster Anna.obj", b"v 0 0 zero\nf 1 1 1\n", "."),
    ],
)
def test_what_is_none_is_one_sentence(scan: Path, tmp_path: Path, name: str, content: bytes, said: str) -> None:
    for path in scan.parent.iterdir():
        (tmp_path / path.name).write_bytes(content if path.name == name else path.read_bytes())
    if b"map_Kd \n" in content:
        assert "texture-1.jpg" not in taken(tmp_path / scan.name)  # its material has no picture
        return
    with pytest.raises(MammometryError, match=said):
        taken(tmp_path / scan.name)


def test_a_picture_that_is_too_large_is_refused_by_its_header(scan: Path, tmp_path: Path) -> None:
    for path in scan.parent.iterdir():
        (tmp_path / path.name).write_bytes(path.read_bytes())
    texture(tmp_path / "Muster Anna.jpg", (400, 300))
    with pytest.raises(ImageError, match="megapixels"):
        taken(tmp_path / scan.name, limits=LimitSettings(megapixels=0.1))


@pytest.mark.parametrize(
    "changed", [{"scanner": " "}, {"scanner": "a\nb"}, {"head": "up"}, {"subject": "a/b"}, {"posture": "sitting"}]
)
def test_what_is_said_of_it_is_checked(scan: Path, changed: dict[str, str]) -> None:
    about = {"scanner": "Artec", "units": "", **changed}
    with pytest.raises(SessionError):
        import_scan(scan, ScanFacts(**about), units="cm")  # type: ignore[arg-type]


@pytest.mark.parametrize("posture", ["", "standing", "leaning", "lying"])
def test_the_posture_is_kept(scan: Path, tmp_path: Path, posture: str) -> None:
    made = import_scan(scan, ScanFacts(scanner="Artec", units="", posture=posture), units="cm")
    (tmp_path / ABOUT).write_bytes(made[ABOUT])
    assert read_scan(tmp_path).posture == posture


@pytest.mark.parametrize("text", ["", "format = 2", "format = 1\nscanner = 3", "format = 1\nwhat = 1", "=", "a\x00"])
def test_a_description_that_is_none_is_one_sentence(tmp_path: Path, text: str) -> None:
    (tmp_path / ABOUT).write_text(text)
    with pytest.raises(SessionError):
        read_scan(tmp_path)


def test_the_command_imports_and_says_so(scan: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command = ["import", "mesh", str(scan), "--scanner", "Vectra M5", "--units", "cm", "--out", str(tmp_path / "out")]
    assert main.run([*command, "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer["files"] == sorted((MESH, MTL, OBJ, ABOUT, "texture-1.jpg"))
    assert main.run([*command[:-1], str(scan.parent)]) != 0
    assert "Muster Anna.obj" in " ".join(path.name for path in scan.parent.iterdir())


@pytest.mark.slow
def test_an_imported_scan_is_measured_by_its_own_description(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scan = scanned(tmp_path / "in", step_mm=2.0)
    folder = tmp_path / "out"
    command = ["import", "mesh", str(scan), "--scanner", "Vectra M5", "--units", "cm", "--subject", "P-1"]
    assert main.run([*command, "--out", str(folder), "--json"]) == 0
    capsys.readouterr()
    assert main.run(["measure", str(folder), "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert set(answer["volumes_cc"]) == {"left", "right"}
    page = (folder / "results" / "report" / "report.html").read_text()
    assert "Vectra M5" in page
    assert "cm, as " in page
