"""Small clean inputs of every kind, each with the numbers that are read from it."""

from __future__ import annotations

import io
import json
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import tifffile
import trimesh
from PIL import Image
from scipy.io import savemat
from tests.brought import test_imported_cameras as brought_cameras
from tests.unit.measure.solids import dome

from mammometry.base.errors import SessionError
from mammometry.base.notices import words_of
from mammometry.batch.entries import find_entries
from mammometry.calibration.targets.kinds.charuco import CharucoTarget
from mammometry.calibration.targets.table import target_from_table
from mammometry.geometry.camera import Camera
from mammometry.geometry.transform import Transform
from mammometry.io.cameras.formats import CameraFormat, camera_texts, import_cameras, require_rig
from mammometry.io.csv_tables import read_table
from mammometry.io.drawn import boundaries_in, landmarks_in
from mammometry.io.manifest import read_manifest
from mammometry.io.meshes.foreign import read_foreign
from mammometry.io.paired_tables import read_pairs
from mammometry.io.photographs.images import read_photograph

Files = dict[str, bytes]
"""Name → content. The first one is what is changed."""
PAIR = brought_cameras.PAIR
DOME = dome(sink_mm=10.0, rings=10, around=32)


@dataclass(frozen=True)
class Input:
    """One kind of file, and how it is read."""

    name: str
    kinds: frozenset[str]
    """What it is: text, table, json, toml, mesh, photograph, cameras."""
    make: Callable[[], Files]
    read: Callable[[list[Path]], np.ndarray]
    """The numbers, in an order that does not hang on that of the file."""
    tolerance: float = 1e-9
    """By which they may differ, relative to the largest of them."""


def texts(files: Mapping[str, str]) -> Files:
    return {name: text.encode() for name, text in files.items()}


# --- tables ---


def agreement() -> Files:
    rows = [f"Größe {k};{300 + 13 * k}.5;{305 + 13 * k + k % 3}.25" for k in range(6)]
    return texts({"table.csv": "\n".join(["subject;water_cc;imaging_cc", *rows]) + "\n"})


def read_agreement(paths: list[Path]) -> np.ndarray:
    pairs = read_pairs(paths[0], reference="water_cc", measured="imaging_cc")
    order = np.argsort(pairs.reference)
    return np.stack([pairs.reference[order], pairs.measured[order]])


def points() -> Files:
    rows = [f"{k},{12.0625 + 31.5 * k},{907.25 - 8.125 * k}" for k in range(12)]
    return texts({"front_left.csv": "\n".join(["id,u,v", *rows]) + "\n"})


def read_points(paths: list[Path]) -> np.ndarray:
    values = read_table(paths[0], "points", "id,u,v").numbers("id", "u", "v")
    return values[np.argsort(values[:, 0])]


def batch() -> Files:
    rows = ["session;reference_left_cc;reference_right_cc", "a;512.5;498", "b;1860.25;", "c;700;702.5"]
    return texts({"study.csv": "\n".join(rows) + "\n", **{f"{name}/session.toml": "" for name in "abc"}})


def read_batch(paths: list[Path]) -> np.ndarray:
    entries = sorted(find_entries([str(paths[0])]), key=lambda entry: entry.address)
    return np.array([entry.reference_cc.get(side, -1.0) for entry in entries for side in ("left", "right")])


# --- meshes ---


def ply(*, binary: bool) -> Callable[[], Files]:
    def make() -> Files:
        content = trimesh.Trimesh(DOME.vertices, DOME.faces, process=False).export(
            file_type="ply", encoding="binary" if binary else "ascii", vertex_normal=False
        )
        return {"mesh.ply": content.replace(b" 1.0\n", " 1.0\ncomment Größe\n".encode(), 1)}

    return make


def obj() -> Files:
    lines = ["# units: mm", "o Größe", *(f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in DOME.vertices.tolist())]
    lines += [f"f {a} {b} {c}" for a, b, c in (DOME.faces + 1).tolist()]
    return texts({"mesh.obj": "\n".join(lines) + "\n"})


def stl(form: str) -> Callable[[], Files]:
    def make() -> Files:
        mesh = trimesh.Trimesh(DOME.vertices.astype(np.float32), DOME.faces, process=False)
        content = mesh.export(file_type=form)
        return {"mesh.stl": content.encode() if isinstance(content, str) else content}

    return make


