"""An independent renderer's capture against ray-cast truth, with true cameras."""

import sys
from pathlib import Path

import pytest

from mammometry.matching.settings import MatchSettings


@pytest.mark.data
@pytest.mark.slow
def test_a_plaster_pair_reaches_what_the_recipe_measured(
    shared_data: Path, repository: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(str(repository))
    sys.modules.pop("benchmarks", None)
    from benchmarks.accuracy.matching import measure

    (row,) = measure(shared_data / "rendered", ["plaster_b"], ["right"], MatchSettings())
    assert row["median_px"] < 0.055  # the recipe's mean over nine plasters is .048
    assert row["p95_px"] < 0.2
    assert row["beyond_1_px_percent"] < 0.15
    assert row["complete_percent"] > 99
    assert abs(row["depth_bias_mm"]) < 0.02
    assert 0.6 < row["error_over_sigma"] < 1.4
    assert abs(row["silhouette_mean_px"]) < 0.2
    assert row["silhouette_p95_px"] < 0.7


@pytest.mark.slow
@pytest.mark.data
def test_a_photograph_of_plants_has_few_bad_pixels(
    shared_data: Path, repository: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(str(repository))
    sys.modules.pop("benchmarks", None)
    from benchmarks.matching import aloe

    ours, rival = aloe(shared_data / "opencv_samples")
    assert ours["bad_percent"] <= 3.7  # what SGBM is documented to leave there
    assert ours["bad_percent"] < rival["bad_percent"] + 0.5  # in the same run
    assert ours["matched_percent"] > 70
