"""Dates of two postures."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from mammometry.api.posture import check_posture, posture_warnings
from mammometry.base.errors import SessionError


def dated(path: str, posture: str) -> Any:
    return SimpleNamespace(folder=Path(path), posture=posture)


@pytest.mark.requirement("R-DATE-1")
def test_dates_of_two_postures_are_refused_unless_somebody_wants_them() -> None:
    standing, leaning, unknown = dated("a", "standing"), dated("b", "leaning"), dated("c", "")
    with pytest.raises(SessionError, match=r"^a, b: .*standing .*leaning .*other_posture"):
        check_posture(standing, leaning)
    assert [notice.values for notice in posture_warnings(standing, leaning)] == [
        {"before": "standing", "after": "leaning"}
    ]
    check_posture(standing, unknown)
    assert [notice.code for notice in posture_warnings(standing, unknown)] == ["postures-differ"]
    assert list(posture_warnings(standing, standing)) == list(posture_warnings(unknown, unknown)) == []
