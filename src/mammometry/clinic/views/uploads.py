"""Requests about uploads: start, continue, assign, set aside, restore, view."""

from typing import Any
from uuid import UUID

from django.http import Http404, HttpRequest, HttpResponse, HttpResponseBase, JsonResponse
from django.shortcuts import get_object_or_404
from django.urls import reverse

from mammometry.base.errors import MammometryError
from mammometry.clinic.intake import uploads
from mammometry.clinic.intake.announced import Announced
from mammometry.clinic.intake.photographs import screen_picture, thumbnail_path
from mammometry.clinic.intake.places import UploadError, target_of
from mammometry.clinic.models import Calibration, DailyCheck, Upload, Visit
from mammometry.clinic.records.search import elsewhere, same_photographs
from mammometry.clinic.views.responses import (
    json_body,
    json_view,
    require_care,
    require_photographer,
    text_of,
    visit_or_404,
)
from mammometry.io.photographs.images import read_photograph
from mammometry.web.replies import Refused

BODY_BYTES = uploads.CHUNK_BYTES + 4096
_TARGETS: dict[str, Any] = {"visit": Visit, "calibration": Calibration, "check": DailyCheck}


def as_json(table: dict[str, Any]) -> dict[str, Any]:
    """An upload with its addresses, for JSON."""
    key = table["id"]
    picture = reverse("upload-thumbnail", kwargs={"upload": key}) if table["has_thumbnail"] else None
    shown = {name: value for name, value in table.items() if name != "has_thumbnail"}
    return {**shown, "url": reverse("upload", kwargs={"upload": key}), "thumbnail": picture}


@json_view("POST")
def new(request: HttpRequest) -> HttpResponseBase:
    """Start an upload."""
    table = json_body(request)
    model = _TARGETS.get(text_of(table, "for"))
    try:
        key = UUID(text_of(table, "id"))
    except ValueError:
        model = None
    if model is None:
        raise Refused("State the target: visit, calibration or check, and its id.", 400)
    target = get_object_or_404(model, pk=key)
    require_photographer(request, target)
    size = table.get("size_bytes")
    if not isinstance(size, int) or isinstance(size, bool):
        raise Refused("size_bytes is no whole number.", 400)
    before = Upload.objects.count()
    try:
        upload = uploads.begin(
            target,
            request.user,  # type: ignore[arg-type]  # logged in
            Announced(
                name=text_of(table, "name", most=400),
                camera=text_of(table, "camera") or None,
                pose=text_of(table, "pose"),
                size_bytes=size,
                sha256=text_of(table, "sha256"),
            ),
            replace=table.get("replace") is True,
        )
    except uploads.OccupiedError as error:
        return JsonResponse({"error": str(error), "occupied": True}, status=error.status)
    return JsonResponse(as_json(uploads.table_of(upload)), status=201 if Upload.objects.count() > before else 200)


@json_view("GET", "PATCH", "DELETE")
def one(request: HttpRequest, upload: UUID) -> HttpResponseBase:
    """Return the offset, receive the next piece, or set the upload aside.

    If a complete file cannot be used, the answer to its last piece is 422 with the reason.
    """
    row = _find(request, upload)
    if request.method == "DELETE":
        uploads.remove(row)
        return HttpResponse(status=204)
    if request.method == "PATCH":
        offset = request.headers.get("Upload-Offset", "")
        if not (offset.isascii() and offset.isdecimal() and len(offset) < 16):
            raise Refused("The header Upload-Offset is missing or no whole number.", 400)
        try:
            row = uploads.append(row, int(offset), request.body)
        except UploadError as error:
            table = as_json(uploads.table_of(row))
            return JsonResponse({**table, "error": str(error)}, status=error.status)
        if row.state == Upload.State.REFUSED:
            reason = next(check["sentence"] for check in row.checks if check["level"] == "refuse")
            return JsonResponse({**as_json(uploads.table_of(row)), "error": reason}, status=422)
    else:
        row = uploads.resumed(row)
    return JsonResponse(as_json(uploads.table_of(row)))


