"""Visits with photographs by one telephone and a printed board."""

import uuid

from django.contrib import messages
from django.db import transaction
from django.http import HttpRequest, HttpResponse
from django.shortcuts import get_object_or_404, redirect, render
from django.utils import timezone

from mammometry.api.photos import board_pdf
from mammometry.clinic.intake import walks
from mammometry.clinic.intake.places import UploadError, require_open
from mammometry.clinic.models import Visit, Walk
from mammometry.clinic.views.patients import chosen_patient, is_part, search_context
from mammometry.clinic.views.responses import person_of
from mammometry.clinic.views.visits import visit_page
from mammometry.clinic.walk_forms import BoardForm, WalkForm, print_words


def walk_new(request: HttpRequest) -> HttpResponse:
    """Start a visit of a chosen patient, who is photographed with a telephone."""
    patient = chosen_patient(request)
    if patient is None:
        page = "clinic/patients_rows.html" if is_part(request) else "clinic/walk_new.html"
        return render(request, page, search_context(request, choosing=True))
    form = WalkForm(request.POST or None, initial={"taken_at": timezone.localtime(), "patient": patient})
    if request.method == "POST" and form.is_valid():
        visit: Visit = form.save(commit=False)
        visit.created_by = person_of(request)
        with transaction.atomic():
            visit.save()
            Walk.objects.create(
                visit=visit, edge_mm=form.cleaned_data["edge_mm"], edge_std_mm=form.cleaned_data["edge_std_mm"]
            )
        return redirect("visit", visit=visit.pk)
    return render(request, "clinic/walk_new.html", {"form": form, "chosen": patient, **print_words()})


def walk_target(request: HttpRequest) -> HttpResponse:
    """The printed board as a PDF at true scale."""
    headers = {"Content-Disposition": 'inline; filename="board-telephone.pdf"'}
    return HttpResponse(board_pdf(), content_type="application/pdf", headers=headers)


def walk_board(request: HttpRequest, visit: uuid.UUID) -> HttpResponse:
    """Change the measured length of a board, before the photographs are prepared."""
    shown = get_object_or_404(Visit.objects.select_for_update(), pk=visit)
    if request.method != "POST":
        return redirect("visit", visit=visit)
    form = BoardForm(request.POST, instance=get_object_or_404(Walk, visit=shown))
    try:
        require_open(shown)
    except UploadError as error:
        messages.error(request, str(error))
        return redirect("visit", visit=visit)
    if walks.is_prepared(shown):
        messages.error(request, walks.PREPARED)
    elif not form.is_valid():
        return visit_page(request, visit, board=form)
    else:
        form.save()
        messages.success(request, "The length of the board is saved.")
    return redirect("visit", visit=visit)


def walk_again(request: HttpRequest, visit: uuid.UUID) -> HttpResponse:
    """Remove the photographs of a refused walk, so that others can be sent."""
    shown = get_object_or_404(Visit.objects.select_for_update(), pk=visit)
    get_object_or_404(Walk, visit=shown)
    if request.method == "POST":
        try:
            walks.begin_again(shown)
        except UploadError as error:
            messages.error(request, str(error))
        else:
            messages.success(request, "The photographs are deleted. Send those of the new walk.")
    return redirect("visit", visit=visit)
