"""Breasts whose true volume is known by another method, measured by every definition of the volume.

```python
from mammometry.api.validation import read_cases
from mammometry.study.validation.study import validation

kind, cases = read_cases("specimens.csv")
found = validation(cases, kind)
```
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

from mammometry.api.job import open_session
from mammometry.base.errors import SessionError
from mammometry.base.progress import Progress, no_progress
from mammometry.io.truth_tables import TruthRow, read_truths
from mammometry.measure.volume.measurement import VolumeMeasurement
from mammometry.settings import Settings
from mammometry.study.validation.study import ValidationCase


def read_cases(
    path: Path | str, settings: Settings | None = None, *, kind: str | None = None, progress: Progress = no_progress
) -> tuple[str, tuple[ValidationCase, ...]]:
    """Read a table of true volumes, and the measured ones from the table or from folders of results.

    Missing results are computed first.

    Args:
        path: see `read_truths`.
        settings: settings of all stages; None for the defaults.
        kind: kind of truth; None: by the table's columns.
        progress: called with the fraction of rows that are read.

    Returns:
        Kind of truth, and one case for each breast.

    Raises:
        MammometryError: the table, a folder or its measurement is refused.
    """
    chosen, rows = read_truths(Path(path), kind)
    cases = []
    for number, row in enumerate(rows):
        cases.append(
            ValidationCase(
                woman=row.woman,
                side=row.side,
                truth_cc=row.truth.volume_cc,
                truth_sd_cc=row.truth.sd_cc,
                measured_cc={**row.measured_cc, **(_of_folder(row, row.folder, settings) if row.folder else {})},
            )
        )
        progress((number + 1) / len(rows))
    return chosen, tuple(cases)


def _of_folder(row: TruthRow, folder: Path, settings: Settings | None) -> Mapping[str, float]:
    job = open_session(folder, settings)
    job.ensure("measure")
    found = job.measure()
    name = row.side or (next(iter(found)) if len(found) == 1 else "")
    if name not in found:
        raise SessionError(
            str(folder),
            found=f"volumes of {', '.join(found) or 'nothing'}",
            expected=f"one of the {name} breast" if name else "a side in the table",
            remedy="Correct the column side of the table, or the folder",
        )
    return dict(volumes_of(found[name]))


def volumes_of(measured: VolumeMeasurement) -> Iterator[tuple[str, float]]:
    """Yield every definition of a breast's volume, cc: its meanings, then the walls."""
    meanings = [(str(one.meaning), one.volume_cc) for one in measured.definitions]
    yield from meanings or [(f"wall {measured.wall_kind}", measured.volume_cc)]
    yield from ((f"wall {name}", volume) for name, volume in measured.alternatives_cc.items())
