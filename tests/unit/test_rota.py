"""Slow tests in turn: none is forgotten, shares take alike, and the table of seconds names tests that there are."""

import ast
from pathlib import Path

import pytest
from tests.rota import SHARES, chosen, longest_first, recorded, turn

SECONDS = recorded()
KNOWN = [(name, [name]) for name in SECONDS if "::" in name]
UNKNOWN = [(f"test_{number:02d}", [f"test_{number:02d}"]) for number in range(40)]


def test_as_many_runs_in_a_row_as_there_are_shares_take_each_test_once() -> None:
    taken = [name for run in range(1213, 1213 + SHARES) for name in chosen(KNOWN + UNKNOWN, turn(f"{run}"))]
    assert sorted(taken) == sorted(name for name, _ in KNOWN + UNKNOWN)


def test_shares_take_alike() -> None:
    """Longest first, no share exceeds the mean by more than the longest of its tests."""
    shares = [sum(SECONDS[name] for name in chosen(KNOWN, run)) for run in range(SHARES)]
    longest = max(SECONDS[name] for name, _ in KNOWN)
    assert max(shares) <= max(1.1 * sum(shares) / SHARES, longest)


def test_a_new_test_moves_no_other_one() -> None:
    before = [chosen(KNOWN + UNKNOWN, run) for run in range(SHARES)]
    after = [chosen([*KNOWN, ("new", ["new"]), *UNKNOWN], run) for run in range(SHARES)]
    assert [share - {"new"} for share in after] == before


def test_cases_of_a_group_take_their_turn_together() -> None:
    name, other = KNOWN[0][0], KNOWN[1][0]
    groups = [("together", [f"{name}[1]", f"{name}[2]", other]), *KNOWN[2:]]
    assert sum("together" in chosen(groups, run) for run in range(SHARES)) == 1


@pytest.mark.parametrize("text", ["a", "3/5", "-1", ""])
def test_nonsense_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="number"):
        turn(text)


def test_long_files_begin_and_others_keep_their_order() -> None:
    files = [name for name in reversed(SECONDS) if "::" not in name]
    by_seconds = sorted(files, key=lambda name: -SECONDS[name])
    assert list(longest_first(["b.py", *files, "a.py", "b.py"])) == [*by_seconds, "b.py", "a.py"]


def _slow_functions(path: Path) -> set[str]:
    """Tests of a file that are slow, or some of whose cases are."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    functions = [node for node in tree.body if isinstance(node, ast.FunctionDef)]
    tests = [one for one in functions if one.name.startswith("test_")]
    if any(isinstance(node, ast.Assign) and "pytestmark" in ast.unparse(node) and "mark.slow" in ast.unparse(node)
           for node in tree.body):  # fmt: skip
        return {one.name for one in tests}
    marking = {one.name for one in functions if one not in tests and "mark.slow" in ast.unparse(one)}
    marks = {one.name: [ast.unparse(mark) for mark in one.decorator_list] for one in tests}
    words = ("mark.slow", "first(")  # the second: tests/first_cases.py
    slow = {name for name, found in marks.items() if any(word in mark for mark in found for word in words)}
    slow |= {name for name, found in marks.items() if marking & set(found)}
    return slow | {one.name for one in tests if marking & {each.arg for each in one.args.args}}  # its fixture's cases


def test_the_table_names_slow_tests_and_files_that_there_are(repository: Path) -> None:
    """A test that was renamed, or is no longer slow, leaves the table; a new one may be missing."""
    files = {name.partition("::")[0] for name in SECONDS}
    there = {file: _slow_functions(repository / file) for file in files if (repository / file).is_file()}
    stale = [name for name in SECONDS for file, _, function in [name.partition("::")]
             if file not in there or (function and function not in there[file])]  # fmt: skip
    assert stale == []
