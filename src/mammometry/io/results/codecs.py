"""Write and read products, each in the format for its kind (docs/session-folder.md, `formats`).

A value without a format of its own becomes a .npz: a JSON tree of dataclasses of this package, mappings, tuples,
enumerations and scalars, and numbered arrays. A stored type is identified by its label in `STORED_TYPES`.
"""

from __future__ import annotations

import importlib
import json
import struct
import zipfile
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, is_dataclass
from enum import Enum
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from mammometry.base.errors import MammometryError, StorageError
from mammometry.base.notices import Notice
from mammometry.base.registry import Registry
from mammometry.calibration.targets.target import TARGETS
from mammometry.geometry.arrays import Array, UInt8
from mammometry.measure.boundary import BoundaryRemark

STORED_TYPES: Mapping[str, str] = MappingProxyType(
    {
        "base.notices:Notice": "mammometry.base.notices.notice:Notice",
        "calibration.calibrated:Calibration": "mammometry.calibration.adjust.calibrated:Calibration",
        "calibration.calibrated:ParameterCovariance": "mammometry.calibration.adjust.calibrated:ParameterCovariance",
        "calibration.calibrated:SetAside": "mammometry.calibration.adjust.calibrated:SetAside",
        "calibration.detect:Detection": "mammometry.calibration.detection.detect:Detection",
        "calibration.detect:MissedView": "mammometry.calibration.detection.detect:MissedView",
        "calibration.detect:Observations": "mammometry.calibration.detection.detect:Observations",
        "calibration.left_out:LeftOut": "mammometry.calibration.adjust.left_out:LeftOut",
        "calibration.target:CharucoTarget": "mammometry.calibration.targets.kinds.charuco:CharucoTarget",
        "calibration.target:ChessboardTarget": "mammometry.calibration.targets.kinds.chessboard:ChessboardTarget",
        "calibration.target:CirclesTarget": "mammometry.calibration.targets.kinds.circles:CirclesTarget",
        "calibration.target:DottedCylinderTarget": "mammometry.calibration.targets.kinds.cylinder:DottedCylinderTarget",
        "calibration.target:PointsTarget": "mammometry.calibration.targets.kinds.points:PointsTarget",
        "geometry.camera:Camera": "mammometry.geometry.camera:Camera",
        "geometry.camera:Rig": "mammometry.geometry.camera:Rig",
        "geometry.mesh:TriangleMesh": "mammometry.geometry.mesh:TriangleMesh",
        "geometry.transform:Transform": "mammometry.geometry.transform:Transform",
        "matching.foreground:Foreground": "mammometry.matching.foreground.foreground:Foreground",
        "matching.match:DisparityMap": "mammometry.matching.dense.match:DisparityMap",
        "matching.subjects:Subjects": "mammometry.matching.foreground.all_cameras:Subjects",
        "measure.anthropometry:Dimensions": "mammometry.measure.shape.anthropometry:Dimensions",
        "measure.body:Body": "mammometry.measure.trunk.body:BodyDirections",
        "measure.boundary:Boundary": "mammometry.measure.boundary.boundary:Boundary",
        "measure.boundary:NoBreast": "mammometry.measure.boundary.breasts:NoBreast",
        "measure.boundary:Standing": "mammometry.measure.boundary.prominence:Prominence",
        "measure.boundary:TorsoSides": "mammometry.measure.boundary.boundary:TorsoSides",
        "measure.lacking:Lacking": "mammometry.measure.volume.measurement:VolumeDeficit",
        "measure.landmarks:Landmark": "mammometry.measure.landmarks.landmarks:Landmark",
        "measure.linear:LinearMeasure": "mammometry.measure.shape.lengths:LinearMeasure",
        "measure.linear:Ptosis": "mammometry.measure.shape.lengths:Ptosis",
        "measure.overlap:Overlap": "mammometry.measure.boundary.overlap:Overlap",
        "measure.shape:BreastShape": "mammometry.measure.shape.anthropometry:BreastShape",
        "measure.size:BodySize": "mammometry.measure.shape.body_size:BodySize",
        "measure.symmetry:Symmetry": "mammometry.measure.shape.symmetry:Symmetry",
        "measure.volume:DefinedVolume": "mammometry.measure.volume.measurement:DefinedVolume",
        "measure.volume:VolumeMeasurement": "mammometry.measure.volume.measurement:VolumeMeasurement",
        "surface.agreement:RowErrors": "mammometry.surface.motion.agreement:RowErrors",
        "surface.atlas:Atlas": "mammometry.surface.texture.texture_atlas:Atlas",
        "surface.occluders:Blocked": "mammometry.surface.occlusion:Occlusion",
        "surface.feature_evidence:CorrectionEvidence": (
            "mammometry.surface.motion.feature_evidence:CorrectionEvidence"
        ),
        "surface.dents:Kept": "mammometry.surface.ranges.dents:KeepMasks",
        "surface.dents:ValidPatches": "mammometry.surface.ranges.dents:ValidPatches",
        "surface.motions:Unknowns": "mammometry.surface.motion.rigid_motion:MotionParameters",
        "surface.range_image:RangeImage": "mammometry.surface.ranges.range_image:RangeImage",
        "surface.repair:RepairedSurface": "mammometry.surface.repair.repair:RepairedSurface",
        "surface.stillness:Displaced": "mammometry.surface.motion.motion_detection:Displaced",
        "surface.stillness:Stillness": "mammometry.surface.motion.motion_detection:MotionEstimate",
        "walk.motion:WalkMotion": "mammometry.walk.motion:WalkMotion",
        "surface.stillness:Turn": "mammometry.surface.motion.motion_detection:Turn",
    }
)
"""Label on disk → current location of the type. Labels never change, so that moving a type makes no result stale. Kinds
of targets not listed here are labelled with their names."""
STORED_FIELDS: Mapping[str, Mapping[str, str]] = MappingProxyType(
    {
        "measure.boundary:NoBreast": {"prominence": "standing"},
        "surface.stillness:Stillness": {"parameters": "asked", "distance_mm": "apart_mm"},
    }
)
"""Label → field → its name on disk, if the field was renamed."""
_SENTENCES = {
    "measure.boundary:Boundary": ("method", "remarks"),
    "measure.volume:VolumeMeasurement": ("boundary_method", "boundary_remarks"),
}
"""Label → field that had a sentence in version 1.0, and the field that has its codes now."""
_CODES_OF_1_0: Mapping[str, BoundaryRemark] = MappingProxyType(
    {
        "given: ": "given",
        "does not show where the head is": "head-not-shown",
        "to be confirmed by eye": "to-be-confirmed",
    }
)
"""Parts of these sentences → codes."""
_OF_PARTNER = "its partner's silhouette is not known"  # version 1.0's reason for a camera without a silhouette
_BY_BREASTS = "as the breasts lie"  # part of version 1.0's sentence about the directions of the body
_TARGET = "target:"  # prefix of the label of a kind of target


