"""Hostile tables are read as they were meant, or refused: none gives another number without a word."""

import itertools
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest
from tests.brought.hostile_tables import STYLES, UNITS, Hostile, Tally, drawn, everything

from mammometry.base.errors import TableError
from mammometry.io.paired_tables import read_pairs


def tallied(tables: Iterable[Hostile], folder: Path) -> Tally:
    """Read each table."""
    tally = Tally()
    path = folder / "table.csv"
    for table in tables:
        path.write_bytes(table.text().encode())
        try:
            found = read_pairs(path, reference=table.names[0], measured=table.names[1])
        except TableError:
            tally.refused += 1
            continue
        read = np.stack([found.reference, found.measured], axis=1) * UNITS[found.unit]
        if wrong := table.wrong_with(read, found.notices, len(set(found.subjects or found.names))):
            tally.wrong.append(f"{table}: {wrong}\n{table.text()}")
        tally.read += 1
    return tally


@pytest.mark.requirement("R-IN-4")
def test_a_draw_of_hostile_tables(tmp_path: Path) -> None:
    tally = tallied(drawn(200, seed=1), tmp_path)
    assert not tally.wrong, "\n".join(tally.wrong[:5])
    assert tally.read > 30  # it does not simply refuse


@pytest.mark.slow
def test_all_hostile_tables(tmp_path: Path) -> None:
    tally = tallied(itertools.chain(everything(), drawn(6000, seed=2)), tmp_path)
    assert not tally.wrong, f"{len(tally.wrong)} of {tally.read}\n" + "\n".join(tally.wrong[:10])
    assert tally.read + tally.refused > 17_000


@pytest.mark.parametrize("separator", ["comma", "semicolon", "tab"])
@pytest.mark.parametrize("style", ["whole", "point 1", "comma 1", "English 1", "German 1", "scientific"])
def test_what_is_written_clearly_is_read(tmp_path: Path, separator: str, style: str) -> None:
    assert style in STYLES
    tally = tallied([Hostile(separator=separator, styles=(style, style), seed=seed) for seed in range(3)], tmp_path)
    assert (tally.read, tally.wrong) == (3, [])
