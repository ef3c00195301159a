"""Comparison of two sessions of one patient, in the order of their dates."""

from __future__ import annotations

import datetime
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mammometry.api.job import Job, open_session
from mammometry.api.posture import check_posture, posture_warnings
from mammometry.base.errors import MeasureError, SessionError
from mammometry.base.identity import NAMELESS, one_subject
from mammometry.base.machine.cores import one_blas_thread
from mammometry.base.notices import Notice
from mammometry.base.notices.words import words_at
from mammometry.base.progress import Progress, no_progress, part
from mammometry.geometry.transform import Transform
from mammometry.io.outputs import require_apart, require_free, write_outputs
from mammometry.io.results.stamp import stamped
from mammometry.io.results.store import Watch, unwatched
from mammometry.job.stages import measure
from mammometry.settings import Settings

if TYPE_CHECKING:
    from mammometry.geometry.mesh import TriangleMesh
    from mammometry.measure.boundary.boundary import Boundary
    from mammometry.measure.change import Change, DatedMeasurements
    from mammometry.measure.volume.measurement import VolumeMeasurement
    from mammometry.measure.volume.uncertainty import VolumeEvidence
    from mammometry.report.documents.change_page import ChangeReport
    from mammometry.report.privacy import Privacy

DOUBT_DEG = 15.0
"""Difference in lean above which there is a warning, degrees. The intervals were not tested for more."""
FOLDER = "compare"
_COMMAND = "compare"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Comparison:
    """Result of comparing two dates, and its files."""

    before: Path
    """The earlier session."""
    after: Path
    """The later session."""
    change: Change
    """Registration of the trunk, and changes of volumes, lengths and skin, in the earlier session's world frame."""
    notices: tuple[Notice, ...]
    """Warnings, worst first, then remarks on the comparison."""
    folder: Path
    """The page, in a folder with its numbers and pictures."""
    page: Path
    """compare.html."""
    table: dict[str, Any]
    """The content of compare.json."""

    @property
    def warnings(self) -> tuple[str, ...]:
        """The warnings as text."""
        return tuple(words_at("warning", self.notices))

    @property
    def remarks(self) -> tuple[str, ...]:
        """Remarks on the comparison, as text."""
        return tuple(words_at("note", self.notices))


@one_blas_thread()
def compare(
    before: Path | str,
    after: Path | str,
    settings: Settings | None = None,
    *,
    out: Path | None = None,
    privacy: Privacy | None = None,
    watches: tuple[Watch, Watch] = (unwatched, unwatched),
    progress: Progress = no_progress,
) -> Comparison:
    """Changes between two sessions of one patient, with a page. Stale results are computed first.

    Args:
        before: the earlier session; if both manifests have a date, the dates decide.
        after: the later session.
        settings: settings of all stages, for both; None for the defaults.
        out: folder to write; None: ``results/compare/<earlier session>`` in the later one.
        privacy: what to leave out of the page; None: nothing.
        watches: called for each product that is computed, for each session.
        progress: called with the fraction of the comparison itself.

    Raises:
        SessionError: a session is missing or invalid, both are the same, one is not of a torso, or they have different
            subjects or postures.
        MeasureError: no breast has a volume at both dates, or the trunks are not of one body.
        StorageError: the page cannot be written, or a foreign file is in its place.
    """
    from mammometry.report.privacy import Privacy

    settings = settings or Settings()
    jobs = [open_session(path, settings, watch=watch) for path, watch in zip((before, after), watches, strict=True)]
    _check(jobs)
    subject = _one_subject(jobs)
    if not settings.compare.other_posture:
        check_posture(*jobs)
    remarks: list[Notice] = []
    dates = [job.date for job in jobs]
    if dates[0] is not None and dates[1] is not None and dates[0] > dates[1]:
        jobs.reverse()
        remarks.append(Notice(code="dates-exchanged", level="note"))
    if None in dates:
        remarks.append(Notice(code="date-missing", level="note"))
    request = _Request(settings=settings, subject=subject, out=out, privacy=privacy or Privacy(), remarks=remarks)
    return _compare(jobs, request, progress)


