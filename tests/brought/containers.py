"""One solid in GLB and USDZ files, a file for every part that such containers may have, each with its true volume."""

from __future__ import annotations

import base64
import io
import json
import struct
import zipfile
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

RINGS, AROUND = 8, 16
HALF_MM = np.array([60.0, 40.0, 80.0])
"""Half axes of the ellipsoid."""
FLOAT, BYTE, SHORT, WORD, INT = 5126, 5121, 5122, 5123, 5125


def solid() -> tuple[np.ndarray, np.ndarray]:
    """Points (mm) and triangles of a closed ellipsoid: south pole, rings from south to north, north pole."""
    height = np.linspace(-np.pi / 2, np.pi / 2, RINGS + 2)[1:-1]
    angle = np.arange(AROUND) * 2 * np.pi / AROUND
    rings = [np.stack([np.cos(h) * np.cos(angle), np.cos(h) * np.sin(angle), 0 * angle + np.sin(h)], 1) for h in height]
    points = np.concatenate([[[0, 0, -1]], *rings, [[0, 0, 1]]]) * HALF_MM
    return points, np.concatenate([triangles_of(*part) for part in pieces()])


def pieces() -> list[tuple[int, list[int]]]:
    """The solid as two fans around its poles, and a strip from ring to ring: mode and corners."""

    def ring(number: int) -> list[int]:
        first = 1 + number * AROUND
        return [*range(first, first + AROUND), first]

    last = 1 + RINGS * AROUND
    found = [(6, [0, *ring(0)[::-1]]), (6, [last, *ring(RINGS - 1)])]
    for number in range(RINGS - 1):
        upper, lower = ring(number + 1), ring(number)
        found.append((5, [corner for pair in zip(upper, lower, strict=True) for corner in pair]))
    return found


def triangles_of(mode: int, corners: list[int]) -> np.ndarray:
    if mode == 6:
        return np.array([[corners[0], corners[k], corners[k + 1]] for k in range(1, len(corners) - 1)])
    rows = [corners[k : k + 3] for k in range(len(corners) - 2)]
    return np.array([[row[0], row[2], row[1]] if k % 2 else row for k, row in enumerate(rows)])


POINTS, FACES = solid()
CORNERS = POINTS[FACES]
VOLUME_CC = float(np.einsum("ni,ni->n", CORNERS[:, 0], np.cross(CORNERS[:, 1], CORNERS[:, 2])).sum() / 6000)
assert VOLUME_CC > 600


@dataclass
class Glb:
    """A GLB that is put together piece by piece."""

    binary: bytes = b""
    table: dict[str, Any] = field(default_factory=lambda: {"asset": {"version": "2.0"}, "bufferViews": [],
                                                           "accessors": [], "meshes": [], "nodes": []})  # fmt: skip

    def view(self, content: bytes, **more: Any) -> int:
        self.binary += b"\0" * (-len(self.binary) % 4)
        self.table["bufferViews"].append(
            {"buffer": 0, "byteOffset": len(self.binary), "byteLength": len(content), **more}
        )
        self.binary += content
        return len(self.table["bufferViews"]) - 1

    def accessor(self, values: Any, component: int = FLOAT, **more: Any) -> int:
        kind = {FLOAT: "<f4", BYTE: "u1", SHORT: "<i2", WORD: "<u2", INT: "<u4"}[component]
        rows = np.asarray(values)
        width = 1 if rows.ndim == 1 else rows.shape[1]
        entry = {"componentType": component, "count": len(rows),
                 "type": {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}[width], **more}  # fmt: skip
        if "sparse" not in more:
            entry["bufferView"] = self.view(rows.astype(kind).tobytes())
        self.table["accessors"].append(entry)
        return len(self.table["accessors"]) - 1

    def mesh(self, points_m: np.ndarray = POINTS / 1000, *, indices: int = INT, **more: Any) -> int:
        part = {"attributes": {"POSITION": self.accessor(points_m)}, "indices": self.accessor(FACES.ravel(), indices)}
        self.table["meshes"].append({"primitives": [part | more]})
        return len(self.table["meshes"]) - 1

    def node(self, **entries: Any) -> int:
        self.table["nodes"].append(entries)
        return len(self.table["nodes"]) - 1

    def content(self, *roots: int, embedded: bool = True, **more: Any) -> bytes:
        table = {"buffers": [{"byteLength": len(self.binary)}], "scenes": [{"nodes": list(roots)}], "scene": 0}
        table = {**self.table, **table, **more}
        if not embedded:
            uri = "data:application/octet-stream;base64," + base64.b64encode(self.binary).decode()
            table["buffers"] = [{"byteLength": len(self.binary), "uri": uri}]
        text = json.dumps(table).encode()
        text += b" " * (-len(text) % 4)
        body = struct.pack("<II", len(text), 0x4E4F534A) + text
        if embedded:
            binary = self.binary + b"\0" * (-len(self.binary) % 4)
            body += struct.pack("<II", len(binary), 0x004E4942) + binary
        return b"glTF" + struct.pack("<II", 2, 12 + len(body)) + body


