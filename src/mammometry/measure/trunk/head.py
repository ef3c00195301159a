"""Find which end of the trunk is the head's, by the body itself.

Four signs, each between −1 and 1 at most, and each with the other sign once the body is turned over. None of them holds
for every body: arms that hang are seen at all heights, and mounds are as full above as below. So they are added.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mammometry.base.errors import MeasureError
from mammometry.geometry.arrays import Array, Float64
from mammometry.measure.trunk.thorax import ARM, Skin, Trunk

_SHOULDERS = (ARM, 1.7)  # half widths from the axis at which arms leave the trunk; chosen by eye
_FEWEST = 200  # samples of skin for a sign to say anything
_LEAST_ARMS = 0.05
"""Share of all skin seen, below which it is no arm: a shelf beside a body without arms gave .015, arms .10 to .17."""
_CLEAR_SHOULDERS = 0.6
"""Balance of that skin below which it says nothing: arms that hang are seen at all heights (−.7 to .6 on upright
bodies); raised ones, or on a frame, gave .7 to 1."""
_FLANK_DEG, _FLANK = (65.0, 115.0), (0.75, ARM)
"""Skin that faces aside (degrees from straight ahead) this many half widths from the axis is the trunk's flank."""
_FLANK_MM = 200.0  # flanks are looked at this far up and down at most; chosen by eye
_AHEAD, _LAST = 0.5, 0.005
"""Skin within this share of the half width shows how far up and down pictures reach, but for this share of it."""
_MIDLINE_MM, _BIN_MM = 20.0, 10.0  # half width of the strip along the midline, and height of its parts; chosen by eye
_FRONT_MM = (40.0, 230.0)  # heights above and below the breasts at which the strip is compared; chosen by eye
_FEWEST_IN_BIN, _FEWEST_BINS = 5, 5  # samples of a part, and parts seen both above and below
_SLOPE = 0.2  # sine of the mean slope at which the strip says all it can; upright bodies have −.04 to 1
_FRONT_SHARE = 0.5
"""What the strip says at most: half of the others. A chest that stands out over a flat belly slopes as much below as
above (an independent renderer's body: −.1)."""
_SHOWN = 0.5
"""Sum of the signs above which the body shows the head up, and below whose opposite it contradicts the cameras
(docs/decisions/0026)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class HeadSigns:
    """Signs of the head on the body, each from −1 (at the other end) to 1. 0 says nothing."""

    arms: float
    """Arms leave the trunk at the head's end."""
    breasts: float
    """A breast is fuller and its crease sharper at the feet's end."""
    flanks: float
    """The trunk's own sides are seen from the armpits to the feet's end. Arms cover them at the head's."""
    front: float
    """The breastbone and what lies above slope back towards the neck. The belly slopes less, or forwards. Between −.5
    and .5."""

    @property
    def together(self) -> float:
        """Sum of all."""
        return self.arms + self.breasts + self.flanks + self.front

    def words(self) -> str:
        """The signs that say something, a clause."""
        reasons = []
        if self.arms:
            share = 50 * (1 + abs(self.arms))
            reasons.append(f"{share:.0f} % of the skin where arms leave the trunk is {_end(self.arms)}")
        if self.breasts:
            reasons.append(f"the breasts are fuller {_end(-self.breasts)}")
        if self.flanks:
            reasons.append(f"the trunk's sides are seen more {_end(-self.flanks)}")
        if self.front:
            reasons.append(f"the chest slopes back {_end(self.front)}")
        return " and ".join(reasons)


@dataclass(frozen=True, slots=True)
class HeadPlace:
    """Result of `check_head`."""

    words: str
    """What the body shows, a clause."""
    is_shown: bool = True
    """Whether the body shows its head, or the user stated it. False: left and right depend on the cameras' mounting."""


def head_signs(skin: Skin, trunk: Trunk, fuller_below: Sequence[float]) -> HeadSigns:
    """Ask the body where its head is.

    Args:
        skin: what was seen of the torso.
        trunk: its axis, at the height of the breasts.
        fuller_below: for each breast that was found, how much fuller and sharper its lower end is, −1 to 1. The one
            that says most counts: a mound beside it says nothing.
    """
    local = (skin.points_world - trunk.origin) @ trunk.frame.T
    normals = skin.normals_world @ trunk.frame.T
    return HeadSigns(
        arms=_arms(local, trunk),
        breasts=float(max(fuller_below, key=abs, default=0.0)),
        flanks=_flanks(local, normals, trunk),
        front=_front(local, normals),
    )


