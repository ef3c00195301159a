"""Sixty varied simulated captures, made once, from photographs to the repaired surface.

Each rig is calibrated once and takes five captures, as a rig is used. Rigs, their errors and their photographs of the
target differ, some lack a pair or two, so that much of a cast stays unseen; casts have flat and curved backs, breasts
are small and large; textures, skins and noise vary. What lies in the folder already is not made again: intervals are
compared on the very same captures. Later ones are held out, with seeds, torsos and rigs (`rigs/`) of their own: 61 to
100 by a row and a cross, measured before some constants were changed; from 101 on by an arc and a ring. From 201 on
every family of subjects takes its turn, women among them: 201 to 230 were developed on, later ones are held out.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from threadpoolctl import threadpool_limits

from mammometry.api.job import Job, open_session
from mammometry.base.errors import MammometryError
from mammometry.job.stages import measure, surface
from mammometry.measure.volume.measurement import VolumeMeasurement
from mammometry.settings import Settings
from mammometry.simulate.recipe import SessionRecipe
from mammometry.simulate.rendering.film import Film
from mammometry.simulate.rendering.skin import make_skin
from mammometry.simulate.session import write_session
from mammometry.simulate.studio import Studio

_PER_RIG = 5
CHOSEN_ON = 20
"""Up to this number they chose the interval's constants; the others are to judge it."""
_FIRST_SEED = 100
_PAIRS = {
    2: "reference:front,left,right",
    5: "reference:front,floor",
    8: "reference:front,floor",
    9: "reference:left,right",
}
"""Rigs that lack pairs, by their number; the others have all four."""
_OTHER_RIGS = {200: ("arc", "reference", "ring", "row"), 100: ("arc", "ring"), 60: ("row", "cross")}
"""After that number these rigs take the captures, in turn; the largest number that is passed counts."""
_ALL_FAMILIES_AFTER = 200
_FAMILIES = ("plaster", "torso", "woman", "leaning-woman", "woman-wide", "leaning-woman-wide")
_HELD_OUT_WOMEN = 2000
"""Their numbers are this one and the capture's: from 1000 on no woman is developed on elsewhere."""
_SKINS = ("skin", "dark-skin", "pale-skin", "sweat")
_CONTRASTS = (None, 0.02, 0.08)
_NOISE = (1.0, 0.5, 2.0, 1.5)
_PIXELS_A_CUBE, _USUAL_CUBE_MM = 0.125, 0.7
"""Cubes' edge, mm, times the scale of the pictures; only pictures so small that this is wider than a torso's usual."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Recipe:
    """One capture."""

    number: int
    """1, 2, …"""
    rig: int
    """0, 1, …: which rig takes it."""
    seed: int
    """Of all that is drawn."""
    plan: str
    """The reference rig, a part of it, or a rig's file."""
    subject: str
    """As the simulator calls it."""
    skin: str
    contrast: float | None
    noise: float

    @property
    def name(self) -> str:
        """Of its folder."""
        return f"{self.number:03d}-{self.subject}"


