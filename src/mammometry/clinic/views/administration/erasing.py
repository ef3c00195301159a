"""A patient, erased by an administrator: by pseudonym, typed twice."""

from __future__ import annotations

from typing import Any

from django.http import HttpRequest, HttpResponse
from django.shortcuts import render

from mammometry.base.errors import MammometryError
from mammometry.clinic.maintenance.backups import backup_files
from mammometry.clinic.maintenance.disk import folder_bytes
from mammometry.clinic.maintenance.patient import erase_patient, rows_of
from mammometry.clinic.models import Patient, Upload, Visit
from mammometry.clinic.site import the_clinic
from mammometry.clinic.views.who import person_of


def erase(request: HttpRequest) -> HttpResponse:
    """Ask for a pseudonym, show what goes, and erase it when the pseudonym is typed again."""
    typed = (request.POST if request.method == "POST" else request.GET).get("pseudonym", "").strip().upper()
    patient = Patient.everything.filter(pseudonym=typed, merged_into=None).first() if typed else None
    context: dict[str, Any] = {"typed": typed}
    if patient is not None:
        context |= what_goes(patient)
    elif typed:
        context["wrong"] = "No patient has this pseudonym."
    if request.method == "POST" and patient is not None:
        if request.POST.get("again", "").strip().upper() != typed:
            context["wrong_again"] = "This is not the same pseudonym. Nothing was erased."
        else:
            try:
                visits = erase_patient(the_clinic(), patient, person_of(request))
                context = {"erased": typed, "visits": visits, "backups": context["backups"]}
            except MammometryError as error:
                context["wrong_again"] = str(error)
    return render(request, "clinic/erase.html", context)


def what_goes(patient: Patient) -> dict[str, Any]:
    """What is erased with a patient, and what stays."""
    rows = rows_of(patient)
    visits = [row for row in rows if isinstance(row, Visit)]
    return {
        "patient": patient,
        "visits": visits,
        "photographs": sum(isinstance(row, Upload) for row in rows),
        "rows": len(rows),
        "bytes": sum(folder_bytes(visit.folder) for visit in visits),
        "backups": [file.path.name for file in backup_files(the_clinic())],
    }
