"""Difference of two volumes (left and right, or before and after), with its own interval.

The volumes share errors: the target's scale, the bias of scanner or matching, the trunk, the shape of the chest,
motions of the body. Of a shared error only the difference of its signed effects remains. All other errors add up (root
of the sum of squares). Errors of a border that a person drew are not shared (docs/decisions/0046).
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
"""Both sides of one capture, or one breast in two captures, in the same or in different poses."""
_UNSHARED_MM: Mapping[Pairing, float] = {"same pose": WALL_SAME_POSE_U95_MM / 2**0.5, "across poses": WALL_FIT_U95_MM}
"""Half-width of the error of a breast's wall that is not shared between two dates, mm."""


@value
class VolumeDifference:
    """Difference and ratio of two volumes, with 95 % intervals."""

    first: str
    """Name of the minuend: ``left``, or the later session."""
    second: str
    """Name of the subtrahend: ``right``, or the earlier session."""
    pairing: Pairing
    """It determines how much of the wall's error is shared."""
    difference_cc: float
    """First − second, cc."""
    difference_interval_cc: tuple[float, float] | None
    """95 % interval of the difference, cc. None if one of the volumes has none."""
    ratio: float
    """First / second."""
    ratio_interval: tuple[float, float] | None
    """95 % interval of the ratio, symmetric in its logarithm. None if one of the volumes has none."""
    terms_cc: Mapping[str, float]
    """Contribution of each source to the difference: half-width at 95 %, cc. Empty without an interval."""
    note: str
    """What the interval covers, and which shared errors cancel."""

    @property
    def beyond_error(self) -> bool | None:
        """Whether the 95 % interval of the difference excludes zero. None without an interval."""
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
    """Difference and ratio of two volumes, with their intervals, by linear theory.

    Both sides of one capture: common errors of a source have signed effects c₁ and c₂ on the volumes
    (`VolumeMeasurement.common_cc`), its other errors r₁ and r₂; it contributes √(|c₁ − c₂|² + r₁² + r₂²). One breast in
    two captures: the same holds for scale and an assumed axis; walls of one kind over bases A contribute
    w·√(A₁² + A₂²), where w is the error that is not shared between the dates; all other errors count in full. For
    ln(V₁/V₂) each effect is divided by its volume.

    Args:
        first: minuend, a `VolumeMeasurement`.
        second: subtrahend.
        pairing: both sides of one capture, or one breast in two captures.
        names: names of the two, instead of the breasts' own.
        common_scale: whether both depend on one measurement of the same target.
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
            # Two measured walls have smaller errors, which are kept.
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
    """Whether a source's common errors are the same for both volumes."""
    if name == SCALE:
        return common_scale
    if name in (AXIS, WALL) and not alike:
        return False
    return pairing == "sides" or name == AXIS


@dataclass(frozen=True, slots=True, kw_only=True)
class _Effect:
    """Effect of one source of error on one volume, cc at 95 %."""

    common_cc: tuple[float, ...]
    """Signed effect of each shared error."""
    own_cc: float
    """Effect of the errors that are not shared."""


def _effect(measured: VolumeMeasurement, name: str, *, common: bool) -> _Effect:
    term_cc = measured.interval_terms_cc.get(name, 0.0)
    common_cc = measured.common_cc.get(name, ()) if common else ()
    own_cc2 = term_cc**2 - sum(effect_cc**2 for effect_cc in common_cc)
    return _Effect(common_cc=common_cc, own_cc=max(own_cc2, 0.0) ** 0.5)


def _half_width(effects: Sequence[_Effect], over: tuple[float, float]) -> float:
    """One source's half-width of the difference of two volumes, each divided by a number."""
    first, second = effects
    common = [
        one / over[0] - other / over[1] for one, other in zip_longest(first.common_cc, second.common_cc, fillvalue=0.0)
    ]
    return float(np.linalg.norm([*common, first.own_cc / over[0], second.own_cc / over[1]]))
