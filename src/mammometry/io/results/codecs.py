"""How each kind of result lies on disk, in documented formats (docs/session-format).

====================  =========================================================================================
product               files
====================  =========================================================================================
cameras               cameras.json: per camera K, dist, R, t, image_size, std
foreground,           one float32 TIFF of several pages each (`rasters`)
disparity, range
first, repaired,      binary PLY, mm, world; provenance, sigma_mm, pairs, red, green, blue a vertex
mesh
boundaries            boundaries.json, which a session may also bring; and .npz
model                 model.glb, model.obj (.mtl, .jpg): the viewing mesh; and .npz
landmarks,            landmarks.json, symmetry.json, dimensions.json; and .npz
symmetry, dimensions
measurement           measurement.json, NAME.ply (the closed solid); and .npz
all others            .npz: arrays, and ``tree``, UTF-8 JSON that says how they belong together
====================  =========================================================================================
"""

from __future__ import annotations

import json
import struct
import zipfile
import zlib
from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mammometry.base.errors import MammometryError, StorageError
from mammometry.geometry.camera import Rig
from mammometry.geometry.mesh import TriangleMesh
from mammometry.io.cameras.own import cameras_from_table, cameras_table
from mammometry.io.meshes import read_ply, write_ply
from mammometry.io.models import write_glb, write_obj
from mammometry.io.results.rasters import read_raster, write_raster
from mammometry.io.results.tree import from_tree, to_tree
from mammometry.job.pipeline import CameraSet, FinishedSurface

_DAMAGED = (
    OSError, ValueError, LookupError, TypeError, AttributeError, ArithmeticError, EOFError, RecursionError,
    zipfile.BadZipFile, zlib.error, struct.error,
)  # fmt: skip
"""What the standard library and NumPy raise of a file that is not as it was written."""
_FORMAT = 1
_FEW = 36


def encode(value: Any, folder: Path, product: str) -> None:
    """Write a product's files into `folder`, named after the product (``disparity/front`` → disparity/front.tif).

    Raises:
        OSError: the disk refuses.
        TypeError: a value that cannot be kept.
    """
    stem = folder / product
    stem.parent.mkdir(parents=True, exist_ok=True)
    write, _, ending, _ = _CODECS[product.partition("/")[0]]
    write(stem.with_name(stem.name + ending), value)


def decode(folder: Path, product: str) -> Any:
    """Read a product back.

    Raises:
        StorageError: its files are missing or damaged.
    """
    stem = folder / product
    _, read, _, ending = _CODECS[product.partition("/")[0]]
    path = stem.with_name(stem.name + ending)
    try:
        return read(path)
    except MammometryError:
        raise
    except _DAMAGED as error:
        raise StorageError(
            path.name,
            found=f"a result that cannot be read back ({error})",
            expected="the file as it was written",
            remedy="Run the command again: it will be made anew",
        ) from None


def _write_npz(path: Path, value: Any) -> None:
    arrays: dict[str, np.ndarray[Any, Any]] = {}
    tree = json.dumps(to_tree(value, arrays)).encode()
    np.savez(path, allow_pickle=False, tree=np.frombuffer(tree, dtype=np.uint8), **arrays)


def _read_npz(path: Path) -> Any:
    with path.open("rb") as file, np.load(file, allow_pickle=False) as stored:
        arrays = {name: stored[name] for name in stored.files if name != "tree"}
        return from_tree(json.loads(stored["tree"].tobytes()), arrays)


