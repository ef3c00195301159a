"""Slow tests in turn: none is forgotten, and neighbours are spread over the runs."""

from itertools import pairwise

import pytest
from tests.rota import chosen, turn

GROUPS = [f"test_{number:02d}" for number in range(17)]


def test_five_runs_in_a_row_take_each_test_once() -> None:
    taken = [name for run in range(1213, 1218) for name in chosen(GROUPS, *turn(f"{run}/5"))]
    assert sorted(taken) == GROUPS


def test_shares_are_alike_and_neighbours_apart() -> None:
    shares = [chosen(GROUPS, run, 5) for run in range(5)]
    assert {len(share) for share in shares} == {3, 4}
    assert not any({first, second} <= share for share in shares for first, second in pairwise(GROUPS))


@pytest.mark.parametrize("text", ["5", "a/5", "3/0", "-1/5", ""])
def test_nonsense_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="expected RUN/SHARES"):
        turn(text)
