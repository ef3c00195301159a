"""Products that have a format of their own beside .npz."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, fields, is_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mammometry.geometry.camera import Rig
from mammometry.geometry.mesh import TriangleMesh
from mammometry.io.cameras.own import cameras_from_table, cameras_table
from mammometry.io.meshes.own_ply import read_ply, write_ply
from mammometry.io.results.codecs import FORMATS, Format, read_arrays, with_json, write_arrays, write_json
from mammometry.io.results.tree import to_tree
from mammometry.job.inputs import CameraSet, FinishedSurface

if TYPE_CHECKING:
    from mammometry.measure.boundary.boundary import Boundary
    from mammometry.measure.landmarks.landmarks import Landmark
    from mammometry.measure.volume.measurement import VolumeMeasurement
    from mammometry.surface.texture.texture_atlas import Atlas


def _boundaries_table(product: str, boundaries: tuple[Boundary, ...]) -> dict[str, Any]:
    curves = {curve.name: {"method": curve.method, "points": curve.points_world.tolist()} for curve in boundaries}
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
        reasons=tuple(table["reasons"]),
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
    """Numbers and sentences of a measurement, JSON-ready, without its meshes and curves."""
    arrays: dict[str, np.ndarray[Any, Any]] = {}
    table = {}
    for name in measured.__dataclass_fields__:
        value = getattr(measured, name)
        if isinstance(value, (np.ndarray, TriangleMesh)):
            continue
        table[name] = dict(value) if isinstance(value, Mapping) else value
        if name == "definitions":
            table[name] = [asdict(item) for item in value]
        to_tree(value, arrays)  # refuses what JSON could not hold
    return table


FORMATS.add("measurement")(Format(write=_measurements_write, read=read_arrays, ending=".json", read_ending=".npz"))


def _model_write(path: Path, model: Atlas) -> None:
    # They bring compilers, which reading other results need not wait for.
    from mammometry.io.meshes.models import write_glb, write_obj
    from mammometry.surface.texture.atlas_jpeg import without_picture

    write_arrays(path.with_suffix(".npz"), without_picture(model))
    write_obj(path.with_suffix(".obj"), model)
    write_glb(path, model)


def _model_read(path: Path) -> Any:
    from mammometry.surface.texture.atlas_jpeg import with_picture

    return with_picture(read_arrays(path))


FORMATS.add("model")(Format(write=_model_write, read=_model_read, ending=".glb", read_ending=".npz"))


_FEW = 36
"""Longest array written as readable numbers. Longer ones are only in the .npz. Chosen by eye."""


def _numbers_table(product: str, value: Any) -> dict[str, Any]:
    return {"units": "mm, cc, degrees", "frame": "world", product: _plain(value)}


def _plain(value: Any) -> Any:
    """Numbers and words of a value, JSON-ready, without meshes and long arrays."""
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
    """Write a bare, repaired or finished mesh.

    What is not one number per vertex goes into a comment as JSON.
    """
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
    """Numbers of up to eight pairs in one byte each."""
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