@one_blas_thread()
def compare_visits(
    before: Path, after: Path, settings: Settings, *, out: Path, progress: Progress = no_progress
) -> Comparison:
    """Changes between two measured visits of a clinic, with a page.

    Patient, order, postures and confirmations come from the clinic's database and not from the manifests. The page does
    not mention postures and confirmations.

    Args:
        before: folder of the earlier visit.
        after: folder of the later visit.
        settings: settings of all stages with which both were measured.
        out: folder to write.
        progress: called with the fraction of the comparison.

    Raises:
        MammometryError: as in `compare`.
    """
    from mammometry.report.privacy import Privacy

    jobs = [open_session(path, settings) for path in (before, after)]
    _check(jobs)
    return _compare(jobs, _Request(settings=settings, out=out, privacy=Privacy(), in_clinic=True), progress)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Request:
    """Settings of a comparison of two dates."""

    settings: Settings
    out: Path | None
    privacy: Privacy
    subject: str | None = None
    """Identifier in both sessions."""
    remarks: Sequence[Notice] = ()
    """Notices on the order of the dates."""
    in_clinic: bool = False
    """Whether confirmations and posture come from another source, such as a clinic's visit."""


def _compare(jobs: list[Job], request: _Request, progress: Progress) -> Comparison:
    """Comparison of two dates, the earlier one first."""
    from mammometry.report.documents import change_page

    settings, privacy = request.settings, request.privacy
    remarks = [*request.remarks]
    dates = [job.date for job in jobs]
    folder = request.out or jobs[1].store.folder / FOLDER / _folder_name(jobs[0], privacy)
    require_apart(folder, [path for job in jobs for path in job.brought])
    require_free(folder, change_page.FILES, command=_COMMAND)
    for which, job in zip(_WHICH, jobs, strict=True):
        measurements = job.plan.get(measure.measurements)
        if measurements is not None and job.store.state(measurements.key) == "stale":
            remarks.append(Notice(code="measured-again", level="note", values={"date": which}))
        job.ensure("measure", drawn=False)
    measured, protocol = _one_protocol(jobs, part(progress, 0.0, 0.4))

    from mammometry.measure.change import compare as compare_measured

    visits = [_visit(job, volumes) for job, volumes in zip(jobs, measured, strict=True)]
    change = compare_measured(
        visits[0], visits[1], settings.compare, common_scale=_common_scale(jobs), progress=part(progress, 0.4, 0.8)
    )
    at_one_date = _at_one_date(measured)
    notices = (
        *(() if request.in_clinic else posture_warnings(*jobs)),
        *_warnings(change),
        *(
            Notice(code="volume-at-one-date", about=(name,), values={"date": which})
            for name, which in at_one_date.items()
        ),
        *(() if request.in_clinic else _unconfirmed(change)),
        *protocol,
        *remarks,
    )
    heading = _heading(jobs, dates, request.subject, privacy.deidentify)
    report = replace(
        _report(jobs, heading, change, visits, notices, privacy),
        at_one_date=at_one_date,
        before=None if privacy.deidentify else dates[0],
    )
    files = change_page.change_files(report)
    marked = {name: stamped(name, data, heading.subject) for name, data in files.items()}
    write_outputs(folder, marked, command=_COMMAND)
    progress(1.0)
    return Comparison(
        before=jobs[0].folder,
        after=jobs[1].folder,
        change=change,
        notices=notices,
        folder=folder,
        page=folder / change_page.PAGE,
        table=change_page.as_table(report),
    )


_WHICH = ("earlier", "later")


@dataclass(frozen=True, slots=True, kw_only=True)
class _Heading:
    """All names and dates on the page."""

    title: str
    subtitle: str
    subject: str | None
    """Identifier in both sessions."""


def _heading(jobs: list[Job], dates: list[datetime.date | None], subject: str | None, deidentify: bool) -> _Heading:
    if deidentify:
        return _Heading(title=NAMELESS.title, subtitle="two dates of one torso", subject=None)
    known = [job.identity for job in jobs]
    names = " → ".join(identity.name for identity in known)
    if subject is not None and all(identity.subject == subject for identity in known):
        return _Heading(title=subject, subtitle=f"{names} · {_dates_words(dates)}", subject=subject)
    return _Heading(title=" → ".join(identity.title for identity in known), subtitle=_dates_words(dates), subject=None)


def _check(jobs: list[Job]) -> None:
    """Raise an error if two dates cannot be compared."""
    first, second = jobs
    same = first.folder.resolve() == second.folder.resolve()
    if same or first.pictures & second.pictures:
        raise SessionError(
            str(second.folder),
            found="the same folder twice" if same else f"photographs or a scan that {first.folder} has too",
            expected="the folders of two dates, each with photographs or a scan of its own",
            remedy="Name the folder of the other date",
        )
    for job in jobs:
        job.require_sides()
        kind = job.inputs.subject_kind
        if kind != "torso":
            remedy = "Compare casts by their volumes: `mammometry run` on each"
            expected = "'torso' in both sessions: dates are registered on the body around the breasts"
            raise SessionError(f"{job.folder}: subject.kind", found=repr(kind), expected=expected, remedy=remedy)


