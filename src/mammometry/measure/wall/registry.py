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
"""Closes a breast that was cut out. Raises a MeasureError if the wall does not fit it."""
DEFAULT = "default"
"""The setting that leaves the choice of the wall to the subject."""
_LAST = 100  # place of a wall that names none: after all that do
_USUAL_BASE_CM2 = 170.0  # of the real women on whom walls were tried
_UNTRIED_MM = 9.5  # of a wall that was not tried on real women: the worst of those that were (docs/decisions/0029)


@dataclass(frozen=True, slots=True, kw_only=True)
class WallModel:
    """One way to close a breast."""

    close: Close
    definition: str
    """One sentence that says what surface it is. Goes into every result."""
    place: int = _LAST
    """Order among a breast's walls in results, lowest first. The first one is the default."""
    sees_the_chest: bool = True
    """Whether it follows the chest. If not, it runs straight behind a torso's breast and overestimates it."""
    measured: bool = False
    """Whether it was measured separately (wall.ply): then it is the default, and better known."""
    flat_u95_mm: float = _UNTRIED_MM
    """Half-width of the 95 % interval of its distance from a flat chest, mm, on 145 breasts of real women, whose bases
    have 170 cm²."""

    def off_u95_mm(self, base_cm2: float) -> float:
        """That half-width over a base of this area, mm.

        A wall errs by what the chest bends where it is not seen: the more, the wider it spans.
        """
        return self.flat_u95_mm * (base_cm2 / _USUAL_BASE_CM2) ** 0.5


_KINDS = "mammometry.measure.wall.kinds"  # a file there is a wall
TORSO_WALLS: Registry[WallModel] = Registry("chest wall", package=_KINDS)
"""Walls of a torso's breast."""
CAST_WALLS: Registry[WallModel] = Registry("wall of a cast", package=_KINDS)
"""Walls of a cast: its own base (plane or convex cylinder, as the rim shows) and others."""


def add_wall(
    *registries: Registry[WallModel],
    name: str,
    definition: str,
    place: int = _LAST,
    sees_the_chest: bool = True,
    measured: bool = False,
    flat_u95_mm: float = _UNTRIED_MM,
) -> Callable[[Close], Close]:
    """Register a function that closes a breast as a wall. The facts are those of `WallModel`."""

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
    """Names of the walls as results list them, the default first."""
    return sorted(walls, key=lambda name: (walls[name].place, name))


def check_wall(name: str) -> None:
    """Refuse a wall that closes neither torsos nor casts.

    Raises:
        SettingsError: it lists the known ones.
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
