"""Difference of two volumes, with its own interval.

Left with right, or before with after. Both volumes are made from one capture or of one breast, and share errors: one
target's scale, one scanner's or matching's bias, one trunk, the form of one chest, motions of one body. Errors that
both share act by the difference of their signed effects, so that they cancel as far as the effects are alike. The
others add up (root of the sum of squares). Whether the difference is then better known than either volume depends on
how much of the errors is shared. That of a border that a person drew is not (docs/decisions/0046).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import zip_longest
from typing import Literal, TypeAlias

import numpy as np

from mammometry.base.value import value
from mammometry.measure.volume.measurement import VolumeMeasurement
from mammometry.measure.volume.sources import AXIS, SCALE, WALL, WALL_FIT_U95_MM, WALL_SAME_POSE_U95_MM

Pairing: TypeAlias = Literal["sides", "same pose", "across poses"]
"""What is compared: both sides of one capture, or one breast in two captures, standing alike or differently."""
_UNSHARED_MM: Mapping[Pairing, float] = {"same pose": WALL_SAME_POSE_U95_MM / 2**0.5, "across poses": WALL_FIT_U95_MM}
"""Half-width of what one breast's wall at one date does not share with that at another, mm."""


@value
class VolumeDifference:
    """Difference and ratio of two volumes, with 95 % intervals."""

    first: str
    """Name of the minuend: "left", or the later session."""
    second: str
    """Name of the subtrahend: "right", or the earlier session."""
    pairing: Pairing
    """What is compared. Decides how much of the wall's error is shared."""
    difference_cc: float
    """First − second, cc."""
    difference_interval_cc: tuple[float, float] | None
    """95 % interval of the difference, cc. None if one of the volumes has none."""
    ratio: float
    """First / second."""
    ratio_interval: tuple[float, float] | None
    """95 % interval of the ratio, symmetric in its logarithm. None if one of the volumes has none."""
    terms_cc: Mapping[str, float]
    """Half-width at 95 % that each named source contributes to the difference, cc. Empty without an interval."""
    note: str
    """What the interval covers and which shared errors it leaves out, one sentence."""

    @property
    def beyond_error(self) -> bool | None:
        """Whether the difference's 95 % interval leaves out zero. None without an interval."""
        if self.difference_interval_cc is None:
            return None
        low, high = self.difference_interval_cc
        return low > 0 or high < 0


def difference(
    first: VolumeMeasurement,
    second: VolumeMeasurement,
    pairing: Pairing,
    *,
    names: tuple[str, str] | None = None,
    common_scale: bool = True,
) -> VolumeDifference:
    """Compare two volumes.

    Linear theory. Of both sides of one capture, every source's common errors have signed effects c₁ and c₂ on the
    volumes (`VolumeMeasurement.common_cc`), and what is each volume's own is r₁ and r₂, so that the source contributes
    √(|c₁ − c₂|² + r₁² + r₂²). Of one breast in two captures, scale and an assumed axis are common so, and walls of one
    kind over base areas A contribute w·√(A₁² + A₂²), where w is what one date's wall does not share with the other's.
    Everything else counts in full on either side. ln(V₁/V₂) likewise, with every effect divided by its volume.

    Args:
        first: minuend, a `VolumeMeasurement`.
        second: subtrahend.
        pairing: both sides of one capture, or one breast in two captures.
        names: what to call the two, instead of the breasts' own names.
        common_scale: whether both depend on one target that was measured once; else each has a scale of its own.
    """
    called = names or (first.name, second.name)
    gap, ratio = first.volume_cc - second.volume_cc, first.volume_cc / second.volume_cc
    if first.interval_cc is None or second.interval_cc is None:
        return VolumeDifference(
            first=called[0], second=called[1], pairing=pairing, difference_cc=gap, difference_interval_cc=None,
            ratio=ratio, ratio_interval=None, terms_cc={},
            note="There is no interval, because one of the volumes has none.",
        )  # fmt: skip
    alike = first.wall_kind == second.wall_kind
    terms: dict[str, float] = {}
    relative: dict[str, float] = {}
    for name in {**first.interval_terms_cc, **second.interval_terms_cc}:
        common = _is_common(name, pairing, alike=alike, common_scale=common_scale)
        effects = [_effect(measured, name, common=common) for measured in (first, second)]
        if name == WALL and alike and pairing != "sides":
            areas_cm2 = (first.base_area_cm2, second.base_area_cm2)
            # Walls that are known better by themselves (measured ones) are no worse together.
            effects = [
                _Effect(common_cc=(), own_cc=min(_UNSHARED_MM[pairing] * area_cm2 / 10, effect.own_cc))
                for area_cm2, effect in zip(areas_cm2, effects, strict=True)
            ]
        terms[name] = _half_width(effects, (1.0, 1.0))
        relative[name] = _half_width(effects, (first.volume_cc, second.volume_cc))
    half = float(np.sqrt(sum(term**2 for term in terms.values())))
    log_half = float(np.sqrt(sum(term**2 for term in relative.values())))
    shared = [name for name in terms if _is_common(name, pairing, alike=alike, common_scale=common_scale)]
    shared = [name for name in shared if first.common_cc.get(name) and second.common_cc.get(name)]
    if alike and pairing != "sides" and WALL in terms:
        shared.append(WALL)
    note = f"The interval of the difference covers {', '.join(terms)}."
    if shared:
        note += f" What both volumes share of {', '.join(shared)} cancels out."
    if not alike:
        note += (
            f" The chest walls are of two kinds ({first.wall_kind}, {second.wall_kind}), so their errors do not cancel."
        )
    return VolumeDifference(
        first=called[0],
        second=called[1],
        pairing=pairing,
        difference_cc=gap,
        difference_interval_cc=(gap - half, gap + half),
        ratio=ratio,
        ratio_interval=(float(ratio * np.exp(-log_half)), float(ratio * np.exp(log_half))),
        terms_cc=terms,
        note=note,
    )


def _is_common(name: str, pairing: Pairing, *, alike: bool, common_scale: bool) -> bool:
    """Whether a source of error is one and the same for both volumes, so far as it is common at all."""
    if name == SCALE:
        return common_scale
    if name in (AXIS, WALL) and not alike:
        return False
    return pairing == "sides" or name == AXIS


@dataclass(frozen=True, slots=True, kw_only=True)
class _Effect:
    """How one source of error acts on one volume, cc at 95 %."""

    common_cc: tuple[float, ...]
    """Signed, by each error that the other volume has too."""
    own_cc: float
    """By what is this volume's own."""


def _effect(measured: VolumeMeasurement, name: str, *, common: bool) -> _Effect:
    term_cc = measured.interval_terms_cc.get(name, 0.0)
    common_cc = measured.common_cc.get(name, ()) if common else ()
    own_cc2 = term_cc**2 - sum(effect_cc**2 for effect_cc in common_cc)
    return _Effect(common_cc=common_cc, own_cc=max(own_cc2, 0.0) ** 0.5)


def _half_width(effects: Sequence[_Effect], over: tuple[float, float]) -> float:
    """Half-width of the difference of two volumes, each divided by a number, by one source."""
    first, second = effects
    common = [
        one / over[0] - other / over[1] for one, other in zip_longest(first.common_cc, second.common_cc, fillvalue=0.0)
    ]
    return float(np.linalg.norm([*common, first.own_cc / over[0], second.own_cc / over[1]]))
