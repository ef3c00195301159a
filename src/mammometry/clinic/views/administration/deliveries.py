"""Results on their way to archives, and the archives themselves."""

from __future__ import annotations

import uuid
from typing import TYPE_CHECKING, Any

from django import forms
from django.contrib import messages
from django.http import Http404, HttpRequest, HttpResponse
from django.shortcuts import get_object_or_404, redirect, render

from mammometry.base.errors import MammometryError
from mammometry.clinic import deliveries
from mammometry.clinic.forms import require_dicom_text
from mammometry.clinic.models import Delivery, Destination, Visit
from mammometry.clinic.records.confirmations import CHANGED_SENTENCE, is_changed
from mammometry.clinic.records.reports import report_file
from mammometry.clinic.views.who import person_of
from mammometry.hospital.peers import Peer, web_address

if TYPE_CHECKING:
    _DestinationForm = forms.ModelForm[Destination]
else:  # it cannot be subscripted while the program runs
    _DestinationForm = forms.ModelForm
_SHOWN = 100  # newest deliveries


class DestinationForm(_DestinationForm):
    """An archive, and how it is spoken to."""

    class Meta:
        model = Destination
        fields = (
            *("name", "kind", "address", "own_title", "encrypted", "authorities", "certificate", "key"),
            *("commitment", "promise_port", "active"),
        )
        labels = {  # noqa: RUF012
            "kind": "Spoken to by", "own_title": "Our AE title", "encrypted": "Encrypted (TLS)",
            "authorities": "File of the archive's certificates", "certificate": "File of our certificate",
            "key": "File of its key", "commitment": "Await the promise to keep what was sent",
            "promise_port": "Port for the promise", "active": "In use",
        }  # fmt: skip
        help_texts = {  # noqa: RUF012
            "address": "PACS@10.0.0.5:104, or https://pacs.example.org/dicom-web.",
            "authorities": "On the clinic's server, PEM. Empty: those that the system trusts.",
            "certificate": "On the clinic's server, PEM. Only if the archive asks for one.",
            "key": "PEM. Empty: in the same file.",
            "commitment": "DICOM storage commitment. Without the promise, the results are sent again later.",
            "promise_port": "If the archive calls back. Empty: it answers on the same connection.",
        }

    def clean_own_title(self) -> str:
        """Refuse what is no title of a DICOM application."""
        title: str = self.cleaned_data["own_title"]
        require_dicom_text(title, "AE")
        return title

    def clean(self) -> dict[str, Any]:
        """Refuse addresses that are none."""
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


def destination_new(request: HttpRequest) -> HttpResponse:
    """Enter an archive."""
    return _edited(request, None)


def destination_edit(request: HttpRequest, destination: uuid.UUID) -> HttpResponse:
    """Change an archive's entry."""
    return _edited(request, get_object_or_404(Destination, pk=destination))


def destination_test(request: HttpRequest, destination: uuid.UUID) -> HttpResponse:
    """Ask an archive whether it answers (C-ECHO)."""
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
    """Have a visit's results sent, and say what became of earlier ones."""
    shown = get_object_or_404(Visit.objects.select_related("patient"), pk=visit)
    active = Destination.objects.filter(active=True).exclude(kind=Destination.Kind.WORKLIST)
    if request.method == "POST":
        chosen = get_object_or_404(active, pk=_key(request.POST.get("destination", "")))
        if report_file(shown, "report.pdf") is None:
            messages.error(request, "This visit is not measured yet.")
        elif is_changed(shown):
            messages.error(request, CHANGED_SENTENCE)
        else:
            deliveries.enqueue(shown, chosen, person_of(request))
            messages.success(request, f"The results are on their way to {chosen}.")
        return redirect("visit-send", visit=visit)
    context = {
        "visit": shown,
        "patient": shown.patient,
        "destinations": active,
        "deliveries": shown.deliveries.select_related("destination", "created_by")[:_SHOWN],
        "measured": report_file(shown, "report.pdf") is not None,
        "changed": CHANGED_SENTENCE if is_changed(shown) else "",
    }
    return render(request, "clinic/visit_send.html", context)


def delivery_retry(request: HttpRequest, delivery: uuid.UUID) -> HttpResponse:
    """Try a failed delivery again."""
    shown = get_object_or_404(Delivery, pk=delivery, visit__binned_at=None)
    if request.method == "POST":
        deliveries.again(shown)
    return redirect("visit-send", visit=shown.visit_id)


def _edited(request: HttpRequest, shown: Destination | None) -> HttpResponse:
    form = DestinationForm(request.POST or None, instance=shown)
    if request.method == "POST" and form.is_valid():
        form.save()
        messages.success(request, "The entry is kept. Test whether the archive answers.")
        return redirect("destinations")
    return render(request, "clinic/destination_form.html", {"form": form, "destination": shown})


def _key(text: str) -> uuid.UUID:
    try:
        return uuid.UUID(text)
    except ValueError:
        raise Http404 from None
