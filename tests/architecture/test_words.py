"""Values, functions, classes and modules bear the field's names, not words that a reader has to look up."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.architecture.test_imports import modules, nodes, syntax

BETTER = {
    "each": "what it is one of: camera, pair, row",
    "told": "what it holds",
    "said": "sentence, lines or reason",
    "asked": "what was asked for",
    "apart_mm": "distance_mm",
    "handed_down": "upsampled",
    "find_blocked": "find_occlusions",
    "unblocked": "without_occluded",
    "answered": "json_view",
    "Blocked": "Occlusion",
    "Desk": "DrawingSession",
    "Door": "OneTimeLogin",
    "Each": "MapTasks",
    "Fired": "CaptureResult",
    "Lacking": "VolumeDeficit",
    "Posed": "PoseResult",
    "Names": "PhotographCheck",
    "Rigged": "OpenRig",
    "Stand": "CameraService",
    "Tell": "StageProgress",
    "Unknowns": "MotionParameters",
    "Wish": "StopRequest",
}
"""Name that the code once had → what stands there now."""
MODULES = {
    "belief", "beside", "carried", "desk", "door", "holds", "keep", "keeping", "occluders", "past_edges",
    "second_process", "slits", "stand", "standing", "workplace",
}  # fmt: skip
"""Names that modules once had."""


def bound(tree: ast.AST) -> Iterator[tuple[int, str]]:
    """Line and name of all that a module defines: classes, functions, parameters, values."""
    for node in nodes(tree):
        if isinstance(node, ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            yield node.lineno, node.name
        elif isinstance(node, ast.arg):
            yield node.lineno, node.arg
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.lineno, node.id


@pytest.mark.parametrize(
    ("source", "names"),
    [
        ("for each in rows: pass", ["each"]),
        ("def told(asked, *, said): pass", ["asked", "said", "told"]),
        ("class Wish: pass", ["Wish"]),
        ("camera = [each.name for each in cameras]", ["each"]),
        ("row = table.asked", []),
    ],
)
def test_names_of_our_own_are_recognised(source: str, names: list[str]) -> None:
    assert sorted(name for _, name in bound(ast.parse(source)) if name in BETTER) == names


def test_names_are_the_fields(repository: Path) -> None:
    paths = modules(repository)
    assert len(paths) > 400
    wrong = [
        f"{path.relative_to(repository)}:{line} {name}: rather {BETTER[name]}"
        for path in paths
        for line, name in bound(syntax(path))
        if name in BETTER
    ]
    wrong += [str(path.relative_to(repository)) for path in paths if path.stem in MODULES]
    assert not wrong, "\n".join(wrong)
