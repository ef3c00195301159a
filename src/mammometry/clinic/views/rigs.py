"""Pages of rigs. May we measure today, calibrations and their history, drift, the daily check."""

from __future__ import annotations

import uuid
from typing import Any

from django.contrib import messages
from django.http import HttpRequest, HttpResponse
from django.shortcuts import get_object_or_404, redirect, render

from mammometry.capture.sessions import cameras_of
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
        "cameras": cameras_of(shown.definition),
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
    context = {
        "calibration": shown,
        "rig": shown.rig,
        "job": shown.jobs.order_by("-created").first(),
        **_figures(shown.figures),
    }
    return render(request, "clinic/calibration.html", context)


def check(request: HttpRequest, check: uuid.UUID) -> HttpResponse:
    """One daily check."""
    shown = get_object_or_404(DailyCheck.objects.select_related("rig", "by"), pk=check)
    context = {
        "check": shown,
        "rig": shown.rig,
        "job": shown.jobs.order_by("-created").first(),
        **_figures(shown.figures),
    }
    return render(request, "clinic/check.html", context)


def _edited(request: HttpRequest, rig: Rig | None) -> HttpResponse:
    form = RigForm(request.POST or None, request.FILES or None, instance=rig)
    if request.method == "POST" and form.is_valid():
        made = form.save()
        messages.success(request, "The rig is saved.")
        return redirect("rig", rig=made.pk)
    return render(request, "clinic/rig_form.html", {"form": form, "rig": rig})


_SINGLE = (
    ("rms_px", "Reprojection error, RMS", "{:.2f} px"),
    ("rms_mm", "The same on the subject, RMS", "{:.2f} mm"),
    ("worst_pair_mm", "Expected error of the worst pair", "{:.2f} mm"),
    ("volume_coverage", "Share of the measuring space that the board filled", "{:.0%}"),
    ("poses", "Poses of the board", "{}"),
    ("effect_mm", "Effect of the movement on a length", "{:.2f} mm"),
    ("limit_mm", "Allowed", "{:.2f} mm"),
)
_BY_CAMERA = (
    ("rms_px_of", "Reprojection error by camera", "{:.2f} px"),
    ("expected_mm_of", "Expected error by pair", "{:.2f} mm"),
    ("coverage_of", "Share of the picture that the board filled, by camera", "{:.0%}"),
)


def _figures(figures: dict[str, Any]) -> dict[str, Any]:
    """Figures of a calibration or check in words with their units."""
    single = [(title, form.format(figures[key])) for key, title, form in _SINGLE if figures.get(key) is not None]
    tables = [
        (
            title,
            [
                (camera.replace("_", " "), form.format(value))
                for camera, value in figures[key].items()
                if value is not None
            ],
        )
        for key, title, form in _BY_CAMERA
        if figures.get(key)
    ]
    return {"figures": single, "tables": tables}
