"""Models for the 3D viewer, and their format inside a page.

They are quantised, compressed and encoded in base64. The step of a position is 1/65535 of the model's extent (0.006 mm
for 400 mm). Normals have 8 bits per component, and values of layers 16 bits over their range. The viewer's side of this
format is ``viewer/src/format.ts``.
"""

from __future__ import annotations

import base64
import json
import re
import zlib
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from mammometry.base.value import value
from mammometry.geometry import Array, Float32, Float64, Int32, Transform, TriangleMesh, UInt8, bounds

FORMAT_VERSION = 1  # version of the data that the viewer reads
SCENE = "scene.json"
"""Name of the file with a scene for programs, next to a comparison's page and in a report's content."""
_IN_PAGE = re.compile(r'<script type="application/json" id="mm-scene">(.*?)</script>', re.DOTALL)
_MISSING = 65535  # code of a missing value: the largest 16-bit number
_STEPS = 65535  # values are stored in 16 bits


@value(eq=False)
class Layer:
    """One property of the surface, drawn in colours with a legend."""

    name: str
    """Name in the program: ``provenance``, ``error``, ``symmetry``."""
    title: str
    """Name for the reader."""
    help: str
    """One sentence that explains how to read it."""
    values: Float32[Array, " n"]
    """One value per vertex: the number of a category, or a value in `unit`. NaN if there is none."""
    kind: Literal["category", "sequential", "diverging"]
    unit: str = ""
    limits: tuple[float, float] = (0.0, 1.0)
    """Values at the ends of the colour scale. Values beyond are clipped."""
    categories: tuple[tuple[str, str], ...] = ()
    """Title and colour (#rrggbb) of each category."""

    def __post_init__(self) -> None:
        if self.kind == "category" and not self.categories:
            raise ValueError(f"layer {self.name}: categories expected")
        if self.kind != "category" and not self.limits[0] < self.limits[1]:
            raise ValueError(f"layer {self.name}: limits must rise, found {self.limits}")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Texture:
    """A picture on a surface."""

    uv: Float32[Array, "n 2"]
    """Position of each vertex in the picture, 0…1, to the right and down from its upper left corner."""
    jpeg: bytes


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ViewedSurface:
    """One surface to view, in the viewing frame, mm.

    x points to the reader's right, y up, z towards the reader.
    """

    name: str
    title: str
    mesh: TriangleMesh
    normals: Float64[Array, "n 3"]
    """Unit normals of the vertices."""
    colours: UInt8[Array, "n 3"] | None = None
    """sRGB colour of each vertex."""
    texture: Texture | None = None
    layers: tuple[Layer, ...] = ()
    curves: tuple[tuple[str, Float64[Array, "k 3"], bool], ...] = ()
    """Title and points of each curve on the surface, and whether it is closed."""
    landmarks: tuple[tuple[str, Float64[Array, 3]], ...] = ()
    """Title and position."""
    lengths: tuple[tuple[str, Float64[Array, "2 3"]], ...] = ()
    """Label, such as "114.8 mm", and both ends of each length."""
    wall: TriangleMesh | None = None
    """The chest wall that closes it."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ViewerScene:
    """Everything that the viewer can show."""

    models: tuple[ViewedSurface, ...]
    world_from_view: Transform
    """Transform from the viewing frame to the world frame."""
    comparisons: tuple[tuple[str, str, str], ...] = field(default=())
    """Title of each comparison, and the names of the two models shown side by side."""
    of_patient: bool = False
    """Whether it shows a body. If so, sides are the patient's, and the wall is a chest wall."""

    def __post_init__(self) -> None:
        names = [model.name for model in self.models]
        if len(set(names)) != len(names):
            raise ValueError(f"models need names of their own, found {names}")
        for title, *pair in self.comparisons:
            if not set(pair) <= set(names):
                raise ValueError(f"comparison {title}: models {names} expected, found {pair}")


