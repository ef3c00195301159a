"""Read a GLB (glTF 2.0 in one file) completely, or refuse it with the reason.

Reads the default scene: all instances of meshes, sparse and normalised numbers, strips and fans, morph targets, skins,
GPU instancing and hidden nodes. A file that requires an extension not in `_READ` is refused.
"""

from __future__ import annotations

import base64
import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NoReturn

import numpy as np

from mammometry.base.errors import SessionError
from mammometry.base.parse import json_value
from mammometry.geometry.arrays import Array, Float64, Int64, UInt8
from mammometry.geometry.mesh_files.colours import eight_bit
from mammometry.geometry.mesh_files.scene import ANIMATED, GREY, HIDDEN, MIRRORED, SceneContent, ScenePart

_MAGIC, _VERSION = b"glTF", 2
_JSON, _BIN = 0x4E4F534A, 0x004E4942  # kinds of chunks (specification, "Binary glTF Layout")
_HEAD = 12  # bytes of the file's header; a chunk's header has 8
_COMPONENTS = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
_NO_SURFACE = (0, 1, 2, 3)  # modes of points and lines
_TRIANGLES, _STRIP, _FAN = 4, 5, 6  # modes of a primitive with a surface
_DRACO = "KHR_draco_mesh_compression"
_MESHOPT = ("EXT_meshopt_compression", "KHR_meshopt_compression")
_VISIBILITY, _INSTANCES = "KHR_node_visibility", "EXT_mesh_gpu_instancing"
_WEBP, _TEXTURE_PLACE, _SPECULAR = "EXT_texture_webp", "KHR_texture_transform", "KHR_materials_pbrSpecularGlossiness"
_READ = frozenset({
    _VISIBILITY, _INSTANCES, _WEBP, _TEXTURE_PLACE, "KHR_mesh_quantization", "KHR_lights_punctual", "KHR_xmp_json_ld",
})  # fmt: skip
_LIGHT_ALONE = "KHR_materials_"  # extensions that affect only the appearance, not the shape
_ENDINGS = ((b"\xff\xd8", ".jpg"), (b"\x89PNG", ".png"), (b"RIFF", ".webp"))


def read_glb(content: bytes, name: str) -> SceneContent:
    """Read the meshes of a GLB.

    Args:
        content: content of the file.
        name: the file's name in messages.

    Raises:
        SessionError: it uses features that are not read here, or refers to other files.
        ValueError: the file is damaged (also KeyError, IndexError, TypeError and `struct.error`).
    """
    table, binary = _chunks(content, name)
    return _Reader(name=name, table=table, binary=binary, size=len(content)).scene()


def _chunks(content: bytes, name: str) -> tuple[dict[str, Any], bytes]:
    magic, version, length = struct.unpack_from("<4sII", content)
    if magic != _MAGIC or version != _VERSION:
        raise ValueError("it is not a GLB of version 2")
    table, binary, at = None, b"", _HEAD
    end = length if _HEAD < length < len(content) else len(content)  # bytes after the end are ignored
    while at + 8 <= end:
        size, kind = struct.unpack_from("<II", content, at)
        chunk = content[at + 8 : at + 8 + size]
        if kind == _JSON and table is None:
            table = json_value(chunk.decode(), name, "a GLB")
        if len(chunk) < size:
            raise ValueError("it is shorter than its header states")
        if kind == _BIN and not binary:
            binary = chunk
        at += 8 + size
    if not isinstance(table, dict):
        raise ValueError("it has no JSON chunk")
    return table, binary


