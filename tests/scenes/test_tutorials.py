"""The ten-minute pages, each done from top to bottom in an empty folder as it stands there."""

import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from tests.clinic_server import served

TUTORIALS = ("scan", "rig", "clinic", "python")
SMALL = {"simulate SESSION --subject plaster_5 --seed 3": "--scale 0.2 --poses 10"}
"""Command → what makes it quick."""
BY_HAND = {
    "edit scan": "tests/unit/editor/test_server.py",
    "clinic demo demo-clinic": "tests/scenes/test_readme.py::test_a_demo_clinic_is_made_and_served_by_one_command",
    "clinic serve my-clinic": "served below",
    "check SESSION --image-set MONDAY": "tests/unit/cli/test_rig.py",
}
"""Command that waits for a person → where it is tested."""
LEFT_BEHIND = {
    "scan": ("scan/results/report/report.html", "mine/report/report.html", "table"),
    "rig": ("board.pdf", "MINE/session.toml", "SESSION/results/report/report.html", "SESSION/evaluation/evaluation.md"),
    "clinic": ("my-clinic/backups",),
    "python": ("SESSION/results/report/report.html",),
}
"""Tutorial → what is there at its end."""


def blocks(text: str) -> list[tuple[str, str]]:
    """Kind and text of every block of commands or code."""
    return re.findall(r"```(console|python)\n(.*?)```", text, re.DOTALL)


def test_every_tutorial_is_walked(repository: Path) -> None:
    folder = repository / "docs" / "tutorials"
    assert {path.stem for path in folder.glob("*.md")} == set(TUTORIALS) == set(LEFT_BEHIND)
    pages = {name: (folder / f"{name}.md").read_text(encoding="utf-8") for name in TUTORIALS}
    for page in pages.values():
        assert any(kind == "console" for kind, _ in blocks(page))
    assert [
        command
        for command in (*SMALL, *BY_HAND)
        if not any(f"$ mammometry {command}\n" in page for page in pages.values())
    ] == []


@pytest.mark.slow
@pytest.mark.parametrize("name", TUTORIALS)
def test_a_tutorial_works_as_it_stands(name: str, repository: Path, tmp_path: Path) -> None:
    script = ""
    for kind, block in blocks((repository / "docs" / "tutorials" / f"{name}.md").read_text(encoding="utf-8")):
        if kind == "python":
            script += block
            continue
        for line in block.splitlines():
            command = line.removeprefix("$ mammometry ")
            if command not in BY_HAND:
                _run(["-m", "mammometry", *shlex.split(f"{command} {SMALL.get(command, '')}")], tmp_path)
    if script:
        (tmp_path / "tutorial.py").write_text(script, encoding="utf-8")
        printed = _run(["tutorial.py"], tmp_path)
        assert re.search(r"^model: 42\d\.\d ± \d\.\d cc \(95 %: 4\d\d\.\d to 4\d\d\.\d cc\)$", printed, re.MULTILINE)
        assert "watertight: True" in printed
    assert [path for path in LEFT_BEHIND[name] if not (tmp_path / path).exists()] == []
    if name == "clinic":
        with served(tmp_path / "my-clinic"):
            pass


def _run(words: list[str], folder: Path) -> str:
    done = subprocess.run(
        [sys.executable, *words], cwd=folder, capture_output=True, text=True, timeout=1200, check=False
    )
    assert done.returncode == 0, (words, done.stdout[-500:], done.stderr[-2000:])
    return done.stdout