def recipe(number: int) -> Recipe:
    """What the capture of that number, from 1 on, is of."""
    rig = (number - 1) // _PER_RIG
    plan = _plan(number, rig)
    subject = _subject(number, plan)
    cast = subject.startswith("plaster")
    return Recipe(
        number=number,
        rig=rig,
        seed=_FIRST_SEED + rig,
        plan=plan,
        subject=subject,
        skin="plaster" if cast else _SKINS[number // 2 % len(_SKINS)],
        contrast=_CONTRASTS[number % len(_CONTRASTS)] if cast else None,
        noise=_NOISE[rig % len(_NOISE)],
    )


def _poses(wanted: Recipe) -> int:
    """Photographs of the target: eight were too few for one in six of the early rigs' focal lengths."""
    return 12 if wanted.number > _ALL_FAMILIES_AFTER else 8


def _subject(number: int, plan: str) -> str:
    if number > _ALL_FAMILIES_AFTER:
        family = _FAMILIES[number % len(_FAMILIES)]
        of_it = {"plaster": number // len(_FAMILIES) % 9 + 1, "torso": number}
        return f"{family}_{of_it.get(family, _HELD_OUT_WOMEN + number)}"
    # By two pairs from the front a trunk's sides are not seen.
    if number % 2 == 1 or plan == "reference:front,floor":
        return f"plaster_{(number // 2) % 9 + 1}"
    return f"torso_{number // 2}"


def _plan(number: int, rig: int) -> str:
    for after, names in _OTHER_RIGS.items():
        if number > after:
            name = names[rig % len(names)]
            return name if name == "reference" else str(Path(__file__).parent / "rigs" / f"{name}.toml")
    return _PAIRS.get(rig, "reference")


def in_rounds(count: int, first: int = 1) -> tuple[list[int], list[int]]:
    """Numbers of the captures that photograph their rig's target, and of those that take it over from them."""
    numbers = range(first, first + count)
    opening = [number for number in numbers if (number - 1) % _PER_RIG == 0]
    return opening, [number for number in numbers if number not in opening]


def made(wanted: Recipe, out: Path, scale: float) -> tuple[Path, str | None]:
    """Simulate a session and find its surface, unless it is there.

    Returns:
        The session, and why it was refused, or None.
    """
    session, ready = out / wanted.name, out / f".{wanted.name}.ready"
    if not ready.exists():
        _photograph(session, wanted, scale, out / recipe(wanted.rig * _PER_RIG + 1).name)
        ready.write_text(_find_surface(session, scale) or "")
    return session, ready.read_text() or None


def _photograph(session: Path, wanted: Recipe, scale: float, first: Path) -> None:
    """Simulate one session; all but a rig's first take over the photographs of its target, and what came of them."""
    shutil.rmtree(session, ignore_errors=True)
    write_session(
        session,
        SessionRecipe(
            rig=wanted.plan,
            subject=wanted.subject,
            scale=scale,
            seed=wanted.seed,
            poses=_poses(wanted) if session == first else 1,
        ),
        Studio(skin=make_skin(wanted.skin, contrast=wanted.contrast), film=Film().with_noise(wanted.noise)),
    )
    if session != first:
        take_over_calibration(session, first)


def take_over_calibration(session: Path, first: Path) -> None:
    """Give a session another one's photographs of the target, and what came of them: the rig was calibrated once."""
    shutil.rmtree(session / "calibration")
    shutil.copytree(first / "calibration", session / "calibration", copy_function=os.link)
    shutil.copytree(first / "results" / "calibrate", session / "results" / "calibrate", dirs_exist_ok=True)


def _find_surface(session: Path, scale: float) -> str | None:
    """From the photographs to the repaired surface; why there is none. What takes much room is then thrown away."""
    job = _job(session, scale)
    refused = None
    with job.store.taken(), threadpool_limits(limits=1, user_api="blas"):
        try:
            job.plan.ensure("calibrate")
            job.plan[surface.repaired].ensure()
        except MammometryError as error:
            refused = str(error)
    for folder in ("match/disparity", "surface/range"):
        shutil.rmtree(session / "results" / folder, ignore_errors=True)  # where it was refused there is none
    return refused


def measured(session: Path, scale: float) -> tuple[tuple[VolumeMeasurement, ...], Mapping[str, str]]:
    """Measure a capture's surface as `mammometry measure` does.

    Returns:
        Volumes, and side → why it has none.

    Raises:
        MammometryError: nothing can be measured.
    """
    plan = _job(session, scale).plan
    with threadpool_limits(limits=1, user_api="blas"):
        found = plan[measure.measurements]()
        absent = plan.value(measure.absent) or ()
    return found, {side.name: side.reason.code for side in absent}


def settings_for(scale: float) -> Settings:
    """Default settings; cubes as wide as small pictures' pixels."""
    cube_mm = round(_PIXELS_A_CUBE / scale, 2)
    return Settings().overridden([f"surface.extract.cube_mm={cube_mm}"] if cube_mm > _USUAL_CUBE_MM else [])


def _job(session: Path, scale: float) -> Job:
    return open_session(session, settings_for(scale))
