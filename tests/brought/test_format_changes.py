"""A machine searches for formats that are read wrongly without a word.

A clean input is changed in its format, not in what it says, and read from a place that people have: odd names, links.
It must give the same numbers, or a sentence that names what was changed; any third outcome is a defect. Every change
of every input is tried once in the slow tests, and then draws of two at a time, 800 in all; a share is drawn by a seed
in every run. MAMMOMETRY_MUTATIONS_SEED starts from another.
"""

import json
import os
import re
import shutil
import tempfile
from functools import cache
from pathlib import Path
from random import Random

import numpy as np
import pytest
from tests.brought.format_changes import CHANGES, Change
from tests.brought.format_inputs import INPUTS, Files, Input

from mammometry.api.mesh import MeshFiles, MeshJob
from mammometry.base.errors import MammometryError

SEED = int(os.environ.get("MAMMOMETRY_MUTATIONS_SEED", "39"))
COUNT, DEFAULT, PARTS = 800, 60, 4
ODD_NAMES = (
    b"plain", b"two words", b"-rf", b"--help", b"caf\xc3\xa9", b"caf\xe9", b"\xff\xfe",
    "乳房".encode(), "צילום".encode(),
    b"a\nb", b"a\tb", b'"', b"'", b"a;b", b"$HOME", b"`id`", b"%s%n", b"{0}", b"[1]", b"*", b"?", b"#1", b"~", b"a\\b",
    b"x" * 200, b"end.", b".hidden", b"a:b", b"a=b", b"&amp;", b"CON", "\u202egpj".encode(), b"\x1b[31m",
)  # fmt: skip
_NOTHING_THERE = "no file|no such|cannot be read|no session.toml|part of a COLMAP"
LINKS = ("none", "none", "none", "file", "folder", "chain")


@cache
def clean(subject: Input) -> tuple[Files, np.ndarray]:
    files = subject.make()
    with tempfile.TemporaryDirectory(prefix="mammometry-") as folder:
        return files, subject.read(written(files, Path(folder)))


def written(files: Files, folder: Path) -> list[Path]:
    paths = []
    for name, content in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
        paths.append(path)
    return [path for path in paths if path.parent == folder]


def placed(files: Files, place: bytes, link: str, folder: Path) -> list[Path]:
    """The files in a folder of this name, by links."""
    there = folder / os.fsdecode(place)
    if link == "none":
        there.mkdir()
        return written(files, there)
    kept = folder / "kept"
    kept.mkdir()
    paths = written(files, kept)
    if link == "folder":
        there.symlink_to(kept, target_is_directory=True)
        return [there / path.name for path in paths]
    there.mkdir()
    for path in kept.iterdir():
        target = path
        if link == "chain":
            target = there / f"{path.name}.link"
            target.symlink_to(path)
        (there / path.name).symlink_to(os.path.relpath(target, there.resolve()))
    return [there / path.name for path in paths]


def outcome(subject: Input, changes: tuple[Change, ...], rng: Random, folder: Path, place: bytes, link: str) -> str:
    """What is wrong, or nothing."""
    files, expected = clean(subject)
    done = f"{subject.name} in {place!r} by link {link}: {', then '.join(change.name for change in changes)}"
    for change in changes:
        files = change.apply(files, rng)
    folder.mkdir()
    try:
        paths = placed(files, place, link, folder)
        read = subject.read(paths)
    except MammometryError as error:
        sentence = str(error)
        about = sentence.replace(str(folder / os.fsdecode(place)), "")
        if not any(re.search(change.words, about) for change in changes):
            return f"{done}\n  refused: {sentence}"
        return "" if "\n" not in sentence else f"{done}\n  more than one line: {sentence}"
    except Exception as error:
        return f"{done}\n  {type(error).__name__}: {error}"
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    relative = subject.tolerance + sum(change.relative for change in changes)
    if read.shape != expected.shape:
        return f"{done}\n  {read.shape} numbers, not {expected.shape}"
    away = float(np.abs(read - expected).max() / np.abs(expected).max())
    return "" if away <= relative else f"{done}\n  numbers differ by {away:.2g} of the largest"


def suiting(subject: Input) -> list[Change]:
    return [change for change in CHANGES if change.suits & subject.kinds]


EVERY = [(subject, (change,)) for subject in INPUTS for change in suiting(subject)]
LETTERS = [change for change in CHANGES if change.suits == {"text"} and not change.name.startswith("UTF-16")]
FORMS = [change for change in CHANGES if not change.suits & {"text", "photograph"} and not change.makes_binary]


