"""Direction of the head along the trunk, from the body itself.

Four signs, each between −1 and 1, are added. Each is reversed if the body is upside down. None of them is reliable for
every body: hanging arms are visible at all heights, and mounds are as full above as below.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mammometry.base.errors import MeasureError
from mammometry.geometry.arrays import Array, Float64
from mammometry.measure.trunk.thorax import ARM, SkinSamples, Trunk

_SHOULDERS = (ARM, 1.7)  # distances from the axis at which arms leave the trunk, in half widths; not critical
_FEWEST = 200  # fewest samples of skin for a sign
_LEAST_ARMS = 0.05
"""Least share of arms in the visible skin: a shelf beside a body without arms gave 0.015, arms 0.10 to 0.17."""
_CLEAR_SHOULDERS = 0.6
"""Least balance of that skin above and below that counts as a sign: hanging arms, visible at all heights, gave −0.7 to
0.6 on upright bodies; raised ones, or arms on a frame, 0.7 to 1."""
_FLANK_DEG, _FLANK = (65.0, 115.0), (0.75, ARM)
"""Flank: directions of the skin's normals, degrees from straight ahead, and distances from the axis, half widths."""
_FLANK_MM = 200.0  # largest height above and below the breasts of flanks; not critical
_AHEAD, _LAST = 0.5, 0.005
"""Share of the half width within which skin shows the images' upper and lower end, and the extreme share left out."""
_MIDLINE_MM, _BIN_MM = 20.0, 10.0  # half width of the strip along the midline, and height of its bins; not critical
_FRONT_MM = (40.0, 230.0)  # heights above and below the breasts at which the strip is compared; not critical
_FEWEST_IN_BIN, _FEWEST_BINS = 5, 5  # fewest samples of a bin, and fewest bins visible both above and below
_SLOPE = 0.2  # sine of the mean slope at which the strip's sign reaches its limit; upright bodies have −0.04 to 1
_FRONT_SHARE = 0.5
"""Largest sign of the strip. It is half of the others', because a chest that projects over a flat belly slopes as much
below as above (a body of an independent renderer: −0.1)."""
_SHOWN = 0.5
"""Sum of the signs from which the head is up. Below its negative, the body contradicts the cameras
(docs/decisions/0026)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class HeadSigns:
    """Signs of the head's direction, each from −1 (at the other end) to 1, or 0 if unknown."""

    arms: float
    """Arms leave the trunk at the head's end."""
    breasts: float
    """A breast is fuller and its crease sharper towards the feet."""
    flanks: float
    """The trunk's sides are visible below the armpits; above them arms cover them."""
    front: float
    """The breastbone slopes back towards the neck, the belly less or forwards. Between −0.5 and 0.5."""

    @property
    def together(self) -> float:
        """Sum of the signs."""
        return self.arms + self.breasts + self.flanks + self.front

    def words(self) -> str:
        """The signs that are not 0, as a clause."""
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
    """Result of the test, as a clause."""
    is_shown: bool = True
    """Whether the body shows the head's direction, or the user stated it. False: left and right depend on the cameras'
    mounting."""


def head_signs(skin: SkinSamples, trunk: Trunk, fuller_below: Sequence[float]) -> HeadSigns:
    """Signs of the head's direction on the body.

    Args:
        skin: the torso's visible skin.
        trunk: its axis, at the height of the breasts.
        fuller_below: inferior–superior asymmetry of each breast, −1 to 1, of which the largest is used.
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
    """Result of the comparison of the assumed head's direction with the body's signs.

    A contradiction is refused and never corrected automatically. The user's statement takes precedence.

    Args:
        signs: the body's signs.
        stated: whether the user stated the head's direction.

    Raises:
        MeasureError: the head is at the other end.
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
            remedy='State in session.toml how the cameras are mounted, for example rig.mounting = "upside-down"; '
            "otherwise left and right are swapped",
            mesh_remedy="Give the file's axis towards the head, for example --head -y; otherwise left and right are "
            "swapped",
        )
    if signs.together < _SHOWN:
        unsure = f" ({words})" if words else ""
        return HeadPlace(f"the body does not show where the head is{unsure}: it is taken as given", is_shown=False)
    return HeadPlace(f"the body shows the head up: {words}")


def _end(above: float) -> str:
    return "above" if above > 0 else "below"


def _arms(local: Float64[Array, "n 3"], trunk: Trunk) -> float:
    """Balance of the skin where arms leave the trunk: share above the middle minus share below.

    0 if there is no such skin, or nearly as much at both ends, as with hanging arms.
    """
    near, far = _SHOULDERS
    aside = np.abs(local[:, 0]) / trunk.half_width_mm
    heights = local[(aside > near) & (aside < far), 1]
    balance = float(np.sign(heights).mean()) if len(heights) >= max(_FEWEST, _LEAST_ARMS * len(local)) else 0.0
    return balance if abs(balance) >= _CLEAR_SHOULDERS else 0.0


def _flanks(local: Float64[Array, "n 3"], normals: Float64[Array, "n 3"], trunk: Trunk) -> float:
    """Balance of the flanks' skin: share below the middle minus share above, mean of the visible sides.

    Only heights at which the front is visible above and below count, so that the images' ends have no effect.
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
    """Slope of the midline's skin: towards the head above the middle, minus towards the feet below.

    Each bin of the strip is compared with the one at the same distance below.
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
