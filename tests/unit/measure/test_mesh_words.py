"""What can be refused while a mesh is measured is said in words of a mesh: it has no session, rig or cameras."""

import ast
import re
from collections.abc import Collection
from pathlib import Path

import pytest

import mammometry.measure

OF_PHOTOGRAPHS = re.compile(
    r"camera|session|\brigs?\b|photograph|mounting|\bpairs?\b|wall\.ply|silhouette|boundaries\.json|preview",
    re.IGNORECASE,
)
RIM_IN_PHOTOGRAPHS = {"_cast_boundary", "no_rim", "require_separate"}
"""Functions that look for a cast's rim in photographs. On a mesh it is drawn."""


def words(*nodes: ast.AST) -> str:
    return " ".join(
        part.value
        for node in nodes
        for part in ast.walk(node)
        if isinstance(part, ast.Constant) and isinstance(part.value, str)
    )


DRAWN = {"check_curve"}
"""Functions that check a curve that somebody drew, and no boundary that was found."""


def refusals(without: Collection[str] = RIM_IN_PHOTOGRAPHS) -> list[tuple[str, str]]:
    """Place and words of every refusal of the measurement, as a mesh gets them, but those of some functions."""
    found = []
    root = Path(mammometry.measure.__file__).parent
    for path in sorted(root.rglob("*.py")):
        functions = [node for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.FunctionDef)]
        for function in functions:
            for call in ast.walk(function):
                given = {each.arg: each.value for each in call.keywords} if isinstance(call, ast.Call) else {}
                if not {"found", "expected", "remedy"} <= given.keys() or function.name in without:
                    continue
                given["remedy"] = given.pop("mesh_remedy", given["remedy"])
                found.append((f"{path.relative_to(root)}:{call.lineno}", words(*call.args, *given.values())))
    return found


def test_no_refusal_of_a_mesh_speaks_of_photographs() -> None:
    table = refusals()
    assert len(table) > 50
    assert [(place, text) for place, text in table if OF_PHOTOGRAPHS.search(text)] == []


@pytest.mark.slow
def test_only_who_drew_a_boundary_is_asked_to_draw_it_again() -> None:
    """With --automatic nobody has drawn one. The same refusals serve sessions, whose boundaries are found too."""
    again = re.compile(r"redraw|draw (it|the boundary) again", re.IGNORECASE)
    assert [place for place, text in refusals(DRAWN) if again.search(text)] == []
    assert any(again.search(text) for _, text in refusals(()))  # the table would show it
