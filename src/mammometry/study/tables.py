"""Figures laid out for people: the same tables on the terminal, as Markdown and on a page; and as JSON."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True, slots=True, kw_only=True)
class Table:
    """A table of text; the first column names the row."""

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]

    def as_markdown(self) -> str:
        """The table under its title, GitHub's Markdown."""
        lines = [self.columns, ("---",) * len(self.columns), *self.rows]
        return "\n".join([f"**{self.title}**", "", *("| " + " | ".join(line) + " |" for line in lines), ""])


def number(value: float | None, form: str = ".3f") -> str:
    """A figure with a true minus sign; a dash where it is not known."""
    if value is None or value != value:
        return "–"
    return format(value, form).replace("-", "−")


def plain(value: Any) -> Any:
    """The same as JSON knows it: null where a number is not known or infinite, lists for tuples."""
    if isinstance(value, Mapping):
        return {key: plain(each) for key, each in value.items()}
    if isinstance(value, Iterable) and not isinstance(value, str):
        return [plain(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
