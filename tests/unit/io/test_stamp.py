"""A stamped file is the same file with the subject in it, for whoever reads that format."""

import io
import json
import struct
from pathlib import Path

import numpy as np
import pytest
import tifffile
import trimesh
from PIL import Image
from test_codecs import disparity_map, repaired, tetrahedron

from mammometry.geometry.mesh_files.ply import write_ply
from mammometry.io.meshes.own import read_ply
from mammometry.io.results.codecs import decode, encode
from mammometry.io.results.stamp import stamp_folder, stamped, subject_of_mesh

ID = "P-ü 1"


def picture(ending: str) -> bytes:
    pixels = np.random.default_rng(1).integers(0, 255, (8, 9, 3), dtype=np.uint8)
    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, ending)
    return buffer.getvalue()


def test_pixels_are_not_touched() -> None:
    for form, ending, field in (("PNG", ".png", "Subject"), ("JPEG", ".jpg", "comment")):
        data = picture(form)
        with Image.open(io.BytesIO(stamped(f"x{ending}", data, ID))) as after, Image.open(io.BytesIO(data)) as before:
            after.load()
            assert np.array_equal(np.asarray(after), np.asarray(before))
            text = after.info[field]
            assert (text.decode() if isinstance(text, bytes) else text).endswith(ID)


def test_a_model_keeps_its_triangles() -> None:
    mesh = trimesh.creation.box()
    data = stamped("model.glb", mesh.export(file_type="glb"), ID)
    assert struct.unpack_from("<I", data, 8)[0] == len(data)
    assert len(trimesh.load(io.BytesIO(data), file_type="glb", force="mesh").faces) == 12
    (length,) = struct.unpack_from("<I", data, 12)
    assert length % 4 == 0
    assert json.loads(data[20 : 20 + length])["asset"]["extras"] == {"subject": ID}
    text = stamped("model.obj", mesh.export(file_type="obj").encode(), ID)
    assert text.startswith(f"# subject {ID}\n".encode())
    assert len(trimesh.load(io.BytesIO(text), file_type="obj", force="mesh").faces) == 12


def test_a_mesh_keeps_its_bytes_behind_the_header(tmp_path: Path) -> None:
    write_ply(tmp_path / "first.ply", tetrahedron(), comments=("mm, world frame",))
    before = read_ply(tmp_path / "first.ply")[0]
    stamp_folder(tmp_path, ID)
    after, _, comments = read_ply(tmp_path / "first.ply")
    assert comments == (f"subject {ID}", "mm, world frame")
    assert np.array_equal(after.vertices, before.vertices)


def test_a_mesh_whose_json_is_too_deep_carries_no_subject(tmp_path: Path) -> None:
    too_deep = b'{"asset": ' + b"[" * 100_000 + b"]" * 100_000 + b"}"
    (tmp_path / "scan.glb").write_bytes(
        struct.pack("<4sIIII", b"glTF", 2, 20 + len(too_deep), len(too_deep), 0x4E4F534A) + too_deep
    )
    assert subject_of_mesh(tmp_path / "scan.glb") is None


@pytest.mark.parametrize("ending", ["ply", "obj", "glb"])
def test_the_subject_of_a_mesh_is_read_back(tmp_path: Path, ending: str) -> None:
    data = trimesh.creation.box().export(file_type=ending)
    path = tmp_path / f"scan.{ending}"
    path.write_bytes(data.encode() if isinstance(data, str) else data)
    assert subject_of_mesh(path) is None
    stamp_folder(tmp_path, ID)
    assert subject_of_mesh(path) == ID
    assert subject_of_mesh(tmp_path / "none.ply") is None


def test_a_list_in_json_has_no_room_and_stays() -> None:
    """The report's warnings are such a list: with a subject's id in session.toml, no report could be written."""
    assert stamped("warnings.json", b'["one"]\n', "P-1") == b'["one"]\n'


def test_json_tells_the_subject_second() -> None:
    table = json.loads(stamped("x.json", b'{"format": 1, "units": "mm", "subject": "old"}', ID))
    assert table == {"format": 1, "subject": ID, "units": "mm"}
    assert list(table)[:2] == ["format", "subject"]


@pytest.mark.parametrize("product", ["disparity/front", "repaired"])
def test_products_are_read_back_as_they_were(tmp_path: Path, product: str) -> None:
    value = disparity_map() if product.startswith("disparity") else repaired()
    encode(value, tmp_path, product)
    stamp_folder(tmp_path, ID)
    read = decode(tmp_path, product)
    name = "d_h_px" if product.startswith("disparity") else "sigma_mm"
    np.testing.assert_array_equal(getattr(read, name), getattr(value, name))
    if product.startswith("disparity"):
        with tifffile.TiffFile(tmp_path / "disparity" / "front.tif") as tiff:
            assert json.loads(tiff.pages.first.description)["subject"] == ID


def test_an_archive_has_one_array_more(tmp_path: Path) -> None:
    np.savez(tmp_path / "valid.npz", a=np.arange(3))
    stamp_folder(tmp_path, ID)
    with np.load(tmp_path / "valid.npz") as stored:
        assert bytes(stored["subject"]).decode() == ID
        assert stored["a"].tolist() == [0, 1, 2]


def test_nobody_told_nothing_changes(tmp_path: Path) -> None:
    (tmp_path / "x.json").write_bytes(b"{}")
    stamp_folder(tmp_path, None)
    assert (tmp_path / "x.json").read_bytes() == b"{}"
    assert stamped("x.csv", b"a,b", ID) == b"a,b"