def json_in_page(page: str) -> str | None:
    """The scene in a report's page, as written by `to_json`. None if there is none."""
    match = _IN_PAGE.search(page)
    return None if match is None else match[1]


def to_json(scene: ViewerScene) -> str:
    """The scene in the viewer's format, safe inside a script element of a page."""
    table = {
        "version": FORMAT_VERSION,
        "worldFromView": scene.world_from_view.matrix.ravel().tolist(),
        "models": [_model(model) for model in scene.models],
        "comparisons": [
            {"title": title, "first": first, "second": second} for title, first, second in scene.comparisons
        ],
        "ofPatient": scene.of_patient,
    }
    return json.dumps(table, allow_nan=False).replace("<", "\\u003c")


def _model(model: ViewedSurface) -> dict[str, object]:
    texture = model.texture
    return {
        "name": model.name,
        "title": model.title,
        **_surface(model.mesh, model.normals),
        "colours": None if model.colours is None or texture is not None else _packed(model.colours),
        "texture": None
        if texture is None
        else {
            "uv": _packed(np.rint(np.clip(texture.uv, 0.0, 1.0) * _STEPS).astype("<u2")),
            "image": f"data:image/jpeg;base64,{base64.b64encode(texture.jpeg).decode('ascii')}",
        },
        "layers": [_layer(layer, len(model.mesh.vertices)) for layer in model.layers],
        "curves": [
            {"title": title, "points": _places(points), "closed": closed} for title, points, closed in model.curves
        ],
        "landmarks": [{"title": title, "point": _places(place[None])[0]} for title, place in model.landmarks],
        "lengths": [{"words": words, "ends": _places(ends)} for words, ends in model.lengths],
        "wall": None if model.wall is None else _surface(model.wall, model.wall.vertex_normals()),
    }


def _surface(mesh: TriangleMesh, normals: Float64[Array, "n 3"]) -> dict[str, object]:
    low, high = bounds(mesh.vertices)
    step = np.maximum((high - low) / _STEPS, 1e-9)
    return {
        "vertexCount": len(mesh.vertices),
        "low": low.tolist(),
        "step": step.tolist(),
        "positions": _packed(np.rint((mesh.vertices - low) / step).astype("<u2")),
        "normals": _packed(np.rint(np.nan_to_num(normals) * 127).astype("i1")),
        "faces": _packed(_differences(mesh.faces)),
    }


def _differences(faces: Int32[Array, "m 3"]) -> Array:
    """Differences of successive corners, zigzag-coded.

    Neighbouring corners have similar numbers, so the differences compress well.
    """
    corners = faces.ravel().astype(np.int64)
    steps = np.diff(corners, prepend=0)
    return np.where(steps < 0, -2 * steps - 1, 2 * steps).astype("<u4")


def _layer(layer: Layer, vertices: int) -> dict[str, object]:
    if len(layer.values) != vertices:
        raise ValueError(f"layer {layer.name}: {vertices} values expected, found {len(layer.values)}")
    low, high = layer.limits
    if layer.kind == "category":
        coded = layer.values.astype("u1")
    else:
        share = np.clip((layer.values.astype(np.float64) - low) / (high - low), 0.0, 1.0)
        coded = np.where(np.isfinite(share), np.rint(np.nan_to_num(share) * (_MISSING - 1)), _MISSING).astype("<u2")
    return {
        "name": layer.name,
        "title": layer.title,
        "help": layer.help,
        "kind": layer.kind,
        "unit": layer.unit,
        "low": low,
        "high": high,
        "categories": [{"title": title, "colour": colour} for title, colour in layer.categories],
        "values": _packed(coded),
    }


def _places(points: Float64[Array, "k 3"]) -> list[list[float]]:
    return [[round(float(value), 3) for value in point] for point in points]


def _packed(values: Array) -> str:
    return base64.b64encode(zlib.compress(np.ascontiguousarray(values).tobytes(), 7)).decode("ascii")
