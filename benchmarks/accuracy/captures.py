"""Sixty simulated captures, of all that a rig may meet: made once, from photographs to the repaired surface.

Each rig is calibrated once and takes five captures, as a rig is used. Rigs, their errors and their photographs of the
target differ, some lack a pair or two, so that much of a cast stays unseen; casts have flat and curved backs, breasts
are small and large; textures, skins and noise vary. What lies in the folder already is not made again: intervals are
compared on the very same captures. Later ones are held out, with seeds, torsos and rigs (`rigs/`) of their own: 61 to
100 by a row and a cross, measured before some constants were changed; from 101 on by an arc and a ring.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from threadpoolctl import threadpool_limits

from mammometry.api.job import open_session
from mammometry.base.errors import MammometryError
from mammometry.io.manifest import read_manifest
from mammometry.io.results.codecs import decode
from mammometry.job.measuring import earlier_errors
from mammometry.measure.boundary.boundary import find_boundaries
from mammometry.measure.settings import MeasureSettings
from mammometry.measure.trunk.body import find_body, rig_frame
from mammometry.measure.volume.uncertainty import Evidence
from mammometry.measure.volume.unseen_space import bounds
from mammometry.measure.volume.volume import VolumeMeasurement
from mammometry.measure.volume.volumes import measure_volumes
from mammometry.measure.wall.open_breast import open_breasts
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
_OTHER_RIGS = {100: ("arc", "ring"), 60: ("row", "cross")}
"""After that number these rigs take the captures, in turn; the largest number that is passed counts."""
_SKINS = ("skin", "dark-skin", "pale-skin", "sweat")
_CONTRASTS = (None, 0.02, 0.08)
_NOISE = (1.0, 0.5, 2.0, 1.5)
_PIXELS_A_CUBE = 0.125
"""Cubes' edge, mm, times the scale of the pictures: the default cubes are for a quarter's pixels."""


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
    cast = number % 2 == 1 or plan == "reference:front,floor"  # by which a trunk's sides are not seen
    return Recipe(
        number=number,
        rig=rig,
        seed=_FIRST_SEED + rig,
        plan=plan,
        subject=f"plaster_{(number // 2) % 9 + 1}" if cast else f"torso_{number // 2}",
        skin="plaster" if cast else _SKINS[number // 2 % len(_SKINS)],
        contrast=_CONTRASTS[number % len(_CONTRASTS)] if cast else None,
        noise=_NOISE[rig % len(_NOISE)],
    )


def _plan(number: int, rig: int) -> str:
    for after, names in _OTHER_RIGS.items():
        if number > after:
            return str(Path(__file__).parent / "rigs" / f"{names[rig % len(names)]}.toml")
    return _PAIRS.get(rig, "reference")


def captures(count: int, out: Path, scale: float, first: int = 1) -> Iterator[tuple[Recipe, Path, str | None]]:
    """Simulate sessions and find their surfaces; what is there already is not made again.

    Yields:
        What was wanted, its session, and why it was refused where it was.
    """
    for number in range(first, first + count):
        wanted = recipe(number)
        session, ready = out / wanted.name, out / f".{wanted.name}.ready"
        if not ready.exists():
            _photograph(session, wanted, scale, out / recipe(wanted.rig * _PER_RIG + 1).name)
            ready.write_text(_find_surface(session, scale) or "")
        yield wanted, session, ready.read_text() or None


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
            poses=8 if session == first else 1,
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
    cube_mm = round(max(0.5, _PIXELS_A_CUBE / scale), 2)
    job = open_session(session, Settings().overridden([f"surface.extract.cube_mm={cube_mm}"]))
    refused = None
    with job.store.taken(), threadpool_limits(limits=1, user_api="blas"):
        try:
            job.plan.calibrated.ensure()
            job.plan.surfaced.repaired.ensure()
        except MammometryError as error:
            refused = str(error)
    for folder in ("match/disparity", "surface/range"):
        shutil.rmtree(session / "results" / folder, ignore_errors=True)  # where it was refused there is none
    return refused


def measured(session: Path) -> tuple[VolumeMeasurement, ...]:
    """Boundaries, walls, volumes and intervals of a capture's surface, by the settings and the code as they are."""
    results = session / "results"
    cameras, calibration = (decode(results / "calibrate", product) for product in ("cameras", "calibration"))
    valid, repaired = (decode(results / "surface", product) for product in ("valid", "repaired"))
    silhouettes = {name: decode(results / "match", f"foreground/{name}") for name in cameras.rig.cameras}
    settings = MeasureSettings()
    subject = read_manifest(session / "session.toml").subject
    rig, images = cameras.rig, valid.range_images
    boundaries = find_boundaries(
        repaired, silhouettes, rig, subject.kind, settings, rim_radius_mm=subject.rim_radius_mm
    )
    evidence = Evidence(views=bounds(silhouettes, images, rig, settings), earlier=earlier_errors(calibration))
    curves = [boundary.points_world for boundary in boundaries]
    torso = subject.kind == "torso"
    frame = find_body(repaired, rig_frame(rig), boundaries=curves).frame if torso else None
    return measure_volumes(open_breasts(boundaries, repaired, settings, frame=frame), evidence)
