"""One sentence on a breast's change, as pages, documents and commands say it."""

import datetime

import pytest

from mammometry.report.words.volumes import change_sentence

MARCH = datetime.date(2026, 3, 12)


@pytest.mark.parametrize(
    ("change_cc", "interval_cc", "beyond", "amount", "verdict"),
    [
        (28.2, (12.4, 44.0), True, "28 cc larger than on 12 March 2026 (95 %: 12 to 44)", "more than"),
        (-28.2, (-44.0, -12.4), True, "28 cc smaller than on 12 March 2026 (95 %: 12 to 44)", "more than"),
        (3.6, (-9.0, 16.2), False, "4 cc larger than on 12 March 2026 (95 %: 9 cc smaller to 16 cc larger)", "within"),
        (-0.4, (-9.0, 8.2), False, "as large as on 12 March 2026 (95 %: 9 cc smaller to 8 cc larger)", "within"),
        (2.25, (0.31, 4.2), True, "2.2 cc larger than on 12 March 2026 (95 %: 0.3 to 4.2)", "more than"),
    ],
)
def test_a_change_is_one_sentence(
    change_cc: float, interval_cc: tuple[float, float], beyond: bool, amount: str, verdict: str
) -> None:
    sentence = change_sentence("left", change_cc, interval_cc, beyond, MARCH)
    assert sentence == f"Left breast: {amount}: {verdict} the measurement error."


def test_an_error_that_is_not_known_gives_no_verdict() -> None:
    sentence = change_sentence("left", 28.2, None, None, MARCH)
    assert sentence.startswith("Left breast: 28.2 cc larger than on 12 March 2026: no verdict, because the error")


def test_a_date_that_nobody_knows_is_before() -> None:
    assert change_sentence("right", 5.0, (1.0, 9.0), True, None).startswith("Right breast: 5.0 cc larger than before")
