"""README's commands, run one after another in one folder as they stand there, with a small session."""

import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from tests.clinic_day_one import spend
from tests.clinic_server import free_port, served

_COARSE = "--set surface.extract.cube_mm=4"
OPTIONS = {
    "simulate SESSION --subject torso_2 --seed 7": "--scale 0.15 --poses 8",
    "run SESSION": _COARSE,
    "evaluate SESSION": _COARSE,
    "info SESSION": _COARSE,
    "figure 5 SESSION": _COARSE,
}
"""Command → what makes it quick."""
ELSEWHERE = {
    "make demo": ".ci/run",
    "make test": ".ci/run",
    "make clinic": ".ci/run",  # and test_a_demo_clinic_is_made_and_served_by_one_command
    "capture SESSION --rig rig.toml": "tests/scenes/test_capture_measured.py",
    "clinic serve my-clinic": "tests/unit/clinic/test_clinic_server.py",  # and below, at another address
    "photos FOLDER": "tests/scenes/test_photos.py",  # needs a telephone's photographs
    "demo --photos": "tests/scenes/test_photos.py",
    "acceptance run TEST": "tests/unit/cli/test_acceptance_command.py",  # needs measured artefacts
    "study landmarks FOUND.json TRUTH.json": "tests/unit/study/test_landmarks.py",
    "check SESSION --image-set DIR": "tests/unit/cli/test_rig.py",  # needs a later exposure
    "study observers curves --mesh front.ply": "tests/unit/cli/test_study.py",
    "study phantoms STUDY": "tests/unit/cli/test_study.py",
}
"""Command → who runs it: it needs cameras, does not end by itself, or takes many captures."""


def readme_commands(repository: Path) -> list[str]:
    """All of README's commands, less the word mammometry."""
    text = (repository / "README.md").read_text(encoding="utf-8")
    lines = [line for block in re.findall(r"```console\n(.*?)```", text, re.DOTALL) for line in block.splitlines()]
    found = [line.partition("#")[0].removeprefix("$ ").strip() for line in lines if line.startswith("$ ")]
    return list(dict.fromkeys(command.removeprefix("mammometry ") for command in found))


def test_every_command_of_the_readme_is_run_by_a_test(repository: Path) -> None:
    listed = readme_commands(repository)
    assert len(listed) > 15
    assert (set(OPTIONS) | set(ELSEWHERE)) - set(listed) == set()
    assert [where for where in ELSEWHERE.values() if not (repository / where).is_file()] == []


@pytest.mark.slow
def test_the_commands_of_the_readme_work_as_they_stand(repository: Path, tmp_path: Path) -> None:
    (tmp_path / "table.csv").write_text(
        "subject,reference_cc,measured_cc\n"
        + "".join(f"s{n},{100 + 30 * n},{101 + 30 * n + n % 3}\n" for n in range(8))
    )
    (tmp_path / "women.csv").write_text(
        "woman,capture,volume_cc\n" + "".join(f"W{n},{k},{300 + 40 * n + 5 * k}\n" for n in range(6) for k in range(2))
    )
    (tmp_path / "specimens.csv").write_text(
        "woman,side,displaced_g,water_c,flat_chest_cc\n"
        + "".join(f"W{n},left,{300 + 40 * n},21,{304 + 41 * n - 5 * (n % 3)}\n" for n in range(8))
    )
    commands = [command for command in readme_commands(repository) if command not in ELSEWHERE]
    # The others look at the simulated session, and measure the demo's scan.
    first = [command for command in commands if command.startswith(("simulate", "demo --scan"))]
    for command in dict.fromkeys((*first, *commands)):
        words = shlex.split(f"{command} {OPTIONS.get(command, '')}")
        if words[0] == "new":
            words[1] = "ANOTHER"
        if words[0] == "edit":
            edited_and_stopped(words, tmp_path)
            continue
        done = subprocess.run(
            [sys.executable, "-m", "mammometry", *words],
            cwd=tmp_path, capture_output=True, text=True, timeout=1200, check=False,
        )  # fmt: skip
        assert done.returncode == 0, (command, done.stdout[-500:], done.stderr[-2000:])
        if command == "demo --scan":
            shutil.copy(tmp_path / "demo-scan/scan.ply", tmp_path / "scan.ply")
    assert (tmp_path / "SESSION/results/report/report.html").is_file()
    with served(tmp_path / "my-clinic"):
        pass


def edited_and_stopped(words: list[str], folder: Path) -> None:
    """Open the editor, without a browser, and press Ctrl-C when its page can be opened."""
    with subprocess.Popen(
        [sys.executable, "-m", "mammometry", *words],
        cwd=folder, stderr=subprocess.PIPE, text=True, env=os.environ | {"BROWSER": "true"},
    ) as running:  # fmt: skip
        assert running.stderr is not None
        printed = []
        for line in running.stderr:
            printed.append(line)
            if "Ctrl-C stops" in line:
                running.send_signal(signal.SIGINT)
        assert running.wait(60) == 0, printed
    assert any("Ctrl-C stops" in line for line in printed)


@pytest.mark.slow
def test_a_demo_clinic_is_made_and_served_by_one_command(repository: Path, tmp_path: Path) -> None:
    address = f"127.0.0.1:{free_port()}"
    spend([sys.executable, "-m", "mammometry", "clinic", "demo", str(tmp_path / "demo"), "--address", address])
