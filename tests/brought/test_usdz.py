"""A USDZ as telephones write it is the same surface, with its unit and its pictures, and no other file is read."""

import io
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from tests.mesh_contents import read_triangles
from tests.unit.measure.trunks import trunk_mesh

from mammometry.base.errors import SessionError
from mammometry.geometry.mesh import TriangleMesh
from mammometry.io.meshes.foreign import read_foreign
from mammometry.io.meshes.scans import ScanFacts, import_scan

pytest.importorskip("pxr")
pytestmark = pytest.mark.slow  # every reading starts a process: 1 to 2 s

MESH = trunk_mesh(12.0)
LIDS = MESH.faces >= len(MESH.vertices) - 2
FRONT = MESH.submesh((MESH.vertices[MESH.faces][:, :, 2] > 0).all(axis=1) & ~LIDS.any(axis=1))


def layer(mesh: TriangleMesh, scale: float, *, head: str = "", more: str = "", mesh_more: str = "") -> str:
    """A mesh moved 1 unit to the side and placed back by its parent."""
    points = ", ".join(f"({x + 1}, {y}, {z})" for x, y, z in mesh.vertices * scale)
    return f"""#usda 1.0
(
    {head}
    upAxis = "Y"
    defaultPrim = "body"
)
def Xform "body" {{
    double3 xformOp:translate = (-1, 0, 0)
    uniform token[] xformOpOrder = ["xformOp:translate"]
    def Mesh "skin" ( prepend apiSchemas = ["MaterialBindingAPI"] ) {{
        point3f[] points = [{points}]
        int[] faceVertexCounts = {[3] * len(mesh.faces)}
        int[] faceVertexIndices = {mesh.faces.ravel().tolist()}
        {mesh_more}
    }}
    {more}
}}
"""


def packed(path: Path, members: dict[str, bytes | str], how: int = zipfile.ZIP_STORED) -> Path:
    with zipfile.ZipFile(path, "w", how) as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return path


@pytest.mark.parametrize(("metres", "unit"), [(1.0, "m"), (0.01, "cm"), (0.001, "mm")])
def test_the_stated_unit_counts_and_the_mesh_stands_where_the_scene_has_it(
    tmp_path: Path, metres: float, unit: str
) -> None:
    text = layer(FRONT, 0.001 / metres, head=f"metersPerUnit = {metres}")
    read = read_foreign(packed(tmp_path / "a.usdz", {"a.usda": text}))
    assert read.units == f"{unit}, as the file says"
    assert read.mesh.area_mm2() == pytest.approx(FRONT.area_mm2(), rel=1e-4)
    np.testing.assert_allclose(read.mesh.vertices.min(axis=0), FRONT.vertices.min(axis=0), atol=0.1)
    assert read.mesh.face_vectors().sum(axis=0)[2] > 0  # looks ahead, as it did


def test_a_unit_that_nobody_states_is_taken_from_the_size_and_inches_are_read(tmp_path: Path) -> None:
    nobody = packed(tmp_path / "a.usdz", {"a.usda": layer(FRONT, 0.001)})
    assert read_foreign(nobody, of_torso=True).units.startswith("m, ")
    inches = packed(tmp_path / "b.usdz", {"a.usda": layer(FRONT, 1 / 25.4, head="metersPerUnit = 0.0254")})
    read = read_foreign(inches)
    assert read.units.startswith("in, ")
    assert read.mesh.area_mm2() == pytest.approx(FRONT.area_mm2(), rel=1e-4)


def test_quads_left_handed_and_coloured(tmp_path: Path) -> None:
    text = """#usda 1.0
def Mesh "skin" {
    point3f[] points = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]
    int[] faceVertexCounts = [4]
    int[] faceVertexIndices = [3, 2, 1, 0]
    uniform token orientation = "leftHanded"
    color3f[] primvars:displayColor = [(1, 0, 0), (1, 0, 0), (0, 1, 0), (0, 1, 0)] ( interpolation = "vertex" )
}
"""
    vertices, faces, colours = read_triangles(packed(tmp_path / "a.usdz", {"a.usda": text}))
    assert TriangleMesh(vertices=vertices, faces=faces).face_vectors().sum(axis=0).tolist() == [0, 0, 1]
    np.testing.assert_array_equal(colours[vertices[:, 1] == 0], [[255, 0, 0]] * 2)
    np.testing.assert_array_equal(colours[vertices[:, 1] == 1], [[0, 255, 0]] * 2)


