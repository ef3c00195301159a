"""Other subjects and rooms with default settings: heads, casts and small figures.

    python -m benchmarks.accuracy.rooms --seeds 1-30 --out build/rooms
    python -m benchmarks.accuracy.rooms --held-out --seeds 1-90 --out build/rooms

Three cameras share two pairs; their optical axes cross far before or behind the subject, which stands before a pale
wall, or lies on a bright table. Or twelve cameras with given calibration stand around a dark figure of 5 cm on a bright
table. Cameras are grey or coloured, focus is soft or sharp. A capture counts as measured if most of the skin that some
pair sees is within 1 mm of the surface, and little of the surface is anything else. Seeds with a remainder of 2 after
division by 3 are held out.
"""

from __future__ import annotations

import argparse
import re
import shutil
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from benchmarks.accuracy.clinic import _numbers as numbers
from mammometry.api.job import open_session
from mammometry.base.errors import MammometryError
from mammometry.geometry.nearest import closest_on_mesh
from mammometry.geometry.transform import Transform
from mammometry.io.truth import read_truth
from mammometry.job.stages import match
from mammometry.settings import Settings
from mammometry.simulate.disturbances.draw import is_held_out
from mammometry.simulate.recipe import SessionRecipe, parse_situation
from mammometry.simulate.rendering.skin import make_skin
from mammometry.simulate.session import write_session
from mammometry.simulate.studio import Studio
from mammometry.study.rays import RayScene, seen_by_pairs
from mammometry.surface.repair.repair import Provenance

_RIGS = Path(__file__).parent / "rigs"
_POINTS = 20_000  # at which surfaces are judged, at most
_RIGHT_MM, _STRAY_MM = 1.0, 3.0  # from the truth: right; beside the subject
_COMPLETE, _STRAY = 0.6, 0.1  # of the skin that pairs see, at least; of the measured surface, at most
_CUBE_MM = 1.0
_FIGURE_CONTRAST = 0.12  # of a figure's paint: skin of a few centimetres has no texture that 640 pixels show
_PIXELS_WIDE = 0.2, 0.5
"""Scales of the rigs of three cameras and of twelve: 800 and 640 pixels."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """One capture."""

    seed: int
    rig: str
    subject: str
    skin: str
    situation: str

    @property
    def given(self) -> bool:
        """Whether the cameras come ready-made."""
        return self.rig == "around"


def case(seed: int) -> Case:
    """The capture of a seed."""
    rng = np.random.default_rng([seed, 98])
    family = seed // 3 % 4
    pale, blur = rng.uniform(0.45, 0.85), rng.choice([0.0, rng.uniform(3.0, 8.0)])
    grey = ",grey" if rng.random() < 0.5 else ""
    soft = f",soft-focus={blur:.1f}" if blur else ""
    rig = str(rng.choice(["three", "three_far"]))
    if family == 3:
        skin = str(rng.choice(["dark-skin", "skin"]))
        return Case(seed=seed, rig="around", subject="figure", skin=skin, situation=f"table={pale:.2f},grey")
    if family == 2:
        cast = f"plaster_{rng.integers(1, 10)}"
        place = str(rng.choice(["pale-wall", "table"]))
        return Case(seed=seed, rig=rig, subject=cast, skin="plaster", situation=f"{place}={pale:.2f}{grey}{soft}")
    skin = str(rng.choice(["skin", "dark-skin", "pale-skin"]))
    return Case(seed=seed, rig=rig, subject="head", skin=skin, situation=f"pale-wall={pale:.2f}{grey}{soft}")


def photographed(one: Case, session: Path) -> None:
    """Simulate a capture, unless it is there."""
    if (session / "session.toml").is_file():
        return
    shutil.rmtree(session, ignore_errors=True)
    write_session(
        session,
        SessionRecipe(
            rig=str(_RIGS / f"{one.rig}.toml"),
            subject=one.subject,
            scale=_PIXELS_WIDE[one.given],
            seed=one.seed,
            poses=1 if one.given else 9,
            situation=parse_situation(one.situation),
        ),
        Studio(skin=make_skin(one.skin, contrast=_FIGURE_CONTRAST if one.given else None)),
    )
    if one.given:
        shutil.copy(session / "truth" / "cameras.json", session / "cameras.json")
        shutil.rmtree(session / "calibration")
        manifest = session / "session.toml"
        text = re.sub(r"\[target\]\n.*?\n(?=\[)", "", manifest.read_text(encoding="utf-8"), flags=re.DOTALL)
        manifest.write_text(text, encoding="utf-8")


def judged(one: Case, out: Path, settings: Settings) -> tuple[bool, str]:
    """Measure a capture; whether it is right, and a line of the table."""
    session = out / f"{one.seed}-{one.rig}-{one.subject}"
    photographed(one, session)
    job = open_session(session, settings)
    head = f"| {one.seed} | {one.subject}, {one.skin}, {one.rig}: {one.situation} | "
    with threadpool_limits(limits=1, user_api="blas"):
        try:
            job.ensure("surface", drawn=False)
        except MammometryError as error:
            return False, f"{head}refused: {' '.join(str(error).split())[:200]} |"
    truth = read_truth(session / "truth", job.inputs.pair_names)
    finished = job.surface()
    calibration = None if one.given else job.calibration()
    worlds = [] if calibration is None else list(calibration.world_from_target)
    truth_from_world = truth.rig_from_target[worlds[0]] if worlds else Transform.identity()
    mesh = finished.repaired.mesh.transformed(truth_from_world)
    points, by_pair = seen_by_pairs(RayScene(truth.mesh), truth.rig)
    at = points[np.any(list(by_pair.values()), axis=0)]
    of_truth = closest_on_mesh(truth.mesh.vertices[at[:: max(1, len(at) // _POINTS)]], mesh).distances_mm
    measured = np.flatnonzero(finished.repaired.provenance == Provenance.MEASURED)
    of_ours = closest_on_mesh(mesh.vertices[measured[:: max(1, len(measured) // _POINTS)]], truth.mesh).distances_mm
    complete, stray = float((of_truth < _RIGHT_MM).mean()), float((of_ours > _STRAY_MM).mean())
    right = complete >= _COMPLETE and stray <= _STRAY
    blind = sum(found().everything for found in job.plan[match.foreground].values())
    found = ("right" if right else "WRONG") + (f", {blind} without silhouette" if blind else "")
    return right, f"{head}{found} | {np.median(of_truth):.2f} | {100 * complete:.0f} | {100 * stray:.1f} |"


def main() -> None:
    """Simulate, measure, print a line a capture and how many are right."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seeds", type=numbers, default=numbers("1-30"))
    parser.add_argument("--held-out", action="store_true", help="measure the held-out seeds, and no others")
    parser.add_argument("--out", type=Path, default=Path("build/rooms"))
    parser.add_argument("--set", action="append", default=[], help="a setting, as in mammometry run")
    arguments = parser.parse_args()
    settings = Settings().overridden([f"surface.extract.cube_mm={_CUBE_MM}", *arguments.set])
    print("| seed | capture | found | error, median mm | skin seen within 1 mm, % | stray, % |\n" + "| --- " * 6 + "|")
    seeds = [seed for seed in arguments.seeds if is_held_out(seed) == arguments.held_out]
    right = 0
    for seed in seeds:
        good, line = judged(case(seed), arguments.out, settings)
        right += good
        print(line, flush=True)
    print(f"\nright: {right} of {len(seeds)}")


if __name__ == "__main__":
    main()
