"""What can be refused while a mesh is measured is said in words of a mesh: it has no session, rig or cameras."""

import ast
import re
from pathlib import Path

import mammometry.measure

OF_PHOTOGRAPHS = re.compile(
    r"camera|session|\brigs?\b|photograph|mounting|\bpairs?\b|wall\.ply|silhouette|boundaries\.json|preview",
    re.IGNORECASE,
)
RIM_IN_PHOTOGRAPHS = {"_cast_boundary", "no_rim"}
"""Functions that look for a cast's rim in photographs. On a mesh it is drawn."""


def words(*nodes: ast.AST) -> str:
    return " ".join(
        part.value
        for node in nodes
        for part in ast.walk(node)
        if isinstance(part, ast.Constant) and isinstance(part.value, str)
    )


def refusals() -> list[tuple[str, str]]:
    """Place and words of every refusal of the measurement, as a mesh gets them."""
    found = []
    root = Path(mammometry.measure.__file__).parent
    for path in sorted(root.rglob("*.py")):
        functions = [node for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.FunctionDef)]
        for function in functions:
            for call in ast.walk(function):
                given = {each.arg: each.value for each in call.keywords} if isinstance(call, ast.Call) else {}
                if not {"found", "expected", "remedy"} <= given.keys() or function.name in RIM_IN_PHOTOGRAPHS:
                    continue
                given["remedy"] = given.pop("mesh_remedy", given["remedy"])
                found.append((f"{path.relative_to(root)}:{call.lineno}", words(*call.args, *given.values())))
    return found


def test_no_refusal_of_a_mesh_speaks_of_photographs() -> None:
    table = refusals()
    assert len(table) > 50
    assert [(place, text) for place, text in table if OF_PHOTOGRAPHS.search(text)] == []
