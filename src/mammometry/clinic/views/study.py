"""Study statistics by pseudonym, and results as files: DICOM, FHIR, REDCap, tables."""

from __future__ import annotations

import datetime
import io
import uuid
import zipfile
from collections.abc import Callable, Mapping
from dataclasses import replace
from itertools import islice
from typing import TYPE_CHECKING, Any

import numpy as np
from django.contrib import messages
from django.db.models import QuerySet
from django.http import Http404, HttpRequest, HttpResponse
from django.shortcuts import get_object_or_404, redirect, render
from django.utils import timezone

from mammometry.base.csv_cells import CsvWriter, csv_text
from mammometry.base.errors import MammometryError
from mammometry.base.extras import MissingLibraryError
from mammometry.clinic import deliveries
from mammometry.clinic.forms import FIRST_DAY
from mammometry.clinic.models import Visit
from mammometry.clinic.records.cohort import left_out, measured_visits, pooled, repeats, study_rows, visits_between
from mammometry.clinic.records.results import SIDES, report_file
from mammometry.clinic.site import the_clinic
from mammometry.clinic.views.responses import download, not_installed
from mammometry.study.agreement import LEAST_SUBJECTS, PairedMeasurements, agreement

if TYPE_CHECKING:
    from mammometry.hospital.fhir import Release


_SHOWN = 200  # rows on the page
_COLUMNS = (
    "pseudonym",
    "day",
    "years",
    "side",
    "definition",
    "volume_cc",
    "low_cc",
    "high_cc",
    "refused",
    "state",
    "confirmed",
    "confirmed_on",
    "rig",
    "software",
    "posture",
    "settings",
    "wall",
    "boundary",
    "apart",
    "repeat_of",
)


def study(request: HttpRequest) -> HttpResponse:
    """Page of the cohort, and of the agreement between repeated visits."""
    visits = _asked(request)
    everything = pooled(visits)
    repeated = repeats(visits)
    figures = None
    patients = tuple(pair.pseudonym for pair in repeated.pairs)  # both breasts of a patient are not independent
    if len(set(patients)) >= LEAST_SUBJECTS:
        figures = agreement(
            PairedMeasurements(
                names=tuple(f"{pair.pseudonym} {pair.side}" for pair in repeated.pairs),
                reference=np.array([pair.first_cc for pair in repeated.pairs]),
                measured=np.array([pair.second_cc for pair in repeated.pairs]),
                reference_name="first", measured_name="second", unit="cc", subjects=patients,
            )
        )  # fmt: skip
    volumes_cc, comparable_cc = everything.volumes_cc, everything.comparable_cc
    left_out_visits, left_out_patients = left_out(visits)
    context = {
        "rows": list(
            islice(study_rows(visits.filter(pk__in=everything.visit_keys[:_SHOWN]), everything.reference), _SHOWN)
        ),
        "more": max(0, len(everything.day) - _SHOWN),
        "patients": everything.patients,
        "visits": everything.visits,
        "measured": len(volumes_cc),
        "refused": len(everything.day) - len(volumes_cc),
        "apart": len(volumes_cc) - len(comparable_cc),
        "median_cc": float(np.median(comparable_cc)) if len(comparable_cc) else None,
        "quartiles_cc": tuple(map(float, np.quantile(comparable_cc, [0.25, 0.75]))) if len(comparable_cc) else None,
        "agreement": figures,
        "pairs": len(repeated.pairs),
        "pairs_of": len(set(patients)),
        "no_pairs": repeated.left_out,
        "least": LEAST_SUBJECTS,
        "left_out": left_out_visits,
        "left_out_patients": left_out_patients,
        "asked": request.GET,
        "query": request.GET.urlencode(),
    }
    return render(request, "clinic/study.html", context)


def study_csv(request: HttpRequest) -> HttpResponse:
    """The cohort as a table, with pseudonyms only."""
    response = download("", f"cohort_{timezone.localdate():%Y-%m-%d}.csv", "text/csv; charset=utf-8")
    writer = CsvWriter(response)
    writer.row(_COLUMNS)
    visits = _asked(request)
    for row in study_rows(visits, pooled(visits).reference):
        writer.row(_cell(getattr(row, name)) for name in _COLUMNS)
    return response


def _asked(request: HttpRequest) -> QuerySet[Visit]:
    begin, end = (_day(request.GET.get(name, "")) for name in ("from", "until"))
    return visits_between(begin, end, confirmed="confirmed" in request.GET)


def _cell(value: object) -> object:
    """Round numbers to one decimal."""
    return f"{value:.1f}" if isinstance(value, float) else value


