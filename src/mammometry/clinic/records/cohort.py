"""The study's cohort by pseudonym: one row for each breast and visit, and statistics of all rows.

Plain values are read from the database. Creating objects for 90 000 volumes would be slow.
"""

from __future__ import annotations

import datetime
import json
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
from typing import Any, TypeAlias

import numpy as np
from django.db.models import Case, CharField, Count, Exists, F, IntegerField, OuterRef, Q, QuerySet, Value, When
from django.db.models.expressions import Combinable
from django.db.models.functions import Cast
from django.utils import timezone

from mammometry.clinic.models import Confirmation, Measurement, Operation, Visit, Volume
from mammometry.clinic.models.patients import TELEPHONE
from mammometry.clinic.records.clinical import research_consent
from mammometry.clinic.records.comparability import Basis, basis, is_between, why_apart
from mammometry.clinic.records.confirmations import CHANGED
from mammometry.clinic.records.results import SIDES, age, latest
from mammometry.geometry.arrays import Array, Float64, Int64

_Values: TypeAlias = tuple[Any, ...]
_OF_REPEATS = ("measurements__volumes", "repeat_of__measurements__volumes", "patient__operations")
_VISITS_AT_ONCE = 250  # visits whose volumes are read together
_YEARS_OF_DAYS = 4_000_000  # larger than any day's ordinal


def _text(column: str) -> Cast:
    """SQL expression for a key or a time as text, to avoid creating objects."""
    return Cast(column, CharField())


_VOLUME = (_text("measurement_id"), "side", "definition")
_SIDE_ORDER = {side: number for number, side in enumerate(SIDES)}


@dataclass(frozen=True, slots=True)
class CohortRow:
    """One breast at one visit, without the patient's name."""

    pseudonym: str
    day: datetime.date
    years: int | None
    """Age in years."""
    side: str
    definition: str
    volume_cc: float | None
    low_cc: float | None
    high_cc: float | None
    refused: str
    state: str
    """State of the visit. There is no number if a boundary or landmark has changed since the measurement."""
    confirmed: bool
    confirmed_on: datetime.date | None
    """None: not confirmed."""
    rig: str
    software: str
    posture: str
    """Empty: not entered."""
    settings: str
    """Settings that differ from the defaults, as JSON. Empty: not recorded."""
    wall: str
    boundary: str
    """Origin of the boundary, a key of `comparability.BOUNDARIES`."""
    apart: str
    """Reason why the volume is not comparable with most of the study's. Empty: it is comparable."""
    repeat_of: datetime.date | None
    """Day of the visit that this one repeats."""