@dataclass(frozen=True)
class Container:
    """A file with one part that a reader may overlook."""

    name: str
    make: Callable[[], bytes]
    volume_cc: float = VOLUME_CC
    """True volume of what the file draws. 0: it must be refused."""
    refused: str = ""
    """What a refusal names."""
    remark: str = ""
    """A word of the remark that must be made."""


def one(**node: Any) -> bytes:
    glb = Glb()
    return glb.content(glb.node(mesh=glb.mesh(), **node))


def child_of(parent: dict[str, Any], child: dict[str, Any]) -> bytes:
    glb = Glb()
    inner = glb.node(mesh=glb.mesh(), **child)
    return glb.content(glb.node(children=[inner], **parent))


def morphed(mesh_weights: list[float], node_weights: list[float] | None = None) -> bytes:
    """Two targets: the first doubles all, the second moves it."""
    glb = Glb()
    targets = [{"POSITION": glb.accessor(POINTS / 1000)}, {"POSITION": glb.accessor(0 * POINTS + 0.1)}]
    mesh = glb.mesh(targets=targets)
    glb.table["meshes"][mesh]["weights"] = mesh_weights
    return glb.content(glb.node(mesh=mesh, **({} if node_weights is None else {"weights": node_weights})))


def sparse(*, with_base: bool) -> bytes:
    """Every vertex of the northern half is a sparse one; without a base, every vertex is."""
    glb = Glb()
    places = np.flatnonzero((POINTS[:, 2] > 0) | (not with_base))
    values = (POINTS[places] / 1000).astype("<f4").tobytes()
    entry = {"count": len(places), "indices": {"bufferView": glb.view(places.astype("<u2").tobytes()),
             "componentType": WORD}, "values": {"bufferView": glb.view(values)}}  # fmt: skip
    mesh = glb.mesh()
    glb.accessor(POINTS, sparse=entry)
    if with_base:
        flat = np.where(POINTS[:, 2:] > 0, 0, POINTS / 1000)
        glb.table["accessors"][-1]["bufferView"] = glb.view(flat.astype("<f4").tobytes())
    glb.table["meshes"][mesh]["primitives"][0]["attributes"]["POSITION"] = len(glb.table["accessors"]) - 1
    return glb.content(glb.node(mesh=mesh))


def skinned(scale: list[float]) -> bytes:
    """Two joints, of which the second one is scaled, and holds all; the node's own place does not count."""
    glb = Glb()
    mesh = glb.mesh()
    attributes = glb.table["meshes"][mesh]["primitives"][0]["attributes"]
    attributes["JOINTS_0"] = glb.accessor(np.tile([1, 0, 0, 0], (len(POINTS), 1)), BYTE)
    attributes["WEIGHTS_0"] = glb.accessor(np.tile([1.0, 0, 0, 0], (len(POINTS), 1)))
    joints = [glb.node(translation=[1, 0, 0]), glb.node(scale=scale)]
    inverse = glb.accessor(np.tile(np.eye(4).ravel(), (2, 1)))
    glb.table["skins"] = [{"joints": joints, "inverseBindMatrices": inverse}]
    return glb.content(glb.node(mesh=mesh, skin=0, scale=[5, 5, 5]), *joints)


def in_strips_and_fans() -> bytes:
    glb = Glb()
    position = glb.accessor(POINTS / 1000)
    parts = [{"attributes": {"POSITION": position}, "mode": mode, "indices": glb.accessor(corners, WORD)}
             for mode, corners in pieces()]  # fmt: skip
    glb.table["meshes"].append({"primitives": parts})
    return glb.content(glb.node(mesh=0))