def _day(text: str) -> datetime.date | None:
    try:
        day = datetime.date.fromisoformat(text)
    except ValueError:
        return None
    return min(max(day, FIRST_DAY), timezone.localdate() + datetime.timedelta(days=1))  # no visits on other days


_RELEASES: Mapping[str, Release] = {"r4": "R4", "r5": "R5"}
_LEFT_OUT, _ZIP = "left-out.csv", "application/zip"
_ZIP_EPOCH = (1980, 1, 1, 0, 0, 0)  # the earliest time in a ZIP; a fixed one gives the same bytes for the same results


def visit_dicom(request: HttpRequest, visit: uuid.UUID) -> HttpResponse:
    """The visit's DICOM objects as a ZIP. ``?deidentify`` makes them for recipients outside the clinic."""
    deidentify = "deidentify" in request.GET
    shown = _measured(visit)
    try:
        made = deliveries.study_of(the_clinic(), shown, deidentify=deidentify)
    except MissingLibraryError as error:
        return not_installed(request, error)
    except MammometryError as error:
        messages.error(request, str(error))
        return redirect("visit-send", visit=visit)
    # Names of deidentified files contain neither pseudonym nor day.
    return download(_zipped(made), "dicom-deidentified.zip" if deidentify else _named(shown, "dicom.zip"), _ZIP)


def visit_fhir(request: HttpRequest, visit: uuid.UUID, release: str) -> HttpResponse:
    """The visit's measurements as a FHIR bundle, R4 or R5."""
    if release not in _RELEASES:
        raise Http404
    shown = _measured(visit)
    try:
        deliveries.require_libraries("fhir.resources")
        from mammometry.hospital.fhir import bundle

        exported = deliveries.gathered(the_clinic(), shown, whole=False)
        made = bundle(exported, deliveries.patient_module(shown.patient), release=_RELEASES[release])
    except MissingLibraryError as error:
        return not_installed(request, error)
    except MammometryError as error:
        messages.error(request, str(error))
        return redirect("visit-send", visit=visit)
    return download(made, _named(shown, f"fhir-{release}.json"), "application/fhir+json")


def study_redcap(request: HttpRequest) -> HttpResponse:
    """The study for REDCap: data dictionary and records, by pseudonym."""
    from mammometry.hospital import tables

    return _study(request, tables.redcap_tables, "redcap")


def study_table(request: HttpRequest) -> HttpResponse:
    """All numbers of the study with a codebook, by pseudonym."""
    from mammometry.hospital import tables

    return _study(request, tables.tables, "table")


def _study(request: HttpRequest, tables: Callable[[Any], dict[str, bytes]], kind: str) -> HttpResponse:
    """Numbers of the requested visits, and the visits left out with the reasons."""
    config, sessions, omitted = the_clinic(), [], []
    visits = _asked(request)
    apart = {(row.pseudonym, row.day, row.side): row.apart for row in study_rows(visits, pooled(visits).reference)}
    for visit in measured_visits(visits).select_related("patient", "rig"):
        pseudonym, day = visit.patient.pseudonym, timezone.localtime(visit.taken_at).date()
        why = {side: apart.get((pseudonym, day, side), "") for side in SIDES}
        try:
            sessions.append(replace(deliveries.gathered(config, visit, whole=False), apart=why))
        except MammometryError as error:
            omitted.append((pseudonym, day.isoformat(), error.found))
    without, patients = left_out(visits)
    if without:
        omitted.append(("", "", f"no consent to research: {without} visits of {patients} patients"))
    try:
        made = tables(sessions)
    except MammometryError as error:
        messages.error(request, str(error))
        return redirect("study")
    if omitted:
        made[_LEFT_OUT] = csv_text(("pseudonym", "day", "why"), omitted).encode()
    return download(_zipped(made), f"study-{kind}_{timezone.localdate():%Y-%m-%d}.zip", _ZIP)


def _measured(visit: uuid.UUID) -> Visit:
    shown = get_object_or_404(Visit.objects.select_related("patient"), pk=visit)
    if report_file(shown, "report.pdf") is None:
        raise Http404
    return shown


def _named(visit: Visit, ending: str) -> str:
    return f"{visit.patient.pseudonym}_{visit.taken_at:%Y-%m-%d}.{ending}"


def _zipped(files: Mapping[str, bytes]) -> bytes:
    """Files as one ZIP, uncompressed, because pictures and models can hardly be compressed."""
    made = io.BytesIO()
    with zipfile.ZipFile(made, "w") as archive:
        for name, content in sorted(files.items()):
            archive.writestr(zipfile.ZipInfo(name, _ZIP_EPOCH), content)
    return made.getvalue()
