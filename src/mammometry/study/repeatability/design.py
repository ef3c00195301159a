"""Captures of a repeatability study, and the random effects that its design can separate."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from mammometry.base.value import value
from mammometry.geometry.arrays import Array, Float64, Int64

LEAST_WOMEN = 3
"""Fewest women: fewer give no spread between women and no useful interval."""


@value
class Reading:
    """One volume of one breast from one capture."""

    woman: str
    side: str = ""
    """``left`` or ``right``. Empty: one breast per woman."""
    device: str = ""
    rater: str = ""
    """Person who positions the woman and takes the capture."""
    day: str = ""
    capture: str
    """Number or name of this capture among those with the same woman, rater, device and day."""
    reader: str = ""
    """Person who draws the borders. Several may draw on one capture."""
    reading: str = ""
    """Number or name of this reading among those with the same capture and reader."""
    volume_cc: float
    conditions: tuple[tuple[str, str], ...] = ()
    """Conditions of the capture, from the table or the results: name → value, such as posture → standing."""

    @property
    def breast(self) -> str:
        """Woman and side."""
        return f"{self.woman}, {self.side}" if self.side else self.woman

    @property
    def cell(self) -> tuple[str, ...]:
        """Labels shared by all captures under the same conditions."""
        return (self.woman, self.side, self.device, self.rater, self.day, self.reader)


WOMAN, BREAST, DEVICE, RATER, READER, DAY = "woman", "side", "device", "rater", "reader", "day"
DEVICE_WOMAN, RATER_WOMAN, READER_WOMAN = "device × woman", "rater × woman", "reader × woman"
CAPTURE, SIDE_IN_CAPTURE, RESIDUAL = "repositioning", "side × repositioning", "residual"
SUBJECT = (WOMAN, BREAST)
"""Effects that are not errors: differences between breasts."""
REPEATABILITY = (CAPTURE, SIDE_IN_CAPTURE, RESIDUAL)
"""Effects that change in a new capture by the same rater with the same device on the same day."""

SAME_DAY, ANOTHER_DAY, ANYBODY = "new capture", "another day", "any rater and device"
_LEVELS = {
    SAME_DAY: {*REPEATABILITY},
    ANOTHER_DAY: {*REPEATABILITY, DAY},
    ANYBODY: {*REPEATABILITY, DAY, DEVICE, RATER, READER, DEVICE_WOMAN, RATER_WOMAN, READER_WOMAN},
}
"""What a repetition changes → the effects that then change."""
_MARKS = {
    SAME_DAY: {CAPTURE},
    ANOTHER_DAY: {DAY},
    ANYBODY: {DEVICE, RATER, READER, DEVICE_WOMAN, RATER_WOMAN, READER_WOMAN},
}
"""Effects of which the design must be able to separate at least one."""


@value(eq=False)
class Design:
    """The random effects of a table."""

    effects: tuple[str, ...]
    """Effects that can be separated, the residual last. The residual is named after the finest effect."""
    groups: tuple[Int64[Array, " n"], ...]
    """For each effect except the residual, the group of each row."""
    levels: tuple[int, ...]
    """Number of groups of each effect. For the residual, the number of rows."""
    merged: tuple[tuple[str, str], ...]
    """Each effect that the design cannot separate, and the effect that includes it."""
    balanced: bool
    """Whether all breasts have the same number of rows for each rater, device, day and reader."""

    def levels_of_repetition(self) -> dict[str, tuple[int, ...]]:
        """Effects that change between two captures, by the kind of repetition.

        The kinds are: a new capture, a capture on another day, a capture by anyone with any device. A kind that the
        design does not contain, or that adds nothing to the previous one, is left out.
        """
        found: dict[str, tuple[int, ...]] = {}
        for level, differing in _LEVELS.items():
            known = tuple(place for place, effect in enumerate(self.effects) if effect in differing)
            names = {self.effects[place] for place in known}
            if names & _MARKS[level] and known not in found.values():
                found[level] = known
        return found


def design(readings: Sequence[Reading]) -> Design:
    """Find the effects that a table can separate.

    Effects with only one group are left out. Of two effects with the same groups, the first one is kept. An effect with
    as many groups as there are rows is the residual.

    Raises:
        ValueError: there are fewer than three women, only one row per breast, or a capture is duplicated.
    """
    women = len({reading.woman for reading in readings})
    if women < LEAST_WOMEN:
        raise ValueError("one woman" if women == 1 else f"{women} women")
    keys = [(*reading.cell, reading.capture, reading.reading) for reading in readings]
    if len(set(keys)) < len(keys):
        twice = next(key for place, key in enumerate(keys) if key in keys[:place])
        raise ValueError(f"the capture {', '.join(filter(None, twice))} twice")
    if len({(one.breast, one.device, one.rater, one.reader) for one in readings}) == len(readings):
        raise ValueError("no breast was captured twice by one rater with one device")
    effects: list[str] = []
    groups: list[Int64[Array, " n"]] = []
    merged: list[tuple[str, str]] = []
    residual = RESIDUAL
    for name, labels in _candidates(readings):
        group = _numbered(labels)
        count = int(group.max()) + 1
        if count == 1:
            continue
        if count == len(readings):
            residual = name if residual == RESIDUAL else residual
            continue
        same = next((effect for effect, other in zip(effects, groups, strict=True) if (other == group).all()), None)
        if same is not None:
            merged += [(name, same)] if not {name, same} <= set(SUBJECT) else []
            continue
        effects.append(name)
        groups.append(group)
    per_cell = np.bincount(_numbered([reading.cell for reading in readings]))
    crossed = _crossed(readings)
    return Design(
        effects=(*effects, residual),
        groups=tuple(groups),
        levels=(*(int(group.max()) + 1 for group in groups), len(readings)),
        merged=tuple(merged),
        balanced=bool(crossed and (per_cell == per_cell[0]).all()),
    )


def _candidates(readings: Sequence[Reading]) -> Iterator[tuple[str, list[tuple[str, ...]]]]:
    """Effects from the coarsest to the finest, each with the label of each row."""
    yield WOMAN, [(one.woman,) for one in readings]
    yield BREAST, [(one.woman, one.side) for one in readings]
    varied = {what: len({getattr(one, what) for one in readings}) > 1 for what in ("device", "rater", "reader", "day")}
    for name, what in ((DEVICE, "device"), (RATER, "rater"), (READER, "reader")):
        yield name, [(getattr(one, what),) for one in readings]
    for name, what in ((DEVICE_WOMAN, "device"), (RATER_WOMAN, "rater"), (READER_WOMAN, "reader")):
        if varied[what]:
            yield name, [(one.woman, one.side, getattr(one, what)) for one in readings]
    if varied["day"]:
        yield DAY, [(one.woman, one.day) for one in readings]
    taken: list[tuple[str, ...]] = [(one.woman, one.device, one.rater, one.day, one.capture) for one in readings]
    yield CAPTURE, taken
    yield SIDE_IN_CAPTURE, [(*key, one.side) for key, one in zip(taken, readings, strict=True)]


def _numbered(labels: Sequence[tuple[str, ...]]) -> Int64[Array, " n"]:
    numbers: dict[tuple[str, ...], int] = {}
    return np.array([numbers.setdefault(label, len(numbers)) for label in labels], dtype=np.int64)


def _crossed(readings: Sequence[Reading]) -> bool:
    """Whether all breasts have the same raters, devices and readers, and all women equally many days."""
    of_breast: dict[str, set[tuple[str, ...]]] = {}
    days: dict[str, set[str]] = {}
    for one in readings:
        of_breast.setdefault(one.breast, set()).add((one.device, one.rater, one.reader))
        days.setdefault(one.woman, set()).add(one.day)
    first, counts = next(iter(of_breast.values())), {len(own) for own in days.values()}
    return all(own == first for own in of_breast.values()) and len(counts) == 1


def volumes_of(readings: Sequence[Reading]) -> Float64[Array, " n"]:
    """All volumes, cc."""
    return np.array([reading.volume_cc for reading in readings])
