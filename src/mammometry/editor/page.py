"""The editor's page and the changes that it may make, for the local server and the clinic."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import TYPE_CHECKING, Any, TypeVar

from mammometry.api.stored_report import stored_scene
from mammometry.editor.messages import EditorMessage, Finish, Measure, Save
from mammometry.editor.session import DrawingSession
from mammometry.report.figures.shading import front_frame
from mammometry.report.models import viewer_scene
from mammometry.report.scene import to_json

if TYPE_CHECKING:
    from pathlib import Path

    from mammometry.api.job import Job

_TRIANGLES = 150_000  # of the surface on the page: fine enough to see the nipple, small enough to load; display only
_Message = TypeVar("_Message", bound=EditorMessage)


class EditorPage:
    """Drawing page of one session or scan. Its methods may be called from several threads."""

    def __init__(self, job: Job, *, author: str | None = None) -> None:
        """Prepare the surface and the scene of the page.

        Args:
            job: an open session or scan; its surface is computed if it is not current.
            author: name of the person who draws; without it the page asks.

        Raises:
            MammometryError: the surface cannot be computed, or the subject has no boundaries.
        """
        self.drawing_session = DrawingSession(job, job.identity.subject)
        self.title = job.identity.title
        self.author = author
        self._scene = _scene(job)

    def drawing(self, author: str | None = None) -> dict[str, Any]:
        """Data of the page when it is opened.

        Args:
            author: name of the logged-in person, which the page cannot change; None lets the page ask.
        """
        known = {"author": author or self.author or "", "signed": author is not None}
        return {"scene": self._scene, **known, **self.drawing_session.state()}

    def items(self) -> dict[str, Any]:
        """State of all boundaries and landmarks, as JSON."""
        return self.drawing_session.state()

    def measure(self, body: bytes) -> dict[str, Any]:
        """Measure the boundaries of a message, as JSON."""
        return self.drawing_session.live(read(Measure, body))

    def save(self, body: bytes, author: str | None = None) -> tuple[Save, tuple[Path, ...]]:
        """Save the changes of a message.

        Args:
            body: JSON.
            author: who sent it, if known; it then replaces the name in the message.

        Returns:
            The answer, and the files that were changed.
        """
        sent = _signed(read(Save, body), author)
        return sent, self.drawing_session.save(sent)

    def finish(self, body: bytes) -> None:
        """Record the confirmation of a message."""
        self.drawing_session.finish(read(Finish, body))


def _scene(job: Job) -> dict[str, Any]:
    """The surface with its photographs, from the report if that is current, else computed."""
    record = job.store.record(job.content_key)
    mesh = job.mesh.key
    if record is not None and record.inputs.get(f"{mesh.stage}/{mesh.product}", mesh.digest) == mesh.digest:
        text = stored_scene(job.store.folder)
        if text is not None:
            scene: dict[str, Any] = json.loads(text)
            return {**scene, "models": scene["models"][:1], "comparisons": []}
    finished, frame = job.surface(), front_frame(job.rig, mounting=job.inputs.mounting)
    shown = viewer_scene(frame, finished.repaired, finished.textured, triangles=_TRIANGLES)
    made: dict[str, Any] = json.loads(to_json(replace(shown, of_patient=job.inputs.subject_kind == "torso")))
    return made


def read(kind: type[_Message], body: bytes) -> _Message:
    """Read a message.

    Raises:
        ValidationError: it is invalid.
    """
    return kind.model_validate_json(body)


def _signed(sent: Any, author: str | None) -> Any:
    return sent if author is None else sent.model_copy(update={"author": author})