def drawn(number: int) -> tuple[Input, tuple[Change, ...]]:
    """Each change of each input once, in a mixed order; then another form, in other letters or lines."""
    order = list(range(len(EVERY)))
    Random(SEED).shuffle(order)
    if number < len(order):
        return EVERY[order[number]]
    rng = Random(f"{SEED} {number}")
    subject = rng.choice([each for each in INPUTS if "text" in each.kinds and set(suiting(each)) & set(FORMS)])
    return subject, (rng.choice([change for change in suiting(subject) if change in FORMS]), rng.choice(LETTERS))


def tried(number: int, folder: Path) -> str:
    rng = Random(f"{SEED} {number} place")
    subject, changes = drawn(number)
    return outcome(subject, changes, rng, folder / str(number), rng.choice(ODD_NAMES), rng.choice(LINKS))


@pytest.mark.requirement("R-IN-2")
def test_some_changes_of_formats_end_in_the_same_numbers_or_their_name(tmp_path: Path) -> None:
    wrong = list(filter(None, (tried(number, tmp_path) for number in range(DEFAULT))))
    assert not wrong, "\n".join(wrong)


@pytest.mark.slow
@pytest.mark.parametrize("part", range(PARTS))
@pytest.mark.requirement("R-IN-2")
def test_eight_hundred_changes_of_formats_end_in_the_same_numbers_or_their_name(tmp_path: Path, part: int) -> None:
    numbers = range(part * COUNT // PARTS, (part + 1) * COUNT // PARTS)
    wrong = list(filter(None, (tried(number, tmp_path) for number in numbers)))
    assert not wrong, "\n".join(wrong)


MESHES = [(subject, change) for subject, (change,) in EVERY if change.suits & {"mesh", "ply", "obj", "stl"}
          and change.words == "(?!)"]  # fmt: skip
"""Every mesh with each change that must not matter."""


def measured_cc(files: Files, folder: Path) -> float:
    """Volume within the dome's rim."""
    (path,) = written(files, folder)
    angle = np.linspace(0, 2 * np.pi, 60, endpoint=False)
    rim = 60 * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    table = {"units": "mm", "frame": "world", "boundaries": {"model": {"points": rim.tolist()}}}
    (folder / "rim.json").write_text(json.dumps(table))
    units = None if path.suffix == ".obj" else "mm"
    job = MeshJob(MeshFiles(mesh=path, units=units, boundary=folder / "rim.json"), folder / "results")
    return float(job.run(report=False).measurements["model"].volume_cc)


@cache
def clean_cc(subject: Input) -> float:
    with tempfile.TemporaryDirectory(prefix="mammometry-") as folder:
        return measured_cc(subject.make(), Path(folder))


@pytest.mark.slow
@pytest.mark.parametrize(("subject", "change"), MESHES, ids=lambda each: each.name)
def test_a_mesh_measures_the_same_in_every_format(tmp_path: Path, subject: Input, change: Change) -> None:
    changed = measured_cc(change.apply(subject.make(), Random(SEED)), tmp_path)
    assert changed == pytest.approx(clean_cc(subject), rel=1e-3)


def test_the_search_covers_every_kind_of_input() -> None:
    assert COUNT > len(EVERY) > 350
    assert all(len(suiting(subject)) >= 1 for subject in INPUTS if subject.name != "matlab")


@pytest.mark.parametrize("subject", INPUTS, ids=lambda subject: subject.name)
@pytest.mark.requirement("R-IN-2")
def test_an_input_is_read_from_a_folder_of_any_name(subject: Input, tmp_path: Path) -> None:
    unchanged = Change(name="nothing", suits=frozenset(), apply=lambda files, rng: files)
    wrong = []
    for number, place in enumerate(ODD_NAMES[INPUTS.index(subject) % 3 :: 3]):  # all of them, by kinds of files
        link = LINKS[number % len(LINKS)]
        wrong.append(outcome(subject, (unchanged,), Random(0), tmp_path / str(number), place, link))
    assert not any(wrong), "\n".join(filter(None, wrong))


@pytest.mark.parametrize("subject", INPUTS, ids=lambda subject: subject.name)
def test_a_link_that_leads_nowhere_is_one_sentence(subject: Input, tmp_path: Path) -> None:
    for target in ("gone", subject.name):  # the second one leads to itself
        folder = tmp_path / target
        folder.mkdir()
        paths = written(subject.make(), folder)
        paths[0].unlink()
        paths[0].symlink_to(folder / ("gone" if target == "gone" else paths[0].name))
        with pytest.raises(MammometryError, match=_NOTHING_THERE):
            subject.read(paths)
