"""Results of visits for pages, and their reports."""

from __future__ import annotations

import datetime
import json
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from mammometry.api.results import FOLDER
from mammometry.base.errors import SessionError
from mammometry.base.notices.texts import TEXTS
from mammometry.base.notices.words import code_of_1_0
from mammometry.clinic.models import Measurement, Visit, Volume
from mammometry.clinic.records.charts import ChartReading
from mammometry.clinic.records.clinical import clinical_of
from mammometry.clinic.records.comparability import Basis, basis_of, why_apart
from mammometry.clinic.records.confirmations import CHANGED
from mammometry.clinic.site import the_clinic
from mammometry.report.words.volumes import MEANINGS

if TYPE_CHECKING:
    from mammometry.api.job import Job
    from mammometry.report.documents.rendering import RenderedReport
    from mammometry.report.figures.canvas import Caption


Interval = tuple[float, float]
SIDES = ("left", "right", "model")
LEADING = ("measured wall", "flat chest", "named wall", "muscle", "closed solid", "any")
"""Definitions of the breast, in the order of preference for a page (docs/decisions/0029)."""


@dataclass(frozen=True, slots=True)
class SideResult:
    """One breast at one visit."""

    side: str
    title: str
    definition: str
    volume_cc: float | None
    interval_cc: Interval | None
    refused: str
    basis: Basis
    """Basis of the volume."""
    others: tuple[SideResult, ...] = ()
    """Results for the same breast with the other definitions."""

    @property
    def meaning(self) -> str:
        """The definition that was measured, in words."""
        return MEANINGS.get(self.definition, self.definition)


@dataclass(frozen=True, slots=True)
class VisitResult:
    """The newest measurement of a visit."""

    visit: Visit
    measurement: Measurement
    sides: tuple[SideResult, ...]
    difference: SideResult | None


def latest(visits: Iterable[Visit]) -> list[VisitResult]:
    """Newest measurement of each visit, in the visits' order. Visits without one are left out."""
    results = []
    for visit in visits:
        measurement = next(iter(visit.measurements.all()), None)  # the newest comes first
        if measurement is not None:
            results.append(visit_result(visit, measurement))
    return results


def add_volumes(measurement: Measurement, volumes: Iterable[Volume]) -> None:
    """Store the volumes of a measurement, and mark the leading one of each side."""
    leaders: dict[str, Volume] = {}
    ordered = sorted(volumes, key=lambda volume: (_rank(volume), volume.definition))
    for volume in ordered:
        volume.measurement = measurement
        volume.leads = leaders.setdefault(volume.side, volume) is volume
    Volume.objects.bulk_create(ordered)


def visit_result(visit: Visit, measurement: Measurement) -> VisitResult:
    """One measurement as shown on pages.

    Without numbers if a boundary or landmark has changed since.
    """
    changed = visit.is_changed
    by_side: dict[str, list[SideResult]] = {}
    for row in sorted(measurement.volumes.all(), key=_rank):
        side = _side(row, basis_of(visit, measurement, row.side, row.definition))
        by_side.setdefault(row.side, []).append(_without_numbers(side) if changed else side)
    first = {side: replace(rows[0], others=tuple(rows[1:])) for side, rows in by_side.items()}
    return VisitResult(
        visit=visit,
        measurement=measurement,
        sides=tuple(first[side] for side in SIDES if side in first),
        difference=first.get("difference"),
    )


def readings(results: Iterable[VisitResult]) -> list[ChartReading]:
    """Volumes for the time line.

    A volume that is not comparable with the newest one of its side is shown separately, with the reason, and not joined
    to the others.
    """
    ordered = sorted(results, key=lambda result: result.visit.taken_at)
    measured = [(result.visit, side) for result in ordered for side in result.sides if side.volume_cc is not None]
    newest = {side.side: side.basis for _, side in measured}
    made = []
    for visit, side in measured:
        assert side.volume_cc is not None
        low, high = side.interval_cc or (side.volume_cc, side.volume_cc)
        date = f"{visit.taken_at.day} {visit.taken_at:%b %Y}"
        apart = why_apart(side.basis, newest[side.side])
        words = f"{side.title}, {date}: {side.volume_cc:.0f} cc (95 %: {low:.0f} to {high:.0f})"
        if apart:
            words += f". Not comparable with the newest: {apart}"
        made.append(
            ChartReading(
                side.side, visit.taken_at, side.volume_cc, low, high, words, line=repr(side.basis), is_apart=bool(apart)
            )
        )
    return made


def age(born: datetime.date | None, at: datetime.date) -> int | None:
    """Age on a day, in full years."""
    if born is None:
        return None
    return at.year - born.year - ((at.month, at.day) < (born.month, born.day))


