"""Connections to the hospital's systems: deliveries to archives, and the worklist."""

from __future__ import annotations

import datetime
import uuid
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from django.contrib import messages
from django.db.models import QuerySet
from django.http import Http404, HttpRequest, HttpResponse
from django.shortcuts import get_object_or_404, redirect, render
from django.utils import timezone

from mammometry.base.errors import MammometryError
from mammometry.clinic import deliveries
from mammometry.clinic.deliveries import connection, require_libraries
from mammometry.clinic.forms import FIRST_DAY, require_dicom_text
from mammometry.clinic.jobs import queue
from mammometry.clinic.models import Calibration, Delivery, Destination, Patient, Rig, Visit, VisitOrder
from mammometry.clinic.record_form import RecordForm
from mammometry.clinic.records.confirmations import CHANGED_SENTENCE, valid_confirmation
from mammometry.clinic.records.results import report_file
from mammometry.clinic.records.search import duplicates
from mammometry.clinic.records.search_words import plain_name
from mammometry.clinic.templatetags.pages import day
from mammometry.clinic.views.responses import form_page, person_of
from mammometry.hospital.peers import Peer, web_address

if TYPE_CHECKING:
    from mammometry.hospital.dicom.worklist import Worklist, WorklistEntry


_SHOWN = 100  # number of newest deliveries on the page


class DestinationForm(RecordForm):
    """An archive and its connection."""

    class Meta:
        model = Destination
        fields = (
            *("name", "kind", "address", "own_title", "encrypted", "authorities", "certificate", "key"),
            *("commitment", "promise_port", "active"),
        )
        labels = {  # noqa: RUF012
            "kind": "Protocol", "own_title": "Our AE title", "encrypted": "Encrypted (TLS)",
            "authorities": "File of the archive's certificates", "certificate": "File of our certificate",
            "key": "File of its key", "commitment": "Wait for the storage commitment",
            "promise_port": "Port for the storage commitment", "active": "In use",
        }  # fmt: skip
        help_texts = {  # noqa: RUF012
            "address": "PACS@10.0.0.5:104, or https://pacs.example.org/dicom-web.",
            "authorities": "On the clinic's server, PEM. Empty: those that the system trusts.",
            "certificate": "On the clinic's server, PEM. Only if the archive asks for one.",
            "key": "PEM. Empty: in the same file.",
            "commitment": "DICOM storage commitment. Without it, the results are sent again later.",
            "promise_port": "If the archive calls back. Empty: it answers on the same connection.",
        }

    def clean_own_title(self) -> str:
        """Refuse invalid titles of a DICOM application."""
        title: str = self.cleaned_data["own_title"]
        require_dicom_text(title, "AE")
        return title

    def clean(self) -> dict[str, Any]:
        """Refuse invalid addresses."""
        values: dict[str, Any] = super().clean() or {}
        address = values.get("address", "")
        try:
            if values.get("kind") == Destination.Kind.STOW:
                web_address(address)
            else:
                Peer.parse(address)
        except MammometryError as error:
            self.add_error("address", str(error))
        named = Destination(**{field: values.get(field) or "" for field in ("authorities", "certificate", "key")})
        named.encrypted = bool(values.get("encrypted"))
        try:
            if (tls := deliveries.tls_of(named)) is not None:
                tls.context()
        except MammometryError as error:
            self.add_error("certificate" if named.certificate else "authorities", str(error))
        port = values.get("promise_port")
        if port is not None and not 0 < port < 65536:
            self.add_error("promise_port", "A port is a number from 1 to 65535.")
        return values


def destinations(request: HttpRequest) -> HttpResponse:
    """All archives."""
    return render(request, "clinic/destinations.html", {"destinations": Destination.objects.all()})


def destination_form(request: HttpRequest, destination: uuid.UUID | None = None) -> HttpResponse:
    """Add an archive, or change its entry."""
    shown = None if destination is None else get_object_or_404(Destination, pk=destination)
    form = DestinationForm(request.POST or None, instance=shown)
    kept, page = "The entry is saved. Test whether the archive answers.", "clinic/destination_form.html"
    return form_page(request, page, form, kept, lambda _: redirect("destinations"), destination=shown)


def destination_test(request: HttpRequest, destination: uuid.UUID) -> HttpResponse:
    """Check that an archive answers (C-ECHO)."""
    shown = get_object_or_404(Destination, pk=destination)
    if request.method == "POST":
        try:
            deliveries.test(shown)
        except MammometryError as error:
            messages.error(request, str(error))
        else:
            messages.success(request, f"{shown} answers.")
    return redirect("destinations")


