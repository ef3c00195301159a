"""The exported numbers."""

from mammometry.hospital.exported import Quantity


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
