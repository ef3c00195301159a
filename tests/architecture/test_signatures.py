"""Functions take few parameters: more become a frozen value with field names."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.architecture.test_imports import modules, nodes, syntax

MOST_PARAMETERS = 7
"""Of a function, `self` aside (CONTRIBUTING.md)."""

KERNELS = ("kernel", "fast_kernel")
"""Decorators of compiled functions: these take arrays and numbers only."""
COMMANDS = "mammometry.cli."
"""Package whose functions' parameters are the options of a command."""


def parameters(function: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    """Number of a function's parameters, without `self` and `cls`."""
    arguments = function.args
    named = [*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs]
    gathered = [one for one in (arguments.vararg, arguments.kwarg) if one is not None]
    return len([one for one in named if one.arg not in ("self", "cls")]) + len(gathered)


def longer(path: Path) -> Iterator[str]:
    """Names of a module's functions with too many parameters, kernels aside, nested ones with them."""
    for node in nodes(syntax(path)):
        if not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            continue
        decorators = {name.id for each in node.decorator_list for name in ast.walk(each) if isinstance(name, ast.Name)}
        if decorators.isdisjoint(KERNELS) and parameters(node) > MOST_PARAMETERS:
            yield node.name


def test_parameters_of_every_kind_are_counted() -> None:
    (function,) = ast.parse("def f(self, a, /, b, *c, d, **e): ...").body
    assert isinstance(function, ast.FunctionDef)
    assert parameters(function) == 5


@pytest.mark.parametrize(("decorator", "found"), [("", ["f"]), ("@kernel", []), ("@other(parallel=True)", ["f"])])
def test_only_kernels_are_left_out(tmp_path: Path, decorator: str, found: list[str]) -> None:
    path = tmp_path / "module.py"
    path.write_text(f"{decorator}\ndef f(a, b, c, d, e, g, h, i): ...\n")
    assert list(longer(path)) == found


def test_functions_take_seven_parameters_at_most(repository: Path) -> None:
    found = set()
    for path in modules(repository):
        module = ".".join(path.relative_to(repository / "src").with_suffix("").parts)
        if not module.startswith(COMMANDS):
            found |= {f"{module}.{name}" for name in longer(path)}
    assert not found, sorted(found)
