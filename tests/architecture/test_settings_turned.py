"""Every setting is turned somewhere: a test, a benchmark, an example or a how-to names it with its section."""

import ast
import dataclasses
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

from mammometry.settings import Settings, paper_method

FOLDERS = ("tests", "benchmarks", "examples", "docs/how-to")


def names(settings: object, *within: str) -> Iterator[tuple[type, tuple[str, ...]]]:
    """Each single setting: the class of its group, and its path of names."""
    assert dataclasses.is_dataclass(settings)
    for field in dataclasses.fields(settings):
        value = getattr(settings, field.name)
        if dataclasses.is_dataclass(value):
            yield from names(value, *within, field.name)
        else:
            yield type(settings), (*within, field.name)


def given_in_calls(python: str) -> Iterator[tuple[str, str]]:
    """Class or function, and keyword, of each call."""
    for node in ast.walk(ast.parse(python)):
        if isinstance(node, ast.Call):
            name = getattr(node.func, "id", getattr(node.func, "attr", ""))
            yield from ((name, keyword.arg) for keyword in node.keywords if keyword.arg)


def given_in_table(table: dict[str, object], *within: str) -> Iterator[str]:
    """Dotted names of what a TOML table gives."""
    for name, value in table.items():
        if isinstance(value, dict):
            yield from given_in_table(value, *within, name)
        else:
            yield ".".join((*within, name))


def never_turned(settings: object, texts: list[str], pythons: list[str], tables: list[dict[str, object]]) -> list[str]:
    """Settings that nothing names with their section."""
    text = "\n".join([*texts, *pythons])
    groups = {group.__name__ for group, _ in names(settings)}
    naming = [python for python in pythons if any(group in python for group in groups)]  # a third: others need no parse
    calls = {call for python in naming for call in given_in_calls(python)}
    given = {name for table in tables for name in given_in_table(table)}
    return [
        dotted
        for group, path in names(settings)
        if (dotted := ".".join(path)) not in text and dotted not in given and (group.__name__, path[-1]) not in calls
    ]


@dataclasses.dataclass(frozen=True)
class Inner:
    seed: int = 0


@dataclasses.dataclass(frozen=True)
class Outer:
    stillness: Inner = dataclasses.field(default_factory=Inner)


@pytest.mark.parametrize(
    ("texts", "pythons", "tables", "turned"),
    [
        (["`stillness.seed=3`"], [], [], True),
        ([], ["Inner(seed=3)"], [], True),
        ([], [], [{"stillness": {"seed": 3}}], True),
        (["`--seed 3`, the seed of `simulate`"], ["Recipe(seed=3)", "replace(x, seed=3)", "seed = 3"], [], False),
        ([], [], [{"motion": {"seed": 3}}], False),
    ],
)
def test_a_setting_is_turned_where_its_section_is_named(
    texts: list[str], pythons: list[str], tables: list[dict[str, object]], turned: bool
) -> None:
    assert never_turned(Outer(), texts, pythons, tables) == ([] if turned else ["stillness.seed"])


def test_every_setting_is_turned_somewhere(repository: Path) -> None:
    paths = [path for folder in FOLDERS for path in (repository / folder).rglob("*") if path != Path(__file__)]
    read = {
        suffix: [path.read_text(encoding="utf-8") for path in paths if path.suffix == suffix]
        for suffix in (".py", ".md")
    }
    never = never_turned(Settings(), read[".md"], read[".py"], [tomllib.loads(paper_method())])
    assert not never, "\n".join(never)