def to_tree(value: object, arrays: dict[str, np.ndarray[Any, Any]]) -> Any:
    """Convert a value to data for JSON. Its arrays are added to `arrays` by name.

    Raises:
        TypeError: a type that cannot be stored.
    """
    if isinstance(value, np.ndarray):
        name = f"a{len(arrays)}"
        arrays[name] = value
        return {"$array": name}
    if isinstance(value, Enum):
        return {"$enum": _label(type(value)), "value": value.value}
    if value is None or isinstance(value, (bool, int, str)):
        return value
    if isinstance(value, float):
        return value if np.isfinite(value) else {"$float": repr(value)}
    if isinstance(value, np.generic):
        return to_tree(value.item(), arrays)
    if is_dataclass(value) and not isinstance(value, type):
        label = _label(type(value))
        first = STORED_FIELDS.get(label, {})
        members = {first.get(item.name, item.name): getattr(value, item.name) for item in fields(value) if item.init}
        return {"$value": label, **{name: to_tree(member, arrays) for name, member in members.items()}}
    if isinstance(value, Mapping):
        return {"$map": [[to_tree(key, arrays), to_tree(item, arrays)] for key, item in value.items()]}
    if isinstance(value, tuple):
        return {"$tuple": [to_tree(item, arrays) for item in value]}
    if isinstance(value, list):
        return [to_tree(item, arrays) for item in value]
    raise TypeError(f"a result contains a {type(value).__name__}, which cannot be stored")


def from_tree(tree: Any, arrays: Mapping[str, np.ndarray[Any, Any]]) -> Any:
    """Convert a tree and its arrays back to a value. The inverse of `to_tree`.

    Raises:
        StorageError: an unknown type, or a missing member.
    """
    if isinstance(tree, list):
        return [from_tree(item, arrays) for item in tree]
    if not isinstance(tree, dict):
        return tree
    try:
        if "$array" in tree:
            return arrays[tree["$array"]]
        if "$float" in tree:
            return float(tree["$float"])
        if "$tuple" in tree:
            return tuple(from_tree(item, arrays) for item in tree["$tuple"])
        if "$map" in tree:
            return {from_tree(key, arrays): from_tree(item, arrays) for key, item in tree["$map"]}
        if "$enum" in tree:
            return _type(tree["$enum"])(tree["value"])
        now = {first: name for name, first in STORED_FIELDS.get(str(tree["$value"]), {}).items()}
        members = {now.get(name, str(name)): from_tree(item, arrays) for name, item in tree.items() if name != "$value"}
        return _type(tree["$value"])(**_without_sentences(str(tree["$value"]), members))
    except (KeyError, TypeError, ValueError, AttributeError, ImportError) as error:
        remedy = "Delete the results folder and run again"
        expected = "a result of this version"
        raise StorageError(
            "a stored result", found=f"one that cannot be rebuilt ({error})", expected=expected, remedy=remedy
        ) from None


