"""`mammometry simulate` refuses disturbances that mean nothing, before it makes anything."""

from pathlib import Path

import pytest

from mammometry.cli import main, simulation
from mammometry.cli.common import Answer
from mammometry.simulate.disturbances.draw import draw
from mammometry.simulate.rendering.skin import SKINS
from mammometry.simulate.subjects.registry import SUBJECTS
from mammometry.simulate.walk import WalkRecipe


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--disturb", "nonsense"], "nonsense"),
        (["--disturb", "drift=9"], "0 and 0.5"),
        (["--disturb", "removed=both"], "left, right"),
        (["--disturb", "rail,rail=3"], "once"),
        (["--clinic", "4", "--disturb", "skin=skin"], "once"),  # every patient drawn has a skin already
        (["--clinic", "4", "--subject", "torso_2"], "--clinic"),
        (["--disturb", "removed=left"], "torsos"),
    ],
)
def test_disturbances_that_mean_nothing_are_refused(
    options: list[str], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main.run(["simulate", str(tmp_path / "out"), "--scale", "0.2", *options]) != 0
    assert said in " ".join(capsys.readouterr().err.replace("│", " ").split())
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("command", "options", "said"),
    [
        (
            ["simulate"],
            ["--scale", "0.12", "--poses", "6"],
            "--poses is 10",
        ),
        (["simulate"], ["--scale", "0.1", "--poses", "30"], "--scale is 0.12"),
        (["simulate"], ["--scale", "0.25", "--poses", "5"], "--poses is 6"),
        (["study", "phantoms"], ["--scale", "0.12"], "0.15"),
    ],
)
def test_pictures_that_do_not_calibrate_the_rig_are_refused(
    command: list[str], options: list[str], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main.run([*command, str(tmp_path / "out"), *options]) == 2
    assert said in " ".join(capsys.readouterr().err.replace("│", " ").split())
    assert not (tmp_path / "out").exists()


def test_a_drawn_situation_is_what_is_written_for_it() -> None:
    assert str(draw(4, 2)) == str(draw(4, 2))
    assert "skin=" in str(draw(4, 0))


def test_the_help_names_every_family(capsys: pytest.CaptureFixture[str]) -> None:
    assert main.run(["simulate", "--help"]) == 0
    said = " ".join(capsys.readouterr().out.replace("│", " ").split())
    named = set(SUBJECTS) - {"user-mesh", "acceptance-test"}  # their names are others
    assert [family for family in named if family not in said] == []
    for name in ("leaning-woman-wide", "test-sphere_1", "test-bar_1", "test-plane_1"):
        assert name in said


@pytest.mark.parametrize("wrong", [["--rig", "rig.toml"], ["--clinic", "3"], ["--disturb", "drift=0.02"]])
def test_a_telephone_has_no_rig(tmp_path, wrong):
    assert main.run(["simulate", str(tmp_path / "walk"), "--telephone", *wrong]) != 0
    assert not (tmp_path / "walk").exists()


@pytest.mark.parametrize(
    ("given", "recipe"),
    [
        ([], WalkRecipe()),
        (["--skin", "plaster"], WalkRecipe(skin=SKINS["plaster"])),
        (["--skin", "plain", "--scale", "0.25"], WalkRecipe(skin=SKINS["plain"], scale=0.25)),
    ],
)
def test_a_telephone_takes_what_is_given(tmp_path, monkeypatch, given, recipe):
    asked = []
    monkeypatch.setattr(simulation, "simulated_walk", lambda out, walk, options: asked.append(walk) or Answer({}, []))
    assert main.run(["simulate", str(tmp_path / "walk"), "--telephone", *given]) == 0
    assert asked == [recipe]


def test_a_telephone_does_not_photograph_a_cast(tmp_path):
    assert main.run(["simulate", str(tmp_path / "walk"), "--telephone", "--subject", "plaster"]) == 3
    assert not (tmp_path / "walk").exists()


def test_a_rig_has_no_walk(tmp_path):
    assert main.run(["simulate", str(tmp_path / "session"), "--disturb", "breath=0.3"]) != 0
    assert not (tmp_path / "session").exists()


def test_two_demos_at_once_are_refused(tmp_path):
    assert main.run(["demo", str(tmp_path / "demo"), "--photos", "--scan"]) == 2