def check_head(signs: HeadSigns, *, stated: bool = False) -> HeadPlace:
    """Compare where the head is said to be with what the body shows.

    A contradiction is refused, never swapped. The user's own word counts more than the signs.

    Args:
        signs: of the body.
        stated: whether the user said where the head is.

    Raises:
        MeasureError: the body shows the head at the other end.
    """
    words = signs.words()
    if stated and signs.together < _SHOWN:
        unlike = f", though {words}" if signs.together < -_SHOWN else ""
        return HeadPlace(f"the head is where it was said to be{unlike}")
    if signs.together < -_SHOWN:
        raise MeasureError(
            "torso",
            found=f"the head at the lower end: {words}",
            expected="an upright patient, head up",
            remedy='Say in session.toml how the cameras are mounted, for example rig.mounting = "upside-down"; '
            "otherwise left and right are exchanged",
            mesh_remedy="Say which of the file's axes points to the head: --head -y, for example; otherwise left and "
            "right are exchanged",
        )
    if signs.together < _SHOWN:
        unsure = f" ({words})" if words else ""
        return HeadPlace(f"the body does not show where the head is{unsure}: it is taken as given", is_shown=False)
    return HeadPlace(f"the body shows the head up: {words}")


def _end(above: float) -> str:
    return "above" if above > 0 else "below"


def _arms(local: Float64[Array, "n 3"], trunk: Trunk) -> float:
    """Share of the skin where arms leave the trunk above the middle, less that below.

    0 if no such skin was seen, or nearly as much at either end, as with arms that hang.
    """
    near, far = _SHOULDERS
    aside = np.abs(local[:, 0]) / trunk.half_width_mm
    heights = local[(aside > near) & (aside < far), 1]
    balance = float(np.sign(heights).mean()) if len(heights) >= max(_FEWEST, _LEAST_ARMS * len(local)) else 0.0
    return balance if abs(balance) >= _CLEAR_SHOULDERS else 0.0


def _flanks(local: Float64[Array, "n 3"], normals: Float64[Array, "n 3"], trunk: Trunk) -> float:
    """Share of the flanks' skin below the middle, less that above. The mean of those sides that were seen.

    Only as far up and down as the trunk's front was seen at both ends: where pictures end shows no head.
    """
    front = local[(np.abs(local[:, 0]) < _AHEAD * trunk.half_width_mm) & (local[:, 2] > 0), 1]
    if len(front) < _FEWEST:
        return 0.0
    low, high = np.quantile(front, (_LAST, 1 - _LAST))
    reach = min(_FLANK_MM, -float(low), float(high))
    aside = np.abs(local[:, 0]) / trunk.half_width_mm
    turned_deg = np.abs(np.rad2deg(np.arctan2(normals[:, 0], normals[:, 2])))
    flank = (turned_deg > _FLANK_DEG[0]) & (turned_deg < _FLANK_DEG[1]) & (aside > _FLANK[0]) & (aside < _FLANK[1])
    flank &= (normals[:, 0] * local[:, 0] > 0) & (np.abs(local[:, 1]) < reach)
    sides = [local[flank & (sign * local[:, 0] > 0), 1] for sign in (1, -1)]
    balances = [-float(np.sign(side).mean()) for side in sides if len(side) >= _FEWEST]
    return float(np.mean(balances)) if balances else 0.0


def _front(local: Float64[Array, "n 3"], normals: Float64[Array, "n 3"]) -> float:
    """Excess of the midline's skin that faces the head above the middle over what faces the feet below.

    Parts of the strip are compared with those as far below, so that it does not matter how much was pictured.
    """
    midline = (np.abs(local[:, 0]) < _MIDLINE_MM) & (local[:, 2] > 0) & (normals[:, 2] > 0)
    part = np.round(local[midline, 1] / _BIN_MM).astype(int)
    first, last = (round(height / _BIN_MM) for height in _FRONT_MM)
    within = np.abs(part) <= last
    count = np.bincount(part[within] + last, minlength=2 * last + 1)
    upwards = np.bincount(part[within] + last, normals[midline, 1][within], minlength=2 * last + 1) / np.maximum(
        count, 1
    )
    steps = np.arange(first, last + 1)
    both = np.minimum(count[last + steps], count[last - steps]) >= _FEWEST_IN_BIN
    if both.sum() < _FEWEST_BINS:
        return 0.0
    slope = (upwards[last + steps] + upwards[last - steps])[both].mean()
    return _FRONT_SHARE * float(np.clip(slope / _SLOPE, -1.0, 1.0))
