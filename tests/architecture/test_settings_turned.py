"""Every setting is turned somewhere: a test, a benchmark or an example shows what it does."""

import dataclasses
import re
from collections.abc import Iterator
from pathlib import Path

from mammometry.settings import Settings


def names(settings: object, *within: str) -> Iterator[tuple[str, ...]]:
    """Path of names to each single setting."""
    assert dataclasses.is_dataclass(settings)
    for field in dataclasses.fields(settings):
        value = getattr(settings, field.name)
        if dataclasses.is_dataclass(value):
            yield from names(value, *within, field.name)
        else:
            yield (*within, field.name)


def given(text: str) -> set[str]:
    """Names that a text gives a value or quotes."""
    return set(re.findall(r"\b(\w+)(?:=|\s=\s|\"|')", text))


def is_turned(path: tuple[str, ...], text: str, values: set[str]) -> bool:
    """Whether a text gives a value to a setting, or names it from the top."""
    return path[-1] in values or ".".join(path) in text


def test_a_turned_setting_is_recognised() -> None:
    path = ("surface", "extract", "cube_mm")
    for text in ("X(cube_mm=1)", 'f"cube_mm"', "cube_mm = 1", "`surface.extract.cube_mm`"):
        assert is_turned(path, text, given(text))
    for text in ("settings.cube_mm", "cube_mmm=1", "cube_mm == 1"):
        assert not is_turned(path, text, given(text))


def test_every_setting_is_turned_somewhere(repository: Path) -> None:
    texts = [
        path.read_text(encoding="utf-8")
        for folder in ("tests", "benchmarks", "docs/how-to")
        for path in (repository / folder).rglob("*")
        if path.suffix in (".py", ".md", ".toml")
    ]
    text = "\n".join(texts)
    values = given(text)
    never = [".".join(path) for path in names(Settings()) if not is_turned(path, text, values)]
    assert not never, "\n".join(never)
