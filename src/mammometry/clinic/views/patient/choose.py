"""Searching for a patient, on every page that needs one."""

from __future__ import annotations

import uuid
from collections.abc import Callable
from functools import wraps
from typing import Any

from django.http import Http404, HttpRequest, HttpResponseBase
from django.shortcuts import redirect

from mammometry.clinic.models import Patient
from mammometry.clinic.records import search


def is_part(request: HttpRequest) -> bool:
    """Whether the page's script asks for its rows alone."""
    return request.headers.get("HX-Request") == "true"


def search_context(request: HttpRequest, *, choosing: bool = False, leave_out: Patient | None = None) -> dict[str, Any]:
    """What ``patient_search.html`` shows. The audit gets the patients who are shown.

    Args:
        request: whose ``q`` is searched for.
        choosing: whether a row leads back to this page with the patient; else it opens the patient's page.
        leave_out: a patient who is not to be chosen.
    """
    text = " ".join(request.GET.get("q", "")[:100].split())
    rows = search.matches(text, leave_out=leave_out) if text or not choosing else search.newest(leave_out=leave_out)
    shown = rows[: search.MANY]
    request.shown = [row.patient.pk for row in shown]  # type: ignore[attr-defined]
    kept = request.GET.copy()
    for name in ("q", "patient"):
        kept.pop(name, None)
    return {
        "rows": shown, "more": len(rows) > search.MANY, "asked": text, "choosing": choosing, "kept": kept,
    }  # fmt: skip


def chosen_patient(request: HttpRequest, *, leave_out: Patient | None = None) -> Patient | None:
    """The patient who was chosen. None: nobody yet.

    Raises:
        Http404: there is no such patient.
    """
    text = request.POST.get("patient") or request.GET.get("patient")
    if not text:
        return None
    try:
        patient = Patient.objects.filter(pk=uuid.UUID(text)).first()
    except ValueError:
        patient = None
    if patient is None or patient == leave_out:
        raise Http404
    return patient


def leads_on(view: Callable[..., HttpResponseBase]) -> Callable[..., HttpResponseBase]:
    """A page of a patient whose old address leads on after two records were merged."""

    @wraps(view)
    def lead(request: HttpRequest, *args: Any, **kwargs: Any) -> HttpResponseBase:
        try:
            return view(request, *args, **kwargs)
        except Http404:
            merged = Patient.everything.filter(pk=kwargs["patient"]).exclude(merged_into=None).first()
            match = request.resolver_match
            if merged is None or match is None or request.method != "GET":
                raise
            return redirect(match.view_name, **{**kwargs, "patient": merged.merged_into_id})

    return lead
