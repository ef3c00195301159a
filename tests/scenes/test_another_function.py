"""A session is measured with another function in one line of the method."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import mammometry as mm
from mammometry.job.products import Context, instead_of
from mammometry.job.stages import match, surface
from mammometry.matching.dense.match import DisparityMap
from mammometry.matching.rectify import RectifiedPair


@pytest.mark.slow
def test_another_matcher_changes_what_is_made_from_it_alone(tiny_finished: Path, tiny_settings: Path) -> None:
    """Each place half a pixel off: farther or nearer skin, and another volume. Cameras and outlines stay."""

    @instead_of(match.disparity, version=1)
    def shifted(rectified: RectifiedPair, *, job: Context) -> DisparityMap:
        found = match.disparity.function(rectified, job=job)
        return replace(found, d_h_px=np.where(found.valid, found.d_h_px + np.float32(0.5), found.d_h_px))

    settings = mm.Settings.load(tiny_settings)
    before = dict(mm.open_session(tiny_finished, settings).run().volumes_cc)
    other = mm.open_session(tiny_finished, settings, given={match.disparity: shifted})
    after = dict(other.run().volumes_cc)
    assert after.keys() == before.keys()
    assert all(abs(after[name] / before[name] - 1) > 1e-4 for name in before)
    made = set(other.store.made)
    assert {"match/disparity/front", "surface/range/front", "surface/repaired", "measure/measurement"} <= made
    assert not {"calibrate/cameras", "match/subjects", "match/foreground/front_left"} & made
    again = mm.open_session(tiny_finished, settings)
    assert again.store.state(again.plan[surface.repaired].key) == "stale"
    assert other.store.state(other.plan[surface.repaired].key) == "current"
