"""Write docs/reference/settings.md and docs/reference/result-fields.md from the fields' docstrings.

python -m tools.fields
"""

from __future__ import annotations

import ast
import inspect
import re
import sys
import textwrap
from collections.abc import Iterator
from dataclasses import Field, fields, is_dataclass
from pathlib import Path
from typing import Any, Literal, get_args, get_origin, get_type_hints

from mammometry.measure.boundary.boundary import TorsoSides
from mammometry.measure.shape.anthropometry import Dimensions
from mammometry.measure.shape.symmetry import Symmetry
from mammometry.measure.trunk.body import BodyDirections
from mammometry.measure.volume.measurement import VolumeDeficit, VolumeMeasurement
from mammometry.settings import RANGES, Settings

REFERENCE = Path(__file__).resolve().parents[1] / "docs" / "reference"
SETTINGS, RESULTS = REFERENCE / "settings.md", REFERENCE / "result-fields.md"
FILES: dict[str, tuple[type, str]] = {
    "measurement.json": (VolumeMeasurement, "One object per breast, under `measurements` and the breast's name."),
    "symmetry.json": (Symmetry, "Under `symmetry`. Null if only one breast was measured."),
    "dimensions.json": (Dimensions, "Under `dimensions`."),
    "lacking.json": (VolumeDeficit, "A list under `lacking`. Empty if no mirror plane was found."),
    "body.json": (BodyDirections, "Under `body`. Torsos only."),
    "sides.json": (TorsoSides, "Under `sides`. Torsos whose boundaries were found automatically."),
}
"""File in results/measure → the class it stores, and where its object is in the file."""
_TOP_OF_SETTINGS = """# Settings

`python -m tools.fields` makes this page. Change a setting for one command with `--set matching.window_px=11`, or for
several with a TOML file and `--settings`. In the file, each stage is a table:

```toml
[matching]
window_px = 11

[surface.extract]
cube_mm = 0.5
```

`mammometry settings` prints all settings with their values as such a file. The defaults are recommended. Every report
lists the settings that differ from them.

A settings file stays valid until the next major version: all names and allowed values are kept. Defaults may change;
the changelog says so. Settings files of 1.0 that name a setting that is now a constant are accepted if they give its
value, and refused otherwise.

"""
_TOP_OF_RESULTS = """# Fields of the result files

`python -m tools.fields` makes this page. The files are in `results/measure`; [the session folder](../session-folder.md)
has all others. Each has `format` (1), and all but `measurement.json` also `units` and `frame`. The `.npz` or `.ply`
next to the file has the meshes and the arrays of more than 36 numbers.
"""


def settings_page() -> str:
    """One table of all settings, by stage."""
    lines = [_TOP_OF_SETTINGS.rstrip()]
    for stage in fields(Settings):
        lines += ["", f"## {stage.name}", "", "| setting | default | allowed | meaning |", "| --- | --- | --- | --- |"]
        lines += [
            f"| `{name}` | `{_shown(default)}` | {_allowed(name, hint, default)} | {meaning} |"
            for name, default, hint, meaning in settings_below(getattr(Settings(), stage.name), stage.name)
        ]
    return "\n".join(lines) + "\n"


def settings_below(group: Any, prefix: str) -> Iterator[tuple[str, Any, Any, str]]:
    """Dotted name, default, type and meaning of each setting."""
    words, hints = field_words(type(group)), get_type_hints(type(group))
    for item in fields(group):
        value, name = getattr(group, item.name), f"{prefix}.{item.name}"
        if is_dataclass(value):
            yield from settings_below(value, name)
        else:
            yield name, value, hints[item.name], words[item.name]


def results_page() -> str:
    """A table for each result file."""
    lines = [_TOP_OF_RESULTS.rstrip()]
    for file, (kind, where) in FILES.items():
        lines += ["", f"## {file}", "", where, "", "| field | meaning |", "| --- | --- |"]
        lines += [f"| `{name}` | {meaning} |" for name, meaning in result_fields(kind)]
    return "\n".join(lines) + "\n"


def result_fields(kind: type, prefix: str = "") -> Iterator[tuple[str, str]]:
    """Name and meaning of each stored field; those of inner objects follow with a dot."""
    words = field_words(kind)
    for item in fields(kind):  # type: ignore[arg-type]  # callers pass dataclasses
        if not item.init or "TriangleMesh" in str(item.type):
            continue
        inside = _dataclasses_in(item, kind)
        otherwise = _one_line(" ".join((cls.__doc__ or "").split("\n\n")[0] for cls in inside))
        yield f"{prefix}{item.name}", words.get(item.name) or otherwise
        for inner in inside:
            yield from result_fields(inner, f"{prefix}{item.name}.")


def _dataclasses_in(item: Field[Any], kind: type) -> list[type]:
    """Dataclasses that a field's annotation names."""
    known = vars(sys.modules[kind.__module__])
    named = [known.get(word) for word in re.findall(r"\w+", str(item.type))]
    return [cls for cls in named if isinstance(cls, type) and is_dataclass(cls)]


def field_words(kind: type) -> dict[str, str]:
    """Field → its docstring on one line, inherited ones included. Fields before a docstring share it."""
    words: dict[str, str] = {}
    for base in reversed(kind.__mro__):
        if not is_dataclass(base) or base.__module__ not in sys.modules:
            continue
        body = ast.parse(textwrap.dedent(inspect.getsource(base))).body[0]
        assert isinstance(body, ast.ClassDef)
        waiting: list[str] = []
        for statement in body.body:
            if isinstance(statement, ast.AnnAssign) and isinstance(statement.target, ast.Name):
                waiting.append(statement.target.id)
            elif isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant):
                words |= dict.fromkeys(waiting, _one_line(str(statement.value.value)))
                waiting = []
    return words


def _one_line(text: str) -> str:
    return re.sub(r"\s+", " ", text).replace("``", "`").replace("|", "\\|").replace("<", "&lt;").strip()


def _shown(value: Any) -> str:
    return repr(list(value) if isinstance(value, tuple) else value).replace("'", '"').replace("True", "true").replace(
        "False", "false"
    )  # fmt: skip


def _allowed(name: str, hint: Any, default: Any) -> str:
    if get_origin(hint) is Literal:
        return ", ".join(f"`{choice}`" for choice in get_args(hint))
    if hint is bool:
        return "`true`, `false`"
    for wanted in (name, f"{name.rpartition('.')[0]}.*"):
        if wanted in RANGES:
            low, high = RANGES[wanted]
            outside = isinstance(default, float) and not low <= default <= high
            return f"{low:g} to {high:g}{f', or {default:g}' if outside else ''}"
    return "the name of a wall"


if __name__ == "__main__":
    SETTINGS.write_text(settings_page(), encoding="utf-8")
    RESULTS.write_text(results_page(), encoding="utf-8")
