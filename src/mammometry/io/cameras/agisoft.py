"""Cameras in Agisoft's XML, as exported by Metashape and PhotoScan (from 1.3).

Conventions (Metashape's manual, appendix "Camera models"): the principal point is relative to the image centre, pixel
centres are at half-integers, and P1 and P2 are in the opposite order to OpenCV's. A camera's transform maps its points
to the chunk, and the chunk's own transform maps them to the world, in metres.
"""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path, PurePosixPath
from typing import Any
from xml.etree import ElementTree

import numpy as np

from mammometry.base.parse import number, numbers, parsing, whole
from mammometry.geometry import Array, Camera, Float64
from mammometry.io.cameras.foreign_text import read_xml
from mammometry.io.cameras.own import camera_from_entry, camera_name, unfit

_EXPECTED = "cameras as Agisoft exports them (Export Cameras, Agisoft XML)"
_MM_PER_M = 1000.0  # Agisoft's world is in metres
_HALF = 0.5  # px: Agisoft's origin is the first pixel's corner, ours its centre
_LENS = frozenset({"f", "cx", "cy", "b1", "b2", "k1", "k2", "k3", "k4", "p1", "p2", "p3", "p4"})
_ZERO = {"b2": "skew", "k4": "no term of Brown's model", "p3": "a term that no lens here has", "p4": "the same"}


def read_agisoft(path: Path, known: Collection[str]) -> dict[str, Camera]:
    """Read the aligned cameras, named by their labels.

    Args:
        path: the XML.
        known: names of the session's cameras.

    Raises:
        SessionError: a lens model other than Brown's, no scale, or a missing or invalid value.
    """
    root = read_xml(path, _EXPECTED)
    chunks = [chunk for chunk in root.iter("chunk") if chunk.find("cameras") is not None]
    if len(chunks) != 1:
        raise unfit(path.name, f"{len(chunks)} chunks with cameras", "one")
    chunk = chunks[0]
    sensors = {sensor.get("id"): sensor for sensor in chunk.iter("sensor")}
    cameras: dict[str, Camera] = {}
    for node in chunk.iter("camera"):
        label = node.get("label", "")
        name = camera_name(PurePosixPath(label.replace("\\", "/")).parts, known) or _stem(label)
        subject = f"{path.name}, camera {label}"
        transform = node.find("transform")
        if transform is None or node.get("enabled") == "false":
            if node.get("master_id") is not None and name in known:
                raise unfit(subject, "a camera of an Agisoft rig, without its own transform", "cameras without a rig")
            continue
        if name in cameras:
            raise unfit(subject, f"a second image of camera {name}", "one image per camera")
        sensor = sensors.get(node.get("sensor_id"))
        if sensor is None:
            raise unfit(subject, "no sensor", "its sensor with a calibration in the same file")
        with parsing("an invalid value", subject, _EXPECTED):
            entry = _lens(subject, sensor) | _pose(subject, _values(transform, 4, 4), _scale(subject, chunk, node))
        cameras[name] = camera_from_entry(path.name, name, entry)
    if not cameras:
        raise unfit(path.name, "no aligned camera", _EXPECTED)
    return cameras


def _lens(subject: str, sensor: ElementTree.Element) -> dict[str, Any]:
    calibrations = sensor.findall("calibration")
    calibration = next(
        (element for element in calibrations if element.get("class") == "adjusted"),
        calibrations[0] if calibrations else None,
    )
    if calibration is None:
        raise unfit(subject, "no calibration of its sensor", "<calibration> with f, cx and cy")
    kinds = {kind for kind in (sensor.get("type"), calibration.get("type")) if kind is not None}
    if kinds - {"frame"}:
        raise unfit(subject, f"a lens of type {', '.join(sorted(kinds))}", "frame: other lenses are not Brown's")
    values = {part.tag: number((part.text or "").strip()) for part in calibration if part.tag in _LENS}
    if "f" not in values:
        raise unfit(subject, "no f", "f in pixels, as PhotoScan 1.3 and Metashape write it")
    for term, words in _ZERO.items():
        if values.get(term):
            raise unfit(subject, f"{term} = {values[term]:g}, {words}", f"a calibration with {term} fixed at zero")
    size = calibration.find("resolution")
    if size is None:
        raise unfit(subject, "no resolution", "<resolution> with width and height")
    width, height = (whole(number(size.get(side, ""))) for side in ("width", "height"))
    f, b1 = values["f"], values.get("b1", 0.0)
    u, v = width / 2 + values.get("cx", 0.0) - _HALF, height / 2 + values.get("cy", 0.0) - _HALF
    return {
        "K": [[f + b1, 0.0, u], [0.0, f, v], [0.0, 0.0, 1.0]],
        "dist": [values.get(term, 0.0) for term in ("k1", "k2", "p2", "p1", "k3")],
        "image_size": (width, height),
    }


def _pose(subject: str, chunk_from_camera: Float64[Array, "4 4"], scale: Any) -> dict[str, Any]:
    rotation, translation, factor = scale
    centre = rotation @ (factor * chunk_from_camera[:3, 3]) + translation
    camera_from_world = (rotation @ chunk_from_camera[:3, :3]).T
    return {"R": camera_from_world, "t": -camera_from_world @ centre * _MM_PER_M}


def _scale(subject: str, chunk: ElementTree.Element, camera: ElementTree.Element) -> Any:
    """Rotation, translation and scale to the world, m, of the chunk or of the camera's component."""
    parts = [part for part in chunk.iter("component") if part.get("id") == camera.get("component_id")]
    for owner in (*parts, chunk):
        transform = owner.find("transform")
        if transform is None or (factor := transform.find("scale")) is None:
            continue
        turned, moved = transform.find("rotation"), transform.find("translation")
        rotation = np.eye(3) if turned is None else _values(turned, 3, 3)
        translation = np.zeros(3) if moved is None else _values(moved, 3)
        return rotation, translation, float(_values(factor, 1)[0])
    raise unfit(
        subject, "no scale of its chunk", "a chunk with scale bars or surveyed cameras, so that lengths are in metres"
    )


def _values(node: ElementTree.Element, *shape: int) -> Any:
    return numbers([number(word) for word in (node.text or "").split()], *shape)


def _stem(label: str) -> str:
    """A label without the extension of an image file. Labels without one may contain dots."""
    path = PurePosixPath(label)
    return path.stem if path.suffix.lower() in (".jpg", ".jpeg", ".png", ".tif", ".tiff") else label
