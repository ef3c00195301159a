"""Search for patients, and for records that exist already."""

import datetime
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from django.db.models import Count, Max, Q, QuerySet
from django.utils import timezone

from mammometry.base.letters import isolated
from mammometry.clinic.models import Patient, Rig, Upload, Visit
from mammometry.clinic.records.search_words import plain, plain_name, read_query

MANY = 50
"""Most rows that a search shows. No more are read."""
_YEAR = re.compile(r"(?:19|20)\d\d")
_NEWEST = 8  # number of patients shown before anything is typed


@dataclass(frozen=True, slots=True)
class PatientMatch:
    """A patient who matches a search."""

    patient: Patient
    visit_count: int
    last_visit: datetime.datetime | None


def search(text: str) -> QuerySet[Patient]:
    """Patients who match every typed word and date.

    Words may be parts of names, record numbers and pseudonyms, in any order. Case, accents and hyphens are ignored. A
    day or a year finds patients who were born or photographed then.
    """
    query = read_query(text)
    patients = Patient.objects.all()
    if text.strip() and not query.days and not query.words:
        return patients.none()
    for word in query.words:
        found = Q(search_words__contains=word)
        if _YEAR.fullmatch(word):
            photographed = Visit.objects.filter(taken_at__year=int(word)).values("patient")
            found |= Q(born__year=int(word)) | Q(pk__in=photographed)
        patients = patients.filter(found)
    for days, typed in query.days:
        photographed = Visit.objects.filter(_on(days)).values("patient")
        patients = patients.filter(Q(born__in=days) | Q(pk__in=photographed) | Q(search_words__contains=typed))
    return patients


def matches(text: str, *, leave_out: Patient | None = None) -> list[PatientMatch]:
    """The first matches in order of names, at most one more than `MANY`.

    Args:
        text: the search.
        leave_out: a patient to exclude.
    """
    return _with_visits(_without(search(text), leave_out)[: MANY + 1])


def newest(*, leave_out: Patient | None = None) -> list[PatientMatch]:
    """The patients who were entered last, shown before anything is typed."""
    return _with_visits(_without(Patient.objects.order_by("-created"), leave_out)[:_NEWEST])


def _without(patients: QuerySet[Patient], leave_out: Patient | None) -> QuerySet[Patient]:
    return patients if leave_out is None else patients.exclude(pk=leave_out.pk)


def _with_visits(patients: Iterable[Patient]) -> list[PatientMatch]:
    rows = list(patients)
    visits = Visit.objects.filter(patient__in=rows).order_by().values("patient")
    counted = {
        row["patient"]: (row["number"], row["last"])
        for row in visits.annotate(number=Count("pk"), last=Max("taken_at"))
    }
    return [PatientMatch(row, *counted.get(row.pk, (0, None))) for row in rows]


def _on(days: Iterable[datetime.date]) -> Q:
    within = Q(pk=None)
    for day in days:
        begin = timezone.make_aware(datetime.datetime.combine(day, datetime.time()))
        within |= Q(taken_at__gte=begin, taken_at__lt=begin + datetime.timedelta(days=1))
    return within


_CLOCK = datetime.timedelta(minutes=10)  # how far the clock of a browser's computer may be ahead


@dataclass(frozen=True, slots=True, kw_only=True)
class Duplicates:
    """Records that may be of the same patient."""

    same_number: Patient | None
    """The record with this number. Case, hyphens and spaces are ignored. Numbers are unique."""
    same_person: tuple[Patient, ...]
    """Records with this name, and with this birthday or without one."""

    def __bool__(self) -> bool:
        """Whether there are any duplicates."""
        return self.same_number is not None or bool(self.same_person)


def duplicates(patient: Patient) -> Duplicates:
    """Records that may be of the same patient, including merged ones and those in the bin."""
    others = Patient.everything.exclude(pk=patient.pk)
    return Duplicates(
        same_number=next(
            (candidate for candidate in of_number(patient.record_number) if candidate.pk != patient.pk), None
        ),
        same_person=tuple(
            candidate
            for candidate in others.filter(_born(patient.born), merged_into=None)
            if _names(candidate) == _names(patient) and plain(candidate.record_number) != plain(patient.record_number)
        ),
    )


def of_number(record_number: str) -> list[Patient]:
    """Patients with a record number. Case, hyphens and spaces are ignored.

    For a merged record, the one that has its visits now.
    """
    number = plain(record_number)
    rows = Patient.everything.filter(search_words__contains=number).select_related("merged_into") if number else ()
    return [row.merged_into or row for row in rows if plain(row.record_number) == number]


def same_photographs(visit: Visit) -> list[tuple[Visit, list[str]]]:
    """Other visits that contain the same files, with the cameras of this visit."""
    used = (Upload.State.PLACED, Upload.State.PREPARED)
    own = {row.sha256: row.camera for row in visit.uploads.filter(state__in=used).exclude(sha256="")}
    rows = Upload.objects.filter(sha256__in=own, state__in=used, visit__binned_at=None)
    cameras_of: dict[Visit, list[str]] = {}
    for row in rows.exclude(visit=None).exclude(visit=visit).select_related("visit__patient"):
        assert row.visit is not None
        cameras_of.setdefault(row.visit, []).append(own[row.sha256])
    return list(cameras_of.items())


def elsewhere(other: Visit, cameras: Sequence[str]) -> str:
    """Sentence about photographs that another visit contains, too."""
    names = ", ".join(sorted({camera.replace("_", " ") for camera in cameras}))
    which = f"the visit of {_day(other.taken_at)} of {isolated(other.patient.name)}"
    return f"The same photograph{'s are' if len(cameras) > 1 else ' is'} also in {which}: {names}."


def date_questions(taken_at: datetime.datetime, rig: Rig | None) -> list[str]:
    """Questions to ask about a visit on an unusual day."""
    now = timezone.now()
    if taken_at > now + _CLOCK:
        return [f"This visit is in the future: today is {_day(now)}. Is the day right?"]
    first = None if rig is None else rig.calibrations.order_by("taken_at").first()
    if first is not None and timezone.localdate(taken_at) < timezone.localdate(first.taken_at):
        return [f"This is before the first calibration of {rig}, on {_day(first.taken_at)}. Is the day right?"]
    return []


def _day(at: datetime.datetime) -> str:
    local = timezone.localtime(at)
    return f"{local.day} {local:%b %Y}"


def _born(born: datetime.date | None) -> Q:
    return Q() if born is None else Q(born=born) | Q(born=None)


def _names(patient: Patient) -> frozenset[str]:
    """Both names, regardless of their order."""
    return frozenset({plain_name(patient.family_name), plain_name(patient.given_name)})
