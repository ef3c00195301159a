"""Measurements: measurement.json, NAME.ply (the closed solid) for each breast, and .npz."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mammometry.geometry.mesh import TriangleMesh
from mammometry.io.meshes.own_ply import write_ply
from mammometry.io.results.formats.arrays import read_arrays, write_arrays, write_json
from mammometry.io.results.formats.registry import FORMATS, Format
from mammometry.io.results.tree import to_tree

if TYPE_CHECKING:
    from mammometry.measure.volume.measurement import VolumeMeasurement


def _write(path: Path, measurements: tuple[VolumeMeasurement, ...]) -> None:
    write_arrays(path.with_suffix(".npz"), measurements)
    for measured in measurements:
        write_ply(path.with_name(f"{measured.name}.ply"), measured.closed, comments=("mm, world frame", "closed solid"))
    write_json(path, {"measurements": {measured.name: _table(measured) for measured in measurements}})


def _table(measured: VolumeMeasurement) -> dict[str, Any]:
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


FORMATS.add("measurement")(Format(write=_write, read=read_arrays, ending=".json", read_ending=".npz"))