def read_mesh(paths: list[Path]) -> np.ndarray:
    """Area, volume and extents: equal for every order of vertices and faces, and for either side out."""
    units = None if paths[0].suffix.lower() == ".obj" else "mm"
    mesh = read_foreign(paths[0], units).mesh
    corners = mesh.vertices[mesh.faces]
    volume = abs(np.einsum("ni,ni->n", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])).sum() / 6)
    extents = [*mesh.vertices.min(axis=0), *mesh.vertices.max(axis=0)]
    return np.array([mesh.area_mm2() / 100, volume / 1000, *extents])


# --- photographs ---


def pixels(bits: int) -> np.ndarray:
    row, column = np.mgrid[0:31, 0:45] / 45
    channels = [0.1 + 0.4 * row + 0.3 * column + 0.05 * channel for channel in range(3)]
    return np.rint(np.stack(channels, axis=-1) * (2**bits - 1)).astype(np.uint8 if bits == 8 else np.uint16)


def photograph(form: str, bits: int) -> Callable[[], Files]:
    def make() -> Files:
        buffer = io.BytesIO()
        if form == "tif":
            tifffile.imwrite(buffer, pixels(bits), photometric="rgb", metadata=None)
        elif bits == 16:
            buffer.write(cv2.imencode(f".{form}", pixels(16)[..., ::-1])[1].tobytes())
        else:
            quality = {"quality": 98, "subsampling": 0} if form == "jpg" else {}
            Image.fromarray(pixels(8)).save(buffer, {"jpg": "JPEG", "png": "PNG"}[form], **quality)
        return {f"front_left.{form}": buffer.getvalue()}

    return make


def read_pixels(paths: list[Path]) -> np.ndarray:
    read = read_photograph(paths[0], "front_left").pixels
    return read.astype(float) / np.iinfo(read.dtype).max


# --- what is written for a session ---

MANIFEST = """\
# Größe
format = 1
units = "mm"
date = 2026-01-31

[rig]
name = "two"
pairs = [ { name = "front", left = "front_left", right = "front_right" } ]

[target]
kind = "charuco"
dictionary = "DICT_4X4_250"
squares = [12, 9]
square_mm = 25.5
marker_mm = 18.25

[subject]
kind = "model"
id = "P-Größe"
rim_radius_mm = 0.5
"""


def session() -> Files:
    return texts({"session.toml": MANIFEST})


def read_session(paths: list[Path]) -> np.ndarray:
    manifest = read_manifest(paths[0])
    assert manifest.target is not None
    assert manifest.date is not None
    assert manifest.subject.id == "P-Größe"
    assert [(pair.left, pair.right) for pair in manifest.rig.pairs] == [("front_left", "front_right")]
    target, radius = target_from_table(manifest.target), manifest.subject.rim_radius_mm
    assert isinstance(target, CharucoTarget)
    assert radius is not None
    return np.array([radius, manifest.date.toordinal() / 1e5, *target.squares, target.square_mm, target.marker_mm])


def drawing(key: str, name: str) -> Callable[[], Files]:
    def make() -> Files:
        angle = np.linspace(0, 2 * np.pi, 24, endpoint=False)
        rim = (60 * np.stack([np.cos(angle), np.sin(angle), 0.1 * angle], axis=1)).round(6)
        entry = {
            "method": "drawn by hand",
            "author": "Größe",
            "points": (rim if key == "boundaries" else rim[:1]).tolist(),
        }
        table = {"units": "mm", "frame": "world", "subject": "P-Größe", key: {name: entry}}
        return texts({f"{key}.json": json.dumps(table, indent=1, ensure_ascii=False)})

    return make


def read_boundaries(paths: list[Path]) -> np.ndarray:
    return boundaries_in(paths[0], ("model",), "P-Größe").curves["model"]


def read_landmarks(paths: list[Path]) -> np.ndarray:
    return landmarks_in(paths[0], "torso", "P-Größe")["nipple_left"]


# --- cameras ---


def clean_cameras() -> dict[str, Camera]:
    with tempfile.TemporaryDirectory(prefix="mammometry-") as folder:
        path = Path(folder) / "rig.mat"
        path.write_bytes(matlab()["rig.mat"])
        return import_cameras([path], PAIR)


