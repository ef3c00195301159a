"""Visits with a scan of another device, without photographs."""

import re
import uuid
from dataclasses import replace
from typing import Any

from django import forms
from django.contrib import messages
from django.db import transaction
from django.http import HttpRequest, HttpResponse
from django.shortcuts import get_object_or_404, redirect, render
from django.utils import timezone

from mammometry.base.errors import MammometryError
from mammometry.base.units import UNIT_TITLES
from mammometry.clinic.forms import DAY_AND_TIME, ask_about_day, name_empty_choices
from mammometry.clinic.intake.scans import taken_in
from mammometry.clinic.jobs import queue
from mammometry.clinic.models import Drawing, Patient, Scan, Visit
from mammometry.clinic.record_form import RecordForm
from mammometry.clinic.records.results import sides_doubtful
from mammometry.clinic.site import the_clinic
from mammometry.clinic.templatetags.pages import on_pages
from mammometry.clinic.views.patients import chosen_patient, is_part, search_context
from mammometry.clinic.views.responses import person_of
from mammometry.io.meshes.scans import ABOUT, AXES, MTL, ScanFacts, confirm_sides, read_scan
from mammometry.io.outputs import write_outputs

BODY_BYTES = 520 * 10**6
"""Largest request: the largest possible `scan_mb` plus the form."""
_SCRATCH = re.compile(r"uploads/scan-[^/]+/(?:first|second)/")  # folders into which received files are unpacked
_AXIS_WORDS = {axis: f"{'minus ' if axis.startswith('-') else ''}{axis.strip('-').upper()}" for axis in AXES}


class _Files(forms.ClearableFileInput):
    allow_multiple_selected = True


class _FilesField(forms.FileField):
    """A field of several files."""

    widget = _Files

    def clean(self, data: Any, initial: Any = None) -> Any:
        """Check every file."""
        every = (data if isinstance(data, list | tuple) else [data]) or [None]
        return [super(_FilesField, self).clean(file, initial) for file in every]


class ScanForm(RecordForm):
    """Patient, device and unit of a scan."""

    scanner = forms.CharField(max_length=100, label="Device", help_text="Such as Vectra M5, 3dMD or Artec Leo.")
    sent = _FilesField(
        label="Files of the scan",
        help_text="All together: OBJ, MTL and picture. Or one ZIP. GLB and USDZ hold pictures; PLY and STL none.",
    )
    second = _FilesField(
        label="Another scan of the same visit", required=False,
        help_text="In the same posture, such as from below if the fold is hidden. Both are merged.",
    )  # fmt: skip
    units = forms.ChoiceField(
        label="Unit of the mesh", required=False, help_text="See the device’s export settings.",
        choices=[("", "From the body’s size"), *((unit, words.title()) for unit, words in UNIT_TITLES.items())],
    )  # fmt: skip
    head = forms.ChoiceField(
        label="Axis towards the head", required=False, help_text="Y with nearly all devices.",
        choices=[("", "Y, or Z where the mesh faces along Y"), *_AXIS_WORDS.items()],
    )  # fmt: skip
    ahead = forms.ChoiceField(
        label="Axis straight ahead", required=False, help_text="Needed if the whole body was scanned all around.",
        choices=[("", "Where the open mesh faces"), *_AXIS_WORDS.items()],
    )  # fmt: skip
    shape_alone = forms.BooleanField(label="Without the picture of the skin", required=False)

    class Meta:
        model = Visit
        fields = ("patient", "taken_at", "posture", "note")
        labels = {"taken_at": "Day and time"}  # noqa: RUF012
        widgets = {  # noqa: RUF012
            "patient": forms.HiddenInput(),
            "taken_at": DAY_AND_TIME,
            "note": forms.Textarea(attrs={"rows": 2}),
        }

    field_order = (
        "patient", "scanner", "sent", "second", "units", "head", "ahead", "shape_alone", "taken_at", "posture", "note",
    )  # fmt: skip

    questions: tuple[str, ...] = ()

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        name_empty_choices(self.fields)

    def clean(self) -> dict[str, Any]:
        """Ask the user to confirm a day in the future."""
        values: dict[str, Any] = super().clean() or self.cleaned_data
        ask_about_day(self, None)
        return values


def scan_new(request: HttpRequest) -> HttpResponse:
    """Start a visit of a chosen patient with a scan, and measure it."""
    patient = chosen_patient(request)
    if patient is None:
        page = "clinic/patients_rows.html" if is_part(request) else "clinic/scan_new.html"
        return render(request, page, search_context(request, choosing=True))
    first = {"taken_at": timezone.localtime(), "patient": patient}
    form = ScanForm(request.POST or None, request.FILES or None, initial=first)
    if request.method == "POST" and form.is_valid():
        given = form.cleaned_data
        about = ScanFacts(scanner=given["scanner"], units="", head=given["head"], ahead=given["ahead"])
        try:
            visit = _entered(request, form, about)
        except MammometryError as error:
            form.add_error("sent", on_pages(_SCRATCH.sub("", str(error).replace(f"{the_clinic().folder}/", ""))))
        else:
            return redirect("visit", visit=visit.pk)
    context = {"form": form, "chosen": patient, "limit_mb": the_clinic().limits.scan_mb}
    return render(request, "clinic/scan_new.html", context)


def scan_sides(request: HttpRequest, visit: uuid.UUID) -> HttpResponse:
    """Record that the sides of a scan were compared with the patient, and make its report again."""
    shown = get_object_or_404(Visit.objects.select_for_update(), pk=visit)
    if request.method != "POST":
        return redirect("visit", visit=visit)
    if shown.state == Visit.State.QUEUED or not sides_doubtful(shown):
        messages.error(request, "Nothing was changed: left and right of this visit are not in doubt.")
        return redirect("visit", visit=visit)
    confirm_sides(shown.folder)
    Drawing.objects.create(
        visit=shown, item="left and right", action=Drawing.Action.CONFIRMED, by=person_of(request),
        digest=read_scan(shown.folder).sha256,
    )  # fmt: skip
    queue.enqueue(shown, person_of(request))
    messages.success(request, "Left and right are confirmed. The report is made again.")
    return redirect("visit", visit=visit)


def _entered(request: HttpRequest, form: ScanForm, about: ScanFacts) -> Visit:
    given = form.cleaned_data
    patient: Patient = given["patient"]
    about = replace(about, subject=patient.pseudonym)
    second = [sent for sent in given["second"] if sent is not None]
    made = taken_in(given["sent"], about, units=given["units"] or None, texture=not given["shape_alone"], second=second)
    visit: Visit = form.save(commit=False)
    visit.created_by, visit.state = person_of(request), Visit.State.READY
    visit.folder.mkdir(mode=0o700, parents=True)
    write_outputs(visit.folder, made, command="import mesh")  # files first, so that no row is without its files
    facts = read_scan(visit.folder)
    with transaction.atomic():
        visit.save()
        Scan.objects.create(
            visit=visit, scanner=facts.scanner, units=facts.units, textured=MTL in made, sha256=facts.sha256
        )
        queue.enqueue(visit, person_of(request))
    assert ABOUT in made
    return visit
