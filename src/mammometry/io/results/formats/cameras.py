"""Cameras: cameras.json of all cameras' K, dist, R, t, image_size and std."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from mammometry.geometry.camera import Rig
from mammometry.io.cameras.own import cameras_from_table, cameras_table
from mammometry.io.results.formats.arrays import write_json
from mammometry.io.results.formats.registry import FORMATS, Format
from mammometry.job.values import CameraSet


def _write(path: Path, value: CameraSet) -> None:
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


def _read(path: Path) -> CameraSet:
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


_CAMERAS = Format(write=_write, read=_read, ending=".json")
FORMATS.add("cameras")(_CAMERAS)
FORMATS.add("stood")(_CAMERAS)
