"""One mesh in every way that scanners and programs write it, read as the same surface."""

import io
import os
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image
from tests.mesh_contents import read_triangles
from tests.unit.measure.solids import dome

from mammometry.base.errors import MeasureError, SessionError
from mammometry.base.parse import LimitSettings
from mammometry.geometry.mesh import TriangleMesh
from mammometry.io.meshes.foreign import read_foreign
from mammometry.io.meshes.scans import ScanFacts, import_scan

MESH = dome(sink_mm=10.0, rings=20, around=60)
AREA_MM2 = MESH.area_mm2()


def lines_of(mesh: TriangleMesh) -> tuple[list[str], np.ndarray]:
    return [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in mesh.vertices], mesh.faces + 1


def plain() -> str:
    vertices, faces = lines_of(MESH)
    return "\n".join([*vertices, *(f"f {a} {b} {c}" for a, b, c in faces)])


def two_groups_with_relative_numbers() -> str:
    """Each group has its own vertices, and its faces count back from where they stand."""
    vertices, lines = lines_of(MESH)[0], []
    for name, half in (("a", slice(None, len(MESH.faces) // 2)), ("b", slice(len(MESH.faces) // 2, None))):
        used, faces = np.unique(MESH.faces[half], return_inverse=True)
        lines += [f"g {name}", *(vertices[k] for k in used)]
        lines += ["f " + " ".join(str(k - len(used)) for k in face) for face in faces.reshape(-1, 3)]
    return "\n".join(lines)


def vertices_and_faces_by_turns() -> str:
    vertices, faces = lines_of(MESH)
    lines, written = [], 0
    for face in faces[np.argsort(faces.max(axis=1))]:
        lines += vertices[written : face.max()]
        written = max(written, int(face.max()))
        lines.append("f " + " ".join(map(str, face)))
    return "\n".join([*lines, *vertices[written:]])


def quads() -> str:
    """Neighbouring triangles joined where that makes a polygon of four."""
    vertices, faces = lines_of(MESH)
    waiting = {tuple(face) for face in faces.tolist()}
    beside = {(a, b): face for face in waiting for a, b in zip(face, (*face[1:], face[0]), strict=True)}
    lines = []
    while waiting:
        face = waiting.pop()
        a, b, c = face
        other = beside.get((b, a))
        if other in waiting:
            waiting.discard(other)
            (d,) = set(other) - {a, b}
            lines.append(f"f {a} {d} {b} {c}")
        else:
            lines.append(f"f {a} {b} {c}")
    return "\n".join([*vertices, *lines])


def continued_lines() -> str:
    return plain().replace(" 7", " \\\n7")


def with_normals_and_places() -> str:
    vertices, faces = lines_of(MESH)
    count = len(vertices)
    return "\n".join([
        *vertices, *["vt 0.5 0.5 0.0"] * count, *["vn 0 0 1"] * count,
        *("f " + " ".join(f"{k}/{k}/{k}" for k in face) for face in faces),
    ])  # fmt: skip


def with_colours() -> str:
    vertices, faces = lines_of(MESH)
    return "\n".join([*(f"{line} 0.8 0.6 0.5" for line in vertices), *(f"f {a}//1 {b}//1 {c}//1" for a, b, c in faces)])


@pytest.mark.parametrize("ending", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize(
    "written",
    [
        plain, two_groups_with_relative_numbers, vertices_and_faces_by_turns, quads, continued_lines,
        with_normals_and_places, with_colours,
    ],
)  # fmt: skip
def test_every_obj_is_the_same_surface(tmp_path: Path, written: Callable[[], str], ending: str) -> None:
    text = "# Größe\n" + written()
    (tmp_path / "a.obj").write_bytes(b"\xef\xbb\xbf" + text.replace("\n", ending).encode("utf-8"))
    vertices, faces, colours = read_triangles(tmp_path / "a.obj")
    read = TriangleMesh(vertices=vertices, faces=faces)
    assert len(faces) == len(MESH.faces)
    assert read.area_mm2() == pytest.approx(AREA_MM2, rel=1e-3)  # another diagonal of a quad bends the skin a little
    assert read.components()[0] == 1
    if written is with_colours:
        assert (colours == [204, 153, 128]).all()


def test_polygons_of_many_corners_are_read(tmp_path: Path) -> None:
    angle = np.arange(7) * 2 * np.pi / 7
    rim = 100 * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    points = "\n".join(" ".join(map(str, point)) for point in rim.tolist())
    (tmp_path / "a.obj").write_text("".join(f"v {line}\n" for line in points.splitlines()) + "f -7 -6 -5 -4 -3 -2 -1\n")
    head = "ply\nformat ascii 1.0\nelement vertex 7\nproperty float x\nproperty float y\nproperty float z\n"
    head += "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
    (tmp_path / "a.ply").write_text(f"{head}{points}\n7 0 1 2 3 4 5 6\n")
    for name in ("a.obj", "a.ply"):
        vertices, faces, _ = read_triangles(tmp_path / name)
        area = TriangleMesh(vertices=vertices, faces=faces).face_vectors().sum(axis=0)
        assert area == pytest.approx([0, 0, 3.5 * 100**2 * np.sin(2 * np.pi / 7)])


@pytest.mark.parametrize("suffix", ["ply", "stl", "glb", "obj"])
def test_every_format_is_the_same_surface(tmp_path: Path, suffix: str) -> None:
    trimesh.Trimesh(MESH.vertices, MESH.faces, process=False).export(tmp_path / f"a.{suffix}")
    vertices, faces, _ = read_triangles(tmp_path / f"a.{suffix}")
    assert TriangleMesh(vertices=vertices, faces=faces).area_mm2() == pytest.approx(AREA_MM2, rel=1e-5)


def polygons() -> list[tuple[int, ...]]:
    """The mesh's faces, neighbours joined to quads where that goes."""
    return [tuple(int(word) - 1 for word in line.split()[1:]) for line in quads().splitlines() if line.startswith("f ")]


def ply(order: str, *, further: bool, floats: bool = False) -> bytes:
    """A PLY with quads, and with further properties and elements."""
    form = {"<": "binary_little_endian", ">": "binary_big_endian", "": "ascii"}[order]
    faces = polygons()
    colour = "float" if floats else "uchar"
    lines = [
        "ply",
        f"format {form} 1.0",
        "comment Größe",
        "obj_info a camera's",
        f"element vertex {len(MESH.vertices)}",
    ]
    lines += [f"property float {axis}" for axis in "xyz"]
    lines += ["property float confidence"] if further else []
    lines += [f"property {colour} {name}" for name in ("red", "green", "blue")]
    lines += ["property double quality"] if further else []
    lines += [f"element face {len(faces)}", "property list uint8 uint32 vertex_index"]
    lines += ["property list uchar float texcoord", "property uchar flags", "element edge 1"] if further else []
    lines += ["property int vertex1", "property int vertex2"] if further else []
    shown = (0.8, 0.6, 0.5) if floats else (204, 153, 128)
    rows: list[tuple[str, tuple[float, ...]]] = []
    for vertex in MESH.vertices:
        rows.append(("3f", tuple(vertex)))
        rows += [("f", (0.5,))] if further else []
        rows.append(("3f" if floats else "3B", shown))
        rows += [("d", (0.25,))] if further else []
    for face in faces:
        rows.append((f"B{len(face)}I", (len(face), *face)))
        rows += [(f"B{2 * len(face)}f", (2 * len(face), *[0.5] * 2 * len(face))), ("B", (3,))] if further else []
    rows += [("2i", (0, 1))] if further else []
    header = ("\n".join([*lines, "end_header"]) + "\n").encode()
    if order:
        return header + b"".join(struct.pack(order + kinds, *values) for kinds, values in rows)
    return header + "\n".join(" ".join(map(str, values)) for _, values in rows).encode()


@pytest.mark.parametrize("floats", [False, True])
@pytest.mark.parametrize("further", [False, True])
@pytest.mark.parametrize("order", ["<", ">", ""])
def test_every_ply_is_the_same_surface(tmp_path: Path, order: str, further: bool, floats: bool) -> None:
    (tmp_path / "a.ply").write_bytes(ply(order, further=further, floats=floats))
    vertices, faces, colours = read_triangles(tmp_path / "a.ply")
    read = TriangleMesh(vertices=vertices, faces=faces)
    assert len(faces) == len(MESH.faces)
    assert read.area_mm2() == pytest.approx(AREA_MM2, rel=1e-3)
    assert read.components()[0] == 1
    assert (colours == [204, 153, 128]).all()


@pytest.mark.parametrize("cut", [0, 3, 40, 200, 3000, -5])
def test_a_ply_that_is_cut_short_is_named(tmp_path: Path, cut: int) -> None:
    (tmp_path / "a.ply").write_bytes(ply("<", further=True)[:cut])
    with pytest.raises(SessionError, match="read"):
        read_triangles(tmp_path / "a.ply")


@pytest.mark.parametrize(
    "content",
    [
        ("# Größe\n" + plain()).encode("utf-16"),
        "# Größe 体\n".encode("utf-16") + plain().encode(),
        b"# " + "体\n".encode("utf-16-le") + b"\n" + plain().encode(),
        ("o a\ns off\nl 1 2\np 1\n" + plain() + "\nl 1 2 3\ncstype bezier\n").encode(),
        ("mtllib absent.mtl\n" + plain()).encode(),
        "\n".join(
            [f"v {x} {y} {z} 1.0" for x, y, z in MESH.corners().reshape(-1, 3)]
            + [f"f {3 * k + 1} {3 * k + 2} {3 * k + 3}" for k in range(len(MESH.faces))]
        ).encode(),
    ],
    ids=["utf-16", "utf-16 comment", "utf-16 in a comment", "lines and curves", "no material file", "soup"],
)
def test_odd_obj_files_are_the_same_surface(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "a.obj").write_bytes(content)
    vertices, faces, _ = read_triangles(tmp_path / "a.obj")
    assert len(faces) == len(MESH.faces)
    assert TriangleMesh(vertices=vertices, faces=faces).area_mm2() == pytest.approx(AREA_MM2, rel=1e-6)


def commas(text: str) -> str:
    return text.replace(".", ",")


def ascii_ply() -> str:
    stream = trimesh.Trimesh(MESH.vertices, MESH.faces, process=False).export(file_type="ply", encoding="ascii")
    return stream.decode() if isinstance(stream, bytes) else stream


def strips() -> str:
    return (
        "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
        "element tristrips 1\nproperty list int int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n1 1 0\n4 0 1 2 3\n"
    )


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("a.obj", commas(plain()), "commas"),
        ("a.ply", ascii_ply().replace("format ascii 1.0", "format ascii 1~0").replace(".", ",").replace("~", "."),
         "commas"),
        ("a.stl", commas(trimesh.Trimesh(MESH.vertices, MESH.faces, process=False).export(file_type="stl_ascii")),
         "commas"),
        ("a.ply", strips(), "strips"),
        ("a.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 4", "line"),
        ("a.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf -1 -2 -4", "line"),
    ],
)  # fmt: skip
def test_what_cannot_be_read_is_named(tmp_path: Path, name: str, text: str, said: str) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(SessionError, match=said):
        read_triangles(tmp_path / name)


def test_digits_lost_far_from_the_origin_are_named(tmp_path: Path) -> None:
    moved = (MESH.vertices + np.array([4e6, 0, 0])).astype(np.float32)
    trimesh.Trimesh(moved, MESH.faces, process=False).export(tmp_path / "a.stl")
    with pytest.raises(SessionError, match=r"0\.25 mm"):
        read_foreign(tmp_path / "a.stl", "mm")


# --- textures ---


def covered(folder: Path, *, obj_head: str, mtl: bytes, mtl_name: str = "a.mtl", picture: str = "skin.jpg",
            orientation: int = 1, mode: str = "RGB") -> Path:  # fmt: skip
    """An OBJ whose picture is red above and green below."""
    vertices, faces = lines_of(MESH)
    low, high = MESH.vertices.min(axis=0), MESH.vertices.max(axis=0)
    places = (MESH.vertices[:, :2] - low[:2]) / (high - low)[:2] * 0.9 + 0.05
    lines = [obj_head, "usemtl skin", *vertices, *(f"vt {u:.5f} {v:.5f}" for u, v in places)]
    lines += ["f " + " ".join(f"{k}/{k}" for k in face) for face in faces]
    (folder / "a.obj").write_bytes("\n".join(lines).encode("utf-8", "surrogateescape"))
    (folder / mtl_name).write_bytes(mtl)
    pixels = np.zeros((64, 64, 3), np.uint8)
    pixels[:32], pixels[32:] = (200, 40, 40), (40, 200, 40)
    exif = Image.Exif()
    exif[274] = orientation
    buffer = io.BytesIO()
    Image.fromarray(pixels).convert(mode).save(buffer, "JPEG", quality=98, subsampling=0, exif=exif)
    (folder / picture).write_bytes(buffer.getvalue())
    return folder / "a.obj"


def vertex_colours(files: dict[str, bytes], folder: Path) -> tuple[np.ndarray, np.ndarray]:
    (folder / "read.ply").write_bytes(files["scan.ply"])
    vertices, _, colours = read_triangles(folder / "read.ply")
    return vertices, colours


def require_covered(files: dict[str, bytes], folder: Path) -> None:
    """The vertices' colours are those of the picture beside them, as the scan's own OBJ has it."""
    vertices, colours = vertex_colours(files, folder)
    middle = (vertices[:, 1].min() + vertices[:, 1].max()) / 2
    above, below = vertices[:, 1] > middle + 3, vertices[:, 1] < middle - 3
    assert (colours[above, 0] > 150).all()
    assert (colours[below, 1] > 150).all()
    assert files["texture-1.jpg"][:2] == b"\xff\xd8"
    with Image.open(io.BytesIO(files["texture-1.jpg"])) as picture:
        pixels = np.asarray(picture.convert("RGB"))
    assert pixels[5, 32, 0] > 150  # as stored, it shows the same
    assert pixels[-5, 32, 1] > 150


SCAN = ScanFacts(scanner="Test", units="")
MTL = b"newmtl skin\nmap_Kd skin.jpg\n"


def test_two_material_files_are_both_read(tmp_path: Path) -> None:
    mesh = covered(tmp_path, obj_head="mtllib other.mtl\nmtllib a.mtl", mtl=MTL)
    (tmp_path / "other.mtl").write_text("newmtl cloth\nKd 1 0 0\n")
    require_covered(import_scan(mesh, SCAN, units="mm"), tmp_path)
    mesh = covered(tmp_path, obj_head="mtllib other.mtl a.mtl", mtl=MTL)
    require_covered(import_scan(mesh, SCAN, units="mm"), tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["my  skin.jpg", "a b.jpg", "Größe.jpg", "-s.jpg", "1 2.jpg"])
def test_a_picture_may_have_any_name(tmp_path: Path, name: str) -> None:
    mesh = covered(tmp_path, obj_head="mtllib a.mtl", mtl=f"newmtl skin\nmap_Kd {name}\n".encode(), picture=name)
    require_covered(import_scan(mesh, SCAN, units="mm"), tmp_path)


def test_options_before_a_picture_are_left_out(tmp_path: Path) -> None:
    mesh = covered(tmp_path, obj_head="mtllib a.mtl", mtl=b"newmtl skin\nmap_Kd -clamp on -s 1 1 1 -o 0 0 skin.jpg\n")
    require_covered(import_scan(mesh, SCAN, units="mm"), tmp_path)


@pytest.mark.parametrize("on_disk", [b"Gr\xf6\xdfe.mtl", "Größe.mtl".encode()], ids=["latin-1", "utf-8"])
def test_a_material_file_named_in_latin_1_is_found(tmp_path: Path, on_disk: bytes) -> None:
    head = b"mtllib Gr\xf6\xdfe.mtl".decode("utf-8", "surrogateescape")
    mesh = covered(tmp_path, obj_head=head, mtl=MTL, mtl_name=os.fsdecode(on_disk))
    require_covered(import_scan(mesh, SCAN, units="mm"), tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("orientation", [1, 3, 6, 8])
def test_a_pictures_orientation_tag_is_not_obeyed(tmp_path: Path, orientation: int) -> None:
    """Places in a texture count from the pixels as stored, as every program that shows an OBJ has it."""
    mesh = covered(tmp_path, obj_head="mtllib a.mtl", mtl=MTL, orientation=orientation)
    require_covered(import_scan(mesh, SCAN, units="mm"), tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("mode", ["L", "CMYK"])
def test_a_picture_in_other_colours_is_read(tmp_path: Path, mode: str) -> None:
    mesh = covered(tmp_path, obj_head="mtllib a.mtl", mtl=MTL, mode=mode)
    files = import_scan(mesh, SCAN, units="mm")
    _, colours = vertex_colours(files, tmp_path)
    assert len(np.unique(colours, axis=0)) == 2
    assert (np.ptp(colours.astype(int), axis=1) == 0).all() == (mode == "L")


@pytest.mark.parametrize("form", ["BMP", "TGA", "TIFF"])
def test_a_picture_of_another_format_is_read(tmp_path: Path, form: str) -> None:
    mesh = covered(tmp_path, obj_head="mtllib a.mtl", mtl=f"newmtl skin\nmap_Kd skin.{form}\n".encode())
    Image.open(tmp_path / "skin.jpg").save(tmp_path / f"skin.{form}", form)
    files = import_scan(mesh, SCAN, units="mm")
    _, colours = vertex_colours(files, tmp_path)
    assert (colours.max(axis=1) > 150).all()
    assert files["texture-1.png"].startswith(b"\x89PNG")
    assert b"map_Kd texture-1.png" in files["scan.mtl"]


def test_a_glbs_pictures_are_taken(tmp_path: Path) -> None:
    """Two parts, each with a picture of its own; the right one stands turned and moved in the scene."""
    scene = trimesh.Scene()
    right = MESH.corners().mean(axis=1)[:, 0] < 0
    for half, colour in ((MESH.submesh(~right), (200, 40, 40)), (MESH.submesh(right), (40, 200, 40))):
        turn = trimesh.transformations.rotation_matrix(0.3 * (colour[1] > 100), [0, 1, 0], [0.1, 0, 0.2])
        stands = trimesh.transform_points(half.vertices / 1000, np.linalg.inv(turn))
        picture = Image.new("RGB", (16, 16), colour)
        material = trimesh.visual.material.PBRMaterial(baseColorTexture=picture)
        visual = trimesh.visual.TextureVisuals(uv=np.full((len(stands), 2), 0.5), material=material)
        scene.add_geometry(trimesh.Trimesh(stands, half.faces, visual=visual, process=False), transform=turn)
    (tmp_path / "a.glb").write_bytes(scene.export(file_type="glb"))
    files = import_scan(tmp_path / "a.glb", SCAN)
    vertices, colours = vertex_colours(files, tmp_path)
    assert TriangleMesh(vertices=vertices, faces=read_triangles(tmp_path / "read.ply")[1]).area_mm2() == pytest.approx(
        AREA_MM2, rel=1e-4
    )
    assert (colours[vertices[:, 0] > 8] == [200, 40, 40]).all()
    assert (colours[vertices[:, 0] < -8] == [40, 200, 40]).all()
    assert {"scan.obj", "scan.mtl", "texture-1.png", "texture-2.png"} < set(files)
    assert "scan.obj" not in import_scan(tmp_path / "a.glb", SCAN, texture=False)
    with pytest.raises(SessionError, match="16 × 16 pixels"):
        import_scan(tmp_path / "a.glb", SCAN, limits=LimitSettings(megapixels=0.0001))


def test_what_no_measurement_takes_is_refused_at_the_door(tmp_path: Path) -> None:
    fins = np.concatenate(
        [MESH.faces, np.stack([MESH.faces[:90, 0], MESH.faces[:90, 1], MESH.faces[300:390, 0]], axis=1)]
    )
    trimesh.Trimesh(MESH.vertices, fins, process=False).export(tmp_path / "a.ply")
    with pytest.raises(MeasureError, match="three"):
        import_scan(tmp_path / "a.ply", SCAN, units="mm")
