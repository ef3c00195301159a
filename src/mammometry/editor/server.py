"""The local page: serves the surface, measures what is drawn, saves it into the session.

It listens on 127.0.0.1 only, under an address with a random token, and answers nobody who comes by another host name.
"""

from __future__ import annotations

import json
import secrets
import socket
from collections.abc import Callable
from importlib.resources import files
from threading import Lock
from typing import Annotated, Any, Literal

import numpy as np
from fastapi import FastAPI, HTTPException, Request
from fastapi.responses import HTMLResponse, JSONResponse, Response
from pydantic import BaseModel, ConfigDict, Field

from mammometry.api import Job
from mammometry.editor.drawing import LiveVolume, drawing_board, handles_of
from mammometry.errors import MammometryError, SessionError
from mammometry.io.drawn import BREASTS, read_boundaries, read_landmarks, write_drawn
from mammometry.measure.landmarks import LANDMARKS
from mammometry.report.models import viewer_scene
from mammometry.report.scene import to_json

HOST = "127.0.0.1"
_TRIANGLES = 150_000
_Point = tuple[float, float, float]
_Curve = Annotated[list[_Point], Field(min_length=3, max_length=5000)]
_Place = Annotated[list[_Point], Field(min_length=1, max_length=5000)]
_HEADERS = {"Cache-Control": "no-store", "Referrer-Policy": "no-referrer", "X-Frame-Options": "DENY"}


class Drawn(BaseModel):
    """What the page sends: handles by breast, points by landmark; mm, world frame."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)
    boundaries: dict[Literal["model", "left", "right"], _Curve] = {}
    landmarks: dict[str, _Place] = {}


def editor_app(job: Job, token: str) -> FastAPI:
    """The page's server for one session whose surface has been made.

    Args:
        job: an open session; its surface is made if it is not current.
        token: the address is ``http://127.0.0.1:PORT/TOKEN/``.

    Raises:
        MammometryError: the surface cannot be made, or the subject has nothing to draw on.
    """
    kind = job.inputs.subject_kind
    if not BREASTS[kind]:
        raise SessionError(
            "session.toml",
            found="an open surface",
            expected="a model or a torso, which have boundaries",
            remedy="Correct [subject] kind",
        )
    job.ensure("surface")
    finished, rig = job.plan.surfaced.mesh(), job.plan.calibrated.cameras().rig
    board = drawing_board(finished.repaired, rig, job.settings.measure)
    scene = json.loads(to_json(viewer_scene(rig, finished.repaired, finished.textured, triangles=_TRIANGLES)))
    one_at_a_time = Lock()
    app = FastAPI(docs_url=None, redoc_url=None, openapi_url=None)

    @app.middleware("http")
    async def guard(request: Request, answer: Callable[[Request], Any]) -> Response:
        host = request.headers.get("host", "").rsplit(":", 1)[0]
        if host not in (HOST, "localhost") or not request.url.path.startswith(f"/{token}/"):
            return Response(status_code=404)
        response: Response = await answer(request)
        response.headers.update(_HEADERS)
        return response

    @app.get(f"/{token}/")
    def page() -> HTMLResponse:
        return HTMLResponse(_page(job.session.path.resolve().name))

    @app.get(f"/{token}/drawing")
    def drawing() -> JSONResponse:
        drawn = read_boundaries(job.session.path, kind)
        marks = read_landmarks(job.session.path, kind)
        curves = drawn or _found(job)
        return JSONResponse(
            {
                "scene": scene,
                "breasts": list(BREASTS[kind]),
                "landmarks": [{"name": mark.name, "title": mark.title, "kind": mark.kind} for mark in LANDMARKS[kind]],
                "drawn": {
                    "boundaries": {name: handles_of(curve).tolist() for name, curve in curves.items()},
                    "landmarks": {name: points.tolist() for name, points in marks.items()},
                },
                "byHand": bool(drawn),
            }
        )

    @app.post(f"/{token}/measure")
    def measure(sent: Drawn) -> JSONResponse:
        with one_at_a_time:
            found = board.measure({name: np.array(points) for name, points in _known(sent, kind).items()})
        return JSONResponse({name: _told(live) for name, live in found.items()})

    @app.post(f"/{token}/save")
    def save(sent: Drawn) -> JSONResponse:
        curves = {name: board.laid(np.array(points)) for name, points in _known(sent, kind).items()}
        allowed = {mark.name for mark in LANDMARKS[kind]}
        if not set(sent.landmarks) <= allowed:
            raise HTTPException(422, f"unknown landmarks: {', '.join(sorted(set(sent.landmarks) - allowed))}")
        marks = {name: np.array(points) for name, points in sent.landmarks.items()}
        try:
            with one_at_a_time:
                changed = write_drawn(job.session.path, curves, marks, author="drawn by hand in the editor")
        except MammometryError as error:
            raise HTTPException(500, str(error)) from None
        return JSONResponse({"saved": [path.name for path in changed]})

    return app


def serve(job: Job, *, ready: Callable[[str], None]) -> None:
    """Serve the page until interrupted.

    Args:
        job: an open session.
        ready: told the page's address as soon as it answers there.

    Raises:
        MammometryError: as for `editor_app`.
    """
    import uvicorn

    token = secrets.token_urlsafe(16)
    app = editor_app(job, token)
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as listener:
        listener.bind((HOST, 0))
        listener.listen()  # from here on a browser that comes early waits
        ready(f"http://{HOST}:{listener.getsockname()[1]}/{token}/")
        server = uvicorn.Server(uvicorn.Config(app, log_level="warning", access_log=False))
        server.run(sockets=[listener])


def _known(sent: Drawn, kind: str) -> dict[str, list[_Point]]:
    strange = [name for name in sent.boundaries if name not in BREASTS[kind]]  # type: ignore[index]
    if strange:
        raise HTTPException(422, f"unknown boundaries: {', '.join(strange)}")
    return {str(name): points for name, points in sent.boundaries.items()}


def _found(job: Job) -> dict[str, Any]:
    """Boundaries that were found by themselves; none where that fails: then they are drawn from nothing."""
    try:
        job.ensure("measure")
    except MammometryError:
        return {}
    product = job.plan.measured.boundaries
    return {} if product is None else {boundary.name: boundary.points_world for boundary in product()}


def _told(live: LiveVolume) -> dict[str, Any]:
    return {
        "curve": np.round(live.curve_world, 3).tolist(),
        "volumeCc": live.volume_cc,
        "intervalCc": live.interval_cc,
        "problem": live.problem,
    }


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