def whole_numbers(*, normalized: bool) -> bytes:
    glb = Glb()
    mesh = glb.mesh()
    shares = np.round(POINTS / 100 * 32767)
    scale = 0.1 if normalized else 0.1 / 32767
    position = glb.accessor(shares, SHORT, normalized=normalized)
    glb.table["accessors"][position]["bufferView"] = glb.view(
        np.pad(shares, ((0, 0), (0, 1))).astype("<i2").tobytes(), byteStride=8
    )
    glb.table["meshes"][mesh]["primitives"][0]["attributes"]["POSITION"] = position
    return glb.content(glb.node(mesh=mesh, scale=[scale] * 3), extensionsRequired=["KHR_mesh_quantization"])


def instances() -> bytes:
    glb = Glb()
    attributes = {"TRANSLATION": glb.accessor([[0, 0, 0], [1, 0, 0]]), "SCALE": glb.accessor([[1, 1, 1], [2, 2, 2.0]])}
    extension = {"EXT_mesh_gpu_instancing": {"attributes": attributes}}
    return glb.content(glb.node(mesh=glb.mesh(), extensions=extension), extensionsRequired=["EXT_mesh_gpu_instancing"])


def hidden(*, visible: bool) -> bytes:
    """A second solid below a node that is hidden."""
    glb = Glb()
    inner = glb.node(mesh=glb.mesh(), translation=[1, 0, 0])
    other = glb.node(children=[inner], extensions={"KHR_node_visibility": {"visible": visible}})
    return glb.content(glb.node(mesh=0), other, extensionsUsed=["KHR_node_visibility"])


def compressed(how: str, *, required: bool, fallback: bool) -> bytes:
    """As Draco and meshopt mark a mesh; what a fallback holds is the solid."""
    glb = Glb()
    mesh = glb.mesh()
    position = glb.table["accessors"][0]
    if how == "KHR_draco_mesh_compression":
        glb.table["meshes"][mesh]["primitives"][0]["extensions"] = {how: {"bufferView": 0, "attributes": {}}}
        if not fallback:
            del position["bufferView"]
    elif not fallback:
        glb.table["bufferViews"][0] |= {"buffer": 1, "byteOffset": 0, "extensions": {how: {"buffer": 0}}}
    empty = {"byteLength": 9999, "extensions": {how: {"fallback": True}}}
    more: dict[str, Any] = {"buffers": [{"byteLength": len(glb.binary)}, empty]}
    more |= {"extensionsRequired": [how]} if required else {}
    return glb.content(glb.node(mesh=mesh), **more)


def two_scenes() -> bytes:
    glb = Glb()
    shown, other = glb.node(mesh=glb.mesh()), glb.node(mesh=0, translation=[1, 0, 0])
    return glb.content(scenes=[{"nodes": [other, other + 1]}, {"nodes": [shown]}], scene=1)


def beside_points() -> bytes:
    glb = Glb()
    mesh = glb.mesh()
    position = glb.table["meshes"][mesh]["primitives"][0]["attributes"]["POSITION"]
    glb.table["meshes"][mesh]["primitives"] += [{"attributes": {"POSITION": position}, "mode": k} for k in range(4)]
    return glb.content(glb.node(mesh=mesh))


def without_indices() -> bytes:
    glb = Glb()
    glb.table["meshes"].append(
        {"primitives": [{"attributes": {"POSITION": glb.accessor(CORNERS.reshape(-1, 3) / 1000)}}]}
    )
    return glb.content(glb.node(mesh=0))


def another_mode() -> bytes:
    glb = Glb()
    return glb.content(glb.node(mesh=glb.mesh(mode=7)))


def embedded_as_text() -> bytes:
    glb = Glb()
    return glb.content(glb.node(mesh=glb.mesh()), embedded=False)


def with_indices(kind: int) -> Callable[[], bytes]:
    def make() -> bytes:
        glb = Glb()
        return glb.content(glb.node(mesh=glb.mesh(indices=kind)))

    return make


def requiring(*names: str) -> Callable[[], bytes]:
    def make() -> bytes:
        glb = Glb()
        return glb.content(glb.node(mesh=glb.mesh()), extensionsRequired=list(names))

    return make


