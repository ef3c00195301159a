"""Difference of two volumes, with its own interval.

Left with right, or before with after. That interval is far smaller than the volumes' own. Both volumes are closed by
walls of one kind, whose errors are largely alike on both sides of a trunk, and both depend on one target's scale.
Errors that they share cancel in the difference. The others stay.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal, TypeAlias

import numpy as np

from mammometry.base.value import value
from mammometry.measure.volume.measurement import VolumeMeasurement
from mammometry.measure.volume.uncertainty import (
    AXIS,
    SCALE,
    WALL,
    WALL_FIT_U95_MM,
    WALL_SAME_POSE_U95_MM,
    WALL_SIDES_U95_MM,
)

Pairing: TypeAlias = Literal["sides", "same pose", "across poses"]
"""What is compared: both sides of one capture, or one breast in two captures, standing alike or differently."""


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

    Linear theory, with V₁ − V₂ = D. A common relative error u of the scale contributes u·|D|, and so does an axis that
    is assumed for both, which have one trunk. Walls of one kind over base areas A contribute w·√(A₁² + A₂²), where w is
    the part of each wall's height that the other does not share (for one breast twice, √½ of a change's). Every other
    source counts in full on either side. ln(V₁/V₂) likewise, with each volume's share divided by the volume.

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
    volumes = np.array([first.volume_cc, second.volume_cc])
    own = [dict(measurement.interval_terms_cc) for measurement in (first, second)]
    terms: dict[str, float] = {}
    relative: dict[str, float] = {}
    for name in {**own[0], **own[1]}:
        contributions = np.array([part.get(name, 0.0) for part in own])
        # An axis that is assumed for both is off alike, since both have one trunk.
        if (name == SCALE and common_scale) or (name == AXIS and alike and contributions.min() > 0):
            terms[name], relative[name] = float((contributions / volumes).max() * abs(gap)), 0.0
        elif name == WALL and alike:
            areas = np.array([first.base_area_cm2, second.base_area_cm2]) / 10
            unshared = {
                "sides": WALL_SIDES_U95_MM,
                "same pose": WALL_SAME_POSE_U95_MM / np.sqrt(2),
                "across poses": WALL_FIT_U95_MM,
            }[pairing]
            # Walls that are known better by themselves (measured ones) are no worse together.
            terms[name] = float(min(unshared * np.hypot(*areas), np.hypot(*contributions)))
            relative[name] = float(min(unshared * np.hypot(*(areas / volumes)), np.hypot(*(contributions / volumes))))
        else:
            terms[name], relative[name] = float(np.hypot(*contributions)), float(np.hypot(*(contributions / volumes)))
    half = float(np.sqrt(sum(term**2 for term in terms.values())))
    log_half = float(np.sqrt(sum(term**2 for term in relative.values())))
    common = f"The chest walls are of two kinds ({first.wall_kind}, {second.wall_kind}), so their errors do not cancel."
    if alike:
        shared = "the chest wall's error and of the scale's error" if common_scale else "the chest wall's error"
        common = f"The part of {shared} that both volumes share cancels out."
    return VolumeDifference(
        first=called[0],
        second=called[1],
        pairing=pairing,
        difference_cc=gap,
        difference_interval_cc=(gap - half, gap + half),
        ratio=ratio,
        ratio_interval=(float(ratio * np.exp(-log_half)), float(ratio * np.exp(log_half))),
        terms_cc=terms,
        note=f"The interval of the difference covers {', '.join(terms)}. {common}",
    )
