"""`mammometry simulate` refuses disturbances that mean nothing, before it makes anything."""

from pathlib import Path

import pytest

from mammometry.cli import main
from mammometry.simulate.disturbances.draw import draw
from mammometry.simulate.subjects.registry import SUBJECTS


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--disturb", "nonsense"], "nonsense"),
        (["--disturb", "drift=9"], "drift must lie between 0 and 0.5"),
        (["--disturb", "removed=both"], "left, right"),
        (["--disturb", "rail,rail=3"], "each once"),
        (["--clinic", "4", "--disturb", "skin=skin"], "each once"),  # every patient drawn has a skin already
        (["--clinic", "4", "--subject", "torso_2"], "--clinic draws subject and seed"),
        (["--disturb", "removed=left"], "only torsos"),
    ],
)
def test_disturbances_that_mean_nothing_are_refused(
    options: list[str], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main.run(["simulate", str(tmp_path / "out"), "--scale", "0.03", *options]) != 0
    assert said in " ".join(capsys.readouterr().err.replace("│", " ").split())
    assert not (tmp_path / "out").exists()


def test_a_drawn_situation_is_what_is_written_for_it() -> None:
    assert str(draw(4, 2)) == str(draw(4, 2))
    assert "skin=" in str(draw(4, 0))


def test_the_help_names_every_family(capsys: pytest.CaptureFixture[str]) -> None:
    assert main.run(["simulate", "--help"]) == 0
    said = " ".join(capsys.readouterr().out.replace("│", " ").split())
    assert [family for family in SUBJECTS if family != "user-mesh" and family not in said] == []
    assert "leaning-woman-wide" in said
