"""The page on which cameras are aimed, focused and fired, served by the local server or the clinic."""

import base64
import html
import json
import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from django.http import HttpRequest, HttpResponse
from django.urls import URLPattern, path

from mammometry.base.errors import SessionError
from mammometry.calibration.targets.table import target_from_table
from mammometry.capture.live import Aids, LiveView
from mammometry.capture.loop import CaptureResult, OpenRig, PoseResult
from mammometry.editor.auth import Door
from mammometry.editor.page import resource
from mammometry.editor.server import Application, entrance_route, guarded_app, listen, page_view


class Stand:
    """Open cameras behind a page: one request at a time.

    A firing waits for a live picture, and the other way round.
    """

    def __init__(self, rigged: OpenRig) -> None:
        self.rigged = rigged
        table = rigged.file.target
        self._target = None if table is None else target_from_table(table)
        self._live = LiveView(rigged.backend, rigged.cameras, rigged.file.subject.kind, self._target)
        self._one = threading.Lock()

    def state(self, title: str, session: Path, *, posing: bool = False) -> dict[str, Any]:
        """The rig before anything is fired.

        Args:
            title: of the page.
            session: where firings go.
            posing: whether the calibration board is photographed, pose by pose.
        """
        with self._one:
            faults = self.rigged.faults()
            guidance = _guidance(self.rigged.guidance(session)) if posing else {}
        return {
            "title": title,
            "cameras": list(self.rigged.cameras),
            "faults": faults,
            "calibrated": self.rigged.rig is not None,
            "board": self._target is not None,
            "posing": posing,
            **guidance,
        }

    def look(self, body: bytes, *, subject_kind: str | None = None) -> dict[str, Any]:
        """A live picture of every camera, with its aids.

        Raises:
            SessionError: the request is not ``{"calibrating": true or false}``.
        """
        with self._one:
            seen = self._live.look(calibrating=_asked(body, "calibrating"), subject_kind=subject_kind)
        return {"cameras": {name: _shown(aids) for name, aids in seen.items()}, "wanted": dict(self._live.wanted())}

    def fire(self, session: Path, *, subject_id: str | None = None) -> CaptureResult:
        """One firing, written and judged: `Rigged.fire_into`."""
        with self._one:
            return self.rigged.fire_into(session, subject_id=subject_id)

    def pose(self, session: Path) -> dict[str, Any]:
        """One pose of the calibration board, for the page."""
        with self._one:
            posed = self.rigged.fire_pose(session)
        lines = [f"Pose {posed.pose} is taken, {posed.count} in all."]
        lines.append(f"Not calibrated yet: {posed.why}" if posed.progress is None else posed.progress.sentence)
        good = posed.progress is not None and posed.progress.good_enough
        return {"accepted": True, "said": lines, "good_enough": good, **_guidance(posed)}

    def close(self) -> None:
        """End the live pictures and let the cameras go."""
        self._live.close()
        self.rigged.close()


def firing_table(fired: CaptureResult, then: str) -> dict[str, Any]:
    """A firing's result as JSON for the page.

    Args:
        fired: what came of it.
        then: what to do with pictures that may be measured.
    """
    return {
        "accepted": fired.accepted,
        "shot": fired.shot.name,
        "said": list(fired.verdict.sentences),
        "next": then if fired.accepted else "",
        **fired.verdict.as_table(),
    }


def _guidance(posed: PoseResult) -> dict[str, Any]:
    suggestion = posed.suggestion
    outlines = (
        {} if suggestion is None else {name: outline.round(4).tolist() for name, outline in suggestion.outlines.items()}
    )
    return {"next": posed.sentence, "outlines": outlines}


def _asked(body: bytes, name: str) -> bool:
    try:
        value = json.loads(body)[name]
    except (ValueError, KeyError, TypeError, RecursionError):
        value = None
    if not isinstance(value, bool):
        raise SessionError("the request", found="something else", expected=f"{name}: true or false", remedy="Reload")
    return value


def _shown(aids: Aids | str) -> dict[str, Any]:
    if isinstance(aids, str):
        return {"fault": aids}
    return {**aids.as_table(), "picture": base64.b64encode(aids.jpeg).decode("ascii")}


@dataclass(frozen=True, slots=True, kw_only=True)
class Goal:
    """Session into which the page fires."""

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