def _write_json(path: Path, table: Mapping[str, Any]) -> None:
    path.write_text(json.dumps({"format": _FORMAT, **table}, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


def _write_cameras(path: Path, value: CameraSet) -> None:
    about = {
        "rig": value.rig.name,
        "pairs": {name: list(pair) for name, pair in value.rig.pair_names.items()},
        "world": value.world,
        "rms_px": value.rms_px,
        "verdict": value.verdict,
        "reasons": list(value.reasons),
    }
    _write_json(path, {**about, **cameras_table(value.rig.cameras, value.std)})


def _read_cameras(path: Path) -> CameraSet:
    table = json.loads(path.read_text(encoding="utf-8"))
    pairs = {name: (left, right) for name, (left, right) in table["pairs"].items()}
    rig = Rig(name=table["rig"], cameras=cameras_from_table(table, path.name), pair_names=pairs)
    std = {name: entry["std"] for name, entry in table["cameras"].items() if "std" in entry}
    return CameraSet(
        rig=rig,
        std=std,
        world=table["world"],
        rms_px=table["rms_px"],
        verdict=table["verdict"],
        reasons=tuple(table["reasons"]),
    )


def _write_mesh(path: Path, value: Any) -> None:
    """Write a bare, repaired or finished mesh; what is no number a vertex goes into a comment as JSON."""
    properties: dict[str, np.ndarray[Any, Any]] = {}
    told: dict[str, Any] = {}
    repaired = value.repaired if isinstance(value, FinishedSurface) else value
    mesh = repaired if isinstance(repaired, TriangleMesh) else repaired.mesh
    if repaired is not mesh:
        properties |= {
            "provenance": repaired.provenance, "sigma_mm": repaired.sigma_mm, "pairs": repaired.pair_bits
        }  # fmt: skip
        told = {
            "pair_names": repaired.pair_names,
            "convergence_mm": repaired.convergence.tolist(),
            "crossings": repaired.crossings,
        }
    if isinstance(value, FinishedSurface):
        colours = zip(("red", "green", "blue"), value.textured.colours.T, strict=True)
        properties |= {name: np.ascontiguousarray(channel) for name, channel in colours}
    comments = ("mm, world frame", *((f"mammometry {json.dumps(told)}",) if told else ()))
    write_ply(path, mesh, properties, comments)


def _read_mesh(path: Path) -> Any:
    mesh, properties, comments = read_ply(path)
    if "provenance" not in properties:
        return mesh
    from mammometry.surface.repair import RepairedSurface
    from mammometry.surface.texture import TexturedMesh

    (told,) = (json.loads(line.partition(" ")[2]) for line in comments if line.startswith("mammometry "))
    repaired = RepairedSurface(
        mesh=mesh,
        provenance=properties["provenance"],
        sigma_mm=properties["sigma_mm"],
        pair_bits=properties["pairs"],
        pair_names=tuple(told["pair_names"]),
        convergence=np.array(told["convergence_mm"], dtype=np.float64),
        crossings=told.get("crossings"),
    )
    if "red" not in properties:
        return repaired
    colours = np.stack([properties[name] for name in ("red", "green", "blue")], axis=1)
    return FinishedSurface(repaired=repaired, textured=TexturedMesh(mesh=mesh, colours=colours))


def _write_model(path: Path, value: Any) -> None:
    _write_npz(path.with_suffix(".npz"), value)
    write_obj(path.with_suffix(".obj"), value)
    write_glb(path, value)


def _write_boundaries(path: Path, value: Any) -> None:
    _write_npz(path.with_suffix(".npz"), value)
    table = {boundary.name: {"method": boundary.method, "points": boundary.points_world.tolist()} for boundary in value}
    _write_json(path, {"units": "mm", "frame": "world", "boundaries": table})


def _write_measurements(path: Path, value: Any) -> None:
    _write_npz(path.with_suffix(".npz"), value)
    for measured in value:
        write_ply(path.with_name(f"{measured.name}.ply"), measured.closed, comments=("mm, world frame", "closed solid"))
    _write_json(path, {"measurements": {measured.name: measurement_table(measured) for measured in value}})


def measurement_table(measured: Any) -> dict[str, Any]:
    """Numbers and sentences of a `VolumeMeasurement`, JSON-ready; its meshes and curves left out."""
    arrays: dict[str, np.ndarray[Any, Any]] = {}
    table = {}
    for name in measured.__dataclass_fields__:
        value = getattr(measured, name)
        if isinstance(value, (np.ndarray, TriangleMesh)):
            continue
        table[name] = dict(value) if isinstance(value, Mapping) else value
        to_tree(value, arrays)  # refuses what JSON could not hold
    return table


def _write_landmarks(path: Path, value: Any) -> None:
    _write_npz(path.with_suffix(".npz"), value)
    table = {
        landmark.name: {
            "method": landmark.method,
            "sigma_mm": landmark.sigma_mm,
            "points": landmark.points_world.tolist(),
        }
        for landmark in value
    }
    _write_json(path, {"units": "mm", "frame": "world", "landmarks": table})


def _write_values(path: Path, value: Any) -> None:
    """Write a value's numbers as JSON beside the whole of it; long arrays stay in the .npz."""
    _write_npz(path.with_suffix(".npz"), value)
    _write_json(path, {"units": "mm, cc, degrees", "frame": "world", path.stem: plain(value)})


def plain(value: Any) -> Any:
    """A value's numbers and words, JSON-ready; meshes and arrays of more than a few dozen numbers left out."""
    if isinstance(value, np.ndarray):
        return value.tolist()
    if is_dataclass(value):
        members = {item.name: getattr(value, item.name) for item in fields(value) if item.init}
        return {name: plain(member) for name, member in members.items() if not _long(member)}
    if isinstance(value, Mapping):
        return {name: plain(member) for name, member in value.items()}
    return [plain(member) for member in value] if isinstance(value, (tuple, list)) else value


def _long(value: Any) -> bool:
    return isinstance(value, TriangleMesh) or (isinstance(value, np.ndarray) and value.size > _FEW)


_Codec = tuple[Callable[[Path, Any], None], Callable[[Path], Any], str, str]
_NPZ: _Codec = (_write_npz, _read_npz, ".npz", ".npz")
_TIFF: _Codec = (write_raster, read_raster, ".tif", ".tif")
_PLY: _Codec = (_write_mesh, _read_mesh, ".ply", ".ply")
_CODECS: Mapping[str, _Codec] = {
    "observations": _NPZ,
    "calibration": _NPZ,
    "cameras": (_write_cameras, _read_cameras, ".json", ".json"),
    "foreground": _TIFF,
    "disparity": _TIFF,
    "range": _TIFF,
    "valid": _NPZ,
    "first": _PLY,
    "repaired": _PLY,
    "mesh": _PLY,
    "model": (_write_model, _read_npz, ".glb", ".npz"),
    "boundaries": (_write_boundaries, _read_npz, ".json", ".npz"),
    "measurement": (_write_measurements, _read_npz, ".json", ".npz"),
    "landmarks": (_write_landmarks, _read_npz, ".json", ".npz"),
    "symmetry": (_write_values, _read_npz, ".json", ".npz"),
    "dimensions": (_write_values, _read_npz, ".json", ".npz"),
}
"""Kind of product → write, read, ending that is written to, ending that is read from."""
