"""First lines of public docstrings: one whole sentence of at most 100 characters, in the field's terms."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.architecture.test_imports import modules, syntax

MOST_CHARACTERS = 100
"""Of a first line, which is one whole sentence."""
OF_OUR_OWN = re.compile(
    r"\b(told|untold|anew|thereof|whereof|hence|thence|whence|lest|nought|manieth|that which|before two|believed|"
    r"handed down|stood still up to|avoid)\b"
)
"""Archaic words and words of our own that the docstrings once had where the field has a term."""


def documented(path: Path) -> Iterator[tuple[str, int, str]]:
    """Name, line and docstring of a module's own docstring and those of its classes and functions."""

    def visit(node: ast.AST, name: str) -> Iterator[tuple[str, int, str]]:
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            text = ast.get_docstring(node)
            if text:
                yield name, getattr(node, "lineno", 1), text
        for child in getattr(node, "body", ()):
            if isinstance(child, ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
                yield from visit(child, child.name)

    yield from visit(syntax(path), path.stem)


def wrong_with(text: str) -> str | None:
    """What is wrong with a docstring's first line, in words. None if it is right."""
    first = text.partition("\n")[0]
    if len(first) > MOST_CHARACTERS:
        return f"{len(first)} characters"
    if ";" in first:
        return "two thoughts"
    if re.match(r"[a-z]+ ", first):
        return "no capital letter"
    if first[-1:] not in ".?:":
        return "no whole sentence"
    if word := OF_OUR_OWN.search(first):
        return f"“{word[0]}”"
    return None


@pytest.mark.parametrize(
    ("text", "wrong"),
    [
        ("Outlines of the subjects, one per camera.", None),
        ("Outlines of the subjects.\n\nA second paragraph may be long, with several sentences; this one is.", None),
        ("Skin that was seen of the whole subject, where that is known already. " + "x" * 40 + ".", "111 characters"),
        ("Read a mesh; None without one.", "two thoughts"),
        ("Masks, told by the session.", "“told”"),
        ("How far each match is believed.", "“believed”"),
        ("masks of the session.", "no capital letter"),
        ("Masks of the session", "no whole sentence"),
    ],
)
def test_a_wrong_first_line_is_recognised(text: str, wrong: str | None) -> None:
    assert wrong_with(text) == wrong


def test_first_lines_are_short_and_plain(repository: Path) -> None:
    wrong, seen = [], 0
    for path in modules(repository):
        for name, line, text in documented(path):
            if name.startswith("_") and name != "__init__":
                continue
            seen += 1
            if said := wrong_with(text):
                wrong.append(f"{path.relative_to(repository)}:{line} {name}: {said}")
    assert seen > 1000
    assert not wrong, "\n".join(wrong)
