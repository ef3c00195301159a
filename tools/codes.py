"""Write docs/reference/codes.md: codes of errors and notices, for programs.

python -m tools.codes
"""

from __future__ import annotations

import importlib
from pathlib import Path

from mammometry.base import errors, extras
from mammometry.base.errors import MammometryError
from mammometry.base.notices.texts import TEXTS

PAGE = Path(__file__).resolve().parents[1] / "docs" / "reference" / "codes.md"
_ELSEWHERE = (
    "mammometry.calibration.adjust.initialise:TooFewViewsError",
    "mammometry.calibration.judge.suspects:SuspectPhotographsError",
    "mammometry.io.drawn_changes:LateError",
    "mammometry.measure.scanned:DirectionError",
)
_TOP = """# Codes

`python -m tools.codes` makes this page. Programs decide by codes: a code keeps its meaning, its text may change.

## Errors

With `--json` an error is one object with `code`, `kind`, `exit_code`, `error` (the sentence), `subject`, `found`,
`expected` and `remedy`, and with `details`, a list of single cases, if there are any.

| code | exit code | meaning |
| --- | --- | --- |
"""
_NOTICES = """
## Notices

A notice is a warning or a remark. With `--json`, commands give their notices under `notices`, and the same as text
under `warnings`, `notes` or (`calibrate`) `reasons`. `results/report/warnings.json` has both for the report, in the
same order. A notice has:

| field | content |
| --- | --- |
| `code` | one of the table below |
| `level` | `warning`: it affects the meaning of the volumes; `note`: for information |
| `about` | breasts, cameras or pairs that it concerns |
| `photographs` | photographs that show it, as `capture/CAMERA` or `calibration/POSE/CAMERA` |
| `values` | numbers and names in the text; the name ends with the unit. `scan`: number of a merged scan |

| code | text |
| --- | --- |
"""


def page() -> str:
    """The page's text."""
    found = [kind for module in (errors, extras) for kind in vars(module).values() if isinstance(kind, type)]
    for place in _ELSEWHERE:
        module, _, name = place.partition(":")
        found.append(getattr(importlib.import_module(module), name))
    kinds = {kind.code: kind for kind in found if issubclass(kind, MammometryError) and kind is not MammometryError}
    rows = [
        f"| `{code}` | {kind.exit_code} | {(kind.__doc__ or '').strip().splitlines()[0]} |"
        for code, kind in sorted(kinds.items())
    ]
    notices = [f"| `{code}` | {text.words} |" for code, text in sorted(TEXTS.items())]
    return _TOP + "\n".join(rows) + "\n" + _NOTICES + "\n".join(notices) + "\n"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
