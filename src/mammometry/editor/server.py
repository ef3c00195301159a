"""The local page, which measures drawn curves and saves changes into the session."""

from collections.abc import Callable, Mapping
from typing import Any

from mammometry.api.job import Job
from mammometry.editor.page import EditorPage
from mammometry.web.local import OneTimeLogin, Page, html_page, listen, local_app, resource
from mammometry.web.replies import Application


def editor_app(opened: Callable[[], Job], login: OneTimeLogin, *, author: str | None = None) -> Application:
    """Application of the page for one session or scan.

    Args:
        opened: opens it, first for the page and again for each measurement. Its surface is computed if not current.
        login: controls access.
        author: name of the person who draws. Without it the page asks.

    Raises:
        MammometryError: the surface cannot be computed, or the subject has no boundaries.
    """
    return local_app(_LocalPage(opened, author).pages(), login)


def serve(opened: Callable[[], Job], *, ready: Callable[[str, str], None], author: str | None = None) -> None:
    """Serve the page until interrupted.

    Args:
        opened: as for `editor_app`.
        ready: as for `listen`.
        author: as for `editor_app`.

    Raises:
        MammometryError: as for `editor_app`.
    """
    login = OneTimeLogin()
    listen(editor_app(opened, login, author=author), login, ready=ready)


class _LocalPage:
    """The page of a session that this computer measures."""

    def __init__(self, opened: Callable[[], Job], author: str | None) -> None:
        self._opened, self._author = opened, author
        self.page = EditorPage(opened(), author=author)

    def pages(self) -> Mapping[str, Page]:
        """Method and path of each request → the function that answers it."""
        return {
            "GET /": lambda body: self.document(),
            "GET /drawing": lambda body: self.page.drawing(),
            "GET /items": lambda body: self.page.items(),
            "POST /measure": lambda body: self.page.measure(body),
            "POST /save": self.save,
            "POST /run": lambda body: self.measure(),
            "POST /finish": self.finish,
        }

    def document(self) -> str:
        """The page in one file."""
        styles = [resource("mammometry.report", name) for name in ("report.css", "viewer.css")]
        return html_page(
            resource("mammometry.editor", "editor.html"),
            self.page.title,
            style="".join([*styles, resource("mammometry.editor", "editor.css")]),
            script=resource("mammometry.report", "editor.js"),
        )

    def save(self, body: bytes) -> dict[str, Any]:
        """Save changes."""
        _, changed = self.page.save(body)
        return {"saved": len(changed), **self.page.items()}

    def measure(self) -> dict[str, Any]:
        """Measure with the current drawing, and write the report."""
        job = self._opened()
        job.run()
        self.page = EditorPage(job, author=self._author)
        return self.page.items()

    def finish(self, body: bytes) -> dict[str, Any]:
        """Record a confirmation."""
        self.page.finish(body)
        return self.page.items()
