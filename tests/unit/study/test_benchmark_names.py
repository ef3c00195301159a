"""Unknown names on a benchmark's command line are refused with the known ones."""

import argparse

import pytest
from benchmarks.accuracy import clinic
from benchmarks.names import known


def test_known_names_are_returned_and_others_refused() -> None:
    assert known("pairs", ["left"], {"left": 1, "right": 2}) == ["left"]
    with pytest.raises(SystemExit, match="left, right; found middle, nonsense"):
        known("pairs", ["left", "middle", "nonsense"], {"left": 1, "right": 2})


@pytest.mark.parametrize("disturbance", ["nonsense", "rail=long", "rail,rail"])
def test_an_unknown_disturbance_is_refused(disturbance: str) -> None:
    arguments = argparse.Namespace(
        disturb=[disturbance], subjects=["torso_3"], skin="skin", seed=7, scale=0.25, seeds=[], mounting_said=False
    )
    with pytest.raises(SystemExit, match="rail"):
        next(clinic.cases(arguments))