@dataclass(kw_only=True)
class _Reader:
    name: str
    table: dict[str, Any]
    binary: bytes
    size: int
    """Size of the file, bytes."""
    pictures: dict[str, bytes] = field(default_factory=dict)
    remarks: list[str] = field(default_factory=list)

    def scene(self) -> SceneContent:
        self._check()
        drawn = list(self._drawn())
        count = sum(self._triangle_count(part) * len(places) for _, part, places in drawn)
        if count > self.size:  # too many instances of a mesh: refused before they are copied
            self._refuse(f"{count} triangles from {self.size} bytes", "a surface", "Export it again")
        parts = [self._part(node, part, place) for node, part, places in drawn for place in places]
        if self.table.get("animations"):
            self.remarks.append(ANIMATED)
        return SceneContent(
            parts=tuple(parts), pictures=self.pictures, metres_per_unit=1.0,
            remarks=tuple(dict.fromkeys(self.remarks)),
        )  # fmt: skip

    def _refuse(self, found: str, expected: str, remedy: str) -> NoReturn:
        raise SessionError(self.name, found=found, expected=expected, remedy=remedy)

    def _compressed(self, how: str) -> NoReturn:
        self._refuse(f"a mesh compressed with {how}", "a mesh without compression", "Export it without compression")

    def _check(self) -> None:
        """Refuse compression, other files and unknown extensions."""
        required = [str(extension) for extension in self.table.get("extensionsRequired", [])]
        for extension in required:
            if extension == _DRACO:
                self._compressed("Draco")
            if extension in _MESHOPT:
                self._compressed("meshopt")
        unknown = [name for name in required if name not in _READ and not name.startswith(_LIGHT_ALONE)]
        if unknown:
            self._refuse(
                f"the required extension {', '.join(unknown)}, which is not supported",
                "a GLB that requires only " + ", ".join(sorted(_READ)),
                "Export it without that extension",
            )
        for buffer in self.table.get("buffers", []):
            if not str(buffer.get("uri", "data:")).startswith("data:"):
                self._refuse("vertices in another file", "a GLB with its vertices inside", "Export it as one file")
        if any(accessor["count"] > self.size for accessor in self.table.get("accessors", [])):
            self._refuse("counts larger than the file", "a complete GLB", "Export it again")

    # --- numbers ---

    def _buffer(self, number: int) -> bytes:
        buffer = self.table["buffers"][number]
        if "uri" in buffer:
            return base64.b64decode(buffer["uri"].partition(",")[2])
        if number:
            raise ValueError("an empty buffer")
        return self.binary

    def _view(self, number: int) -> tuple[bytes, int]:
        """Bytes of a buffer view, and its stride, which is 0 if it is tightly packed."""
        view = self.table["bufferViews"][number]
        compressed = next((how for how in _MESHOPT if how in view.get("extensions", {})), None)
        if compressed is not None:
            buffer = self.table["buffers"][view["buffer"]]
            if view["buffer"] or compressed in buffer.get("extensions", {}):
                self._compressed("meshopt")
        start, length = view.get("byteOffset", 0), view["byteLength"]
        content = self._buffer(view["buffer"])[start : start + length]
        if len(content) < length or start < 0:
            raise ValueError("it is shorter than its header states")
        return content, view.get("byteStride", 0)

    def _rows(self, view: int, offset: int, kind: np.dtype[Any], count: int, width: int) -> Array:
        content, stride = self._view(view)
        row = width * kind.itemsize
        stride = stride or row
        if offset < 0 or count < 0 or stride < row or (count and offset + (count - 1) * stride + row > len(content)):
            raise ValueError("it is shorter than its header states")
        return np.ndarray((count, width), kind, content, offset, (stride, kind.itemsize)).copy()

    def _numbers(self, number: int) -> Array:
        """Rows of an accessor, (count, width): normalised integers as floats, others unchanged."""
        accessor = self.table["accessors"][number]
        count, width = accessor["count"], _WIDTHS[accessor["type"]]
        kind = np.dtype(_COMPONENTS[accessor["componentType"]])
        if "bufferView" in accessor:
            values = self._rows(accessor["bufferView"], accessor.get("byteOffset", 0), kind, count, width)
        else:
            values = np.zeros((count, width), kind)
        if "sparse" in accessor:
            self._replace(values, accessor["sparse"], kind)
        if not accessor.get("normalized", False):
            return values
        return np.maximum(values / float(np.iinfo(kind).max), -1.0)

    def _replace(self, values: Array, sparse: Mapping[str, Any], kind: np.dtype[Any]) -> None:
        """Write the rows of a sparse accessor."""
        count, where, what = sparse["count"], sparse["indices"], sparse["values"]
        index_kind = np.dtype(_COMPONENTS[where["componentType"]])
        places = self._rows(where["bufferView"], where.get("byteOffset", 0), index_kind, count, 1)[:, 0]
        if places.max(initial=0) >= max(len(values), 1):
            raise ValueError("it refers to rows that do not exist")
        values[places] = self._rows(what["bufferView"], what.get("byteOffset", 0), kind, count, values.shape[1])

    # --- nodes ---

    @property
    def _nodes(self) -> list[dict[str, Any]]:
        return list(self.table.get("nodes", []))

    def _roots(self) -> list[int]:
        """Root nodes of the default scene. Without scenes: all nodes without a parent."""
        if self.table.get("scenes"):
            return list(self.table["scenes"][self.table.get("scene", 0)].get("nodes", []))
        inner = {child for node in self._nodes for child in node.get("children", [])}
        return [number for number in range(len(self._nodes)) if number not in inner]

    @cached_property
    def _placed(self) -> dict[int, tuple[Float64[Array, "4 4"], bool]]:
        """Node of the scene → its transform, and whether it is visible."""
        placed: dict[int, tuple[Float64[Array, "4 4"], bool]] = {}
        waiting = [(number, np.eye(4), True) for number in self._roots()]
        while waiting:
            number, parent, shown = waiting.pop()
            if number in placed or number < 0:
                raise ValueError("its nodes form a cycle")
            node = self._nodes[number]
            here = parent @ _transform(node)
            shown = shown and node.get("extensions", {}).get(_VISIBILITY, {}).get("visible", True) is not False
            placed[number] = here, shown
            waiting += [(child, here, shown) for child in node.get("children", [])]
        return placed

    def _drawn(self) -> Iterator[tuple[dict[str, Any], dict[str, Any], list[Float64[Array, "4 4"]]]]:
        """Node, primitive and transforms of its instances, for all visible surfaces."""
        for number, (place, shown) in sorted(self._placed.items()):
            node = self._nodes[number]
            if "mesh" not in node:
                continue
            if not shown:
                self.remarks.append(HIDDEN)
                continue
            own = node.get("extensions", {}).get(_INSTANCES)
            places = [place] if own is None else [place @ instance for instance in self._instances(own)]
            for part in self.table["meshes"][node["mesh"]]["primitives"]:
                if part.get("mode", _TRIANGLES) not in _NO_SURFACE:
                    yield node, part, places

    def _instances(self, instances: Mapping[str, Any]) -> list[Float64[Array, "4 4"]]:
        attributes = {name: self._numbers(number) for name, number in instances["attributes"].items()}
        count = min((len(rows) for rows in attributes.values()), default=0)
        names = {"TRANSLATION": "translation", "ROTATION": "rotation", "SCALE": "scale"}
        return [
            _transform({key: attributes[name][row] for name, key in names.items() if name in attributes})
            for row in range(count)
        ]

    # --- surfaces ---

    def _triangle_count(self, part: Mapping[str, Any]) -> int:
        corners = part.get("indices", part["attributes"]["POSITION"])
        count: int = self.table["accessors"][corners]["count"]
        return count // 3 if part.get("mode", _TRIANGLES) == _TRIANGLES else max(count - 2, 0)

    def _part(self, node: dict[str, Any], part: dict[str, Any], place: Float64[Array, "4 4"]) -> ScenePart:
        attributes = part["attributes"]
        accessor = self.table["accessors"][attributes["POSITION"]]
        if _DRACO in part.get("extensions", {}) and "bufferView" not in accessor:
            self._compressed("Draco")
        points = np.asarray(self._numbers(attributes["POSITION"]), dtype=np.float64)
        points = points + self._morphed(node, part)
        faces = self._faces(part, len(points))
        if "skin" in node and "JOINTS_0" in attributes:
            matrices = self._skinned(node["skin"], attributes, len(points))
            points = np.einsum("nij,nj->ni", matrices[:, :3, :3], points) + matrices[:, :3, 3]
            turn = np.median(np.linalg.det(matrices[:, :3, :3]))
        else:
            points = points @ place[:3, :3].T + place[:3, 3]
            turn = np.linalg.det(place[:3, :3])
        if turn < 0:
            faces = faces[:, ::-1]
            self.remarks.append(MIRRORED)
        uv, picture = self._picture(part)
        return ScenePart(
            points=points, faces=np.ascontiguousarray(faces), colours=self._colours(attributes, len(points)),
            uv=uv if picture is not None else None, picture=picture if uv is not None else None,
        )  # fmt: skip

    def _morphed(self, node: Mapping[str, Any], part: Mapping[str, Any]) -> Float64[Array, "n 3"] | float:
        """Offset of the points by morph targets with non-zero weights."""
        weights = node.get("weights") or self.table["meshes"][node["mesh"]].get("weights") or []
        moved: Float64[Array, "n 3"] | float = 0.0
        for weight, target in zip(weights, part.get("targets", []), strict=False):
            if weight and "POSITION" in target:
                moved = moved + float(weight) * np.asarray(self._numbers(target["POSITION"]), dtype=np.float64)
        return moved

    def _skinned(self, number: int, attributes: Mapping[str, int], count: int) -> Float64[Array, "n 4 4"]:
        """Transform of each vertex by its joints. The node's own is ignored (specification, "Skins")."""
        skin = self.table["skins"][number]
        joints = np.array([self._joint(joint) for joint in skin["joints"]]).reshape(-1, 4, 4)
        if "inverseBindMatrices" in skin:
            inverse = np.asarray(self._numbers(skin["inverseBindMatrices"]), dtype=np.float64)
            joints = joints @ inverse[: len(joints)].reshape(-1, 4, 4).transpose(0, 2, 1)
        matrices = np.zeros((count, 4, 4))
        total = np.zeros(count)
        names = (name.removeprefix("JOINTS_") for name in sorted(attributes) if name.startswith("JOINTS_"))
        for name in names:
            which = self._numbers(attributes[f"JOINTS_{name}"]).astype(np.int64)
            weights = np.asarray(self._numbers(attributes[f"WEIGHTS_{name}"]), dtype=np.float64)
            matrices += np.einsum("nk,nkij->nij", weights, joints[which])
            total += weights.sum(axis=1)
        if not (total > 0).all():
            raise ValueError("it has vertices without joints")
        return matrices / total[:, None, None]

    def _joint(self, number: int) -> Float64[Array, "4 4"]:
        if number not in self._placed:
            raise ValueError("a joint is outside the scene")
        return self._placed[number][0]

    def _faces(self, part: Mapping[str, Any], count: int) -> Int64[Array, "m 3"]:
        corners = self._numbers(part["indices"])[:, 0].astype(np.int64) if "indices" in part else np.arange(count)
        if corners.max(initial=-1) >= count:
            raise ValueError("faces refer to vertices that do not exist")
        mode = part.get("mode", _TRIANGLES)
        if mode == _TRIANGLES:
            return corners[: len(corners) // 3 * 3].reshape(-1, 3)
        if mode not in (_STRIP, _FAN):
            self._refuse(f"a part of mode {mode}", "triangles, a strip or a fan", "Export it as triangles")
        first = np.arange(max(len(corners) - 2, 0))
        odd = first % 2 if mode == _STRIP else 0
        start = first if mode == _STRIP else first * 0
        middle, last = (first + 1 + odd, first + 2 - odd) if mode == _STRIP else (first + 1, first + 2)
        return corners[np.stack([start, middle, last], axis=1)]

    def _colours(self, attributes: Mapping[str, int], count: int) -> UInt8[Array, "n 3"]:
        if "COLOR_0" not in attributes:
            return np.full((count, 3), GREY, dtype=np.uint8)
        values = self._numbers(attributes["COLOR_0"])[:, :3]
        return eight_bit(values, whole=values.dtype.kind != "f")

    def _picture(self, part: Mapping[str, Any]) -> tuple[Float64[Array, "n 2"] | None, str | None]:
        """Texture coordinates of the base colour, with (0, 0) at the lower left, and the image's name."""
        if "material" not in part:
            return None, None
        material = self.table["materials"][part["material"]]
        base = material.get("pbrMetallicRoughness", {}).get("baseColorTexture")
        base = base or material.get("extensions", {}).get(_SPECULAR, {}).get("diffuseTexture")
        if base is None:
            return None, None
        placed = base.get("extensions", {}).get(_TEXTURE_PLACE, {})
        number = part["attributes"].get(f"TEXCOORD_{placed.get('texCoord', base.get('texCoord', 0))}")
        texture = self.table["textures"][base["index"]]
        source = texture.get("source", texture.get("extensions", {}).get(_WEBP, {}).get("source"))
        if number is None or source is None:
            return None, None
        uv = np.asarray(self._numbers(number), dtype=np.float64)
        if placed:
            turn = placed.get("rotation", 0.0)
            matrix = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
            uv = (uv * placed.get("scale", [1, 1])) @ matrix.T + placed.get("offset", [0, 0])
        return np.stack([uv[:, 0], 1.0 - uv[:, 1]], axis=1), self._image(source)

    def _image(self, number: int) -> str | None:
        """Name of an image, which is added to the scene's images. None if it is in another file."""
        image = self.table["images"][number]
        if "bufferView" in image:
            content = self._view(image["bufferView"])[0]
        elif str(image.get("uri", "")).startswith("data:"):
            content = base64.b64decode(image["uri"].partition(",")[2])
        else:
            return None
        ending = next((ending for mark, ending in _ENDINGS if content.startswith(mark)), ".png")
        self.pictures[f"{number}{ending}"] = content
        return f"{number}{ending}"


def _transform(node: Mapping[str, Any]) -> Float64[Array, "4 4"]:
    """A node's local transform, from its matrix or its translation, rotation and scale."""
    from scipy.spatial.transform import Rotation  # imported late: sessions with photographs do not need SciPy

    if "matrix" in node:
        return np.array(node["matrix"], dtype=np.float64).reshape(4, 4).T
    made = np.eye(4)
    turn = np.asarray(node.get("rotation", (0, 0, 0, 1)), dtype=np.float64)
    made[:3, :3] = Rotation.from_quat(turn).as_matrix() * np.asarray(node.get("scale", (1, 1, 1)), dtype=np.float64)
    made[:3, 3] = np.asarray(node.get("translation", (0, 0, 0)), dtype=np.float64)
    return made
