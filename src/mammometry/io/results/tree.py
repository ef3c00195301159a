"""Frozen values as a JSON tree and arrays, and back.

Results without their own format are stored this way. Dataclasses of this package, mappings, tuples, enumerations and
scalars become JSON. Arrays are set aside under a number, for the caller to store. A stored type is written under its
label in `STORED_TYPES`.
"""

import importlib
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from functools import cache
from types import MappingProxyType
from typing import Any

import numpy as np

from mammometry.base.errors import StorageError
from mammometry.calibration.targets.target import TARGETS

STORED_TYPES: Mapping[str, str] = MappingProxyType(
    {
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
        "measure.body:Body": "mammometry.measure.trunk.body:Body",
        "measure.boundary:Boundary": "mammometry.measure.boundary.boundary:Boundary",
        "measure.boundary:NoBreast": "mammometry.measure.boundary.breasts:NoBreast",
        "measure.boundary:Standing": "mammometry.measure.boundary.standing:Standing",
        "measure.boundary:TorsoSides": "mammometry.measure.boundary.boundary:TorsoSides",
        "measure.lacking:Lacking": "mammometry.measure.volume.measurement:VolumeDeficit",
        "measure.landmarks:Landmark": "mammometry.measure.landmarks.landmarks:Landmark",
        "measure.linear:LinearMeasure": "mammometry.measure.shape.lengths:LinearMeasure",
        "measure.linear:Ptosis": "mammometry.measure.shape.lengths:Ptosis",
        "measure.shape:BreastShape": "mammometry.measure.shape.shape:BreastShape",
        "measure.symmetry:Symmetry": "mammometry.measure.shape.symmetry:Symmetry",
        "measure.volume:DefinedVolume": "mammometry.measure.volume.definitions:DefinedVolume",
        "measure.volume:VolumeMeasurement": "mammometry.measure.volume.measurement:VolumeMeasurement",
        "surface.agreement:RowErrors": "mammometry.surface.motion.agreement:RowErrors",
        "surface.atlas:Atlas": "mammometry.surface.texture.texture_atlas:Atlas",
        "surface.occluders:Blocked": "mammometry.surface.occlusion.occlusion:Occlusion",
        "surface.dents:Kept": "mammometry.surface.ranges.dents:KeepMasks",
        "surface.dents:ValidPatches": "mammometry.surface.ranges.dents:ValidPatches",
        "surface.motions:Unknowns": "mammometry.surface.motion.rigid_motion:MotionParameters",
        "surface.range_image:RangeImage": "mammometry.surface.ranges.range_image:RangeImage",
        "surface.repair:RepairedSurface": "mammometry.surface.repair.repair:RepairedSurface",
        "surface.stillness:Displaced": "mammometry.surface.motion.motion_test:Displaced",
        "surface.stillness:Stillness": "mammometry.surface.motion.motion_test:Stillness",
        "surface.stillness:Turn": "mammometry.surface.motion.motion_test:Turn",
    }
)
"""Label on disk → current place of the type. A label never changes: a type that moves keeps its first label, so that
moving code makes no result stale. Other kinds of target are labelled by their name.
"""
STORED_FIELDS: Mapping[str, Mapping[str, str]] = MappingProxyType(
    {"surface.stillness:Stillness": {"parameters": "asked", "distance_mm": "apart_mm"}}
)
"""Label → field → its first name, under which it stays on disk where it has another name now."""
_TARGET = "target:"  # before the name of a kind of target


def to_tree(value: object, arrays: dict[str, np.ndarray[Any, Any]]) -> Any:
    """Turn a value into JSON-ready data. Its arrays go into `arrays` by name.

    Raises:
        TypeError: a type that no result should have.
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
    raise TypeError(f"a result holds a {type(value).__name__}, which cannot be kept")


def from_tree(tree: Any, arrays: Mapping[str, np.ndarray[Any, Any]]) -> Any:
    """Rebuild what `to_tree` took apart.

    Raises:
        StorageError: it names a type that is not one of ours, or lacks a member.
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
        return _type(tree["$value"])(**members)
    except (KeyError, TypeError, ValueError, AttributeError, ImportError) as error:
        remedy = "Delete the results folder and run again"
        expected = "a result of this version"
        raise StorageError(
            "a stored result", found=f"one that cannot be rebuilt ({error})", expected=expected, remedy=remedy
        ) from None


def _label(kind: type) -> str:
    label = _labels().get(f"{kind.__module__}:{kind.__qualname__}")
    if label is None and (name := next((name for name, target in TARGETS.items() if target is kind), None)) is not None:
        label = f"{_TARGET}{name}"
    if label is None:
        raise TypeError(f"a result holds a {kind.__module__}.{kind.__qualname__}, which has no label on disk")
    return label


def _type(label: str) -> Any:
    if label.startswith(_TARGET):
        return TARGETS[label.removeprefix(_TARGET)]
    module, _, name = STORED_TYPES[label].partition(":")
    return getattr(importlib.import_module(module), name)


@cache
def _labels() -> dict[str, str]:
    return {place: label for label, place in STORED_TYPES.items()}
