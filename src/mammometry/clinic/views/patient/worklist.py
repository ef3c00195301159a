"""The hospital's worklist: one press fills in patient, visit and order."""

from __future__ import annotations

import datetime
import uuid
from dataclasses import dataclass
from typing import TYPE_CHECKING

from django.contrib import messages
from django.db.models import QuerySet
from django.http import Http404, HttpRequest, HttpResponse
from django.shortcuts import get_object_or_404, redirect, render
from django.utils import timezone

from mammometry.base.errors import MammometryError
from mammometry.clinic.deliveries import connection, require_libraries
from mammometry.clinic.models import Calibration, Destination, Patient, Rig, Visit, VisitOrder
from mammometry.clinic.records.duplicates import duplicates
from mammometry.clinic.records.search_words import plain_name
from mammometry.clinic.views.who import person_of

if TYPE_CHECKING:
    from mammometry.hospital.dicom.worklist import Entry, Worklist


@dataclass(frozen=True, slots=True)
class Line:
    """One entry as the page shows it."""

    worklist: Destination
    entry: Entry
    name: str
    """Family name, given name."""


def worklist(request: HttpRequest) -> HttpResponse:
    """Today's entries of all worklists, or a visit from one."""
    if request.method == "POST":
        return _begun(request)
    lines = []
    for source in _sources():
        try:
            found = _asked(source, day=timezone.localdate())
        except MammometryError as error:
            messages.error(request, str(error))
            continue
        for refusal in found.refused:
            messages.error(request, str(refusal))
        lines += [Line(source, entry, ", ".join(_names(entry))) for entry in found.entries]
    context = {"lines": lines, "sources": _sources(), "rigs": Rig.objects.filter(active=True)}
    return render(request, "clinic/worklist.html", context)


def _begun(request: HttpRequest) -> HttpResponse:
    """Begin a visit out of the entry, which is asked for again. Nothing of it is taken from the page."""
    source = get_object_or_404(_sources(), pk=_key(request.POST.get("worklist", "")))
    rig = get_object_or_404(Rig.objects.filter(active=True), pk=_key(request.POST.get("rig", "")))
    accession, number = request.POST.get("accession", ""), request.POST.get("patient", "")
    if not number:
        raise Http404
    try:
        found = [
            entry
            for entry in _asked(source, accession=accession, patient_id=number).entries
            if (entry.order.accession, entry.patient.id) == (accession, number)
        ]
        if len(found) != 1:
            messages.error(request, f"The worklist has {len(found)} such entries now. Choose again.")
            return redirect("worklist")
    except MammometryError as error:
        messages.error(request, str(error))
        return redirect("worklist")
    (entry,) = found
    patient = _patient(entry)
    alike = duplicates(patient)
    if alike.same_number is not None:
        known = alike.same_number
        if known.binned_at is not None:
            messages.error(request, "This record number is in the bin. Take it out first, then choose again.")
            return redirect("worklist")
        if not _is_same(known, patient):
            messages.error(
                request,
                "The clinic knows this record number under another name or date of birth. Ask who is right, correct "
                "the entry, then choose again.",
            )
            return redirect("worklist")
        patient = known
    elif alike.same_person and "anyway" not in request.POST:
        context = {"duplicates": alike, "patient": patient, "sent": request.POST}
        return render(request, "clinic/worklist_duplicates.html", context)
    else:
        patient.save()
    visit = Visit.objects.create(
        patient=patient, rig=rig, taken_at=timezone.now(), created_by=person_of(request),
        calibration=Calibration.objects.filter(rig=rig, current=True).first(),
    )  # fmt: skip
    order = entry.order
    VisitOrder.objects.create(
        visit=visit, accession=order.accession, study_uid=order.study_uid, referring=order.referring,
        procedure_id=order.procedure_id, procedure=order.procedure,
    )  # fmt: skip
    return redirect("visit", visit=visit.pk)


def _patient(entry: Entry) -> Patient:
    """The entry's patient, not kept yet."""
    family, given = _names(entry)
    listed = entry.patient
    return Patient(family_name=family, given_name=given, born=listed.born, record_number=listed.id)


def _is_same(known: Patient, listed: Patient) -> bool:
    """Whether the clinic knows this record number under the same name and birthday."""
    same_day = None in (known.born, listed.born) or known.born == listed.born
    return same_day and plain_name(known.family_name) == plain_name(listed.family_name)


def _names(entry: Entry) -> tuple[str, str]:
    group = next(filter(None, entry.patient.name.split("=")), "")  # the others write the same name in other letters
    family, _, others = group.partition("^")
    return family.strip(), others.partition("^")[0].strip()


def _asked(
    source: Destination, *, day: datetime.date | None = None, accession: str = "", patient_id: str = ""
) -> Worklist:
    require_libraries("pydicom", "pynetdicom")
    from mammometry.hospital.dicom.worklist import entries

    peer, tls = connection(source)
    return entries(peer, day=day, accession=accession, patient_id=patient_id, own_title=source.own_title, tls=tls)


def _sources() -> QuerySet[Destination]:
    return Destination.objects.filter(active=True, kind=Destination.Kind.WORKLIST)


def _key(text: str) -> uuid.UUID:
    try:
        return uuid.UUID(text)
    except ValueError:
        raise Http404 from None
