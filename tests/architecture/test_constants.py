"""Numbers at the top of a module say what they are."""

import ast
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import pytest
from tests.architecture.test_imports import modules, syntax


def is_number(node: ast.expr) -> bool:
    """Whether an expression is a number, several of them, or computed from numbers alone."""
    match node:
        case ast.Constant(value=value):
            return isinstance(value, int | float) and not isinstance(value, bool)
        case ast.UnaryOp(operand=operand):
            return is_number(operand)
        case ast.BinOp(left=left, right=right):
            return is_number(left) and is_number(right)
        case ast.Tuple(elts=parts) | ast.List(elts=parts):
            return bool(parts) and all(map(is_number, parts))
    return False


def unexplained(text: str, body: list[ast.stmt]) -> Iterator[tuple[int, str]]:
    """Line and source of each number at the top of a module that has neither a comment nor a docstring.

    One docstring may explain several numbers on the lines right above it.
    """
    lines = text.splitlines()
    for place, node in enumerate(body):
        if not isinstance(node, ast.Assign | ast.AnnAssign) or node.value is None or not is_number(node.value):
            continue
        above = lines[node.lineno - 2].startswith("#") if node.lineno > 1 else False
        beside = any("  # " in line for line in lines[node.lineno - 1 : node.end_lineno])
        if not (above or beside or _has_docstring(body[place:])):
            yield node.lineno, ast.unparse(node)


def _has_docstring(statements: list[ast.stmt]) -> bool:
    """Whether assignments without a gap, the first one among them, end in a docstring."""
    for node, following in pairwise(statements):
        if following.lineno != (node.end_lineno or node.lineno) + 1:
            return False
        if isinstance(following, ast.Expr):
            return isinstance(following.value, ast.Constant) and isinstance(following.value.value, str)
        if not isinstance(following, ast.Assign | ast.AnnAssign):
            return False
    return False


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("_A_MM = 3.0", [1]),
        ("_A_MM = 3.0  # radius of the ball", []),
        ("# Radius of the ball, mm.\n_A_MM = 3.0", []),
        ('_A_MM = 3.0\n"""Radius of the ball."""', []),
        ('_A_MM = 3.0\n_B_MM = 4.0\n"""Radii of both balls."""', []),
        ('_A_MM = 3.0\n\n_B_MM = 4.0\n"""Radius of the other ball."""', [1]),
        ("_A, _B = 1 << 20, -2.0", [1]),
        ("_NAME = 'ball'\n_ON = True", []),
    ],
)
def test_an_unexplained_number_is_recognised(text: str, found: list[int]) -> None:
    assert [line for line, _ in unexplained(text, ast.parse(text).body)] == found


def test_numbers_say_what_they_are(repository: Path) -> None:
    bare = [
        f"{path.relative_to(repository)}:{line}: {source}"
        for path in modules(repository)
        for line, source in unexplained(path.read_text(encoding="utf-8"), syntax(path).body)
    ]
    assert not bare, "\n".join(bare)
