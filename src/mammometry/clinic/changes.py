"""Changes of volumes between two visits, from the stored figures alone."""

from __future__ import annotations

import math
from dataclasses import dataclass

Interval = tuple[float, float]


@dataclass(frozen=True, slots=True)
class VolumeChange:
    """Change of a volume, with its 95 % interval where known."""

    difference_cc: float
    interval_cc: Interval | None

    @property
    def beyond_error(self) -> bool | None:
        """Whether zero lies outside the interval.

        None where that is not known.
        """
        if self.interval_cc is None:
            return None
        low, high = self.interval_cc
        return not low <= 0.0 <= high

    @property
    def verdict(self) -> str:
        """In words."""
        if self.beyond_error is None:
            return "No verdict: the error is not known."
        if not self.beyond_error:
            return "Within the measurement error."
        return (
            "Larger: more than the measurement error."
            if self.difference_cc > 0
            else "Smaller: more than the measurement error."
        )


def volume_change(
    before_cc: float, before_interval_cc: Interval | None, after_cc: float, after_interval_cc: Interval | None
) -> VolumeChange:
    """Subtract two volumes whose errors are taken as independent.

    What both visits share, such as a rig's scale, makes the true interval narrower: this one errs towards caution. The
    comparison of two dates (`mammometry.api.dates`) lays the trunks onto one another and knows better.
    """
    difference = after_cc - before_cc
    if before_interval_cc is None or after_interval_cc is None:
        return VolumeChange(difference, None)
    down = math.hypot(after_cc - after_interval_cc[0], before_interval_cc[1] - before_cc)
    up = math.hypot(after_interval_cc[1] - after_cc, before_cc - before_interval_cc[0])
    return VolumeChange(difference, (difference - down, difference + up))
