"""What programs of a page are answered. JSON, and one sentence where something cannot be done."""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import wraps
from typing import Any, TypeVar

from django.core.exceptions import PermissionDenied
from django.http import Http404, HttpRequest, HttpResponseBase, JsonResponse

from mammometry.base.errors import MammometryError
from mammometry.clinic.intake.uploads import UploadError
from mammometry.clinic.models import Comparison, Visit
from mammometry.clinic.models.keyed import Keyed
from mammometry.clinic.roles import CARE

Row = TypeVar("Row", bound=Keyed)


class Refused(Exception):
    """Something cannot be done. Its text is the sentence that says why."""

    def __init__(self, sentence: str, status: int = 409) -> None:
        super().__init__(sentence)
        self.status = status


def json_view(*methods: str) -> Callable[[Callable[..., HttpResponseBase]], Callable[..., HttpResponseBase]]:
    """A view of these methods only, whose errors are JSON."""

    def wrapped(view: Callable[..., HttpResponseBase]) -> Callable[..., HttpResponseBase]:
        @wraps(view)
        def answer(request: HttpRequest, *args: Any, **kwargs: Any) -> HttpResponseBase:
            if request.method not in methods:
                return JsonResponse(
                    {"error": f"Only {', '.join(methods)}."}, status=405, headers={"Allow": ", ".join(methods)}
                )
            try:
                return view(request, *args, **kwargs)
            except (Refused, UploadError) as error:
                return JsonResponse({"error": str(error)}, status=error.status)
            except MammometryError as error:
                return JsonResponse({"error": str(error)}, status=409 if error.exit_code != 9 else 507)

        return answer

    return wrapped


def json_body(request: HttpRequest) -> dict[str, Any]:
    """What the request's JSON says. Nothing where it has none.

    Raises:
        Refused: it is no JSON object.
    """
    if not request.body:
        return {}
    try:
        table = json.loads(request.body)
    except (ValueError, RecursionError):
        table = None
    if not isinstance(table, dict):
        raise Refused("The request is no JSON object.", 400)
    return table


def text_of(table: dict[str, Any], name: str, *, most: int = 200) -> str:
    """A text of the request. Empty where there is none.

    Raises:
        Refused: it is no text, or too long.
    """
    value = table.get(name)
    if value is None:
        return ""
    if not isinstance(value, str) or len(value) > most:
        raise Refused(f"{name} is no text of at most {most} characters.", 400)
    return value


def require_care(request: HttpRequest, target: object) -> None:
    """Refuse what is of a patient to those who only keep rigs, and what lies in the bin to everybody.

    Raises:
        PermissionDenied: it is a visit or a comparison, and this person cares for no patients.
        Http404: it is a visit in the bin.
    """
    if isinstance(target, Visit | Comparison) and not request.user.has_role(*CARE):  # type: ignore[union-attr]  # logged in
        raise PermissionDenied
    if isinstance(target, Visit) and target.binned_at is not None:
        raise Http404


def get_or_404(row: Row | None) -> Row:
    """A row, or the page that says that there is none."""
    if row is None:
        raise Http404
    return row