def animated() -> bytes:
    glb = Glb()
    return glb.content(glb.node(mesh=glb.mesh()), animations=[{"channels": [], "samplers": []}])


_DRACO, _MESHOPT = "KHR_draco_mesh_compression", "EXT_meshopt_compression"
_HALF_TURN = [0.0, 1.0, 0.0, 0.0]
GLBS = (
    Container("plain", one),
    Container("indices of 8 bits", with_indices(BYTE)),
    Container("indices of 16 bits", with_indices(WORD)),
    Container("without indices", without_indices),
    Container("turned", lambda: one(rotation=_HALF_TURN, translation=[0.3, 0, 0])),
    Container("a matrix", lambda: one(matrix=(2 * np.eye(4) - np.diag([0, 0, 0, 1])).ravel().tolist()), 8 * VOLUME_CC),
    Container("a scale below a scale", lambda: child_of({"scale": [2, 1, 1]}, {"scale": [1, 1, 0.5]})),
    Container("a negative scale", lambda: one(scale=[-1, 1, 1]), remark="mesh-part-mirrored"),
    Container("two negative scales", lambda: child_of({"scale": [-1, 1, 1]}, {"scale": [1, -1, 1]})),
    Container("morph weights of 0", lambda: morphed([0, 0])),
    Container("morph weights of a mesh", lambda: morphed([1, 0]), 8 * VOLUME_CC),
    Container("morph weights of a node", lambda: morphed([1, 0], [0, 0.5])),
    Container("half a morph weight", lambda: morphed([0.5, 1]), 1.5**3 * VOLUME_CC),
    Container("sparse", lambda: sparse(with_base=True)),
    Container("sparse without a base", lambda: sparse(with_base=False)),
    Container("a skin", lambda: skinned([1, 1, 1])),
    Container("a skin with a scaled joint", lambda: skinned([2, 2, 2]), 8 * VOLUME_CC),
    Container("strips and fans", in_strips_and_fans),
    Container("normalized positions", lambda: whole_numbers(normalized=True)),
    Container("positions in whole numbers", lambda: whole_numbers(normalized=False)),
    Container("instances", instances, 9 * VOLUME_CC),
    Container("a hidden node", lambda: hidden(visible=False), remark="mesh-parts-hidden"),
    Container("a node that is not hidden", lambda: hidden(visible=True), 2 * VOLUME_CC),
    Container("a second scene", two_scenes),
    Container("points and lines", beside_points),
    Container("another mode", another_mode, 0, "mode 7"),
    Container("a buffer as text", embedded_as_text),
    Container("an animation", animated, remark="mesh-animated"),
    Container("Draco", lambda: compressed(_DRACO, required=True, fallback=False), 0, "Draco.*without compression"),
    Container("Draco, not required", lambda: compressed(_DRACO, required=False, fallback=False), 0, "Draco"),
    Container("Draco with a fallback", lambda: compressed(_DRACO, required=False, fallback=True)),
    Container("meshopt", lambda: compressed(_MESHOPT, required=True, fallback=False), 0, "meshopt.*without comp"),
    Container("meshopt, not required", lambda: compressed(_MESHOPT, required=False, fallback=False), 0, "meshopt"),
    Container("an unknown extension", requiring("VENDOR_mesh_folding"), 0, "VENDOR_mesh_folding"),
    Container("an extension of the look alone", requiring("KHR_materials_unlit", "KHR_texture_transform")),
)  # fmt: skip


# --- USDZ ---


def usda(body: str, *, head: str = "metersPerUnit = 0.001") -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_STORED) as archive:
        archive.writestr("a.usda", f'#usda 1.0\n(\n    {head}\n    upAxis = "Y"\n)\n{body}\n')
    return buffer.getvalue()


def usd_mesh(*, scale: float = 1.0, more: str = "", faces: np.ndarray = FACES, prim: str = 'def Mesh "skin"',
             place_mm: float = 0.0) -> str:  # fmt: skip
    points = ", ".join(f"({x + place_mm}, {y}, {z})" for x, y, z in (POINTS * scale).tolist())
    return f"""{prim} {{
    point3f[] points = [{points}]
    int[] faceVertexCounts = {[3] * len(faces)}
    int[] faceVertexIndices = {faces.ravel().tolist()}
    uniform token subdivisionScheme = "none"
    {more}
}}"""