def _one_subject(jobs: list[Job]) -> str | None:
    """The subject in the manifests. Raises an error if they differ."""
    return one_subject(
        [(f"{job.folder}: subject.id", job.identity.subject) for job in jobs],
        remedy="Name two sessions of one subject, or correct subject.id in the one that is wrong",
    )


def _one_protocol(jobs: list[Job], progress: Progress) -> tuple[list[tuple[VolumeMeasurement, ...]], list[Notice]]:
    """Volumes of both dates by the same protocol, measured again if boundaries or walls differ in kind."""
    from mammometry.measure.wall.registry import TORSO_WALLS, in_order

    notices: list[Notice] = []
    by_name = [{measurement.name: measurement for measurement in _measurements(job)} for job in jobs]
    boundaries = [_boundaries(job) for job in jobs]
    both = by_name[0].keys() & by_name[1].keys()
    drawn = [frozenset(job.inputs.boundaries) & both for job in jobs]
    replaced: list[frozenset[str]] = [frozenset(), frozenset()]
    if drawn[0] != drawn[1]:
        by_hand = " and the ".join(which for which, some in zip(_WHICH, drawn, strict=True) if some)
        try:
            boundaries = [
                _automatic(job) if some else own for job, some, own in zip(jobs, drawn, boundaries, strict=True)
            ]
        except MeasureError as error:
            notices.append(Notice(code="drawn-at-one-date", values={"date": by_hand, "found": error.found}))
        else:
            replaced = drawn
            notices.append(Notice(code="drawn-at-one-date-replaced", values={"date": by_hand}))
    wall: str | None = None
    if any(by_name[0][name].wall_kind != by_name[1][name].wall_kind for name in both):
        wall = in_order(TORSO_WALLS)[0]
        names = " and ".join(dict.fromkeys(volume.wall_kind for volumes in by_name for volume in volumes.values()))
        notices.append(Notice(code="walls-differ", values={"walls": names, "wall": wall}))
    if wall is None and not any(replaced):
        return [tuple(volumes.values()) for volumes in by_name], notices
    backs = [job.inputs.wall for job in jobs]
    if None in backs:
        backs = [None, None]
    volumes = []
    for number, (job, own, back) in enumerate(zip(jobs, boundaries, backs, strict=True)):
        kept = {
            name: measured
            for name, measured in by_name[number].items()
            if name not in replaced[number] and wall in (None, measured.wall_kind)
        }
        again = [boundary for boundary in own if boundary.name in both and boundary.name not in kept]
        measured = _measured_again(job, again, wall, back, part(progress, number / 2, (number + 1) / 2))
        order: list[str] = [boundary.name for boundary in own]
        volumes.append(tuple(sorted((*kept.values(), *measured), key=lambda breast: order.index(breast.name))))
    return volumes, notices


def _at_one_date(measured: Sequence[tuple[VolumeMeasurement, ...]]) -> dict[str, str]:
    """Breast → the only date with a volume."""
    names = [{volume.name for volume in volumes} for volumes in measured]
    return {
        name: _WHICH[number] for number in (0, 1) for name in sorted(names[number]) if name not in names[1 - number]
    }


def _measured_again(
    job: Job, boundaries: list[Boundary], wall: str | None, back: TriangleMesh | None, progress: Progress
) -> tuple[VolumeMeasurement, ...]:
    """Volumes of one date within these boundaries.

    Args:
        job: the date.
        boundaries: boundaries of the breasts.
        wall: kind of chest wall; None: from the settings.
        back: the measured wall, if there is one at both dates.
        progress: called with the fraction done.
    """
    from mammometry.measure.volume.volumes import measure_volumes
    from mammometry.measure.wall.open_breast import open_breasts

    if not boundaries:
        return ()
    settings = job.settings.measure if wall is None else replace(job.settings.measure, wall=wall)
    breasts = open_breasts(boundaries, job.surface().repaired, settings, frame=job.frame(), back=back)
    return measure_volumes(breasts, _evidence(job), progress=progress)


def _evidence(job: Job) -> VolumeEvidence:
    """Errors of earlier stages, for a volume's interval."""
    return job.plan[measure.evidence]()


