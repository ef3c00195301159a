"""The paper's check of depth (section 3): a tilted flat plate comes out flat, and where it is."""

from pathlib import Path

import numpy as np
import pytest
from benchmarks.accuracy.plate import PAPER_MM, measure, plane_residuals_mm

from mammometry.settings import Settings
from mammometry.simulate.recipe import SessionRecipe
from mammometry.simulate.session import write_session


def test_a_plates_residuals_are_the_noise_about_its_plane() -> None:
    """Residuals of a turned plane, and only what stands off it along its normal."""
    rng = np.random.default_rng(3)
    normal = np.array([1.0, -2.0, 2.0]) / 3
    along = rng.normal(size=(4000, 3)) * 40
    flat = along - np.outer(along @ normal, normal)
    noise_mm = rng.normal(size=4000) * 0.1
    placed = flat + np.array([100.0, -50.0, 900.0])
    found = plane_residuals_mm(placed + np.outer(noise_mm, normal))
    # A plane has three unknowns: it takes 3 of 4000 parts of the variance.
    assert np.sqrt(np.mean(found**2)) == pytest.approx(np.sqrt(np.mean(noise_mm**2)), rel=2e-3)


@pytest.mark.slow
@pytest.mark.requirement("R-VOL-3")
def test_a_tilted_plate_is_flat_within_the_papers_half_millimetre(tmp_path: Path, tiny_settings: Path) -> None:
    """At a tenth of the size a pixel of disparity is 3.5 mm of depth (z²/(b·f): 771²/(210·803)).

    Matching to .05 px RMS leaves .18 mm of depth, .14 mm across a plate at 39°, and twice that at 95 %. The paper's
    .5 mm is of full-size pictures: here it is asked of the worst datum. The depth's mean error is the calibration's
    alone; .05 px, common to a picture, are .18 mm.
    """
    session = tmp_path / "plate"
    write_session(session, SessionRecipe(rig="reference:front", subject="plate", scale=0.1, seed=7, poses=8))
    (found,) = measure(session, Settings.load(tiny_settings))
    assert found.tilt_deg == pytest.approx(39, abs=3)  # not looked at straight on
    assert found.complete_percent > 99
    assert found.residual_worst_mm < PAPER_MM
    assert found.residual_rms_mm < 0.14
    assert found.residual_p95_mm < 0.28
    assert abs(found.depth_bias_mm) < 0.18
    assert found.depth_p95_mm < 0.36
