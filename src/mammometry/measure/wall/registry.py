"""The walls that can close a breast or a cast, by name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

from mammometry.base.errors import SettingsError
from mammometry.base.registry import Registry

if TYPE_CHECKING:
    from mammometry.measure.solid.patch import Closed
    from mammometry.measure.wall.open_breast import OpenBreast

Close: TypeAlias = "Callable[[OpenBreast], Closed]"
"""Function that closes a breast. It raises a MeasureError if the wall does not fit it."""
DEFAULT = "default"
"""Value of the setting `measure.wall` for which the wall depends on the subject."""
_LAST = 100  # place of a wall that states none: after all others
_USUAL_BASE_CM2 = 170.0  # mean area of the base of the real women on whom walls were tested
_UNTRIED_MM = 9.5  # half-width for an untested wall: that of the worst tested one (docs/decisions/0029)


@dataclass(frozen=True, slots=True, kw_only=True)
class WallModel:
    """One way to close a breast."""

    close: Close
    definition: str
    """What surface it is, in one sentence that every result contains."""
    place: int = _LAST
    """Rank among a breast's walls in results, lowest first. The first one is the default."""
    sees_the_chest: bool = True
    """Whether it follows the chest's curvature. If not, it is straight and overestimates a torso's breast."""
    measured: bool = False
    """Whether it was measured separately (wall.ply). It is then the default, with a smaller uncertainty."""
    flat_u95_mm: float = _UNTRIED_MM
    """Half-width of the 95 % interval of its distance from a flat chest, mm, on 145 breasts of real women with bases of
    170 cm²."""

    def off_u95_mm(self, base_cm2: float) -> float:
        """`flat_u95_mm` for a base of this area, mm, larger for a wider base."""
        return self.flat_u95_mm * (base_cm2 / _USUAL_BASE_CM2) ** 0.5


_KINDS = "mammometry.measure.wall.kinds"  # each file there defines walls
TORSO_WALLS: Registry[WallModel] = Registry("chest wall", package=_KINDS)
"""Walls of a torso's breast."""
CAST_WALLS: Registry[WallModel] = Registry("wall of a cast", package=_KINDS)
"""Walls of a cast: its own base (plane or convex cylinder, depending on the rim) and others."""


def add_wall(
    *registries: Registry[WallModel],
    name: str,
    definition: str,
    place: int = _LAST,
    sees_the_chest: bool = True,
    measured: bool = False,
    flat_u95_mm: float = _UNTRIED_MM,
) -> Callable[[Close], Close]:
    """Decorator that registers a function as a wall. The parameters are those of `WallModel`."""

    def enter(close: Close) -> Close:
        model = WallModel(
            close=close,
            definition=definition,
            place=place,
            sees_the_chest=sees_the_chest,
            measured=measured,
            flat_u95_mm=flat_u95_mm,
        )
        for registry in registries:
            registry.add(name)(model)
        return close

    return enter


def in_order(walls: Registry[WallModel]) -> list[str]:
    """Names of the walls in the order of results, the default first."""
    return sorted(walls, key=lambda name: (walls[name].place, name))


def check_wall(name: str) -> None:
    """Raise an error for an unknown wall.

    Raises:
        SettingsError: it lists the known walls.
    """
    if name != DEFAULT:
        known = dict.fromkeys((DEFAULT, *in_order(TORSO_WALLS), *in_order(CAST_WALLS)))
        if name not in known:
            raise SettingsError(
                "measure.wall",
                found=repr(name),
                expected=f"one of {', '.join(map(repr, known))}",
                remedy=f"The default is {DEFAULT!r}",
            )