@json_view("POST")
def place(request: HttpRequest, upload: UUID) -> HttpResponseBase:
    """Choose the camera of a photograph."""
    row = uploads.place(_find(request, upload), text_of(json_body(request), "camera"))
    return JsonResponse(as_json(uploads.table_of(row)))


@json_view("POST")
def put_right(request: HttpRequest, visit: UUID) -> HttpResponseBase:
    """Assign swapped photographs to the right cameras."""
    row = visit_or_404(visit)
    exchanged = json_body(request).get("exchanged")
    if not isinstance(exchanged, dict):
        raise Refused("State which photographs are exchanged.", 400)
    uploads.put_right(row, exchanged)
    return _state(row)


@json_view("POST")
def back(request: HttpRequest, upload: UUID) -> HttpResponseBase:
    """Restore a photograph that was set aside."""
    row = _find(request, upload)
    uploads.bring_back(row)
    return JsonResponse(as_json(uploads.table_of(row)))


@json_view("GET")
def thumbnail(request: HttpRequest, upload: UUID) -> HttpResponseBase:
    """Thumbnail of an uploaded photograph."""
    path = thumbnail_path(_find(request, upload))
    if not path.is_file():
        raise Http404
    return HttpResponse(path.read_bytes(), content_type="image/webp", headers={"Cache-Control": "private, no-store"})


@json_view("GET")
def screen(request: HttpRequest, upload: UUID) -> HttpResponseBase:
    """A visit's photograph, large enough for the screen."""
    row = _find(request, upload)
    if row.visit is None or row.state != Upload.State.PLACED:
        raise Http404
    try:
        photograph = read_photograph(row.visit.folder / row.name, row.camera)
    except MammometryError:
        raise Http404 from None
    headers = {"Cache-Control": "private, no-store"}
    return HttpResponse(screen_picture(photograph), content_type="image/webp", headers=headers)


@json_view("GET")
def of_visit(request: HttpRequest, visit: UUID) -> HttpResponseBase:
    """All photographs of a visit."""
    return _state(visit_or_404(visit))


@json_view("GET")
def of_calibration(request: HttpRequest, calibration: UUID) -> HttpResponseBase:
    """All photographs of a calibration."""
    return _state(get_object_or_404(Calibration.objects.select_related("rig"), pk=calibration))


@json_view("GET")
def of_check(request: HttpRequest, check: UUID) -> HttpResponseBase:
    """All photographs of a daily check."""
    return _state(get_object_or_404(DailyCheck.objects.select_related("rig", "calibration"), pk=check))


def _find(request: HttpRequest, key: UUID) -> Upload:
    related = ("visit__rig", "visit__calibration", "visit__patient", "calibration__rig", "check_of_day__rig")
    rows = Upload.objects.select_related(*related, "check_of_day__calibration")
    row: Upload = get_object_or_404(rows, pk=key)
    if request.method in ("GET", "HEAD"):
        require_care(request, target_of(row))
    else:
        require_photographer(request, target_of(row))
    return row


def _state(target: Visit | Calibration | DailyCheck) -> JsonResponse:
    table = uploads.state_of(target)
    for name in ("unplaced", "set_aside", "shots"):
        table |= {name: [as_json(row) for row in table[name]]} if name in table else {}
    if isinstance(target, Visit):
        table["together"] += [
            {"check": "elsewhere", "level": "warn", "sentence": elsewhere(other, cameras),
             "url": reverse("visit", kwargs={"visit": other.pk})}
            for other, cameras in same_photographs(target)
        ]  # fmt: skip
    for row in table.get("cameras", ()):
        row["upload"] = None if row["upload"] is None else as_json(row["upload"])
    if "poses" in table:
        table["poses"] = {
            pose: {camera: as_json(shot) for camera, shot in shots.items()} for pose, shots in table["poses"].items()
        }
    return JsonResponse(table)
