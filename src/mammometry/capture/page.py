"""The local page on which cameras are aimed, focused and fired.

As the editor's, it listens only on 127.0.0.1 and answers only those who entered with a key (`editor.auth`).
"""

from __future__ import annotations

import html
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from django.http import HttpRequest, HttpResponse
from django.urls import URLPattern, path

from mammometry.capture.loop import OpenRig
from mammometry.capture.page_service import Stand, firing_table
from mammometry.editor.auth import Door
from mammometry.editor.page import resource
from mammometry.editor.server import Application, entrance_route, guarded_app, listen, page_view


@dataclass(frozen=True, slots=True, kw_only=True)
class Goal:
    """Where firings go."""

    session: Path
    """Made if there is none."""
    subject_id: str | None = None
    """Pseudonym of the patient."""
    posing: bool = False
    """Each firing is a pose of the calibration board."""


def capture_app(stand: Stand, goal: Goal, door: Door) -> Application:
    """Make the page's server."""
    return guarded_app(_routes(stand, goal, door), door)


def serve(rigged: OpenRig, goal: Goal, *, ready: Callable[[str, str], None]) -> None:
    """Serve the page until interrupted.

    Args:
        rigged: open cameras, which are let go at the end.
        goal: where firings go.
        ready: called as soon as the page answers, with the address to type, which works once, and the address of a
            local file that opens the page.
    """
    door, stand = Door("capture --page"), Stand(rigged)
    try:
        listen(capture_app(stand, goal, door), door, ready=ready)
    finally:
        stand.close()


def _routes(stand: Stand, goal: Goal, door: Door) -> tuple[URLPattern, ...]:
    title = f"{'Calibrate' if goal.posing else 'Capture'} {goal.session.name} with rig {stand.rigged.file.rig.name}"

    def document(request: HttpRequest) -> HttpResponse:
        script = resource("mammometry.report", "capture.js").replace("</", "<\\/")
        page = resource("mammometry.capture", "capture.html").replace("{{ title }}", html.escape(title))
        style = resource("mammometry.capture", "capture.css")
        return HttpResponse(page.replace("{{ style }}", style).replace("{{ script }}", script))

    def fire(request: HttpRequest) -> dict[str, Any]:
        if goal.posing:
            return stand.pose(goal.session)
        fired = stand.fire(goal.session, subject_id=goal.subject_id)
        return firing_table(fired, f"mammometry run {goal.session}")

    return (
        entrance_route(door),
        path("", page_view(GET=document)),
        path("state", page_view(GET=lambda request: stand.state(title, goal.session, posing=goal.posing))),
        path("look", page_view(POST=lambda request: stand.look(request.body))),
        path("fire", page_view(POST=fire)),
    )
