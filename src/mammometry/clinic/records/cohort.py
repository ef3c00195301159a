"""The study's cohort by pseudonym: one row for each breast and visit, and the figures of all rows.

The database gives plain values. Of 90 000 volumes no objects are made.
"""

from __future__ import annotations

import datetime
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
from typing import Any, TypeAlias

import numpy as np
from django.db.models import Case, CharField, Count, Exists, IntegerField, OuterRef, Q, QuerySet, Value, When
from django.db.models.expressions import Combinable
from django.db.models.functions import Cast
from django.utils import timezone

from mammometry.clinic.models import Confirmation, Measurement, Visit, Volume
from mammometry.clinic.records.clinical import research_consent
from mammometry.clinic.records.confirmations import CHANGED
from mammometry.clinic.records.results import SIDES, age
from mammometry.geometry.arrays import Array, Float64, Int64

_Values: TypeAlias = tuple[Any, ...]
_VISITS_AT_ONCE = 250  # whose volumes are read together
_YEARS_OF_DAYS = 4_000_000  # more than any day's ordinal


def _text(column: str) -> Cast:
    """A key or a time as text: of so many, no objects are made."""
    return Cast(column, CharField())


_VOLUME = (_text("measurement_id"), "side", "definition")
_SIDE_ORDER = {side: number for number, side in enumerate(SIDES)}


@dataclass(frozen=True, slots=True)
class Row:
    """One breast at one visit, without a name."""

    pseudonym: str
    day: datetime.date
    years: int | None
    """Of age."""
    side: str
    definition: str
    volume_cc: float | None
    low_cc: float | None
    high_cc: float | None
    refused: str
    state: str
    """Of the visit. An unmeasured change of a boundary or landmark is said, and no number is given."""
    confirmed: bool
    confirmed_on: datetime.date | None
    """None: not confirmed."""
    rig: str
    software: str


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Pooled:
    """All rows as columns, by pseudonym and time."""

    visit_keys: tuple[str, ...]
    """Of the visits that have a row."""
    pseudonyms: tuple[str, ...]
    breasts: tuple[tuple[str, str], ...]
    """Side and definition."""
    patient: Int64[Array, " n"]
    """Index in `pseudonyms`."""
    breast: Int64[Array, " n"]
    """Index in `breasts`."""
    day: Int64[Array, " n"]
    """Ordinal."""
    volume_cc: Float64[Array, " n"]
    """Not a number: there is none."""

    @property
    def patients(self) -> int:
        """Number of patients who have a row."""
        return len(np.unique(self.patient))

    @property
    def visits(self) -> int:
        """Number of days on which patients were measured."""
        return len(np.unique(self.patient * _YEARS_OF_DAYS + self.day))

    @property
    def volumes_cc(self) -> Float64[Array, " m"]:
        """The volumes that there are."""
        return self.volume_cc[~np.isnan(self.volume_cc)]

    def repeated(self, within_days: int) -> list[tuple[str, float, float]]:
        """Volumes of breasts that were measured twice within some days. Name, first cc, second cc.

        One pair a breast, since pairs of one breast are not independent.
        """
        measured_rows = np.flatnonzero(~np.isnan(self.volume_cc))
        breast = self.patient[measured_rows] * len(self.breasts) + self.breast[measured_rows]
        order = np.argsort(breast, kind="stable")
        breast, ordered = breast[order], measured_rows[order]
        days = np.diff(self.day[ordered])
        close = np.flatnonzero((np.diff(breast) == 0) & (days <= within_days))
        pairs = close[np.unique(breast[close], return_index=True)[1]]
        return [
            (
                f"{self.pseudonyms[self.patient[second]]} {self.breasts[self.breast[second]][0]}",
                float(self.volume_cc[first]),
                float(self.volume_cc[second]),
            )
            for second, first in sorted(zip(ordered[pairs + 1].tolist(), ordered[pairs].tolist(), strict=True))
        ]


def visits_between(begin: datetime.date | None, end: datetime.date | None, *, confirmed: bool) -> QuerySet[Visit]:
    """Visits of a time, by pseudonym and day, whether or not the consent to research holds."""
    visits = Visit.objects.filter(subject_kind=Visit.Subject.TORSO)
    if begin is not None:
        visits = visits.filter(taken_at__gte=_midnight(begin))
    if end is not None:
        visits = visits.filter(taken_at__lt=_midnight(end) + datetime.timedelta(days=1))
    if confirmed:
        visits = visits.filter(state=Visit.State.CONFIRMED)
    return visits.order_by("patient__pseudonym", "taken_at", "pk")


def measured_visits(visits: QuerySet[Visit]) -> QuerySet[Visit]:
    """Visits with a measurement, of patients whose consent to research holds."""
    return visits.filter(_is_measured(), research_consent())


def left_out(visits: QuerySet[Visit]) -> tuple[int, int]:
    """Numbers of measured visits, and of their patients, whose consent to research does not hold."""
    without = visits.filter(_is_measured(), ~research_consent()).order_by()
    counts = without.aggregate(visits=Count("pk"), patients=Count("patient", distinct=True))
    return counts["visits"], counts["patients"]


