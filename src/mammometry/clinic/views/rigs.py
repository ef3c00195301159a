"""Rigs: may we measure today, calibrations and their history, drift, the daily check."""

from __future__ import annotations

import uuid
from typing import Any

from django.contrib import messages
from django.http import HttpRequest, HttpResponse
from django.shortcuts import get_object_or_404, redirect, render

from mammometry.clinic.forms import RigForm
from mammometry.clinic.models import Calibration, DailyCheck, Rig
from mammometry.clinic.rigs.history import drift_rows
from mammometry.clinic.rigs.history import today as verdict_of


def rigs(request: HttpRequest) -> HttpResponse:
    """All rigs with the verdict of today."""
    rows = [(rig, verdict_of(rig) if rig.active else None) for rig in Rig.objects.all()]
    return render(request, "clinic/rigs.html", {"rows": rows})


def rig(request: HttpRequest, rig: uuid.UUID) -> HttpResponse:
    """One rig: verdict, calibrations, checks, drift."""
    shown = get_object_or_404(Rig, pk=rig)
    context = {
        "rig": shown,
        "verdict": verdict_of(shown),
        "calibrations": shown.calibrations.select_related("created_by")[:50],
        "checks": shown.checks.select_related("by")[:30],
        "drift": list(drift_rows(shown)),
        "cameras": _cameras(shown),
    }
    return render(request, "clinic/rig.html", context)


def rig_new(request: HttpRequest) -> HttpResponse:
    """Enter a rig."""
    return _edited(request, None)


def rig_edit(request: HttpRequest, rig: uuid.UUID) -> HttpResponse:
    """Change a rig's name, note or description."""
    return _edited(request, get_object_or_404(Rig, pk=rig))


def calibration(request: HttpRequest, calibration: uuid.UUID) -> HttpResponse:
    """One calibration: its photographs, progress, figures and verdict."""
    shown = get_object_or_404(Calibration.objects.select_related("rig", "created_by"), pk=calibration)
    context = {"calibration": shown, "rig": shown.rig, "job": shown.jobs.order_by("-created").first(), **_figures(shown.figures)}
    return render(request, "clinic/calibration.html", context)


def check(request: HttpRequest, check: uuid.UUID) -> HttpResponse:
    """One daily check."""
    shown = get_object_or_404(DailyCheck.objects.select_related("rig", "by"), pk=check)
    context = {"check": shown, "rig": shown.rig, "job": shown.jobs.order_by("-created").first(), **_figures(shown.figures)}
    return render(request, "clinic/check.html", context)


def _edited(request: HttpRequest, rig: Rig | None) -> HttpResponse:
    form = RigForm(request.POST or None, request.FILES or None, instance=rig)
    if request.method == "POST" and form.is_valid():
        made = form.save()
        messages.success(request, "The rig is saved.")
        return redirect("rig", rig=made.pk)
    return render(request, "clinic/rig_form.html", {"form": form, "rig": rig})


def _cameras(rig: Rig) -> list[str]:
    cameras = rig.definition.get("rig", {}).get("cameras", [])
    return [str(name) for name in cameras]


def _figures(figures: dict[str, Any]) -> dict[str, Any]:
    """Single figures in words with their units, and tables by camera."""
    single = [(_words(name), value) for name, value in figures.items() if isinstance(value, int | float | str)]
    return {"figures": single, "by_camera": {_words(k): v for k, v in figures.items() if isinstance(v, dict)}}


def _words(name: str) -> str:
    """``worst_pair_mm`` as "Worst pair (mm)"."""
    stem, _, unit = name.rpartition("_")
    if unit in ("mm", "px", "deg", "cc") and stem:
        return f"{stem.replace('_', ' ').capitalize()} ({unit})"
    return name.replace("_", " ").capitalize()
