"""Registry of disturbances.

A new one is a function in one of these files, or in a new file with one line here. Each changes one value between a
recipe and the photographs: the torso's shape, its skin, the objects around it, or how a rig or a telephone takes
pictures. Its random values depend only on the session's seed and its own name, so that removing one disturbance changes
nothing else.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, TypeAlias

import numpy as np

from mammometry.base.errors import UnknownWordError
from mammometry.base.registry import Registry
from mammometry.simulate.recipe import Disturbance, Situation

Stage: TypeAlias = Literal["patient", "skin", "thing", "shoot", "walk"]
"""Which value a disturbance changes."""
Size: TypeAlias = "float | str"


@dataclass(frozen=True, slots=True, kw_only=True)
class Number:
    """A size that is a number."""

    usual: float
    """Default size."""
    within: tuple[float, float]
    """Smallest and largest size."""
    likely: tuple[float, float] | None = None
    """Range of random sizes. None: the same as `within`."""
    unit: str = ""
    whole: bool = False
    """Whether only whole numbers are allowed."""

    def read(self, name: str, text: str) -> float:
        """Parse a size.

        Raises:
            ValueError: it is not a number in the range.
        """
        try:
            number = float(text)
        except ValueError:
            number = float("nan")
        low, high = self.within
        if not low <= number <= high:
            raise UnknownWordError(f"{name} must be between {low:g} and {high:g}", f"{text!r}")
        if self.whole and number != round(number):
            raise UnknownWordError(f"{name} must be a whole number", f"{text!r}")
        return number

    def drawn(self, rng: np.random.Generator, share: float = 1.0) -> str:
        """A random size from the lower `share` of its likely range."""
        low, high = self.likely or self.within
        number = rng.uniform(low, low + share * (high - low))
        return f"{round(number) if self.whole else number:.3g}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Word:
    """A size that is one of several words."""

    usual: str
    """Default word."""
    words: tuple[str, ...]
    unit: ClassVar[str] = ""

    def read(self, name: str, text: str) -> str:
        """Parse a word.

        Raises:
            ValueError: it is unknown.
        """
        if text not in self.words:
            raise UnknownWordError(f"{name} is one of {', '.join(self.words)}", f"{text!r}")
        return text

    def drawn(self, rng: np.random.Generator, share: float = 1.0) -> str:
        """A random word. `share` has no effect, because words have no order."""
        return str(rng.choice(self.words))


@dataclass(frozen=True, slots=True, kw_only=True)
class DisturbanceKind:
    """A kind of disturbance."""

    name: str
    stage: Stage
    what: str
    """Description for the documentation and the truth."""
    size: Number | Word
    order: int = 0
    """Order of application, lowest first: reconstructions come before the marks on them."""
    apply: Callable[..., Any]
    """Function of the value to change, the size, and a random generator. Returns the changed value."""

    def sized(self, item: Disturbance) -> Size:
        """Size of a disturbance of this kind.

        Raises:
            ValueError: the word is unknown, or the number is outside the range.
        """
        return self.size.read(self.name, item.size) if item.size else self.size.usual


DISTURBANCES: Registry[DisturbanceKind] = Registry(
    "disturbance",
    modules=tuple(
        f"mammometry.simulate.disturbances.{module}"
        for module in ("bodies", "on_skin", "surroundings", "exposures", "walks")
    ),
)
"""Name → disturbance."""


def disturbance(
    name: str, stage: Stage, what: str, size: Number | Word, *, order: int = 0
) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Decorate a function to register it as a disturbance. For the arguments see `DisturbanceKind`."""

    def enter(apply: Callable[..., Any]) -> Callable[..., Any]:
        DISTURBANCES.add(name)(DisturbanceKind(name=name, stage=stage, what=what, size=size, order=order, apply=apply))
        return apply

    return enter


def disturbed(value: Any, stage: Stage, situation: Situation, seed: int) -> Any:
    """Apply a situation's disturbances of one stage, in order and then by name.

    Raises:
        ValueError: a disturbance or its size is unknown.
    """
    wanted = {item.name: item for item in situation.disturbances}
    check(situation)
    for kind in sorted(DISTURBANCES.values(), key=lambda kind: (kind.order, kind.name)):
        if kind.name in wanted and kind.stage == stage:
            value = kind.apply(value, kind.sized(wanted[kind.name]), own_rng(seed, kind.name))
    return value


def check(situation: Situation, without: Stage | None = None) -> None:
    """Refuse unknown names and invalid sizes.

    Args:
        situation: the disturbances.
        without: a stage that does not apply: "walk" for a rig, "shoot" for a walk with a telephone.

    Raises:
        ValueError: a disturbance or its size is unknown.
    """
    known = [name for name, kind in DISTURBANCES.items() if kind.stage != without]
    for item in situation.disturbances:
        if item.name not in known:
            raise UnknownWordError(f"disturbances are {', '.join(known)}", f"{item.name!r}")
        DISTURBANCES[item.name].sized(item)


def own_rng(seed: int, name: str) -> np.random.Generator:
    """Random generator for one disturbance of one session."""
    return np.random.default_rng([seed, 95, zlib.crc32(name.encode())])


def as_truth(situation: Situation) -> list[dict[str, object]]:
    """Description of a situation in truth.json."""
    return [
        {
            "name": kind.name,
            "what": kind.what,
            "size": kind.sized(item),
            **({"unit": kind.size.unit} if kind.size.unit else {}),
            "changes": kind.stage,
        }
        for item in situation.disturbances
        for kind in (DISTURBANCES[item.name],)
    ]
