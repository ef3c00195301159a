"""Mesh files that lie about their size or name other files, and results that were changed."""

import json
import os
import struct
from pathlib import Path

import numpy as np
import pytest
import trimesh
from tests.mesh_contents import read_triangles

from mammometry.base.errors import MammometryError, SessionError, StorageError
from mammometry.geometry.mesh_files.ply import write_ply
from mammometry.io.meshes.foreign import read_foreign
from mammometry.io.meshes.own import read_ply
from mammometry.io.results.formats import read_raster

HEADER = """\
ply
format binary_little_endian 1.0
element vertex 4
property double x
property double y
property double z
element face 0
property list uchar int vertex_indices
end_header
"""


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("vertex 4", "vertex " + "9" * 30),
        ("vertex 4", "vertex " + "9" * 5000),
        ("vertex 4", "vertex -4"),
        ("vertex 4", "vertex four"),
        ("vertex 4", "vertex 1e9"),
        ("vertex 4", "vertex 4.5"),
        ("vertex 4", "vertex 5"),
        ("face 0", "face 1"),
        ("face 0", "face " + "9" * 30),
        ("property double z\n", ""),
        ("property double z", "property double y"),
        ("property double z", "property list uchar int z"),
        ("element face 0\n", ""),
        ("element vertex 4", "element camera 1\nproperty double a\nelement vertex 4"),
        ("format binary_little_endian 1.0\n", ""),
        ("binary_little_endian", "ascii"),
        ("end_header", "end_headers"),
        ("ply", "plx"),
    ],
)
def test_a_ply_that_lies_is_one_sentence(tmp_path: Path, old: str, new: str) -> None:
    content = bytes(4 * 24)
    (tmp_path / "wall.ply").write_bytes(HEADER.encode() + content)
    assert len(read_ply(tmp_path / "wall.ply")[0].vertices) == 4
    (tmp_path / "wall.ply").write_bytes(HEADER.replace(old, new, 1).encode() + content)
    with pytest.raises(StorageError, match=r"^wall\.ply: .*read") as caught:
        read_ply(tmp_path / "wall.ply")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("faces", ["list int int vertex_indices", "list uchar int vertex_indices\nproperty uchar red"])
def test_a_wall_of_another_program_is_read(tmp_path: Path, faces: str) -> None:
    header = HEADER.replace("list uchar int vertex_indices", faces)
    (tmp_path / "wall.ply").write_bytes(header.encode() + bytes(4 * 24))
    assert len(read_ply(tmp_path / "wall.ply")[0].vertices) == 4


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e300])
def test_coordinates_beyond_all_are_refused(tmp_path: Path, value: float) -> None:
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, value, 0], [0, 0, 1.0]])
    (tmp_path / "wall.ply").write_bytes(HEADER.encode() + vertices.tobytes())
    with pytest.raises(StorageError, match="wall"):
        read_ply(tmp_path / "wall.ply")


def test_pipes_do_not_hang(tmp_path: Path) -> None:
    for suffix in ("ply", "obj", "stl", "glb", "usdz"):
        os.mkfifo(tmp_path / f"a.{suffix}")
        for units in ("mm", None):
            with pytest.raises(SessionError, match=r"pipe|unit"):
                read_foreign(tmp_path / f"a.{suffix}", units)
    with pytest.raises(StorageError, match="pipe"):
        read_ply(tmp_path / "a.ply")


def glb(table: dict[str, object], binary: bytes = b"") -> bytes:
    text = json.dumps(table).encode()
    text += b" " * (-len(text) % 4)
    body = struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(binary), 0x004E4942) + binary
    return b"glTF" + struct.pack("<II", 2, 12 + len(body)) + body


TRIANGLE = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0]], np.float32).tobytes() + np.array([0, 1, 2], "<u4").tobytes()


def triangle(**changes: object) -> dict[str, object]:
    return {
        "asset": {"version": "2.0"},
        "buffers": [{"byteLength": len(TRIANGLE)}],
        "bufferViews": [
            {"buffer": 0, "byteOffset": 0, "byteLength": 36},
            {"buffer": 0, "byteOffset": 36, "byteLength": 12},
        ],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"},
            {"bufferView": 1, "componentType": 5125, "count": 3, "type": "SCALAR"},
        ],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "nodes": [{"mesh": 0}],
        "scenes": [{"nodes": [0]}],
        "scene": 0,
    } | changes


