"""The size of a print by two witnesses."""

from dataclasses import replace

import pytest
from board_walk import BOARD

from mammometry.base.errors import BoardSizeError
from mammometry.walk.bank_card import CardScale
from mammometry.walk.print_size import sized


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
