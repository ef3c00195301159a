"""The board of a rig, to print."""

from __future__ import annotations

import uuid

from django.contrib import messages
from django.http import HttpRequest, HttpResponse
from django.shortcuts import get_object_or_404, redirect

from mammometry.base.errors import MammometryError, SettingsError
from mammometry.calibration.targets.target import Target
from mammometry.clinic.models import Rig

_MEASURED = ("edge_mm", "edge_std_mm", "flatness_mm")
"""Keys of a description that belong to an earlier print. The board is drawn as designed."""


def target(request: HttpRequest, rig: uuid.UUID) -> HttpResponse:
    """The calibration board of the rig's description as a PDF at true scale."""
    from mammometry.calibration.targets.table import target_from_table

    shown = get_object_or_404(Rig, pk=rig)
    table = {key: value for key, value in shown.definition.get("target", {}).items() if key not in _MEASURED}
    try:
        content = _on_smallest_page(target_from_table(table))
    except MammometryError as error:
        messages.error(request, f"The board cannot be drawn: {error}")
        return redirect("rig", rig=shown.pk)
    name = f"board-{shown.pk}.pdf"
    return HttpResponse(
        content, content_type="application/pdf", headers={"Content-Disposition": f'inline; filename="{name}"'}
    )


def _on_smallest_page(target: Target) -> bytes:
    """The board on the smallest of the usual pages that holds it, or on one of its own size."""
    from mammometry.calibration.targets.pdf import target_pdf

    for page in ("A4", "A3", "A2", "A1", "A0"):
        try:
            return target_pdf(target, page=page)
        except SettingsError:
            continue
    return target_pdf(target)
