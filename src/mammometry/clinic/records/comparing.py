"""Comparison of two visits of one patient, and its verdict in words."""

import itertools
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from django.utils import timezone

import mammometry
from mammometry.clinic.models import Comparison, Measurement, Visit
from mammometry.clinic.records.comparability import posture_apart
from mammometry.clinic.site import the_clinic
from mammometry.measure.settings import NOT_TO_BE_COMPARED
from mammometry.report.words.volumes import change_sentence, date_words

_MEASURED = (Visit.State.MEASURED, Visit.State.CONFIRMED)
"""States in which a visit's newest measurement includes all drawings."""
_BREASTS = ("left", "right")


@dataclass(frozen=True, slots=True, kw_only=True)
class ComparisonVerdict:
    """A comparison as shown on pages."""

    before: Visit
    after: Visit
    state: str
    """``done``, ``busy``, ``refused``, ``waiting`` (a visit has changes that are not measured yet) or ``apart`` (the
    visits are not comparable)."""
    sentences: tuple[str, ...]
    """One sentence per breast if it is done, otherwise the reason."""
    cautions: tuple[str, ...] = ()
    """Cautions for the reader."""


def comparison_folder(before: Visit, after: Visit) -> Path:
    """Folder for the files of a comparison."""
    return after.folder / "results" / "compare" / str(before.pk)


def comparable(visits: Iterable[Visit]) -> list[Visit]:
    """Visits whose newest measurement has a volume, earliest first."""
    chosen = [visit for visit in visits if visit.binned_at is None and _has_volume(_newest(visit))]
    return sorted(chosen, key=lambda visit: (visit.taken_at, visit.created))


def neighbours(visit: Visit) -> list[tuple[Visit, Visit]]:
    """Pairs of a visit and the comparable visits before and after it."""
    visits = comparable(Visit.objects.filter(patient=visit.patient_id).prefetch_related("measurements__volumes"))
    return [pair for pair in itertools.pairwise(visits) if visit in pair]


def measured_digests(before: Visit, after: Visit) -> str:
    """Digests of both newest measurements, separated by a colon."""
    newest = [_newest(visit) for visit in (before, after)]
    return ":".join("" if measurement is None else measurement.digest for measurement in newest)


def refusal_of(digests: str) -> str:
    """Key of a refused comparison, with the software version, because another version may accept it."""
    return f"{digests} {mammometry.__version__}"


def is_current(comparison: Comparison) -> bool:
    """Whether a comparison uses the newest measurements of both visits."""
    digests = measured_digests(comparison.before, comparison.after)
    if comparison.state == Comparison.State.DONE:
        return comparison.of == digests
    return comparison.state == Comparison.State.REFUSED and comparison.of == refusal_of(digests)


def may_compare(before: Visit, after: Visit) -> bool:
    """Whether both measurements are current and have the same posture."""
    return all(visit.state in _MEASURED for visit in (before, after)) and not _apart(before, after)


def verdict(before: Visit, after: Visit) -> ComparisonVerdict:
    """State of the comparison of two visits, and its verdict."""
    return _verdict(before, after, Comparison.objects.filter(before=before, after=after).first())


def changes(visits: Iterable[Visit]) -> list[ComparisonVerdict]:
    """Verdicts on the changes between successive comparable visits of a patient, newest first."""
    pairs = list(itertools.pairwise(comparable(visits)))
    rows = {(row.before_id, row.after_id): row for row in Comparison.objects.filter(after__in=[b for _, b in pairs])}
    return [_verdict(before, after, rows.get((before.pk, after.pk))) for before, after in reversed(pairs)]


def _verdict(before: Visit, after: Visit, row: Comparison | None) -> ComparisonVerdict:
    if row is not None:
        row.before, row.after = before, after  # with their measurements
    day = date_words(timezone.localdate(before.taken_at))
    if apart := _apart(before, after):
        sentence = f"Not compared with {day}: {apart}. {NOT_TO_BE_COMPARED}."
        return ComparisonVerdict(before=before, after=after, state="apart", sentences=(sentence,))
    changed = before.is_changed or after.is_changed
    if row is not None and is_current(row) and not changed:
        if row.state == Comparison.State.REFUSED:
            why = f"It cannot be compared with {day}. {row.message[:1].upper()}{row.message[1:]}"
            cautions = _posture_cautions(before, after)
            return ComparisonVerdict(before=before, after=after, state="refused", sentences=(why,), cautions=cautions)
        return ComparisonVerdict(
            before=before, after=after, state="done", sentences=_sentences(row), cautions=_cautions(row)
        )
    if not may_compare(before, after):
        sentence = f"Not yet compared with {day}: one of the visits has unmeasured changes."
        return ComparisonVerdict(before=before, after=after, state="waiting", sentences=(sentence,))
    queued = row is not None and row.state == Comparison.State.QUEUED
    sentence = f"Not yet compared with {day}{': it is being compared' if queued else ''}."
    return ComparisonVerdict(before=before, after=after, state="busy", sentences=(sentence,))


def verdicts(visit: Visit) -> tuple[str, ...]:
    """Verdict on the change since the previous visit: one sentence per breast, then cautions.

    Empty if there is no previous visit.
    """
    pair = next((pair for pair in neighbours(visit) if pair[1] == visit), None)
    if pair is None:
        return ()
    change = verdict(*pair)
    return (*change.sentences, *change.cautions)


def _sentences(comparison: Comparison) -> tuple[str, ...]:
    breasts = comparison.table["breasts"]
    day = timezone.localdate(comparison.before.taken_at)
    changed = [
        change_sentence(
            name, breasts[name]["change_cc"], breasts[name]["change_interval_cc"], breasts[name]["beyond_error"], day
        )
        for name in _BREASTS
        if name in breasts
    ]
    at_one_date = comparison.table.get("at_one_date", {})
    alone = [f"{name.capitalize()} breast: a volume only at the {which} date." for name, which in at_one_date.items()]
    return (*changed, *alone)


def _cautions(comparison: Comparison) -> tuple[str, ...]:
    cautions = _posture_cautions(comparison.before, comparison.after)
    if comparison.table["registration"]["doubtful"]:
        cautions += ("The trunks of both dates fit badly: check that both visits are of this patient.",)
    return cautions


def _posture_cautions(before: Visit, after: Visit) -> tuple[str, ...]:
    if apart := posture_apart(after, before):  # the clinic's settings allow it
        return (f"Not compared automatically: {apart}. {NOT_TO_BE_COMPARED}.",)
    return () if after.posture else ("The posture of neither visit is entered.",)


def _apart(before: Visit, after: Visit) -> str:
    """Reason why the clinic does not compare two visits. Empty if it does."""
    apart = posture_apart(after, before)
    return "" if apart and the_clinic().measuring().compare.other_posture else apart


def _newest(visit: Visit) -> Measurement | None:
    return next(iter(visit.measurements.all()), None)


def _has_volume(measurement: Measurement | None) -> bool:
    volumes = () if measurement is None else measurement.volumes.all()
    return any(row.side in _BREASTS and row.volume_cc is not None for row in volumes)