def _rank(volume: Volume) -> int:
    return LEADING.index(volume.definition) if volume.definition in LEADING else len(LEADING)


def _without_numbers(side: SideResult) -> SideResult:
    return replace(side, volume_cc=None, interval_cc=None, refused=CHANGED)


def _side(volume: Volume, rests_on: Basis) -> SideResult:
    interval = None
    if volume.low_cc is not None and volume.high_cc is not None:
        interval = volume.low_cc, volume.high_cc
    titles = {"left": "Left breast", "right": "Right breast", "model": "Model", "difference": "Difference"}
    return SideResult(
        side=volume.side, title=titles.get(volume.side, volume.side), definition=volume.definition,
        volume_cc=volume.volume_cc, interval_cc=interval, refused=volume.refused, basis=rests_on,
    )  # fmt: skip


_UNKNOWN = TEXTS["sentence"]  # codes of a later version are shown with the volumes
_LARGEST = 64 << 20  # largest report that is read, bytes; ours have a few MB


@dataclass(frozen=True, slots=True)
class Facts:
    """Warnings and notes about the volumes."""

    warnings: tuple[str, ...]
    """Notices about the numbers."""
    notes: tuple[str, ...] = ()
    """Notices about single photographs and their matching."""
    codes: frozenset[str] = frozenset()
    """Codes of all of them."""


def report_file(visit: Visit, name: str) -> Path | None:
    """A file of the visit's report. None if there is none."""
    return readable(visit.folder / "results" / "report" / name)


def readable(path: Path) -> Path | None:
    """A result file that may be shown. None if there is none."""
    return path if path.is_file() and not path.is_symlink() and path.stat().st_size <= _LARGEST else None


def refusal_pictures(visit: Visit) -> dict[str, Caption]:
    """Pictures of the visit's refused measurement: name → caption."""
    from mammometry.report.figures.canvas import caption_of

    paths = sorted((visit.folder / "results" / FOLDER).glob("*.png"))
    return {path.stem: caption_of(path.read_bytes()) for path in paths if readable(path)}


def refusal_picture(visit: Visit, name: str) -> bytes | None:
    """One of those pictures, as PNG. None if there is none."""
    path = readable(visit.folder / "results" / FOLDER / f"{name}.png")
    return None if path is None else path.read_bytes()


def facts(visit: Visit) -> Facts:
    """Warnings of the report, without those that the visit's state already shows."""
    path = report_file(visit, "warnings.json")
    try:
        table = {} if path is None else json.loads(path.read_text(encoding="utf-8"))
        warnings = table if isinstance(table, list) else table["warnings"]  # a list in version 1.0
        sentences = [str(warning) for warning in warnings]
        notices = table.get("notices") if isinstance(table, dict) else None  # not in version 1.0
        codes = list(map(code_of_1_0, sentences)) if notices is None else [str(notice["code"]) for notice in notices]
        lines = list(zip(codes, sentences, strict=True))
    except (OSError, ValueError, TypeError, KeyError):
        lines = []
    return Facts(
        tuple(words for code, words in lines if TEXTS.get(code, _UNKNOWN).concern == "volume"),
        tuple(words for code, words in lines if TEXTS.get(code, _UNKNOWN).concern == "photographs"),
        frozenset(code for code, _ in lines),
    )


def sides_doubtful(visit: Visit) -> bool:
    """Whether left and right of a visit's scan may be swapped, and nobody has checked it."""
    return visit.is_scan and "sides-doubtful" in facts(visit).codes


def scene_of(visit: Visit) -> str | None:
    """The 3D scene of the visit's report, as JSON. None if there is none."""
    from mammometry.api.stored_report import stored_scene

    return stored_scene(visit.folder / "results")


def measured_job(visit: Visit) -> Job:
    """Open a visit if its newest boundaries and landmarks have been measured.

    Raises:
        SessionError: it has changed since, or must be measured again.
        MammometryError: its folder cannot be opened.
    """
    from mammometry.api.job import open_session

    if visit.is_changed:
        remedy = "Wait until it is measured, or measure it"
        expected = "a visit whose newest boundaries and landmarks are measured"
        raise SessionError(str(visit), found=CHANGED, expected=expected, remedy=remedy)
    job = open_session(visit.folder, the_clinic().measuring())
    if not job.store.has(job.content_key):
        remedy = "Measure it again"
        expected = "a measured visit"
        raise SessionError(str(visit), found="a visit whose report is not current", expected=expected, remedy=remedy)
    return job


def rendered_report(visit: Visit) -> RenderedReport:
    """The report with the patient's name, operations, confirmation and conclusions.

    Raises:
        MammometryError: as for `measured_job`.
    """
    return measured_job(visit).rendered(clinical_of(visit))