def _without_sentences(label: str, members: dict[str, Any]) -> dict[str, Any]:
    """Members of a value, with codes in place of the sentences that version 1.0 stored."""
    if label == "measure.landmarks:Landmark" and "proposed" not in members:
        return members | {"proposed": members["method"].startswith("proposed: ")}
    if label == "matching.subjects:Subjects":
        return members | {
            "doubts": {name: "" if why == _OF_PARTNER else why for name, why in members["doubts"].items()}
        }
    if label == "measure.body:Body" and "how" in members:
        return {name: value for name, value in members.items() if name != "how"} | {
            "by_breasts": _BY_BREASTS in members["how"]
        }
    if label == "measure.boundary:NoBreast" and "why" in members:
        reason = Notice(code="sentence", values={"text": members["why"]})
        return {name: value for name, value in members.items() if name != "why"} | {"reason": reason}
    sentence, codes = _SENTENCES.get(label, ("", ""))
    if not codes or codes in members:
        return members
    words = members[sentence]
    found = tuple(code for part, code in _CODES_OF_1_0.items() if part in words)
    return members | {sentence: words.removesuffix("to be confirmed by eye").rstrip("; "), codes: found}


def _label(kind: type) -> str:
    label = _labels().get(f"{kind.__module__}:{kind.__qualname__}")
    if label is None and (name := next((name for name, target in TARGETS.items() if target is kind), None)) is not None:
        label = f"{_TARGET}{name}"
    if label is None:
        raise TypeError(f"a result contains a {kind.__module__}.{kind.__qualname__}, which has no label on disk")
    return label


def _type(label: str) -> Any:
    if label.startswith(_TARGET):
        return TARGETS[label.removeprefix(_TARGET)]
    module, _, name = STORED_TYPES[label].partition(":")
    return getattr(importlib.import_module(module), name)


@cache
def _labels() -> dict[str, str]:
    return {place: label for label, place in STORED_TYPES.items()}


@dataclass(frozen=True, slots=True, kw_only=True)
class Format:
    """Format of one kind of product on disk."""

    write: Callable[[Path, Any], None]
    """Writes the value to a path with extension `ending`, and the format's other files with the same stem."""
    read: Callable[[Path], Any]
    """Reads the value from the path with `read_ending`. Any error means a damaged file."""
    ending: str
    """Extension of the product's main file, with the dot."""
    read_ending: str | None = None
    """Extension of the file from which the value is read. None: `ending`."""


FORMATS: Registry[Format] = Registry(
    "format of a product", modules=("mammometry.io.results.formats", "mammometry.io.results.formats")
)
"""Kind of product → its format. All other kinds are stored as `ARRAYS`."""
_LEVEL = 1  # deflate level: higher ones take longer and save little
_LEAST = 1 << 12  # smallest array that is packed, values
_PER_UNIT = 1024.0  # steps of packed positions, 1/mm
_LARGEST = 2.0**30  # integers below this have differences that fit into 32 bits


def packed(array: Array) -> tuple[UInt8[Array, "4 n"], dict[str, Any]] | None:
    """Convert an array to byte planes of differences, which deflate well, with facts for `unpacked`.

    None if this saves nothing, or would change values.
    """
    if array.size < _LEAST or array.dtype not in (np.int32, np.float64) or not array.flags.c_contiguous:
        return None
    per_unit = _PER_UNIT if array.dtype == np.float64 else 1.0
    scaled = array * per_unit
    if not (np.abs(scaled) < _LARGEST).all():  # also false for NaN
        return None
    whole = scaled.astype(np.int32)
    if per_unit != 1.0 and (whole.astype(np.float64) / per_unit).tobytes() != array.tobytes():
        return None
    steps = whole.copy()
    steps[1:] -= whole[:-1]
    folded = ((steps << 1) ^ (steps >> 31)).astype("<i4")  # 0, −1, 1, −2 … become 0, 1, 2, 3 …
    planes = np.ascontiguousarray(folded.reshape(-1).view(np.uint8).reshape(-1, 4).T)
    return planes, {"dtype": array.dtype.str, "shape": list(array.shape), "per_unit": per_unit}


