"""Settings refuse values that make no sense, by name."""

import pytest

from mammometry.calibration.settings import BundleSettings, CalibrateSettings


@pytest.mark.parametrize(
    ("values", "named"),
    [({"target_prior_mm": (0.1, 0.0, 0.3)}, "target_prior_mm"), ({"model": "paper", "k3": "free"}, "k3")],
)
def test_impossible_values_are_named(values: dict[str, object], named: str) -> None:
    with pytest.raises(ValueError, match=named):
        BundleSettings(**values)  # type: ignore[arg-type]


def test_defaults_are_the_recommended_ones() -> None:
    assert CalibrateSettings().bundle == BundleSettings(model="brown", free_target="auto")
