"""Commands where people run them: no room, a disk that may only be read, a computer without UTF-8, links as folders.

Each ends in success or in one sentence that says why, with one of our exit codes.
"""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from tests.brought.format_inputs import INPUTS, MANIFEST, Input

BY_NAME = {subject.name: subject for subject in INPUTS}
COMMANDS = {
    "import-cameras": ("kalibr", ["import-cameras", "{out}", "{in}"]),
    "agreement": (
        "agreement",
        ["study", "agreement", "{in}", "--reference", "water_cc", "--measured", "imaging_cc", "--out", "{out}"],
    ),
    "import-mesh": ("obj", ["import", "mesh", "{in}", "--scanner", "Test", "--out", "{out}"]),
    "new": ("session", ["new", "{out}/new", "--target", "charuco", "--subject", "model"]),
}
"""Name → its input, and what it is called with. ``{out}`` is the place that is made difficult."""
TARGET = b"caf\xe9 \xe2\x82\xac"
"""Name of a folder as no encoding has it."""


def arranged(folder: Path, name: str) -> tuple[list[str], Path]:
    """The command's words, and its folder for results."""
    subject: Input = BY_NAME[COMMANDS[name][0]]
    for file, content in subject.make().items():
        path = folder / file
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
    out = folder / "out"
    out.mkdir()
    if name == "import-cameras":
        (out / "session.toml").write_text(MANIFEST)
    first = folder / next(iter(subject.make()))
    return [word.format(out=out, **{"in": first}) for word in COMMANDS[name][1]], out


def run(words: list[str], *, before: str = "", **environment: str) -> tuple[int, str]:
    """Exit code and what was said, of a command that may first change what its own process sees mounted."""
    command = [sys.executable, "-m", "mammometry", *words, "--quiet"]
    given = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))} | environment
    if before:
        command = ["unshare", "-rm", "sh", "-c", f'{before} && exec "$@"', "sh", *command]
    ended = subprocess.run(command, capture_output=True, env=given, check=False)
    return ended.returncode, ended.stderr.decode("utf-8", "backslashreplace")


def require_one_sentence(code: int, said: str, words: str) -> None:
    assert 3 <= code <= 9, said
    assert said.startswith("mammometry: "), said
    assert said.count("\n") == 1, said
    assert words in said, said


@pytest.fixture(scope="session")
def can_mount(tmp_path_factory: pytest.TempPathFactory) -> None:
    place = tmp_path_factory.mktemp("mount")
    if run(["settings"], before=f"mount -t tmpfs none {place}")[0] != 0:
        pytest.skip("mounting is not permitted here")


@pytest.mark.slow
@pytest.mark.usefixtures("can_mount")
@pytest.mark.parametrize("name", COMMANDS)
@pytest.mark.requirement("R-IN-3")
def test_a_disk_without_room_is_said(tmp_path: Path, name: str) -> None:
    words, out = arranged(tmp_path, name)
    steps = [f"mount -t tmpfs -o size=8k none {out}"]
    if name == "import-cameras":
        (tmp_path / "kept.toml").write_text(MANIFEST)
        steps.append(f"cp {tmp_path}/kept.toml {out}/session.toml")
    steps.append(f"(head -c 99999 /dev/zero > {out}/full 2> {tmp_path}/why || true)")
    code, said = run(words, before=" && ".join(steps))
    require_one_sentence(code, said, "no room")


@pytest.mark.slow
@pytest.mark.usefixtures("can_mount")
@pytest.mark.parametrize("name", COMMANDS)
@pytest.mark.requirement("R-IN-3")
def test_a_disk_that_may_only_be_read_is_said(tmp_path: Path, name: str) -> None:
    words, out = arranged(tmp_path, name)
    code, said = run(words, before=f"mount --bind {out} {out} && mount -o remount,ro,bind {out}")
    require_one_sentence(code, said, "ead-only")


@pytest.mark.slow
@pytest.mark.parametrize("name", COMMANDS)
@pytest.mark.parametrize("coerced", ["0", "1"])
@pytest.mark.requirement("R-IN-3")
def test_a_computer_without_utf_8_does_the_same(tmp_path: Path, name: str, coerced: str) -> None:
    """As cron, a container or an old remote shell sets it."""
    place = tmp_path / os.fsdecode(TARGET)
    place.mkdir()
    words, _ = arranged(place, name)
    code, said = run(words, LC_ALL="C", PYTHONCOERCECLOCALE=coerced, PYTHONUTF8=coerced)
    assert code == 0, said


@pytest.mark.slow
@pytest.mark.parametrize("name", COMMANDS)
def test_a_folder_that_is_a_link_is_followed(tmp_path: Path, name: str) -> None:
    words, out = arranged(tmp_path, name)
    kept = tmp_path / "another disk"
    out.rename(kept)
    out.symlink_to(kept, target_is_directory=True)
    code, said = run(words)
    assert code == 0, said
    assert any(kept.iterdir())
    assert out.is_symlink()