def study_rows(visits: QuerySet[Visit]) -> Iterator[Row]:
    """Rows of the newest measurement of each visit, read some visits at a time."""
    columns = ("state", "patient__pseudonym", "patient__born", "taken_at", "rig__name", "scan__scanner")
    read = _with_newest(visits, *columns)
    while some := list(islice(read, _VISITS_AT_ONCE)):
        keys = [key for key, *_ in some]
        software = dict(Measurement.objects.filter(pk__in=keys).values_list(_text("pk"), "software"))
        volumes, confirmed_at = _leading_volumes(keys), _confirmed_at(keys)
        for key, changed, state, pseudonym, born, taken_at, rig, scanner in some:
            day = timezone.localtime(taken_at).date()
            at = confirmed_at.get(key) if state == Visit.State.CONFIRMED else None
            for side in (side for side in SIDES if (key, side) in volumes):
                definition, volume_cc, low_cc, high_cc, refused = volumes[key, side]
                if changed or low_cc is None or high_cc is None:
                    low_cc = high_cc = None
                yield Row(
                    pseudonym=pseudonym, day=day, years=age(born, day), side=side, definition=definition,
                    volume_cc=None if changed else volume_cc, low_cc=low_cc, high_cc=high_cc,
                    refused=CHANGED if changed else refused, state=CHANGED if changed else state,
                    confirmed=at is not None, confirmed_on=None if at is None else timezone.localtime(at).date(),
                    rig=rig or scanner or "", software=software[key],
                )  # fmt: skip


def pooled(visits: QuerySet[Visit]) -> Pooled:
    """Columns of all rows of `study_rows`, in its order."""
    number_of: dict[str, int] = {}  # of the newest measurement
    patient_of: dict[str, int] = {}
    breast_of: dict[tuple[str, str], int] = {}
    by_visit, keys = [], []
    zone = timezone.get_current_timezone()
    columns = _text("pk"), "patient__pseudonym", _text("taken_at")
    for key, is_old, visit, pseudonym, taken_at in _with_newest(visits, *columns):
        keys.append(visit)
        number_of[key] = len(number_of)
        ordinal = datetime.datetime.fromisoformat(taken_at).replace(tzinfo=datetime.UTC).astimezone(zone).toordinal()
        by_visit.append((patient_of.setdefault(pseudonym, len(patient_of)), ordinal, is_old))
    by_volume = [
        (number_of[key], _SIDE_ORDER[side], breast_of.setdefault((side, definition), len(breast_of)), volume_cc)
        for key, side, definition, volume_cc in _leading().values_list(*_VOLUME, "volume_cc")
        if key in number_of
    ]
    patient, day, changed = np.array(by_visit, dtype=np.int64).reshape(-1, 3).T
    number, side, breast, volume_cc = np.array(by_volume, dtype=np.float64).reshape(-1, 4).T  # None becomes NaN
    order = np.lexsort((side, number))
    number, breast, volume_cc = number[order].astype(np.int64), breast[order].astype(np.int64), volume_cc[order]
    return Pooled(
        visit_keys=tuple(keys[place] for place in np.unique(number)),
        pseudonyms=tuple(patient_of),
        breasts=tuple(breast_of),
        patient=patient[number],
        breast=breast,
        day=day[number],
        volume_cc=np.where(changed[number] > 0, np.nan, volume_cc),
    )


def _with_newest(visits: QuerySet[Visit], *columns: str | Combinable) -> Iterator[_Values]:
    """Of each measured visit: key of its newest measurement, whether its numbers are of an earlier state, columns."""
    queued = visits.filter(state=Visit.State.QUEUED)
    changed = Q(state=Visit.State.CHANGED) | Q(pk__in=[visit.pk for visit in queued if visit.is_changed])
    is_old = Case(When(changed, then=Value(1)), default=Value(0), output_field=IntegerField())
    by_age = Measurement.objects.order_by("made_at").values_list(_text("visit_id"), _text("pk"))
    newest = dict(by_age.iterator())  # the last of a visit stays; a subquery for each visit takes twice the time
    read = visits.filter(research_consent()).values_list(_text("pk"), is_old, *columns)
    return ((newest[visit], *values) for visit, *values in read.iterator() if visit in newest)


def _leading_volumes(measurements: list[str]) -> dict[tuple[str, str], _Values]:
    """Measurement and side → the volume that leads: definition, volume, low, high (cc), why there is none."""
    columns = ("definition", "volume_cc", "low_cc", "high_cc", "refused")
    rows = _leading().filter(measurement_id__in=measurements).values_list(*_VOLUME[:2], *columns)
    return {(key, side): tuple(volume) for key, side, *volume in rows}


def _leading() -> QuerySet[Volume]:
    """For every breast and measurement, the volume in the leading meaning."""
    return Volume.objects.filter(leads=True, side__in=SIDES).order_by()


def _confirmed_at(measurements: list[str]) -> dict[str, datetime.datetime]:
    """Measurement → when the boundaries that were measured were confirmed last."""
    rows = Confirmation.objects.filter(measurement_id__in=measurements).order_by("at")
    columns = rows.values_list(_text("measurement_id"), "curves", "measurement__curves", "at")
    return {key: at for key, curves, measured, at in columns if curves == measured}


def _is_measured() -> Exists:
    return Exists(Measurement.objects.filter(visit=OuterRef("pk")))


def _midnight(day: datetime.date) -> datetime.datetime:
    return timezone.make_aware(datetime.datetime.combine(day, datetime.time()))
