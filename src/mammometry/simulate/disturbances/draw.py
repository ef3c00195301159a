"""Draw a patient, surroundings and cameras at random, by seed and difficulty.

The patient depends on the seed alone. The difficulty, 0 to 3, adds objects around the body and faults of the cameras.
With higher difficulty, they are more and larger. At difficulty 0, only the patient differs from a clean capture. Seeds
that leave remainder 2 when divided by 3, and all from 9000, are held out: they are measured only once, at the end, and
never used for development. All shares here are made up; no measurement uses them.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from mammometry.base.errors import UnknownWordError
from mammometry.simulate.disturbances.registry import DISTURBANCES, DisturbanceKind, Stage
from mammometry.simulate.recipe import Disturbance, Situation

OF_OTHER_CAPTURES = ("board", "grey", "lens", "soft-focus", "table")
"""Disturbances for heads, figures, casts and artefacts, which captures of a clinic do not get."""
HARDEST = 3
"""Greatest difficulty."""
_THIRD, _HELD_OUT_FROM = 3, 9000  # every third seed is held out, and all from this one on
_NOT_AT_RANDOM = ("rail", "upright")  # parts of a posing frame: at most one of them, because both would hide too much
_ROLLED = "mounted"
_ROLLED_FROM, _ROLLED_SHARE = 2, 0.2  # least difficulty at which rigs are rolled, and share of rolled rigs
# Shares below are guesses for a clinic that rebuilds breasts, not from a register.
_SIDES = {"both": 0.3, "removed": 0.27, "mound": 0.23, "flap": 0.12, "no-nipple": 0.08}


def is_held_out(seed: int) -> bool:
    """Whether a seed is reserved for the final measurement."""
    return seed % _THIRD == _THIRD - 1 or seed >= _HELD_OUT_FROM


def draw(seed: int, difficulty: int) -> Situation:
    """Draw a random situation for the torso of a seed.

    Args:
        seed: seed of the patient and the disturbances.
        difficulty: 0 to 3.

    Raises:
        ValueError: an unknown difficulty.
    """
    if not 0 <= difficulty <= HARDEST:
        raise UnknownWordError(f"the difficulty must be between 0 and {HARDEST}", difficulty)
    drawn = [*_patient(np.random.default_rng([seed, 96]))]
    if difficulty:
        rng = np.random.default_rng([seed, 97, difficulty])
        drawn += [*_things(rng, difficulty), *_faults(rng, difficulty)]
    return Situation(disturbances=tuple(drawn))


def _patient(rng: np.random.Generator) -> Iterable[Disturbance]:
    sides = str(rng.choice(list(_SIDES), p=list(_SIDES.values())))
    chance = iter(rng.random(16).tolist())
    if sides == "both":
        if next(chance) < 0.5:
            ratio = float(np.exp(rng.uniform(-np.log(5.0), np.log(5.0))))
            yield Disturbance(name="ratio", size=f"{ratio:.3g}")
    else:
        yield _sized(DISTURBANCES[sides], rng)
        if sides in ("removed", "mound") and next(chance) < 0.8:
            yield _sized(DISTURBANCES["scar"], rng, 0.5)
        if sides == "removed" and next(chance) < 0.4:
            yield _sized(DISTURBANCES["loose-skin"], rng, 0.6)
        if sides in ("mound", "flap") and next(chance) < 0.35:
            yield _sized(DISTURBANCES["new-nipple"], rng)
    shares = {
        "ptosis": 0.3,
        "build": 0.35,
        "arms": 0.6,
        "older-skin": 0.3,
        "tattoo": 0.1,
        "body-hair": 0.15,
        "wet": 0.1,
    }
    for name, share in shares.items():
        if next(chance) < share:
            yield _sized(DISTURBANCES[name], rng)
    yield _sized(DISTURBANCES["skin"], rng)


def _things(rng: np.random.Generator, difficulty: int) -> Iterable[Disturbance]:
    frame = str(rng.choice(_NOT_AT_RANDOM))
    names = [name for name in _of("thing") if name == frame or name not in _NOT_AT_RANDOM]
    number = int(rng.integers(difficulty, difficulty + 2))
    for name in sorted(rng.choice(names, size=number, replace=False).tolist()):
        yield _sized(DISTURBANCES[name], rng)


def _faults(rng: np.random.Generator, difficulty: int) -> Iterable[Disturbance]:
    names = [name for name in _of("shoot") if name != _ROLLED]
    number = int(rng.integers(difficulty, difficulty + 3))
    for name in sorted(rng.choice(names, size=number, replace=False).tolist()):
        yield _sized(DISTURBANCES[name], rng, difficulty / HARDEST)
    if difficulty >= _ROLLED_FROM and rng.random() < _ROLLED_SHARE:
        yield _sized(DISTURBANCES[_ROLLED], rng)


def _of(stage: Stage) -> list[str]:
    return [name for name, kind in DISTURBANCES.items() if kind.stage == stage and name not in OF_OTHER_CAPTURES]


def _sized(kind: DisturbanceKind, rng: np.random.Generator, share: float = 1.0) -> Disturbance:
    """A disturbance with a random size from the lower `share` of its range."""
    return Disturbance(name=kind.name, size=kind.size.drawn(rng, share))
