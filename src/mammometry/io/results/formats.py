"""Formats of products other than .npz: tables, meshes, and images as one TIFF."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import asdict, fields, is_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mammometry.base.errors import MammometryError
from mammometry.base.machine.cores import available_cores
from mammometry.base.notices import Notice, from_table
from mammometry.base.parse import error_text
from mammometry.geometry import Rig, TriangleMesh
from mammometry.geometry.mesh_files.ply import write_ply
from mammometry.io.cameras.own import cameras_from_table, cameras_table
from mammometry.io.meshes.own import read_ply
from mammometry.io.results.codecs import (
    FORMATS,
    Format,
    from_tree,
    read_arrays,
    to_tree,
    with_json,
    write_arrays,
    write_json,
)
from mammometry.job.inputs import CameraSet, FinishedSurface
from mammometry.measure.boundary import boundary_words

if TYPE_CHECKING:
    from mammometry.measure.boundary.boundary import Boundary
    from mammometry.measure.landmarks.landmarks import Landmark
    from mammometry.measure.volume.measurement import VolumeMeasurement
    from mammometry.surface.texture.texture_atlas import Atlas


_STRIP_ROWS = 64  # rows per strip: about half a megabyte, so that the cores compress strips in parallel
_LEVEL = 1  # of deflate; level 6 saves 8 % of the bytes and takes 25 % longer
_FLOATING_POINT = 3  # predictor (TIFF Technical Note 3)
_FLAT = 2  # number of dimensions of an image with one channel
_PAGE_NAME = 285  # TIFF 6.0's tag PageName


def write_raster(path: Path, value: object) -> None:
    """Write a dataclass with images to one TIFF, losslessly compressed.

    The pages are float32 images (floating-point predictor, 3) and masks (8 bits, 0 and 1) in the order of the fields.
    Each is named after its field (PageName, tag 285), with its path if it is in a nested value. The first page's
    ImageDescription is JSON with the pages' names and the value's other members, such as cameras.

    Raises:
        ValueError: it contains no images.
    """
    import tifffile

    arrays: dict[str, np.ndarray[Any, Any]] = {}
    tree = to_tree(value, arrays)
    pages = [(name, page) for name, page in _places(tree, "") if _is_image(arrays[name])]
    if not pages:
        raise ValueError("a raster without images")
    about = {
        "pages": [{"array": name, "name": page, "dtype": arrays[name].dtype.str} for name, page in pages],
        "small": {
            name: {"dtype": array.dtype.str, "values": array.tolist()}
            for name, array in arrays.items()
            if name not in dict(pages)
        },
        "value": tree,
    }
    with tifffile.TiffWriter(path) as tiff:
        for index, (name, page) in enumerate(pages):
            array = arrays[name]
            floats = array.dtype == np.float32
            tiff.write(
                array if floats else array.astype(np.uint8),
                rowsperstrip=_STRIP_ROWS,
                photometric="minisblack",
                description=json.dumps(about) if index == 0 else None,
                extratags=[(_PAGE_NAME, 2, None, page, True)],
                metadata=None,
                compression="zlib",
                compressionargs={"level": _LEVEL},
                predictor=_FLOATING_POINT if floats else None,
                contiguous=False,
                maxworkers=available_cores(),
            )


def _places(tree: Any, place: str) -> Iterator[tuple[str, str]]:
    """Name of each array, and its path in the value, such as ``keep.0``."""
    if isinstance(tree, dict) and "$array" in tree:
        yield tree["$array"], place
    elif isinstance(tree, dict) and "$tuple" in tree:
        yield from _places(dict(enumerate(tree["$tuple"])), place)
    elif isinstance(tree, dict):
        for name, member in tree.items():
            yield from _places(member, f"{place}.{name}" if place else str(name))


def _is_image(array: np.ndarray[Any, Any]) -> bool:
    return array.ndim == _FLAT and array.dtype in (np.float32, np.bool_)


def read_raster(path: Path) -> Any:
    """Read a value written by `write_raster`.

    Raises:
        ValueError: it is not such a file.
    """
    import tifffile

    try:
        with tifffile.TiffFile(path) as tiff:
            about = json.loads(tiff.pages.first.description)
            arrays = {
                page["array"]: tiff.pages[index].asarray(maxworkers=available_cores()).astype(page["dtype"], copy=False)
                for index, page in enumerate(about["pages"])
            }
        arrays |= {name: np.array(small["values"], dtype=small["dtype"]) for name, small in about["small"].items()}
        return from_tree(about["value"], arrays)
    except (MammometryError, OSError, MemoryError):
        raise
    except Exception as error:  # tifffile raises many kinds of exceptions for damaged files
        raise ValueError(error_text(error)) from None


for _product in ("foreground", "disparity", "range", "valid"):
    FORMATS.add(_product)(Format(write=write_raster, read=read_raster, ending=".tif"))


def _boundaries_table(product: str, boundaries: tuple[Boundary, ...]) -> dict[str, Any]:
    curves = {
        curve.name: {"method": boundary_words(curve.method, curve.remarks), "points": curve.points_world.tolist()}
        for curve in boundaries
    }
    return {"units": "mm", "frame": "world", "boundaries": curves}


FORMATS.add("boundaries")(with_json(_boundaries_table))


def _cameras_write(path: Path, value: CameraSet) -> None:
    about = {
        "rig": value.rig.name,
        "pairs": {name: list(pair) for name, pair in value.rig.pair_names.items()},
        "world": value.world,
        "target_middle": None if value.rig.target_middle_world is None else value.rig.target_middle_world.tolist(),
        "rms_px": value.rms_px,
        "verdict": value.verdict,
        "reasons": list(value.reasons),
        "notices": [notice.as_table() for notice in value.notices],
    }
    write_json(path, {**about, **cameras_table(value.rig.cameras, value.std)})


def _cameras_read(path: Path) -> CameraSet:
    table = json.loads(path.read_text(encoding="utf-8"))
    pairs = {name: (left, right) for name, (left, right) in table["pairs"].items()}
    middle = table.get("target_middle")
    rig = Rig(
        name=table["rig"],
        cameras=cameras_from_table(table, path.name),
        pair_names=pairs,
        target_middle_world=None if middle is None else np.array(middle),
    )
    std = {name: entry["std"] for name, entry in table["cameras"].items() if "std" in entry}
    return CameraSet(
        rig=rig,
        std=std,
        world=table["world"],
        rms_px=table["rms_px"],
        verdict=table["verdict"],
        notices=tuple(map(from_table, table["notices"]))
        if "notices" in table
        else tuple(Notice(code="sentence", values={"text": reason}) for reason in table["reasons"]),  # from version 1.0
    )


_CAMERAS = Format(write=_cameras_write, read=_cameras_read, ending=".json")
FORMATS.add("cameras")(_CAMERAS)
FORMATS.add("stood")(_CAMERAS)


def _landmarks_table(product: str, landmarks: tuple[Landmark, ...]) -> dict[str, Any]:
    places = {
        landmark.name: {
            "method": landmark.method,
            "sigma_mm": landmark.sigma_mm,
            "probability": landmark.probability,
            "points": landmark.points_world.tolist(),
        }
        for landmark in landmarks
    }
    return {"units": "mm", "frame": "world", "landmarks": places}


FORMATS.add("landmarks")(with_json(_landmarks_table))


def _measurements_write(path: Path, measurements: tuple[VolumeMeasurement, ...]) -> None:
    write_arrays(path.with_suffix(".npz"), measurements)
    for measured in measurements:
        write_ply(path.with_name(f"{measured.name}.ply"), measured.closed, comments=("mm, world frame", "closed solid"))
    write_json(path, {"measurements": {measured.name: _measurements_table(measured) for measured in measurements}})


def _measurements_table(measured: VolumeMeasurement) -> dict[str, Any]:
    """Numbers and texts of a measurement as data for JSON, without its meshes and curves."""
    arrays: dict[str, np.ndarray[Any, Any]] = {}
    table = {}
    for name in measured.__dataclass_fields__:
        value = getattr(measured, name)
        if isinstance(value, (np.ndarray, TriangleMesh)):
            continue
        table[name] = dict(value) if isinstance(value, Mapping) else value
        if name == "definitions":
            table[name] = [asdict(item) for item in value]
        to_tree(value, arrays)  # raises an error for values that JSON cannot contain
    return table | {"boundary_method": boundary_words(measured.boundary_method, measured.boundary_remarks)}


FORMATS.add("measurement")(Format(write=_measurements_write, read=read_arrays, ending=".json", read_ending=".npz"))


def _model_write(path: Path, model: Atlas) -> None:
    # Imported here, because they import compilers that other formats do not need.
    from mammometry.io.meshes.own import write_glb, write_obj
    from mammometry.surface.texture.texture_atlas import without_picture

    write_arrays(path.with_suffix(".npz"), without_picture(model))
    write_obj(path.with_suffix(".obj"), model)
    write_glb(path, model)


def _model_read(path: Path) -> Any:
    from mammometry.surface.texture.texture_atlas import with_picture

    return with_picture(read_arrays(path))


FORMATS.add("model")(Format(write=_model_write, read=_model_read, ending=".glb", read_ending=".npz"))


_FEW = 36  # length of the longest array in the JSON (6 × 6); longer ones are only in the .npz


def _numbers_table(product: str, value: Any) -> dict[str, Any]:
    return {"units": "mm, cc, degrees", "frame": "world", product: _plain(value)}


def _plain(value: Any) -> Any:
    """Numbers and texts of a value as data for JSON, without meshes and long arrays."""
    if isinstance(value, np.ndarray):
        return value.tolist()
    if is_dataclass(value):
        members = {item.name: getattr(value, item.name) for item in fields(value) if item.init}
        return {name: _plain(member) for name, member in members.items() if not _is_long(member)}
    if isinstance(value, Mapping):
        return {name: _plain(member) for name, member in value.items()}
    return [_plain(member) for member in value] if isinstance(value, (tuple, list)) else value


def _is_long(value: Any) -> bool:
    return isinstance(value, TriangleMesh) or (isinstance(value, np.ndarray) and value.size > _FEW)


for _product in ("symmetry", "dimensions", "lacking", "body", "sides"):
    FORMATS.add(_product)(with_json(_numbers_table))


def _surfaces_write(path: Path, value: Any) -> None:
    """Write a mesh as PLY. Members other than one number per vertex become a comment in JSON."""
    properties: dict[str, np.ndarray[Any, Any]] = {}
    about: dict[str, Any] = {}
    repaired = value.repaired if isinstance(value, FinishedSurface) else value
    mesh = repaired if isinstance(repaired, TriangleMesh) else repaired.mesh
    if repaired is not mesh:
        properties |= {
            "provenance": repaired.provenance, "sigma_mm": repaired.sigma_mm, "pairs": _narrowed(repaired.pair_bits)
        }  # fmt: skip
        about = {
            "pair_names": repaired.pair_names,
            "convergence_mm": repaired.convergence.tolist(),
            "crossings": repaired.crossings,
        }
    if isinstance(value, FinishedSurface):
        colours = zip(("red", "green", "blue"), value.textured.colours.T, strict=True)
        properties |= {name: np.ascontiguousarray(channel) for name, channel in colours}
    comments = ("mm, world frame", *((f"mammometry {json.dumps(about)}",) if about else ()))
    write_ply(path, mesh, properties, comments)


def _narrowed(bits: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """Bit masks of up to eight pairs, as bytes."""
    return bits.astype(np.uint8) if bits.min(initial=0) >= 0 and bits.max(initial=0) < 1 << 8 else bits


def _surfaces_read(path: Path) -> Any:
    mesh, properties, comments = read_ply(path)
    if "provenance" not in properties:
        return mesh
    from mammometry.surface.repair.repair import RepairedSurface
    from mammometry.surface.texture.texture import TexturedMesh

    (about,) = (json.loads(line.partition(" ")[2]) for line in comments if line.startswith("mammometry "))
    repaired = RepairedSurface(
        mesh=mesh,
        provenance=properties["provenance"],
        sigma_mm=properties["sigma_mm"],
        pair_bits=properties["pairs"].astype(np.int32, copy=False),
        pair_names=tuple(about["pair_names"]),
        convergence=np.array(about["convergence_mm"], dtype=np.float64),
        crossings=about.get("crossings"),
    )
    if "red" not in properties:
        return repaired
    colours = np.stack([properties[name] for name in ("red", "green", "blue")], axis=1)
    return FinishedSurface(repaired=repaired, textured=TexturedMesh(mesh=mesh, colours=colours))


FORMATS.add("mesh")(Format(write=_surfaces_write, read=_surfaces_read, ending=".ply"))
