"""The size of a print by two witnesses."""

from dataclasses import replace

import numpy as np
import pytest
from board_walk import BOARD

from mammometry.base.errors import BoardSizeError
from mammometry.job.inputs import Walk
from mammometry.report.warnings import walk_concerns
from mammometry.walk.bank_card import CardScale
from mammometry.walk.motion import WalkMotion
from mammometry.walk.print_size import sized
from mammometry.walk.region import Region


def by_card(scale, std=7e-4):
    return CardScale(width_mm=85.6 / scale, height_mm=53.98 / scale, scale=scale, std=std, photographs=20)


def test_a_card_replaces_a_size_that_nobody_measured():
    made = sized(BOARD, by_card(0.99))
    assert made.edge_mm == pytest.approx(0.99 * 264.0, rel=1e-4)
    assert made.square_mm == pytest.approx(made.edge_mm / 11)
    assert made.scale_std == pytest.approx(7e-4, rel=0.01)


def test_two_measurements_are_weighted_by_their_uncertainty():
    typed = replace(BOARD, edge_std_mm=7e-4 * 264.0)
    made = sized(typed, by_card(1.001))
    assert made.edge_mm == pytest.approx(1.0005 * 264.0, rel=1e-6)
    assert made.scale_std == pytest.approx(7e-4 / 2**0.5, rel=1e-3)


@pytest.mark.requirement("R-PHOTO-3")
def test_a_contradiction_is_refused():
    typed = replace(BOARD, edge_std_mm=0.2)
    assert sized(typed, by_card(1.002)).scale_std < 7e-4
    with pytest.raises(BoardSizeError):
        sized(typed, by_card(0.99))


def test_the_report_notes_a_card():
    region = Region(low_world=np.zeros(3), high_world=np.ones(3))
    walk = Walk(region=region, scale_std=7e-4, point_std_mm=0.1, board_mm=np.zeros((2, 2)), card_scale=0.99)
    still = WalkMotion(
        cameras=(),
        turn_rad=np.zeros((0, 3)),
        shift_mm=np.zeros((0, 3)),
        centre_world=np.zeros(3),
        size_mm=0.0,
        lens_px=0.0,
        before_mm=0.1,
        rest_mm=0.1,
        point_std_mm=0.0,
    )
    (noted,) = walk_concerns(walk, still)
    assert (noted.code, noted.level) == ("board-measured-by-card", "note")
    assert noted.values["percent"] == pytest.approx(-1.0)
