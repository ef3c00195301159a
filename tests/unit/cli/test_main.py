"""Errors become sentences and exit codes; answers become text or exactly one JSON object."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
import typer

from mammometry.base.errors import ImageError, MatchingError
from mammometry.cli import main
from mammometry.cli.common import Answer


def outcome(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, raised: BaseException, *arguments: str
) -> tuple[int, str, str]:
    """Exit code, standard output and standard error of a command that raises."""

    def command(*args: object, **kwargs: object) -> None:
        sys.stdout.write("chatter of a library\n")
        raise raised

    monkeypatch.setattr(main, "app", command)
    code = main.run(["run", "SESSION", *arguments])
    printed = capsys.readouterr()
    return code, printed.out, printed.err


ERROR = MatchingError("pair front", found="nothing", expected="a match", remedy="Look again.")


def test_our_errors_are_one_sentence_on_standard_error(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    code, _, err = outcome(capsys, monkeypatch, ERROR)
    assert code == 6
    assert err == f"mammometry: {ERROR}\n"


@pytest.mark.parametrize(
    ("raised", "code", "kind"),
    [
        (ERROR, 6, "MatchingError"),
        (ImageError("a", found="b", expected="c", remedy="d"), 4, "ImageError"),
        (KeyboardInterrupt(), 130, "Interrupted"),
        (typer.Abort(), 130, "Interrupted"),
        (typer.BadParameter("no such thing"), 2, "UsageError"),
        (RuntimeError("oh"), 70, "Defect"),
        (MemoryError(), 1, "MemoryError"),
    ],
)
def test_failures_as_json_are_one_object(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, raised: BaseException, code: int, kind: str
) -> None:
    returned, out, err = outcome(capsys, monkeypatch, raised, "--json")
    table = json.loads(out)
    assert (returned, table["exit_code"], table["kind"]) == (code, code, kind)
    assert isinstance(table["error"], str)
    assert "\n" not in table["error"]
    assert "Traceback" not in err


def test_an_interruption_that_typer_reports_as_a_number(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(main, "app", lambda *_, **__: 130)
    assert main.run(["run", "SESSION"]) == 130
    assert capsys.readouterr().err.startswith("mammometry: Interrupted: ")


def test_a_defect_shows_its_traceback_only_on_demand(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    _, _, err = outcome(capsys, monkeypatch, RuntimeError("two\nlines"))
    assert "RuntimeError: two. " in err
    assert err.count("\n") == 1
    _, _, err = outcome(capsys, monkeypatch, RuntimeError("oh"), "-v")
    assert "Traceback" in err


def test_an_answer_in_words_as_json_and_not_at_all(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(main, "app", lambda *_, **__: Answer({"a": 1}, ["one [line]"]))
    assert main.run(["x"]) == 0
    assert capsys.readouterr().out == "one [line]\n"
    assert main.run(["x", "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {"a": 1}
    assert main.run(["x", "-q"]) == 0
    assert capsys.readouterr().out == ""


@pytest.mark.parametrize(
    "arguments", [["nonsense"], ["run"], ["run", "SESSION", "--nonsense"], ["new", "S", "--rig", "x"]]
)
def test_usage_errors(capsys: pytest.CaptureFixture[str], arguments: list[str]) -> None:
    assert main.run(arguments) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.startswith("mammometry: ")
    assert main.run([*arguments, "--json"]) == 2
    assert json.loads(capsys.readouterr().out)["exit_code"] == 2


def commands() -> list[str]:
    return [command.name or command.callback.__name__ for command in main.app.registered_commands if command.callback]


def test_the_commands_of_the_issue_are_there() -> None:
    wanted = {"demo", "run", "calibrate", "match", "surface", "measure", "report", "info", "new", "simulate"}
    wanted |= {"import-cameras", "settings"}
    assert wanted <= set(commands())


@pytest.mark.parametrize("command", commands())
def test_every_command_has_help_with_examples(capsys: pytest.CaptureFixture[str], command: str) -> None:
    assert main.run([command, "--help"]) == 0
    printed = capsys.readouterr().out
    assert "Examples:" in printed
    assert f"$ mammometry {command}" in printed
    for option in ("--quiet", "--json", "--verbose"):
        assert option in printed


def test_an_interrupt_while_source_text_runs_has_its_exit_code_too(tmp_path: Path) -> None:
    """Dataclasses and namedtuples run text, and Ctrl-C may come while they are imported."""
    (tmp_path / "interrupted.py").write_text(
        "from mammometry.cli import main\nmain.app = lambda *_, **__: exec('raise KeyboardInterrupt')\nmain.main()\n"
    )
    command = [sys.executable, "-m", "interrupted"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 130
    assert done.stderr.startswith("mammometry: Interrupted")


@pytest.mark.parametrize("verbose", [False, True])
def test_what_c_libraries_write_to_standard_error_is_shown_on_demand_only(tmp_path: Path, verbose: bool) -> None:
    (tmp_path / "chattering.py").write_text(
        "import os\n"
        "from mammometry.base.errors import ImageError\n"
        "from mammometry.cli import main\n"
        "def command(*_, **__):\n"
        "    os.write(2, b'tempfile.tif: Using code not yet in table.\\n')\n"
        "    raise ImageError('a.tif', found='noise', expected='a photograph', remedy='Look again')\n"
        "main.app = command\n"
        "main.main()\n"
    )
    command = [sys.executable, "-m", "chattering", *(["-v"] if verbose else [])]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == ImageError.exit_code
    said = "mammometry: a.tif: found noise, expected a photograph. Look again.\n"
    assert done.stderr == ("tempfile.tif: Using code not yet in table.\n" if verbose else "") + said


def test_help_is_quick_and_imports_nothing_heavy() -> None:
    script = (
        "import sys\nfrom mammometry.cli.main import run\nrun(['--help'])\n"
        "heavy = {'numpy', 'scipy', 'numba', 'cv2', 'pydantic', 'skimage', 'matplotlib'} & set(sys.modules)\n"
        "sys.exit(f'imported {heavy}' if heavy else 0)"
    )
    before = os.times()
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    taken_s = sum(os.times()[2:4]) - sum(before[2:4])  # of children
    assert done.returncode == 0, done.stderr
    assert taken_s < 3  # processor seconds; usually 0.3


def test_the_package_imports_lazily() -> None:
    script = (
        "import sys, mammometry\nassert 'numpy' not in sys.modules\nmammometry.Settings().matching\ndir(mammometry)"
    )
    subprocess.run([sys.executable, "-c", script], check=True)


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    import mammometry

    assert main.run(["--version"]) == 0
    assert capsys.readouterr().out.startswith(f"mammometry {mammometry.__version__} (commit ")


def test_new_makes_a_session_that_opens(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from mammometry.io.session import Session

    folder = tmp_path / "s"
    assert main.run(["new", str(folder), "--rig", "single", "--target", "dotted-cylinder", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["manifest"] == str(folder / "session.toml")
    assert Session.open(folder).pair_names == {"front": ("front_left", "front_right")}
    assert (folder / "capture").is_dir()
    assert main.run(["new", str(folder)]) == 3
    assert str(folder) in capsys.readouterr().err
    assert main.run(["info", str(folder), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["missing"] == ["capture/front_left", "capture/front_right"]
    assert main.run(["info", str(folder)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[-1].endswith(f" {folder / 'capture'}")
    assert not any("observations" in line for line in lines)
    assert main.run(["info", str(folder), "-v"]) == 0
    assert "calibration" in capsys.readouterr().out
    assert main.run(["calibrate", str(folder)]) == 3
    assert capsys.readouterr().err.startswith("mammometry: calibration: found 0 poses")


def test_settings_are_listed_as_toml(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from mammometry.settings import Settings

    assert main.run(["settings", "--set", "matching.window_px=11"]) == 0
    listed = capsys.readouterr().out
    assert Settings.from_toml(listed).matching.window_px == 11
    file = tmp_path / "my.toml"
    file.write_text(listed)
    assert main.run(["settings", "--settings", str(file), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["settings"]["matching"]["window_px"] == 11
    assert main.run(["settings", "--set", "matching.windw=11"]) == 3
    assert "matching.window_px" in capsys.readouterr().err


def test_the_papers_settings_are_printed_as_a_file_that_is_read(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main.run(["settings", "--paper"]) == 0
    file = tmp_path / "paper.toml"
    file.write_text(capsys.readouterr().out, encoding="utf-8")
    assert "# 2.6.2" in file.read_text(encoding="utf-8")
    assert main.run(["settings", "--settings", str(file), "--json"]) == 0
    read = json.loads(capsys.readouterr().out)["settings"]
    assert read["matching"]["vertical"] == "free"
    assert main.run(["settings", "--paper", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["settings"] == read
    assert main.run(["settings", "--paper", "--set", "matching.vertical=polynomial"]) == 2
    assert "--paper" in capsys.readouterr().err


def test_cameras_are_imported_whole_or_not(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "s"
    assert main.run(["new", str(folder), "--rig", "single", "-q"]) == 0
    entry = {
        "K": [[100, 0, 15], [0, 100, 10], [0, 0, 1]],
        "dist": [0, 0, 0, 0, 0],
        "R": [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
        "t": [0, 0, 0],
        "image_size": [30, 20],
    }
    file = tmp_path / "mine.json"
    file.write_text(json.dumps({"cameras": {"front_left": entry}}))
    assert main.run(["import-cameras", str(folder), str(file)]) == 3
    assert "also front_right" in capsys.readouterr().err
    assert not (folder / "cameras.json").exists()
    file.write_text(json.dumps({"cameras": {"front_left": entry, "front_right": {**entry, "t": [-200, 0, 0]}}}))
    assert main.run(["import-cameras", str(folder), str(file), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["cameras"] == ["front_left", "front_right"]
    assert (folder / "cameras.json").is_file()


def test_a_board_is_drawn_as_a_pdf_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main.run(["target", str(tmp_path / "b.png")]) == main.USAGE
    assert ".pdf, found b.png" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