def camera_files(form: CameraFormat, factor: float = 1.0, *, exchanged: bool = False) -> Callable[[], Files]:
    """The pair as another program's files; its lengths times a factor, or each camera under the other one's name."""

    def make() -> Files:
        cameras = {
            name: replace(
                camera,
                camera_from_world=Transform(
                    rotation=camera.camera_from_world.rotation,
                    translation_mm=camera.camera_from_world.translation_mm * factor,
                ),
            )
            for name, camera in clean_cameras().items()
        }
        if exchanged:
            left, right = cameras
            cameras = {left: replace(cameras[right], name=left), right: replace(cameras[left], name=right)}
        if form == "kalibr":  # its lens has no k3
            cameras = {
                name: replace(camera, distortion=np.array([*camera.distortion[:4], 0.0]))
                for name, camera in cameras.items()
            }
        return texts(camera_texts(cameras, form))

    return make


def agisoft() -> Files:
    return texts({"cameras.xml": brought_cameras.agisoft()})


def matlab() -> Files:
    buffer = io.BytesIO()
    savemat(buffer, {"s": brought_cameras.matlab_pair()})
    return {"rig.mat": buffer.getvalue()}


def halcon() -> Files:
    with tempfile.TemporaryDirectory(prefix="mammometry-") as place:
        folder = Path(place)
        paths = [brought_cameras.halcon(folder / f"{name}.cal", Kappa=-60.0) for name in PAIR["front"]]
        paths.append(brought_cameras.halcon_pose(folder / "relpose.dat"))
        return {path.name: path.read_bytes() for path in paths}


def read_cameras(paths: list[Path]) -> np.ndarray:
    """Where points of the world fall in both pictures, in the frame of the left camera."""
    files = [path for path in paths if path.name != "points3D.txt"]
    cameras = import_cameras(files, PAIR)
    for doubt in require_rig(paths[0].name, cameras, PAIR, "torso"):
        raise SessionError(paths[0].name, found=words_of(doubt), expected="no doubts", remedy="Look")
    left, right = (cameras[name].camera_from_world for name in PAIR["front"])
    turned = right.rotation @ left.rotation.T
    moved = right.translation_mm - turned @ left.translation_mm
    there = brought_cameras.WORLD_MM @ left.rotation - left.rotation.T @ left.translation_mm
    seen = [cameras[name].project(there) for name in PAIR["front"]]
    return np.concatenate([*seen, moved[None, :2]])


def _input(name: str, kinds: str, make: Callable[[], Files], read: Callable[[list[Path]], np.ndarray],
           tolerance: float = 1e-9) -> Input:  # fmt: skip
    return Input(name=name, kinds=frozenset(kinds.split()), make=make, read=read, tolerance=tolerance)


INPUTS = (
    _input("agreement", "text table", agreement, read_agreement),
    _input("points", "text table", points, read_points),
    _input("batch", "text table", batch, read_batch),
    _input("ply-ascii", "text mesh ply", ply(binary=False), read_mesh, 1e-5),
    _input("ply-binary", "mesh ply", ply(binary=True), read_mesh, 1e-5),
    _input("obj", "text mesh obj", obj, read_mesh, 1e-5),
    _input("stl-ascii", "text mesh stl", stl("stl_ascii"), read_mesh, 1e-5),
    _input("stl-binary", "mesh stl", stl("stl"), read_mesh, 1e-5),
    _input("jpg", "photograph", photograph("jpg", 8), read_pixels, 0.02),
    _input("png", "photograph", photograph("png", 8), read_pixels, 1 / 250),
    _input("png-16", "photograph", photograph("png", 16), read_pixels, 1 / 250),
    _input("tif-16", "photograph", photograph("tif", 16), read_pixels, 1 / 250),
    _input("session", "text toml", session, read_session),
    _input("boundaries", "text json", drawing("boundaries", "model"), read_boundaries),
    _input("landmarks", "text json", drawing("landmarks", "nipple_left"), read_landmarks),
    _input("cameras-json", "text json cameras rig", camera_files("json"), read_cameras),
    _input("opencv", "text yaml cameras rig", camera_files("opencv"), read_cameras),
    _input("colmap", "text cameras rig", camera_files("colmap"), read_cameras),
    _input("kalibr", "text yaml cameras rig", camera_files("kalibr"), read_cameras),
    _input("agisoft", "text xml cameras", agisoft, read_cameras),
    _input("halcon", "text cameras", halcon, read_cameras),
    _input("matlab", "cameras", matlab, read_cameras),
)
