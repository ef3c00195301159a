"""The 95 % intervals hold the truth on surfaces with errors as the stages make them, and are not much too wide."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
import pytest
from benchmarks.accuracy.coverage import Held, summary, surfaces

GROUPS = {
    "casts": (("model",), 0.2),
    "torsos": (("left", "right"), 0.07),
    # Wider than these need since the border's own uncertainty is that of all likely borders (docs/decisions/0043).
    "torsos as defined": (("left, as defined", "right, as defined"), 0.14),
    "left less right": (("left less right",), 0.1),
}
"""Volumes of a group, and the least RMS of error / half width; 1/1.96 is that of normal errors whose σ is known.

Casts and volumes as defined may have an interval 2.5 times as wide: they allow for skin that nobody saw, to which no
error is added here. The other two are mostly the wall's, and these torsos are the kinder family: they show a fifth to
a third of what is allowed (decision 9: 1.6 of 9 mm, .93 of 3.4).
"""


def complaints(held: Sequence[Held]) -> Iterator[str]:
    """Groups whose intervals hold too few of the volumes, or would hold them at a fraction of their width."""
    for name, (volumes, least) in GROUPS.items():
        ratios = np.array([one.error_cc / one.half_cc for one in held if one.volume in volumes])
        share, rms = (np.abs(ratios) <= 1).mean(), np.sqrt(np.mean(ratios**2))
        if share < 0.95:
            yield f"{name}: {share:.0%} held"
        if not least < rms < 1 / 1.96:
            yield f"{name}: errors are {rms:.2f} of the half width, expected {least} to 0.51"


@pytest.mark.slow
@pytest.mark.requirement("R-VOL-4")
def test_intervals_hold_the_truth_on_more_than_sixty_volumes() -> None:
    """31 casts and 62 breasts, each breast also as it is defined, before the wall that is named, and 31 differences.

    The errors are not those that the interval is told: their tails are heavier, and it knows their size by an estimate.
    """
    held = list(surfaces(31))
    assert len(held) == 31 * (1 + 2 + 2 + 1)
    assert list(complaints(held)) == []


@pytest.mark.parametrize(("factor", "says"), [(0.5, "held"), (3.0, "of the half width"), (1.0, None)])
def test_intervals_of_another_width_are_noticed(factor: float, says: str | None) -> None:
    """The judgement itself, on normal errors of .3 of the half width: about what the intervals have."""
    rng = np.random.default_rng(4)
    held = [
        replace(Held("a", volume, error_cc=0.3 * rng.normal(), half_cc=1.0), half_cc=factor)
        for volumes, _ in GROUPS.values()
        for volume in volumes
        for _ in range(31)
    ]
    found = list(complaints(held))
    assert bool(found) == bool(says)
    if says:
        assert all(any(name in one and says in one for one in found) for name in ("casts", "torsos as defined"))


def test_the_summary_counts_what_is_held() -> None:
    """19 of 20: Clopper and Pearson's interval of the share is 75.1 to 99.9 % (their own table)."""
    held = [Held("a", "model", error_cc=0.5 if number else 2.0, half_cc=1.0) for number in range(20)]
    lines = list(summary(held))
    assert "| casts | 20 | 95.0 % | 75 … 100 % | 0.66 | 1.0 | +0.6 ± 0.3 |" in lines