@dataclass(frozen=True, slots=True)
class RepeatedVolume:
    """A breast that was measured at two visits, of which one was declared a repeat of the other."""

    pseudonym: str
    side: str
    first_cc: float
    second_cc: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Repeats:
    """Volumes of declared repeats."""

    pairs: tuple[RepeatedVolume, ...]
    """Sorted by pseudonym: those of one patient are not independent."""
    left_out: tuple[tuple[str, str], ...]
    """Pseudonym and reason, for each breast without a pair."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Pooled:
    """All rows as columns, by pseudonym and time."""

    visit_keys: tuple[str, ...]
    """Keys of the visits that have a row."""
    breasts: tuple[tuple[str, str], ...]
    """Side and definition."""
    patient: Int64[Array, " n"]
    """Index of the patient, in the order of the pseudonyms."""
    breast: Int64[Array, " n"]
    """Index in `breasts`."""
    day: Int64[Array, " n"]
    """Ordinal of the day."""
    volume_cc: Float64[Array, " n"]
    """Volume, cc. NaN if there is none."""
    bases: tuple[Basis, ...]
    """All different bases of the volumes, each once."""
    basis: Int64[Array, " n"]
    """Index in `bases`."""

    @property
    def patients(self) -> int:
        """Number of patients with a row."""
        return len(np.unique(self.patient))

    @property
    def visits(self) -> int:
        """Number of different patients and days with a row."""
        return len(np.unique(self.patient * _YEARS_OF_DAYS + self.day))

    @property
    def volumes_cc(self) -> Float64[Array, " m"]:
        """All volumes that exist."""
        return self.volume_cc[~np.isnan(self.volume_cc)]

    @property
    def reference(self) -> Basis | None:
        """Basis of most volumes. None without volumes."""
        measured = self.basis[~np.isnan(self.volume_cc)]
        return self.bases[int(np.bincount(measured).argmax())] if len(measured) else None

    @property
    def comparable_cc(self) -> Float64[Array, " m"]:
        """Volumes that may be pooled because they are comparable with most of them."""
        reference = self.reference
        if reference is None:
            return self.volumes_cc
        may = np.array([not why_apart(basis, reference) for basis in self.bases], dtype=bool)
        return self.volume_cc[~np.isnan(self.volume_cc) & may[self.basis]]


def repeats(visits: QuerySet[Visit]) -> Repeats:
    """Volumes of visits that were declared to be repeats.

    A breast is left out if its two volumes are not comparable, or if it was operated on between the visits.
    """
    declared = visits.filter(research_consent(), repeat_of__in=visits, repeat_of__patient=F("patient"))
    rows = declared.select_related("patient", "repeat_of").prefetch_related(*_OF_REPEATS)
    pairs: list[RepeatedVolume] = []
    left_out = []
    for later in rows.order_by("patient__pseudonym", "taken_at"):
        assert later.repeat_of is not None
        name = later.patient.pseudonym
        results = {
            result.visit.pk: {side.side: side for side in result.sides} for result in latest([later.repeat_of, later])
        }
        before, after = results.get(later.repeat_of.pk, {}), results.get(later.pk, {})
        operations = [row for row in later.patient.operations.all() if is_between(row, later.repeat_of, later)]
        for side in (side for side in SIDES if side in before or side in after):
            was, now = before.get(side), after.get(side)
            if was is None or now is None or was.volume_cc is None or now.volume_cc is None:
                why = "no volume at one of both visits"
            elif any(row.side in (side, Operation.Side.BOTH) for row in operations):
                why = "an operation between the visits"
            else:
                why = why_apart(now.basis, was.basis)
                if not why:
                    pairs.append(RepeatedVolume(name, side, was.volume_cc, now.volume_cc))
                    continue
            left_out.append((name, f"{side}: {why}"))
    return Repeats(pairs=tuple(pairs), left_out=tuple(left_out))


def visits_between(begin: datetime.date | None, end: datetime.date | None, *, confirmed: bool) -> QuerySet[Visit]:
    """Visits of a period, by pseudonym and day, with or without consent to research."""
    visits = Visit.objects.filter(subject_kind=Visit.Subject.TORSO)
    if begin is not None:
        visits = visits.filter(taken_at__gte=_midnight(begin))
    if end is not None:
        visits = visits.filter(taken_at__lt=_midnight(end) + datetime.timedelta(days=1))
    if confirmed:
        visits = visits.filter(state=Visit.State.CONFIRMED)
    return visits.order_by("patient__pseudonym", "taken_at", "pk")


def measured_visits(visits: QuerySet[Visit]) -> QuerySet[Visit]:
    """Visits with a measurement, of patients with consent to research."""
    return visits.filter(_is_measured(), research_consent())


def left_out(visits: QuerySet[Visit]) -> tuple[int, int]:
    """Numbers of measured visits and patients without consent to research."""
    without = visits.filter(_is_measured(), ~research_consent()).order_by()
    counts = without.aggregate(visits=Count("pk"), patients=Count("patient", distinct=True))
    return counts["visits"], counts["patients"]


def study_rows(visits: QuerySet[Visit], reference: Basis | None = None) -> Iterator[CohortRow]:
    """Rows of the newest measurement of each visit, read some visits at a time.

    Args:
        visits: to read.
        reference: basis of most volumes (`Pooled.reference`). Rows with another basis get the reason for being
            separate.
    """
    columns = (
        *("state", "patient__pseudonym", "patient__born", "taken_at", "rig__name", "scan__scanner", "walk__pk"),
        *("posture", "repeat_of__taken_at"),
    )
    read = _with_newest(visits, *columns)
    while some := list(islice(read, _VISITS_AT_ONCE)):
        keys = [key for key, *_ in some]
        made = Measurement.objects.filter(pk__in=keys).values_list(_text("pk"), "software", "how")
        measured = {key: (software, how) for key, software, how in made}
        volumes, confirmed_at = _leading_volumes(keys), _confirmed_at(keys)
        for key, changed, state, pseudonym, born, taken_at, rig, scanner, walk, posture, repeated in some:
            software, how = measured[key]
            day = timezone.localtime(taken_at).date()
            at = confirmed_at.get(key) if state == Visit.State.CONFIRMED else None
            for side in (side for side in SIDES if (key, side) in volumes):
                definition, volume_cc, low_cc, high_cc, refused = volumes[key, side]
                rests_on = basis(posture, how, side, definition)
                if changed or low_cc is None or high_cc is None:
                    low_cc = high_cc = None
                yield CohortRow(
                    pseudonym=pseudonym, day=day, years=age(born, day), side=side, definition=definition,
                    volume_cc=None if changed else volume_cc, low_cc=low_cc, high_cc=high_cc,
                    refused=CHANGED if changed else refused, state=CHANGED if changed else state,
                    confirmed=at is not None, confirmed_on=None if at is None else timezone.localtime(at).date(),
                    rig=rig or scanner or (TELEPHONE if walk else ""), software=software, posture=posture,
                    settings=rests_on.settings, wall=rests_on.wall, boundary=rests_on.boundary,
                    apart=(
                        "" if reference is None or changed or volume_cc is None else why_apart(rests_on, reference)
                    ),
                    repeat_of=None if repeated is None else timezone.localtime(repeated).date(),
                )  # fmt: skip


def pooled(visits: QuerySet[Visit]) -> Pooled:
    """Columns of all rows of `study_rows`, in its order."""
    number_of: dict[str, int] = {}  # key: the newest measurement
    patient_of: dict[str, int] = {}
    breast_of: dict[tuple[str, str], int] = {}
    by_visit, keys = [], []
    basis_number: dict[Basis, int] = {}
    resting: dict[tuple[str, str, str, str], int] = {}  # many volumes have few different bases
    how_of = dict(Measurement.objects.order_by().values_list(_text("pk"), _text("how")).iterator())
    posture_of: dict[str, str] = {}
    zone = timezone.get_current_timezone()
    columns = _text("pk"), "patient__pseudonym", _text("taken_at"), "posture"
    for key, is_old, visit, pseudonym, taken_at, posture in _with_newest(visits, *columns):
        keys.append(visit)
        posture_of[key] = posture
        number_of[key] = len(number_of)
        ordinal = datetime.datetime.fromisoformat(taken_at).replace(tzinfo=datetime.UTC).astimezone(zone).toordinal()
        by_visit.append((patient_of.setdefault(pseudonym, len(patient_of)), ordinal, is_old))

    def number_of_basis(key: str, side: str, definition: str) -> int:
        known = posture_of[key], how_of[key], side, definition
        if known not in resting:
            made = basis(known[0], json.loads(known[1]), side, definition)
            resting[known] = basis_number.setdefault(made, len(basis_number))
        return resting[known]

    by_volume = [
        (
            number_of[key],
            _SIDE_ORDER[side],
            breast_of.setdefault((side, definition), len(breast_of)),
            volume_cc,
            number_of_basis(key, side, definition),
        )
        for key, side, definition, volume_cc in _leading().values_list(*_VOLUME, "volume_cc")
        if key in number_of
    ]
    patient, day, changed = np.array(by_visit, dtype=np.int64).reshape(-1, 3).T
    # None becomes NaN
    table = np.array(by_volume, dtype=np.float64).reshape(-1, 5)
    table = table[np.lexsort((table[:, 1], table[:, 0]))]
    number, _, breast, _, rests = np.where(np.isnan(table), 0, table).astype(np.int64).T
    volume_cc = table[:, 3]
    return Pooled(
        visit_keys=tuple(keys[place] for place in np.unique(number)),
        breasts=tuple(breast_of),
        patient=patient[number],
        breast=breast,
        day=day[number],
        volume_cc=np.where(changed[number] > 0, np.nan, volume_cc),
        bases=tuple(basis_number),
        basis=rests,
    )


def _with_newest(visits: QuerySet[Visit], *columns: str | Combinable) -> Iterator[_Values]:
    """Newest measurement of each visit, whether it is out of date, and columns of the visit."""
    queued = visits.filter(state=Visit.State.QUEUED)
    changed = Q(state=Visit.State.CHANGED) | Q(pk__in=[visit.pk for visit in queued if visit.is_changed])
    is_old = Case(When(changed, then=Value(1)), default=Value(0), output_field=IntegerField())
    by_age = Measurement.objects.order_by("made_at").values_list(_text("visit_id"), _text("pk"))
    newest = dict(by_age.iterator())  # the last of a visit remains; a subquery for each takes twice as long
    read = visits.filter(research_consent()).values_list(_text("pk"), is_old, *columns)
    return ((newest[visit], *values) for visit, *values in read.iterator() if visit in newest)


def _leading_volumes(measurements: list[str]) -> dict[tuple[str, str], _Values]:
    """Measurement and side → leading volume: definition, volume, low, high (cc), reason for having none."""
    columns = ("definition", "volume_cc", "low_cc", "high_cc", "refused")
    rows = _leading().filter(measurement_id__in=measurements).values_list(*_VOLUME[:2], *columns)
    return {(key, side): tuple(volume) for key, side, *volume in rows}


def _leading() -> QuerySet[Volume]:
    """For every breast and measurement, the volume in the leading definition."""
    return Volume.objects.filter(leads=True, side__in=SIDES).order_by()


def _confirmed_at(measurements: list[str]) -> dict[str, datetime.datetime]:
    """Measurement → time of the last confirmation of the measured boundaries."""
    rows = Confirmation.objects.filter(measurement_id__in=measurements).order_by("at")
    columns = rows.values_list(_text("measurement_id"), "curves", "measurement__curves", "at")
    return {key: at for key, curves, measured, at in columns if curves == measured}


def _is_measured() -> Exists:
    return Exists(Measurement.objects.filter(visit=OuterRef("pk")))


def _midnight(day: datetime.date) -> datetime.datetime:
    return timezone.make_aware(datetime.datetime.combine(day, datetime.time()))
