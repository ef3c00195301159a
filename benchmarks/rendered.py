"""Sessions from the independent renderer's captures (a folder laid out as ../shared/data/rendered).

The images are linked, not copied, and `truth/` stays where it is: the session that is measured has no truth in it.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.names import known
from mammometry.geometry.transform import Transform


@dataclass(frozen=True)
class RenderedTruth:
    """What the renderer knows of one subject."""

    volumes_cc: dict[str, float]
    """Name in our results (`model`, or the patient's `left` and `right`) → true volume, cc."""
    world_from_rig: Transform
    """Our world is the board of the first pose; the renderer's truth is in its rig frame."""
    folder: Path
    """The subject's truth folder: mesh.ply, boundaries, visibility."""


def subjects(captures: Path) -> list[str]:
    """Names of the subjects that the captures hold."""
    return list(json.loads((captures / "session.json").read_text())["subjects"])


def make_session(captures: Path, subject: str, out: Path) -> Path:
    """Write a session folder for one subject: the manifest, and links to its photographs."""
    described = json.loads((captures / "session.json").read_text())
    known("subjects", [subject], sorted(path.parent.parent.name for path in captures.glob("*/truth/truth.json")))
    target = described["targets"]["charuco"]
    kind = (
        "model"
        if json.loads((captures / subject / "truth" / "truth.json").read_text())["kind"] == "plaster"
        else "torso"
    )
    pairs = ",\n  ".join(
        f'{{ name = "{name}", left = "{left}", right = "{right}" }}'
        for name, (left, right) in described["pairs"].items()
    )
    out.mkdir(parents=True, exist_ok=True)
    (out / "session.toml").write_text(
        f"""format = 1
units = "mm"
[rig]
name = "rendered"
pairs = [
  {pairs},
]
[target]
kind = "charuco"
squares = [{target["squares_x"]}, {target["squares_y"]}]
square_mm = {target["square_mm"]}
marker_mm = {target["marker_mm"]}
dictionary = "{target["dictionary"]}"
[subject]
kind = "{kind}"
"""
    )
    for link, source in (("calibration", captures / "calibration"), ("capture", captures / subject / "capture")):
        if not (out / link).exists():
            (out / link).symlink_to(source.resolve(), target_is_directory=True)
    return out


def read_truth(captures: Path, subject: str) -> RenderedTruth:
    """Read the true volumes and where the truth's frame lies in ours."""
    folder = captures / subject / "truth"
    truth = json.loads((folder / "truth.json").read_text())
    if truth["kind"] == "plaster":
        volumes = {"model": truth["volume_cc"]}
    else:
        volumes = {
            name.removeprefix("patient_"): breast["volume_cc"][breast["primary"]]
            for name, breast in truth["breasts"].items()
        }
    own = folder / "cameras.json"  # else the captures share them
    cameras = json.loads((own if own.is_file() else captures / "truth" / "cameras.json").read_text())
    rig_from_world = Transform.from_matrix(np.array(cameras["rig_from_board0"]))
    return RenderedTruth(volumes_cc=volumes, world_from_rig=rig_from_world.inverse(), folder=folder)
