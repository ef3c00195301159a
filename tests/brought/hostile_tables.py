"""Tables of pairs as spreadsheets, programs and people of several countries write them, with their true content.

A true table is written in a style for each column. Whoever reads it must find the true numbers or refuse it.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np

from mammometry.base.notices import Notice

Style = Callable[[float], str]


def grouped(value: float, thousands: str, decimal: str, decimals: int) -> str:
    """``1860.5`` → ``1.860,50``."""
    return f"{value:,.{decimals}f}".translate(str.maketrans({",": thousands, ".": decimal}))


STYLES: dict[str, Style] = {
    "whole": lambda value: f"{value:.0f}",
    "point 1": lambda value: f"{value:.1f}",
    "point 3": lambda value: f"{value:.3f}",
    "comma 1": lambda value: f"{value:.1f}".replace(".", ","),
    "comma 3": lambda value: f"{value:.3f}".replace(".", ","),
    "English whole": lambda value: grouped(value, ",", ".", 0),
    "English 1": lambda value: grouped(value, ",", ".", 1),
    "English 3": lambda value: grouped(value, ",", ".", 3),
    "German whole": lambda value: grouped(value, ".", ",", 0),
    "German 1": lambda value: grouped(value, ".", ",", 1),
    "German 3": lambda value: grouped(value, ".", ",", 3),
    "Swiss": lambda value: grouped(value, "'", ".", 1),
    "French": lambda value: grouped(value, "\u202f", ",", 1),
    "scientific": lambda value: f"{value:.5e}",
    "general": lambda value: f"{value:.6g}",
}
SEPARATORS = {"comma": ",", "semicolon": ";", "tab": "\t"}
UNITS = {"cc": 1.0, "ml": 1.0, "l": 1000.0, "mm3": 0.001, "dl": 100.0, "": 1.0}
"""Ending of a column's name → cc."""
MISSING = ("", "NA", "-", "-999", "-9", "999", "9999", "0")
WARNED = ("999", "9999", "0")
SUMMARIES = ("Mean", "MEAN:", "Mean (SD)", "Average", "S.D.", "Mittelwert", "Keskiarvo", "", "x̄")
"""Names of the row of means below the table. The last is no word of any language: its numbers tell."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Hostile:
    """One way to write one table."""

    separator: str
    styles: tuple[str, str]
    units: tuple[str, str] = ("cc", "cc")
    missing: str | None = None
    """What one cell holds. None: all are there."""
    summary: str | None = None
    """Name of the row of means. None: there is none."""
    sides: str = ""
    """How both breasts of each woman are named: ``column``, ``name`` or not at all."""
    seed: int = 0
    quoted: bool = False
    end: str = "\n"

    @property
    def truth_cc(self) -> np.ndarray:
        """Reference and measured volume, cc, of eight breasts. Some are larger than a litre."""
        rng = np.random.default_rng(self.seed)
        reference = np.exp(rng.uniform(np.log(150), np.log(2600), 8))
        return np.stack([reference, reference * rng.normal(1.01, 0.03, 8)], axis=1)

    @property
    def cells(self) -> np.ndarray:
        """The true numbers in the units of their columns, and below them their means where there is a summary."""
        values = self.truth_cc / [UNITS[unit] for unit in self.units]
        return values if self.summary is None else np.concatenate([values, values.mean(axis=0, keepdims=True)])

    @property
    def names(self) -> tuple[str, str]:
        """Names of both columns."""
        first, second = (f"_{unit}" if unit else "" for unit in self.units)
        return f"water{first}", f"scan{second}"

    def text(self) -> str:
        """The file's content."""
        mark = SEPARATORS[self.separator]
        side = ["side"] if self.sides == "column" else []
        rows = [["id", *side, *self.names]]
        for number, values in enumerate(self.cells):
            who, which = f"P{number // 2 if self.sides else number}", ("left", "right")[number % 2]
            name = f"{who} {which}" if self.sides == "name" else who
            if number == len(self.truth_cc):
                name, which = self.summary or "", ""
            own = [STYLES[style](float(value)) for style, value in zip(self.styles, values, strict=True)]
            rows.append([name, *([which] if side else []), *own])
        if self.missing is not None:
            rows[3][-1] = self.missing
        return self.end.join(mark.join(self._cell(cell, mark) for cell in row) for row in rows) + self.end

    def _cell(self, cell: str, mark: str) -> str:
        return f'"{cell}"' if self.quoted or mark in cell else cell

    def wrong_with(self, read_cc: np.ndarray, notices: tuple[Notice, ...], subjects: int) -> str:
        """What is wrong with a table that was read, in words. Empty: nothing.

        Args:
            read_cc: the numbers, cc.
            notices: of the reader.
            subjects: how many it counted.
        """
        truth = self.truth_cc
        if self.summary is not None:
            return "a summary is a subject"
        if self.missing is not None and (self.missing not in WARNED or not notices):
            return f"{self.missing!r} is a measurement"
        known = np.ones(truth.shape, dtype=bool)
        known[2, 1] = self.missing is None
        within = np.maximum(6e-6 * truth, [[0.51 * UNITS[unit] for unit in self.units]])  # six digits, or whole numbers
        if not (np.abs(read_cc - truth) <= within)[known].all():
            return f"other numbers: {read_cc[:3].tolist()} for {truth[:3].tolist()}"
        expected = len(truth) // 2 if self.sides else len(truth)
        return "" if subjects == expected else f"{subjects} subjects, not {expected}"


@dataclass(slots=True)
class Tally:
    """Outcomes of many tables."""

    read: int = 0
    refused: int = 0
    wrong: list[str] = field(default_factory=list)


def everything() -> Iterator[Hostile]:
    """All styles of both columns by all separators and some units, and each fault in each style that is read."""
    for separator, *styles in itertools.product(SEPARATORS, STYLES, STYLES):
        for units in (("cc", "cc"), ("l", "cc"), ("ml", "dl"), ("", "mm3"), ("l", "l")):
            for seed in (0, 1):
                yield Hostile(separator=separator, styles=(styles[0], styles[1]), units=units, seed=seed)
    for separator, style, sides in itertools.product(SEPARATORS, STYLES, ("", "column", "name")):
        for missing, summary in [*((word, None) for word in MISSING), *((None, word) for word in SUMMARIES)]:
            for end, quoted in (("\n", False), ("\r\n", True)):
                yield Hostile(
                    separator=separator, styles=(style, style), missing=missing, summary=summary, sides=sides,
                    end=end, quoted=quoted, seed=2,
                )  # fmt: skip


def drawn(count: int, seed: int) -> Iterator[Hostile]:
    """A draw of everything, each with another table."""
    rng = np.random.default_rng(seed)
    choose = rng.choice
    for number in range(count):
        fault = rng.random()
        summary = str(choose(SUMMARIES)) if fault > 0.85 else None
        plain = summary == SUMMARIES[-1] or rng.random() < 0.5  # whole litres do not show that a row is a mean
        yield Hostile(
            separator=str(choose(list(SEPARATORS))),
            styles=(str(choose(list(STYLES))), str(choose(list(STYLES)))),
            units=("cc", "cc") if plain else (str(choose(list(UNITS))), str(choose(list(UNITS)))),
            missing=str(choose(MISSING)) if fault < 0.15 else None,
            summary=summary,
            sides=str(choose(["", "column", "name"])),
            seed=1000 * seed + number,
            quoted=bool(rng.random() < 0.2),
            end=str(choose(["\n", "\r\n", "\r"])),
        )