def test_a_glb_holds_what_it_says(tmp_path: Path) -> None:
    path = tmp_path / "a.glb"
    path.write_bytes(glb(triangle(), TRIANGLE))
    assert len(read_triangles(path)[1]) == 1
    (tmp_path / "secret.bin").write_bytes(TRIANGLE)
    path.write_bytes(glb(triangle(buffers=[{"byteLength": len(TRIANGLE), "uri": "secret.bin"}])))
    with pytest.raises(SessionError, match="vertices"):
        read_triangles(path)
    huge = [{"componentType": 5126, "count": 10**9, "type": "VEC3"}]
    path.write_bytes(glb(triangle(accessors=huge), TRIANGLE))
    with pytest.raises(SessionError, match="counts"):
        read_triangles(path)
    many = triangle(nodes=[{"mesh": 0, "name": str(i)} for i in range(3000)], scenes=[{"nodes": list(range(3000))}])
    path.write_bytes(glb(many, TRIANGLE))
    read_triangles(path)  # as many as it has room to name
    path.write_bytes(b"glTF" + struct.pack("<II", 2, 10) + struct.pack("<II", 200_000, 0x4E4F534A) + b"[" * 200_000)
    with pytest.raises(SessionError, match="nested"):
        read_triangles(path)


@pytest.mark.requirement("R-IN-10")
def test_no_mesh_makes_other_files_be_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "skin.mtl").write_text("newmtl skin\nmap_Kd skin.png\n")
    (tmp_path / "skin.png").write_bytes(b"x")
    (tmp_path / "a.obj").write_text("mtllib skin.mtl\nusemtl skin\nv 0 0 0\nv 100 0 0\nv 0 100 0\nf 1 2 3\n")
    text = trimesh.creation.box((100, 80, 60)).export(file_type="ply", encoding="ascii")
    (tmp_path / "a.ply").write_bytes(text.replace(b"ascii 1.0\n", b"ascii 1.0\ncomment TextureFile skin.png\n"))
    opened: list[str] = []
    real = Path.open

    def watched(self: Path, *arguments: object, **named: object) -> object:
        opened.append(self.name)
        return real(self, *arguments, **named)  # type: ignore[call-overload]

    monkeypatch.setattr(Path, "open", watched)
    monkeypatch.setattr(trimesh.resolvers.FilePathResolver, "get", lambda _, name: pytest.fail(f"{name} was read"))
    for name in ("a.obj", "a.ply"):
        read_triangles(tmp_path / name)
    assert set(opened) == {"a.obj", "a.ply"}


@pytest.mark.parametrize("name", ["a.zip", "a.gltf", "a.3mf", "a.dae", "a.xaml", "a.svg", "a"])
def test_other_suffixes_are_not_even_opened(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_bytes(b"PK\x03\x04")
    with pytest.raises(SessionError, match="file type"):
        read_triangles(tmp_path / name)


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("suffix", ["ply", "obj", "stl", "glb"])
def test_whatever_bytes_change_it_is_a_mesh_or_one_sentence(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a.{suffix}"
    trimesh.creation.box((100, 80, 60)).export(path)
    whole, random = path.read_bytes(), np.random.default_rng(11)
    for _ in range(60):
        content = bytearray(whole)
        for place in random.integers(0, len(content), random.integers(1, 6)):
            content[place] = random.integers(0, 256)
        path.write_bytes(content[: random.integers(1, len(content) + 1)] if random.random() < 0.2 else content)
        try:
            assert np.isfinite(read_triangles(path)[0]).all()
        except MammometryError as error:
            assert "\n" not in str(error)  # noqa: PT017


@pytest.mark.filterwarnings("ignore")
def test_a_changed_raster_is_a_value_error(tmp_path: Path) -> None:
    import tifffile

    path = tmp_path / "a.tif"
    tifffile.imwrite(path, np.zeros((4, 5), np.float32), description='{"pages": []}', metadata=None)
    whole, random = path.read_bytes(), np.random.default_rng(2)
    for _ in range(50):
        content = bytearray(whole)
        for place in random.integers(0, len(content), 3):
            content[place] = random.integers(0, 256)
        path.write_bytes(content)
        with pytest.raises((ValueError, OSError, MammometryError)):
            read_raster(path)


def test_our_own_ply_is_read_back(tmp_path: Path) -> None:
    from mammometry.geometry.mesh import TriangleMesh

    mesh = TriangleMesh(vertices=np.eye(3), faces=np.array([[0, 1, 2]], np.int32))
    write_ply(tmp_path / "a.ply", mesh, {"sigma": np.array([1.0, np.nan, np.inf])})
    assert np.isnan(read_ply(tmp_path / "a.ply")[1]["sigma"][1])