def _with_purpose(purpose: str) -> bytes:
    second = usd_mesh(prim='def Mesh "other"', more=f'uniform token purpose = "{purpose}"', place_mm=500)
    return usda(usd_mesh() + "\n" + second)


def _placed_usd(order: str) -> bytes:
    return usda(f'def Xform "body" {{\n{order}\n{usd_mesh()}\n}}')


def _with_holes() -> bytes:
    """The first faces are holes, and a second mesh has them."""
    first = usd_mesh(more=f"int[] holeIndices = {list(range(20))}")
    return usda(first + "\n" + usd_mesh(prim='def Mesh "lid"', faces=FACES[:20]))


_INSTANCER = """def PointInstancer "many" {
    int[] protoIndices = [0, 0]
    point3f[] positions = [(0, 0, 0), (500, 0, 0)]
    rel prototypes = </many/skin>
    %s
}"""
_SKELETON = """def SkelRoot "figure" {
    def Skeleton "bones" ( prepend apiSchemas = ["SkelBindingAPI"] ) {
        uniform token[] joints = ["a"]
        uniform matrix4d[] bindTransforms = [((1,0,0,0),(0,1,0,0),(0,0,1,0),(0,0,0,1))]
        uniform matrix4d[] restTransforms = [((2,0,0,0),(0,2,0,0),(0,0,2,0),(0,0,0,1))]
        rel skel:animationSource = </figure/move>
    }
    def SkelAnimation "move" {
        uniform token[] joints = ["a"]
        uniform token[] blendShapes = ["wide"]
        float[] blendShapeWeights = [%s]
    }
    %s
}"""
_JOINTS = f"""rel skel:skeleton = </figure/bones>
    int[] primvars:skel:jointIndices = {[0] * len(POINTS)} ( interpolation = "vertex"
        elementSize = 1 )
    float[] primvars:skel:jointWeights = {[1] * len(POINTS)} ( interpolation = "vertex"
        elementSize = 1 )"""
_SHAPES = f"""rel skel:skeleton = </figure/bones>
    uniform token[] skel:blendShapes = ["wide"]
    rel skel:blendShapeTargets = </figure/skin/wide>
    def BlendShape "wide" {{
        uniform vector3f[] offsets = [{", ".join(f"({x}, {y}, {z})" for x, y, z in POINTS.tolist())}]
    }}"""
_BOUND = 'def Mesh "skin" ( prepend apiSchemas = ["SkelBindingAPI"] )'


def _skeleton(weight: float, more: str) -> bytes:
    return usda(_SKELETON % (weight, usd_mesh(prim=_BOUND, more=more)))


def _in_unit(metres: float) -> Container:
    return Container(f"a unit of {metres} m",
                     lambda: usda(usd_mesh(scale=0.001 / metres), head=f"metersPerUnit = {metres}"))  # fmt: skip


_FLIPPED = 'double3 xformOp:scale = (-1, 1, 1)\nuniform token[] xformOpOrder = ["xformOp:scale"]'
USDZS = (
    Container("plain", lambda: usda(usd_mesh())),
    Container("a proxy", lambda: _with_purpose("proxy"), remark="mesh-parts-hidden"),
    Container("a guide", lambda: _with_purpose("guide"), remark="mesh-parts-hidden"),
    Container("render", lambda: _with_purpose("render"), 2 * VOLUME_CC),
    Container("invisible", lambda: usda(
        usd_mesh() + "\n" + usd_mesh(prim='def Mesh "other"', more='token visibility = "invisible"')),
        remark="mesh-parts-hidden"),
    Container("holes", _with_holes),
    Container("a PointInstancer", lambda: usda(_INSTANCER % usd_mesh()), 0, "PointInstancer"),
    Container("a cube", lambda: usda(usd_mesh() + '\ndef Cube "base" {\n double size = 80\n}'), 0, "a Cube"),
    Container("points", lambda: usda(usd_mesh() + '\ndef Points "cloud" {\n point3f[] points = [(0, 0, 0)]\n}')),
    Container("a skeleton", lambda: _skeleton(0, _JOINTS), 0, "skeleton"),
    Container("blend shapes", lambda: _skeleton(1, _SHAPES), 0, "blend shapes"),
    Container("blend shapes of weight 0", lambda: _skeleton(0, _SHAPES)),
    Container("a negative scale", lambda: _placed_usd(_FLIPPED), remark="mesh-part-mirrored"),
    Container("subdivision", lambda: usda(usd_mesh().replace('"none"', '"catmullClark"')), remark="mesh-subdivided"),
    Container("left-handed", lambda: usda(
        usd_mesh(faces=FACES[:, ::-1], more='uniform token orientation = "leftHanded"'))),
    *(_in_unit(metres) for metres in (1.0, 0.01, 0.0254, 0.3048, 0.02, 1e-6)),
)  # fmt: skip


