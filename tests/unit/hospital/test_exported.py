"""The exported numbers."""

from types import SimpleNamespace
from typing import Any

import pytest
from tests.unit.report import synthetic

from mammometry.hospital import codes
from mammometry.hospital.exported import Quantity
from mammometry.hospital.gather import quantities
from mammometry.hospital.tables import dictionary
from mammometry.measure.volume.difference import difference


def test_exported_numbers_are_rounded_by_their_uncertainty() -> None:
    long = Quantity(
        code="sn_n_straight", title="", side="left", value=126.7134, unit="mm", sigma=12.8064, method="straight"
    )
    assert (long.rounded().value, long.rounded().sigma) == (127.0, 13.0)
    volume = Quantity(
        code="volume",
        title="",
        side="left",
        value=284.43,
        unit="cm3",
        interval_95=(229.51, 339.35),
        method="closed-mesh",
    )
    assert (volume.rounded().value, volume.rounded().interval_95) == (284.0, (230.0, 339.0))
    area = Quantity(code="skin_area", title="", side="left", value=283.1234, unit="cm2", method="mesh-area")
    assert area.rounded().value == 283.1


@pytest.mark.requirement("R-VOL-11")
def test_left_less_right_is_exported_with_its_own_interval() -> None:
    left, right = (synthetic.measurement(side, interval_cc=(440.0, 460.0)) for side in ("left", "right"))
    plan: Any = SimpleNamespace(value=lambda product: None)
    found = {quantity.name: quantity for quantity in quantities((left, right), plan)}
    apart = difference(left, right, "sides")
    assert found["volume_left_less_right"].interval_95 == apart.difference_interval_cc
    assert found["volume_left_less_right"].note == apart.note
    assert found["volume_left_less_right"].method in codes.METHODS
    assert "volume_left_less_right_low" in dictionary()
    assert "volume_left_less_right" not in {quantity.name for quantity in quantities((left,), plan)}