def jpeg(colour: tuple[int, int, int]) -> bytes:
    buffer = io.BytesIO()
    Image.new("RGB", (16, 16), colour).save(buffer, "JPEG", quality=100, subsampling=0)
    return buffer.getvalue()


def material(name: str, picture: str) -> str:
    return f"""def Material "{name}" {{
        token outputs:surface.connect = </body/{name}/surface.outputs:surface>
        def Shader "surface" {{
            uniform token info:id = "UsdPreviewSurface"
            color3f inputs:diffuseColor.connect = </body/{name}/picture.outputs:rgb>
            token outputs:surface
        }}
        def Shader "picture" {{
            uniform token info:id = "UsdUVTexture"
            asset inputs:file = @{picture}@
            float3 outputs:rgb
        }}
    }}
    """


def covered(picture: str = "0/right.jpg") -> str:
    """Both halves have pictures of their own; places in them are given for each corner."""
    right = np.flatnonzero(FRONT.corners().mean(axis=1)[:, 0] < 0).tolist()
    uv = ", ".join(["(0.5, 0.5)"] * (3 * len(FRONT.faces)))
    inner = f"""texCoord2f[] primvars:st = [{uv}] ( interpolation = "faceVarying" )
        rel material:binding = </body/left>
        def GeomSubset "right" ( prepend apiSchemas = ["MaterialBindingAPI"] ) {{
            uniform token elementType = "face"
            uniform token familyName = "materialBind"
            int[] indices = {right}
            rel material:binding = </body/right>
        }}"""
    more = material("left", "0/left.jpg") + material("right", picture)
    return layer(FRONT, 0.001, head="metersPerUnit = 1", more=more, mesh_more=inner)


def test_its_pictures_are_taken(tmp_path: Path) -> None:
    pictures: dict[str, bytes | str] = {"0/left.jpg": jpeg((200, 40, 40)), "0/right.jpg": jpeg((40, 200, 40))}
    mesh = packed(tmp_path / "a.usdz", {"a.usda": covered(), **pictures})
    files = import_scan(mesh, ScanFacts(scanner="A telephone", units=""))
    assert {"scan.obj", "scan.mtl", "texture-1.jpg", "texture-2.jpg"} < set(files)
    (tmp_path / "read.ply").write_bytes(files["scan.ply"])
    vertices, _, colours = read_triangles(tmp_path / "read.ply")
    red, green = colours[vertices[:, 0] > 15].astype(int), colours[vertices[:, 0] < -15].astype(int)
    assert (np.abs(red - [200, 40, 40]) < 4).all()
    assert (np.abs(green - [40, 200, 40]) < 4).all()


def refused(path: Path) -> str:
    with pytest.raises(SessionError) as error:
        read_triangles(path)
    return str(error.value)


def test_nothing_outside_is_read(tmp_path: Path) -> None:
    other = tmp_path / "other.usda"
    other.write_text(layer(FRONT, 1.0))
    text = f'#usda 1.0\ndef "body" ( references = @{other}@ ) {{\n}}\n'
    assert "another" in refused(packed(tmp_path / "a.usdz", {"a.usda": text}))
    secret = tmp_path / "secret.jpg"
    secret.write_bytes(jpeg((1, 2, 3)))
    mesh = packed(tmp_path / "b.usdz", {"a.usda": covered(str(secret)), "0/left.jpg": jpeg((200, 40, 40))})
    assert "scan.obj" not in import_scan(mesh, ScanFacts(scanner="A telephone", units=""))


@pytest.mark.parametrize(
    ("members", "how", "sentence"),
    [
        ({"a.usda": "#usda 1.0\n"}, zipfile.ZIP_STORED, "triangles"),
        ({"a.usda": "#usda 1.0\n"}, zipfile.ZIP_DEFLATED, "ZIP"),
        ({"a.txt": "a"}, zipfile.ZIP_STORED, "a ZIP without a USD file"),
        ({"a.usdc": b"PXR-USDC" + bytes(range(256))}, zipfile.ZIP_STORED, "read"),
        (
            {"a.usda": layer(FRONT, 1.0).replace("faceVertexIndices = [", "faceVertexIndices = [-1, ")},
            zipfile.ZIP_STORED,
            "vertices",
        ),
    ],
)
def test_what_is_none_is_one_sentence(tmp_path: Path, members: dict[str, Any], how: int, sentence: str) -> None:
    assert sentence in refused(packed(tmp_path / "a.usdz", members, how))
