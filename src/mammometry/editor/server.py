"""The local page: serves the surface, measures what is drawn, saves changes into the session.

It listens only on 127.0.0.1, and answers only those who entered with a key (`door`).
"""

from __future__ import annotations

import json
import socket
from collections.abc import Callable
from dataclasses import replace
from importlib.resources import files
from typing import Any

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import HTMLResponse, JSONResponse, Response

from mammometry.api.job import Job
from mammometry.base.errors import MammometryError, StorageError
from mammometry.editor.desk import Desk
from mammometry.editor.door import HOST, Door, entrance, local_page, sealed
from mammometry.editor.messages import Confirm, Measure, Save, sentence
from mammometry.io.drawn_changes import LateError
from mammometry.report.figures.shading import front_frame
from mammometry.report.models import viewer_scene
from mammometry.report.scene import to_json

_TRIANGLES = 150_000  # of the surface on the page: fine enough to see the nipple, light enough to load; chosen by eye


def editor_app(job: Job, door: Door, *, author: str | None = None) -> FastAPI:
    """Make the server of the page for one session.

    Args:
        job: an open session; its surface is made if it is not current.
        door: decides who may enter.
        author: name of the person who draws. Without it the page asks.

    Raises:
        MammometryError: the surface cannot be made, or the subject has nothing to draw on.
    """
    desk = Desk(job, job.identity.subject)
    finished, rig = job.plan.surfaced.mesh(), job.plan.calibrated.cameras().rig
    frame = front_frame(rig, mounting=job.inputs.mounting)
    shown = viewer_scene(frame, finished.repaired, finished.textured, triangles=_TRIANGLES)
    scene = json.loads(to_json(replace(shown, of_patient=desk.kind == "torso")))
    app = FastAPI(docs_url=None, redoc_url=None, openapi_url=None)

    @app.middleware("http")
    async def guard(request: Request, answer: Callable[[Request], Any]) -> Response:
        return sealed(door.refusal(request) or await answer(request))

    @app.exception_handler(RequestValidationError)
    async def malformed(request: Request, error: RequestValidationError) -> JSONResponse:
        return JSONResponse({"detail": sentence(list(error.errors()))}, 422)

    @app.exception_handler(MammometryError)
    async def refused(request: Request, error: MammometryError) -> JSONResponse:
        if isinstance(error, LateError):
            return JSONResponse({"detail": str(error), "late": [list(item) for item in error.items]}, 409)
        return JSONResponse({"detail": str(error)}, 500 if isinstance(error, StorageError) else 422)

    @app.get("/enter")
    def ask() -> HTMLResponse:
        return entrance()

    @app.post("/enter")
    async def enter(request: Request) -> Response:
        return await door.enter(request)

    @app.get("/")
    def page() -> HTMLResponse:
        return HTMLResponse(_page(job.identity.title))

    @app.get("/drawing")
    def drawing() -> JSONResponse:
        return JSONResponse({"scene": scene, "author": author or "", **desk.state()})

    @app.get("/items")
    def items() -> JSONResponse:
        return JSONResponse(desk.state())

    @app.post("/measure")
    def measure(sent: Measure) -> JSONResponse:
        return JSONResponse(desk.measured(sent))

    @app.post("/save")
    def save(sent: Save) -> JSONResponse:
        changed = desk.save(sent)
        return JSONResponse({"saved": [path.name for path in changed], **desk.state()})

    @app.post("/confirm")
    def confirm(sent: Confirm) -> JSONResponse:
        desk.confirm(sent)
        return JSONResponse(desk.state())

    return app


def serve(job: Job, *, ready: Callable[[str, str], None], author: str | None = None) -> None:
    """Serve the page until interrupted.

    Args:
        job: an open session.
        ready: called as soon as the page answers, with the address to type, which works once, and the address of a
            local file that opens the page without showing a key to other users of this computer.
        author: as for `editor_app`.

    Raises:
        MammometryError: as for `editor_app`.
    """
    import uvicorn

    door = Door()
    app = editor_app(job, door, author=author)
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as listener:
        listener.bind((HOST, 0))
        listener.listen()  # from here on a browser that comes early waits
        address = f"http://{HOST}:{listener.getsockname()[1]}"
        server = uvicorn.Server(uvicorn.Config(app, log_level="warning", access_log=False))
        with local_page(address, door.new_key()) as file:
            ready(f"{address}/enter#{door.new_key()}", file.as_uri())
            server.run(sockets=[listener])


def _page(title: str) -> str:
    from jinja2 import Environment, StrictUndefined
    from markupsafe import Markup

    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    template = environment.from_string(_resource("mammometry.editor", "editor.html.j2"))
    style = "".join(_resource("mammometry.report", name) for name in ("report.css", "viewer.css"))
    script = _resource("mammometry.report", "editor.js").replace("</", "<\\/")
    return template.render(
        title=title, style=Markup(style + _resource("mammometry.editor", "editor.css")), script=Markup(script)
    )


def _resource(package: str, name: str) -> str:
    return files(package).joinpath("templates", name).read_text(encoding="utf-8")
