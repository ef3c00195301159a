"""The local page on which cameras are aimed, focused and fired.

As the editor's, it listens only on 127.0.0.1 and answers only those who entered with a key (`editor.door`).
"""

from __future__ import annotations

import base64
import json
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

from django.http import HttpRequest, HttpResponse
from django.urls import URLPattern, path

from mammometry.base.errors import SessionError
from mammometry.calibration.targets.table import target_from_table
from mammometry.capture.live import Aids, LiveView
from mammometry.capture.loop import Rigged
from mammometry.editor.door import Door
from mammometry.editor.page import resource
from mammometry.editor.server import Application, entrance_route, guarded_app, listen, page_view


class CapturePage:
    """What the page asks for, one at a time.

    A firing waits for a live picture, and the other way round.
    """

    def __init__(self, rigged: Rigged, session: Path, *, subject_id: str | None = None) -> None:
        self._rigged, self._session, self._subject_id = rigged, session, subject_id
        table = rigged.file.target
        target = None if table is None else target_from_table(table)
        self._live = LiveView(rigged.backend, rigged.cameras, rigged.file.subject.kind, target)
        self._one = threading.Lock()

    def state(self) -> dict[str, Any]:
        """The rig before anything is fired."""
        with self._one:
            faults = self._rigged.faults()
        skew = self._rigged.skew
        return {
            "rig": self._rigged.file.rig.name,
            "session": self._session.name,
            "cameras": list(self._rigged.cameras),
            "faults": faults,
            "calibrated": self._rigged.rig is not None,
            "skew": None if skew is None else skew.as_table(),
        }

    def look(self, body: bytes) -> dict[str, Any]:
        """A live picture of every camera, with its aids.

        Raises:
            SessionError: the request is not ``{"calibrating": true or false}``.
        """
        with self._one:
            seen = self._live.look(calibrating=_asked(body, "calibrating"))
        return {"cameras": {name: _shown(one) for name, one in seen.items()}, "wanted": dict(self._live.wanted())}

    def fire(self) -> dict[str, Any]:
        """One firing, written and judged."""
        with self._one:
            fired = self._rigged.fire_into(self._session, subject_id=self._subject_id)
        return {
            "accepted": fired.accepted,
            "shot": fired.shot.name,
            "said": list(fired.verdict.said),
            "next": f"mammometry run {self._session}" if fired.accepted else "",
            **fired.verdict.as_table(),
        }

    def close(self) -> None:
        """End the live pictures."""
        self._live.close()


def capture_app(page: CapturePage, door: Door) -> Application:
    """Make the page's server."""
    return guarded_app(_routes(page, door), door)


def serve(rigged: Rigged, session: Path, *, ready: Callable[[str, str], None], subject_id: str | None = None) -> None:
    """Serve the page until interrupted.

    Args:
        rigged: open cameras.
        session: where firings go.
        ready: called as soon as the page answers, with the address to type, which works once, and the address of a
            local file that opens the page.
        subject_id: pseudonym of the patient.
    """
    door, page = Door("capture --page"), CapturePage(rigged, session, subject_id=subject_id)
    try:
        listen(capture_app(page, door), door, ready=ready)
    finally:
        page.close()


def _routes(page: CapturePage, door: Door) -> tuple[URLPattern, ...]:
    def document(request: HttpRequest) -> HttpResponse:
        return HttpResponse(resource("mammometry.capture", "capture.html"))

    return (
        entrance_route(door),
        path("", page_view(GET=document)),
        path("state", page_view(GET=lambda request: page.state())),
        path("look", page_view(POST=lambda request: page.look(request.body))),
        path("fire", page_view(POST=lambda request: page.fire())),
    )


def _asked(body: bytes, name: str) -> bool:
    try:
        value = json.loads(body)[name]
    except (ValueError, KeyError, TypeError, RecursionError):
        value = None
    if not isinstance(value, bool):
        raise SessionError("the request", found="something else", expected=f"{name}: true or false", remedy="Reload")
    return value


def _shown(one: Aids | str) -> dict[str, Any]:
    if isinstance(one, str):
        return {"fault": one}
    return {**one.as_table(), "picture": base64.b64encode(one.jpeg).decode("ascii")}