def _measurements(job: Job) -> tuple[VolumeMeasurement, ...]:
    from mammometry.measure.volume.attribution import attributed

    made = job.plan.value(measure.measurements) or ()
    return tuple(attributed(measurement, job.inputs.attributions, named=False) for measurement in made)


def _boundaries(job: Job) -> tuple[Boundary, ...]:
    return job.plan.value(measure.boundaries) or ()


def _automatic(job: Job) -> tuple[Boundary, ...]:
    if (sides := job.plan.value(measure.sides)) is not None:  # found during the measurement
        return sides.boundaries
    from mammometry.measure.boundary.boundary import outline_torso
    from mammometry.measure.trunk.body import rig_frame

    frame = rig_frame(job.rig, job.inputs.mounting)
    return outline_torso(job.surface().repaired, frame).boundaries


def _visit(job: Job, volumes: tuple[VolumeMeasurement, ...]) -> DatedMeasurements:
    from mammometry.measure.change import DatedMeasurements

    sizes = job.plan.value(measure.dimensions)
    return DatedMeasurements(
        surface=job.surface().repaired,
        measurements=volumes,
        frame=job.frame(),
        lengths=() if sizes is None else sizes.lengths,
    )


def _common_scale(jobs: list[Job]) -> bool:
    """Whether both were calibrated with the same target and its measured size."""
    if not all(job.has_own_scale for job in jobs):
        return False
    first, second = (job.inputs.digests["target"] for job in jobs)
    return first == second


def _warnings(change: Change) -> Iterator[Notice]:
    if change.doubtful:
        yield Notice(code="trunks-fit-badly", values={"within_mm": change.fit.within_mm})
    if change.fit.turned_deg > DOUBT_DEG:
        yield Notice(code="trunks-lean-differently", values={"turned_deg": change.fit.turned_deg})


def _unconfirmed(change: Change) -> Iterator[Notice]:
    for number, which in enumerate(_WHICH):
        boundaries = [(breast.before, breast.after)[number] for breast in change.breasts]
        if any("to-be-confirmed" in measurement.boundary_remarks for measurement in boundaries):
            yield Notice(code="date-not-confirmed", values={"date": which})


def _folder_name(before: Job, privacy: Privacy) -> str:
    name = before.folder.resolve().name
    if privacy.deidentify:
        return "deidentified"  # a folder's name may be a patient's
    return f"{name}-geometry-only" if privacy.geometry_only else name


def _report(
    jobs: list[Job],
    heading: _Heading,
    change: Change,
    visits: list[DatedMeasurements],
    notices: tuple[Notice, ...],
    privacy: Privacy,
) -> ChangeReport:
    from mammometry.report.documents.change_page import ChangeReport
    from mammometry.report.figures.change import Dated
    from mammometry.report.privacy import guard
    from mammometry.report.words.describe import settings_facts

    motions = (Transform.identity(), change.fit.before_from_after)
    shown, holds = [], []
    for number, (job, visit) in enumerate(zip(jobs, visits, strict=True)):
        guarded = guard(
            job.surface().textured,
            privacy,
            subject_kind="torso",
            up_world=visit.frame[1],
            landmarks=job.inputs.landmarks,
        )
        holds.append(guarded.contains)
        mesh = visit.surface.mesh.transformed(motions[number])
        shown.append(
            Dated(
                name=("before", "after")[number],
                title=("Before", "After")[number],
                repaired=replace(visit.surface, mesh=mesh),
                textured=replace(guarded.textured, mesh=mesh),
                measurements=visit.measurements,
                world_from_own=motions[number],
                change_mm=(None, change.after_mm)[number],
            )
        )
    return ChangeReport(
        title=heading.title,
        subtitle=heading.subtitle,
        subject=heading.subject,
        keys=(jobs[0].page_digest(deidentify=privacy.deidentify), jobs[1].page_digest(deidentify=privacy.deidentify)),
        change=change,
        dates=(shown[0], shown[1]),
        frame=visits[0].frame,
        notices=notices,
        contains="at either date, " + "; and ".join(dict.fromkeys(holds)),
        settings=settings_facts(jobs[0].settings)[0],
    )


def _dates_words(dates: list[datetime.date | None]) -> str:
    first, second = (None if date is None else date.isoformat() for date in dates)
    if dates[0] is not None and dates[1] is not None:
        days = (dates[1] - dates[0]).days
        return f"{first} → {second}: {days} day{'' if days == 1 else 's'} apart"
    return f"{first or 'date not given'} → {second or 'date not given'}"
