"""Repeated captures of the same women, from a table or from folders of results.

```python
from mammometry.api.repeatability import read_captures
from mammometry.study.repeatability.study import repeatability

found = repeatability(read_captures("study"))
```
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from mammometry.api.job import Job, open_session
from mammometry.base.errors import SessionError
from mammometry.base.listing import visible
from mammometry.base.progress import Progress, no_progress
from mammometry.io.meshes.measured import can_be_opened
from mammometry.io.repeated_tables import RepeatedFolder, read_repeated
from mammometry.job.stages import measure
from mammometry.settings import Settings
from mammometry.study.repeatability.design import Reading

LEVELS = {2: ("woman", "capture"), 3: ("woman", "rater", "capture"), 4: ("woman", "device", "rater", "capture")}
"""Depth of the folders → what each level names, unless the user states it."""
_NAMES = ("woman", "device", "rater", "day", "capture")
_LENGTHS = ("SN-N", "N-N")
"""Lengths whose spread shows posture, breath and arms: sternal notch to nipple, nipple to nipple."""


def read_captures(
    source: Path | str,
    settings: Settings | None = None,
    *,
    measured: str | None = None,
    levels: Sequence[str] = (),
    progress: Progress = no_progress,
) -> tuple[Reading, ...]:
    """Read repeated captures. Missing results are computed first.

    Args:
        source: a table (see `read_repeated`), or a folder of folders: WOMAN/CAPTURE, WOMAN/RATER/CAPTURE or
            WOMAN/DEVICE/RATER/CAPTURE, where each CAPTURE is a session or a scan.
        settings: settings of all stages; None for the defaults.
        measured: column of the volumes in a table.
        levels: what the levels of folders name: woman, device, rater, day, capture. Empty: by their depth, as above.
        progress: called with the fraction of folders that are read.

    Raises:
        MammometryError: the table, a folder, or the measurement of a folder is refused.
    """
    path = Path(source)
    found: Sequence[Reading | RepeatedFolder] = (
        tuple(_folders(path, levels)) if path.is_dir() else read_repeated(path, measured)
    )
    read: list[Reading] = []
    for number, one in enumerate(found):
        read += [one] if isinstance(one, Reading) else _readings(one, settings)
        progress((number + 1) / len(found))
    return tuple(read)


def _folders(path: Path, levels: Sequence[str]) -> Iterator[RepeatedFolder]:
    found = list(_captures(path, ()))
    depths = {len(names) for _, names in found}
    if len(depths) != 1:
        raise SessionError(
            str(path),
            found=f"sessions and scans at {len(depths)} depths" if found else "no session and no scan",
            expected="folders WOMAN/CAPTURE, WOMAN/RATER/CAPTURE or WOMAN/DEVICE/RATER/CAPTURE",
            remedy="Arrange the folders so, or give a table with a column folder",
        )
    depth = depths.pop()
    names = tuple(levels) or LEVELS.get(depth, ())
    if len(names) != depth or not {"woman", "capture"} <= set(names) <= set(_NAMES):
        raise SessionError(
            str(path),
            found=f"sessions {depth} folders deep, named {', '.join(names) or 'nothing'}",
            expected=f"one name per level, of {', '.join(_NAMES)}, with woman and capture among them",
            remedy="Name the levels: --levels woman,rater,day,capture",
        )
    for folder, labels in found:
        of = dict(zip(names, labels, strict=True))
        yield RepeatedFolder(
            folder=folder,
            woman=of["woman"],
            device=of.get("device", ""),
            rater=of.get("rater", ""),
            day=of.get("day", ""),
            capture=of["capture"],
        )


def _captures(folder: Path, names: tuple[str, ...]) -> Iterator[tuple[Path, tuple[str, ...]]]:
    for path in sorted(visible(folder)):
        if not path.is_dir():
            continue
        if can_be_opened(path):
            yield path, (*names, path.name)
        elif len(names) < len(_NAMES) - 1:
            yield from _captures(path, (*names, path.name))


def _readings(one: RepeatedFolder, settings: Settings | None) -> list[Reading]:
    job = open_session(one.folder, settings)
    job.ensure("measure")
    conditions = (*one.conditions, *_conditions(job))
    return [
        Reading(
            woman=one.woman,
            side="" if name == "model" else name,
            device=one.device,
            rater=one.rater,
            day=one.day,
            capture=one.capture,
            reader=one.reader,
            reading=one.reading,
            volume_cc=found.volume_cc,
            conditions=tuple(_of_side(conditions, name)),
        )
        for name, found in job.measure().items()
    ]


def _of_side(conditions: Sequence[tuple[str, str]], side: str) -> Iterator[tuple[str, str]]:
    """Conditions that concern one side or both sides."""
    others = {"left": "right_mm", "right": "left_mm"}
    yield from ((what, text) for what, text in conditions if not what.endswith(others.get(side, "?")))


def _conditions(job: Job) -> Iterator[tuple[str, str]]:
    """Posture of a capture, and the lengths that it changes."""
    if job.posture:
        yield "posture", job.posture
    sizes = job.plan.value(measure.dimensions)
    for length in () if sizes is None else sizes.lengths:
        if length.name.startswith(_LENGTHS):
            yield f"{length.name}_mm", f"{length.straight_mm:.1f}"
