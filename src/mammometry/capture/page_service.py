"""What a capture page asks for. Whoever serves it: the local server or the clinic."""

from __future__ import annotations

import base64
import json
import threading
from pathlib import Path
from typing import Any

from mammometry.base.errors import SessionError
from mammometry.calibration.targets.table import target_from_table
from mammometry.capture.live import Aids, LiveView
from mammometry.capture.loop import CaptureResult, OpenRig, PoseResult


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
    """A firing, for the page.

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
    found = posed.suggestion
    outlines = {} if found is None else {name: outline.round(4).tolist() for name, outline in found.outlines.items()}
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
