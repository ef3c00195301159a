"""Tables and numbers for the terminal, Markdown, pages and JSON."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

_LEAST_P = 0.001  # smaller values are written "< 0.001", as by the American Medical Association and most journals


@dataclass(frozen=True, slots=True, kw_only=True)
class TextTable:
    """A table of text. The first column contains the rows' names."""

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]

    def as_markdown(self) -> str:
        """The table with its title, as GitHub Markdown."""
        lines = [self.columns, ("---",) * len(self.columns), *self.rows]
        return "\n".join([f"**{self.title}**", "", *("| " + " | ".join(line) + " |" for line in lines), ""])


def number(value: float | None, form: str = ".3f") -> str:
    """A number with a proper minus sign, or a dash if unknown."""
    if value is None or math.isnan(value):
        return "–"
    return format(value, form).replace("inf", "∞").replace("-", "−")


def probability(p: float) -> str:
    """A probability with four decimals, or ``< 0.001``."""
    return "< 0.001" if p < _LEAST_P else number(p, ".4f")


def p_words(p: float) -> str:
    """``p = 0.1888`` or ``p < 0.001``."""
    return f"p {'' if p < _LEAST_P else '= '}{probability(p)}"


def signed(value: float, digits: int = 1) -> str:
    """A number with its sign (a proper minus). Zero has no sign."""
    words = number(value, f"+.{digits}f")
    return words.lstrip("+−") if value == value and not float(f"{value:.{digits}f}") else words


def thousands(count: int) -> str:
    """A count with thin spaces between thousands."""
    return f"{count:,}".replace(",", " ")


def plain(value: Any) -> Any:
    """Convert to data for JSON: null for unknown or infinite numbers, lists for tuples."""
    if isinstance(value, Mapping):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, Iterable) and not isinstance(value, str):
        return [plain(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