def unpacked(planes: UInt8[Array, "4 n"], about: Mapping[str, Any]) -> Array:
    """Restore the array from the result of `packed`.

    Raises:
        ValueError: bytes and facts do not match.
    """
    folded = np.ascontiguousarray(planes.T).view("<u4").reshape(about["shape"])
    steps = (folded >> np.uint32(1)).astype(np.int32) ^ -(folded & np.uint32(1)).astype(np.int32)
    whole = np.add.accumulate(steps, axis=0, dtype=np.int32)
    per_unit = float(about["per_unit"])
    values = whole if per_unit == 1.0 else whole / per_unit
    return values.astype(about["dtype"], copy=False)


_JSON_FORMAT = 1
"""Version of the JSON files, whose members other programs depend on."""


def write_arrays(path: Path, value: Any) -> None:
    """Write a value to a compressed .npz. Its array ``packed`` lists the packed arrays as JSON."""
    arrays: dict[str, np.ndarray[Any, Any]] = {}
    tree = json.dumps(to_tree(value, arrays)).encode()
    laid_out: dict[str, dict[str, Any]] = {}
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=_LEVEL) as archive:

        def write(name: str, array: np.ndarray[Any, Any]) -> None:
            with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                np.lib.format.write_array(member, array, allow_pickle=False)

        write("tree", np.frombuffer(tree, dtype=np.uint8))
        for name, array in arrays.items():
            array = np.asanyarray(array)
            if (tight := packed(array)) is not None:
                array, laid_out[name] = tight
            write(name, array)
        if laid_out:
            write("packed", np.frombuffer(json.dumps(laid_out).encode(), dtype=np.uint8))


def read_arrays(path: Path) -> Any:
    """Read a value written by `write_arrays`."""
    with path.open("rb") as file, np.load(file, allow_pickle=False) as stored:
        arrays = {name: stored[name] for name in stored.files if name not in ("tree", "packed")}
        for name, about in json.loads(stored["packed"].tobytes()).items() if "packed" in stored.files else ():
            arrays[name] = unpacked(arrays[name], about)
        return from_tree(json.loads(stored["tree"].tobytes()), arrays)


def write_json(path: Path, table: Mapping[str, Any]) -> None:
    """Write a table for other programs."""
    path.write_text(
        json.dumps({"format": _JSON_FORMAT, **table}, indent=1, ensure_ascii=False) + "\n", encoding="utf-8"
    )


def with_json(table: Callable[[str, Any], Mapping[str, Any]]) -> Format:
    """Return a format with the value in .npz, and a table for other programs in .json.

    Args:
        table: makes the table from the product's name and value.
    """

    def write(path: Path, value: Any) -> None:
        write_arrays(path.with_suffix(".npz"), value)
        write_json(path, table(path.stem, value))

    return Format(write=write, read=read_arrays, ending=".json", read_ending=".npz")


ARRAYS = Format(write=write_arrays, read=read_arrays, ending=".npz")
"""Format of products without a format of their own."""


_DAMAGED = (
    OSError, ValueError, LookupError, TypeError, AttributeError, ArithmeticError, EOFError, RecursionError,
    zipfile.BadZipFile, zlib.error, struct.error,
)  # fmt: skip
"""Errors that the standard library and NumPy raise for damaged files."""


def encode(value: Any, folder: Path, product: str) -> None:
    """Write a product's files into `folder`: ``disparity/front`` becomes disparity/front.tif.

    Raises:
        OSError: the disk reports an error.
        TypeError: a value that cannot be stored.
    """
    stem = folder / product
    stem.parent.mkdir(parents=True, exist_ok=True)
    format_ = _format(product)
    format_.write(stem.with_name(stem.name + format_.ending), value)


def decode(folder: Path, product: str) -> Any:
    """Read a product from `folder`.

    Raises:
        StorageError: its files are missing or damaged.
    """
    stem = folder / product
    format_ = _format(product)
    path = stem.with_name(stem.name + (format_.read_ending or format_.ending))
    try:
        return format_.read(path)
    except MammometryError:
        raise
    except _DAMAGED as error:
        remedy = "Run the command again, which computes it again"
        expected = "the file as it was written"
        raise StorageError(
            path.name, found=f"a result that cannot be read ({error})", expected=expected, remedy=remedy
        ) from None


def _format(product: str) -> Format:
    """Format for a product's kind: the kind of ``disparity/front`` is ``disparity``."""
    return FORMATS.get(product.partition("/")[0], ARRAYS)