# --- drawn by chance ---

FORMS = ("plain", "whole numbers", "morphed", "sparse", "strips", "instances")


def random_glb(seed: int) -> tuple[bytes, float]:
    """A GLB of up to four solids in a tree of nodes, in forms drawn by chance, and the true volume of all, cc.

    It is the solid's, times what its form multiplies it by, times the determinants of the scales above it, whatever
    their signs.
    """
    rng = np.random.default_rng(seed)
    glb, volume_cc, roots = Glb(), 0.0, []
    for number in range(rng.integers(1, 5)):
        entries, factor, scale = _random_form(glb, rng, str(rng.choice(FORMS)))
        for depth in range(rng.integers(1, 4)):
            scales = rng.uniform(0.7, 1.3, 3) * rng.choice([-1, 1], 3, p=[0.2, 0.8]) * (1.0 if depth else scale)
            factor *= abs(float(np.prod(scales)))
            turn = rng.normal(size=4)
            place = rng.uniform(-0.05, 0.05, 3) + np.array([0.25 * number, 0, 0])
            node = glb.node(**entries, scale=scales.tolist(), rotation=(turn / np.linalg.norm(turn)).tolist(),
                            translation=place.tolist())  # fmt: skip
            entries = {"children": [node]}
        if rng.random() < 0.2:
            node = glb.node(children=[node], extensions={"KHR_node_visibility": {"visible": False}})
        else:
            volume_cc += factor * VOLUME_CC
        roots.append(node)
    return glb.content(*roots, embedded=bool(rng.random() < 0.8)), volume_cc


def _random_form(glb: Glb, rng: np.random.Generator, form: str) -> tuple[dict[str, Any], float, float]:
    """A mesh: entries of its node, what its form multiplies the volume by, and the scale that makes it metres."""
    mesh = glb.mesh(indices=int(rng.choice([BYTE, WORD, INT])))
    parts = glb.table["meshes"][mesh]["primitives"]
    attributes = parts[0]["attributes"]
    if form == "whole numbers":  # shares of 0.1 m
        attributes["POSITION"] = glb.accessor(np.round(POINTS / 100 * 32767), SHORT, normalized=True)
        return {"mesh": mesh}, 1000.0, 0.1
    if form == "morphed":
        weight = float(rng.choice([0.0, rng.uniform(-0.3, 0.3)]))
        parts[0]["targets"] = [{"POSITION": glb.accessor(POINTS / 1000)}]
        return {"mesh": mesh, "weights": [weight]}, (1 + weight) ** 3, 1.0
    if form == "sparse":
        places = np.sort(rng.choice(len(POINTS), 40, replace=False))
        wrong = POINTS / 1000
        wrong = np.where(np.isin(np.arange(len(POINTS)), places)[:, None], rng.normal(size=wrong.shape), wrong)
        attributes["POSITION"] = glb.accessor(wrong)
        glb.table["accessors"][-1]["sparse"] = {
            "count": len(places),
            "indices": {"bufferView": glb.view(places.astype("<u2").tobytes()), "componentType": WORD},
            "values": {"bufferView": glb.view((POINTS[places] / 1000).astype("<f4").tobytes())},
        }
    if form == "strips":
        parts[:] = [{"attributes": attributes, "mode": mode, "indices": glb.accessor(corners, WORD)}
                    for mode, corners in pieces()]  # fmt: skip
    if form == "instances":
        scales = rng.uniform(0.7, 1.2, (2, 3))
        extension = {"EXT_mesh_gpu_instancing": {"attributes": {"SCALE": glb.accessor(scales)}}}
        return {"mesh": mesh, "extensions": extension}, float(np.prod(scales, axis=1).sum()), 1.0
    return {"mesh": mesh}, 1.0, 1.0
