"""Casts of 60 to 900 cc on plain, speckled and patterned boards: their outlines, and their volumes.

    python -m benchmarks.accuracy.boards [--volumes] [--scale 0.12] [--out build/boards]

photographs each cast with all eight cameras of the reference rig and finds its outlines by the true cameras. "Lost" and
"gained" are shares of the true silhouette's area, of the worst camera; "doubted" is the number of outlines that are not
used. With --volumes each session is calibrated and measured as well. What is in --out is not simulated again.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from mammometry.api.job import open_session
from mammometry.base.errors import MammometryError
from mammometry.geometry.arrays import Array, Bool
from mammometry.geometry.camera import Rig
from mammometry.io.photographs.images import read_photograph
from mammometry.io.truth import read_truth
from mammometry.matching.foreground.all_cameras import find_subjects
from mammometry.matching.foreground.foreground import estimate_foreground
from mammometry.simulate.recipe import SessionRecipe, parse_situation
from mammometry.simulate.rigs.build import build_rig, pairs_of
from mammometry.simulate.rigs.rig_file import find_plan
from mammometry.simulate.session import write_session
from mammometry.study.evaluation import Truth
from mammometry.study.rays import RayScene, pixel_grid

VOLUMES_CC = (60, 100, 250, 500, 900)
TEXTURES = ("plain", "speckled", "patterned")
_TARGET_MIDDLE = np.array([[175.0, 125.0, 0.0]])
"""Of the reference target, 14 × 10 squares of 25 mm, in its own frame, mm."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Outlines:
    """How well a capture's outlines were found."""

    doubts: dict[str, str]
    lost_percent: float
    gained_percent: float


def recipe(volume_cc: int, texture: str, scale: float, *, rig: str = "reference", poses: int = 8) -> SessionRecipe:
    """A cast on a board."""
    situation = parse_situation(f"board={texture}")
    subject = f"plaster_{volume_cc}cc"
    return SessionRecipe(rig=rig, subject=subject, seed=volume_cc, scale=scale, poses=poses, situation=situation)


def outlines(session: Path, wanted: SessionRecipe) -> Outlines:
    """Find the subject in a session's photographs by its true cameras, and compare with the true silhouettes."""
    plan, pairs = find_plan(wanted.rig)
    names = build_rig(plan, wanted.scale, wanted.seed)
    truth = read_truth(session / "truth", (pairs_of(names, pairs) if pairs else names).pair_names)
    rig = with_target(truth)
    shots = {name: read_photograph(next((session / "capture").glob(f"{name}.*")), name) for name in rig.cameras}
    found = find_subjects(rig, shots)
    scene = RayScene(truth.mesh)
    lost, gained = [0.0], [0.0]
    for name, blocks in found.blocks.items():
        camera = rig.cameras[name]
        mask = estimate_foreground(shots[name], name, subject=blocks).mask
        true: Bool[Array, "h w"] = scene.cast(camera.centre_world, camera.rays_world(pixel_grid(camera))).hit
        lost.append(100 * float((true & ~mask).sum() / true.sum()))
        gained.append(100 * float((mask & ~true).sum() / true.sum()))
    return Outlines(doubts=dict(found.doubts), lost_percent=max(lost), gained_percent=max(gained))


def with_target(truth: Truth) -> Rig:
    """The true cameras, and where the target was held, as a calibration knows it."""
    middles = [pose.apply(_TARGET_MIDDLE)[0] for pose in truth.rig_from_target.values()]
    return replace(truth.rig, target_middle_world=np.median(middles, axis=0))


def volume(session: Path) -> str:
    """Calibrate and measure a session: its volume with interval, or the refusal."""
    try:
        measured = open_session(session).measure()["model"]
    except MammometryError as error:
        return f"refused: {error}"
    if measured.interval_cc is None:
        return f"{measured.volume_cc:.1f}"
    low, high = measured.interval_cc
    return f"{measured.volume_cc:.1f} ({low:.1f} … {high:.1f})"


def rows(arguments: argparse.Namespace) -> Iterator[dict[str, object]]:
    """One row a capture."""
    for volume_cc in arguments.cc:
        for texture in arguments.textures:
            wanted = recipe(volume_cc, texture, arguments.scale)
            session = arguments.out / f"{volume_cc}-{texture}-{arguments.scale:g}"
            if not session.exists():
                write_session(session, wanted)
            found = outlines(session, wanted)
            row: dict[str, object] = {
                "true cc": volume_cc,
                "board": texture,
                "doubted": len(found.doubts),
                "lost %": round(found.lost_percent, 1),
                "gained %": round(found.gained_percent, 1),
            }
            if arguments.volumes:
                row["measured cc"] = volume(session)
            yield row


def main() -> None:
    """Print a row a capture; write JSON where asked."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--cc", type=int, nargs="*", default=VOLUMES_CC, help="volumes of the casts")
    parser.add_argument("--textures", nargs="*", default=TEXTURES, help="of the boards")
    parser.add_argument("--scale", type=float, default=0.12)
    parser.add_argument("--volumes", action="store_true", help="calibrate and measure, too")
    parser.add_argument("--out", type=Path, default=Path("build/boards"), help="where sessions are kept")
    parser.add_argument("--json", type=Path, help="write the figures there")
    arguments = parser.parse_args()
    made: list[dict[str, object]] = []
    for row in rows(arguments):
        if not made:
            print("| " + " | ".join(row) + " |\n" + "| --- " * len(row) + "|")
        made.append(row)
        print("| " + " | ".join(map(str, row.values())) + " |", flush=True)
    if arguments.json:
        arguments.json.write_text(json.dumps(made, indent=1))


if __name__ == "__main__":
    main()