def visit_send(request: HttpRequest, visit: uuid.UUID) -> HttpResponse:
    """Send a visit's results, and show earlier deliveries."""
    shown = get_object_or_404(Visit.objects.select_related("patient"), pk=visit)
    active = Destination.objects.filter(active=True).exclude(kind=Destination.Kind.WORKLIST)
    ask_for = None
    if request.method == "POST":
        chosen = get_object_or_404(active, pk=_key(request.POST.get("destination", "")))
        if (
            "anyway" not in request.POST
            and not shown.is_changed
            and report_file(shown, "report.pdf") is not None
            and valid_confirmation(shown) is None
        ):
            ask_for = chosen
        elif report_file(shown, "report.pdf") is None:
            messages.error(request, "This visit is not measured yet.")
        elif shown.is_changed:
            messages.error(request, CHANGED_SENTENCE)
        else:
            deliveries.enqueue(shown, chosen, person_of(request))
            messages.success(request, f"The results are being sent to {chosen}.")
        if ask_for is None:
            return redirect("visit-send", visit=visit)
    context = {
        "visit": shown,
        "patient": shown.patient,
        "destinations": active,
        "deliveries": shown.deliveries.select_related("destination", "created_by").prefetch_related("jobs")[:_SHOWN],
        "measured": report_file(shown, "report.pdf") is not None,
        "changed": CHANGED_SENTENCE if shown.is_changed else "",
        "ask_for": ask_for,
    }
    return render(request, "clinic/visit_send.html", context)


def delivery_retry(request: HttpRequest, delivery: uuid.UUID) -> HttpResponse:
    """Retry a failed delivery."""
    shown = get_object_or_404(Delivery, pk=delivery, visit__binned_at=None)
    if request.method == "POST" and shown.state == Delivery.State.FAILED:
        queue.enqueue(shown, person_of(request))
    return redirect("visit-send", visit=shown.visit_id)


def _key(text: str) -> uuid.UUID:
    try:
        return uuid.UUID(text)
    except ValueError:
        raise Http404 from None


@dataclass(frozen=True, slots=True)
class WorklistLine:
    """A worklist entry as shown on the page."""

    worklist: Destination
    entry: WorklistEntry
    name: str
    """Family name, given name."""


def worklist(request: HttpRequest) -> HttpResponse:
    """Show today's entries of all worklists, or start a visit from one."""
    if request.method == "POST":
        return _begun(request)
    lines = []
    for source in _sources():
        try:
            answer = _asked(source, day=timezone.localdate())
        except MammometryError as error:
            messages.error(request, str(error))
            continue
        for refusal in answer.refused:
            messages.error(request, str(refusal))
        lines += [WorklistLine(source, entry, ", ".join(_names(entry))) for entry in answer.entries]
    context = {"lines": lines, "sources": _sources(), "rigs": Rig.objects.filter(active=True)}
    return render(request, "clinic/worklist.html", context)


def _begun(request: HttpRequest) -> HttpResponse:
    """Start a visit from an entry, which is queried again, so that nothing is taken from the page."""
    source = get_object_or_404(_sources(), pk=_key(request.POST.get("worklist", "")))
    rig = get_object_or_404(Rig.objects.filter(active=True), pk=_key(request.POST.get("rig", "")))
    accession, number = request.POST.get("accession", ""), request.POST.get("patient", "")
    if not number:
        raise Http404
    try:
        begun = [
            entry
            for entry in _asked(source, accession=accession, patient_id=number).entries
            if (entry.order.accession, entry.patient.id) == (accession, number)
        ]
        if len(begun) != 1:
            messages.error(request, f"The worklist has {len(begun)} such entries now. Choose again.")
            return redirect("worklist")
    except MammometryError as error:
        messages.error(request, str(error))
        return redirect("worklist")
    (entry,) = begun
    patient = _patient(entry)
    if patient.born is not None and not FIRST_DAY <= patient.born <= timezone.localdate():
        messages.error(
            request,
            f"The worklist says {day(patient.born)} as date of birth. It must be between 1900 and "
            "today. Have it corrected in the hospital’s system, then choose again.",
        )
        return redirect("worklist")
    alike = duplicates(patient)
    if alike.same_number is not None:
        known = alike.same_number
        if known.binned_at is not None:
            messages.error(request, "This record number is in the bin. Take it out first, then choose again.")
            return redirect("worklist")
        if not _is_same(known, patient):
            messages.error(
                request,
                "In the clinic this record number has a different name or date of birth. Find out which is "
                "right, correct the entry, then choose again.",
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


def _patient(entry: WorklistEntry) -> Patient:
    """The entry's patient, not saved yet."""
    family, given = _names(entry)
    listed = entry.patient
    return Patient(family_name=family, given_name=given, born=listed.born, record_number=listed.id)


def _is_same(known: Patient, listed: Patient) -> bool:
    """Whether the clinic's record with this number has the same name and birthday."""
    same_day = None in (known.born, listed.born) or known.born == listed.born
    return same_day and plain_name(known.family_name) == plain_name(listed.family_name)


def _names(entry: WorklistEntry) -> tuple[str, str]:
    group = next(filter(None, entry.patient.name.split("=")), "")  # other groups write the same name in other scripts
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
