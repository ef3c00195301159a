"""The paper's rule on a case as its Fig. 5 has it: what a depth discontinuity dents, and what is left of it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from benchmarks.accuracy.dents import CASES, dented, judge, photographed

from mammometry.report.figures.paper import draw_dent_grid
from mammometry.surface.ranges.dents import dent_grid


def test_there_are_fifteen_cases_as_in_the_paper() -> None:
    assert len(set(CASES)) == 15


@pytest.mark.slow
def test_dents_are_counted_against_the_truth_and_mostly_removed(tmp_path: Path) -> None:
    """A tenth of the size. A sheet drawn from the cast's outline towards the camera is the dent that is put in."""
    images, truth = photographed("plaster_3", tmp_path / "case", rig="reference:front,left", scale=0.1, seed=3)
    before = judge("plaster_3", images, truth)
    front = images[0]
    rows, columns = np.nonzero(front.valid)
    near = np.zeros_like(front.valid)
    near[rows[columns < columns.min() + 12], columns[columns < columns.min() + 12]] = True
    # 5 mm a pixel of 1 mm: as steep as a window that lies half on the cast, half on the backdrop, leaves it.
    smeared = front.range_mm - 5.0 * (columns.min() + 12 - np.arange(front.range_mm.shape[1]))[None, :]
    spoilt = replace(front, range_mm=np.where(near, smeared, front.range_mm).astype(np.float32))
    put_in = int((near & ~dented(front, truth)).sum())
    assert put_in > 200
    found = judge("spoilt", [spoilt, images[1]], truth)
    assert found.dented - before.dented == pytest.approx(put_in, rel=0.01)  # an element may be dented beside the sheet
    assert found.left_by_element - before.left_by_element < 0.1 * put_in
    assert found.sound_lost_by_element_percent < 1
    assert draw_dent_grid(dent_grid([spoilt, images[1]])).printed("pdf").startswith(b"%PDF")
