"""The editor's page: whom it answers, what it saves, and its mouse and keys in a real browser."""

import json
import shutil
import socket
import threading
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import test_drawing
import uvicorn
from fastapi import FastAPI
from fastapi.testclient import TestClient
from playwright.sync_api import Page, sync_playwright

from mammometry.editor.server import HOST, editor_app
from mammometry.errors import SessionError
from mammometry.measure.boundary import Boundary
from mammometry.measure.settings import MeasureSettings
from mammometry.surface.texture import TexturedMesh

CHROMIUM = shutil.which("chromium")
FLAGS = [
    *("--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"),
    *("--disable-background-networking", "--disable-component-update", "--disable-sync", "--no-first-run"),
]
HALF_BALL_CC = 2 / 3 * np.pi * test_drawing.RADIUS_MM**3 / 1000


def job(folder: Path, kind: str = "model") -> SimpleNamespace:
    """What the editor asks of a job, on a ball."""
    ball, rig = test_drawing.ball(), test_drawing.rig()
    colours = np.full((len(ball.mesh.vertices), 3), 180, dtype=np.uint8)
    finished = SimpleNamespace(repaired=ball, textured=TexturedMesh(mesh=ball.mesh, colours=colours))
    found = Boundary(name="model", points_world=test_drawing.circle(0.0, 200), method="found")
    return SimpleNamespace(
        inputs=SimpleNamespace(subject_kind=kind),
        session=SimpleNamespace(path=folder),
        settings=SimpleNamespace(measure=MeasureSettings()),
        ensure=lambda stage: None,
        plan=SimpleNamespace(
            surfaced=SimpleNamespace(mesh=lambda: finished),
            calibrated=SimpleNamespace(cameras=lambda: SimpleNamespace(rig=rig)),
            measured=SimpleNamespace(boundaries=lambda: (found,)),
        ),
    )


@pytest.fixture
def app(tmp_path: Path) -> FastAPI:
    return editor_app(job(tmp_path), "secret")  # type: ignore[arg-type]


def test_only_those_who_know_the_address_are_answered(app: FastAPI) -> None:
    client = TestClient(app, base_url=f"http://{HOST}:8000")
    page = client.get("/secret/")
    assert page.status_code == 200
    assert "mm-editor" in page.text
    assert page.headers["cache-control"] == "no-store"
    for path in ("/", "/drawing", "/guess/drawing", "/secretdrawing", "/docs", "/openapi.json"):
        assert client.get(path).status_code == 404
    stranger = TestClient(app, base_url="http://elsewhere.example")  # a name that was made to point here
    assert stranger.get("/secret/drawing").status_code == 404


def test_the_found_boundary_is_offered_measured_and_saved(app: FastAPI, tmp_path: Path) -> None:
    client = TestClient(app, base_url=f"http://{HOST}")
    drawing = client.get("/secret/drawing").json()
    assert not drawing["byHand"]
    assert [mark["name"] for mark in drawing["landmarks"]] == ["nipple_model"]
    handles = drawing["drawn"]["boundaries"]
    live = client.post("/secret/measure", json={"boundaries": handles}).json()["model"]
    assert live["volumeCc"] == pytest.approx(HALF_BALL_CC, rel=0.01)
    sent = {"boundaries": handles, "landmarks": {"nipple_model": [[0.0, 0.0, 60.0]]}}
    assert client.post("/secret/save", json=sent).json()["saved"] == ["boundaries.json", "landmarks.json"]
    saved = json.loads((tmp_path / "boundaries.json").read_text())
    assert saved["units"] == "mm"
    assert len(saved["boundaries"]["model"]["points"]) > 100
    assert client.get("/secret/drawing").json()["byHand"]


@pytest.mark.parametrize(
    "sent",
    [
        {"boundaries": {"elbow": [[0, 0, 0]] * 3}},
        {"boundaries": {"left": [[0, 0, 0]] * 3}},  # this subject is a cast
        {"boundaries": {"model": [[0, 0, 0]] * 2}},
        {"boundaries": {"model": [[0, 0]] * 3}},
        {"landmarks": {"elbow": [[0, 0, 0]]}},
        {"boundaries": {}, "path": "/etc/passwd"},
    ],
)
def test_what_makes_no_sense_is_refused_and_nothing_is_written(app: FastAPI, tmp_path: Path, sent: object) -> None:
    client = TestClient(app, base_url=f"http://{HOST}")
    assert client.post("/secret/save", json=sent).status_code == 422
    assert list(tmp_path.iterdir()) == []


def test_an_open_surface_has_nothing_to_draw(tmp_path: Path) -> None:
    with pytest.raises(SessionError, match="open surface"):
        editor_app(job(tmp_path, "surface"), "secret")  # type: ignore[arg-type]


@pytest.fixture
def page(app: FastAPI) -> Iterator[Page]:
    if CHROMIUM is None:
        pytest.skip("no chromium on this machine: apt-get install chromium")
    listener = socket.socket()
    listener.bind((HOST, 0))
    server = uvicorn.Server(uvicorn.Config(app, log_level="error"))
    thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]}, daemon=True)
    thread.start()
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        page = browser.new_page(viewport={"width": 1000, "height": 900})
        wrong: list[str] = []
        page.on("pageerror", lambda error: wrong.append(str(error)))
        page.goto(f"http://{HOST}:{listener.getsockname()[1]}/secret/")
        page.wait_for_selector(".mm-volumes b")
        yield page
        assert wrong == []
        browser.close()
    server.should_exit = True
    thread.join(10)
    listener.close()


def volume_cc(page: Page) -> float:
    return float(page.locator(".mm-volumes b").inner_text().split()[0])


def measured_anew(page: Page, before: str | None) -> float:
    """Wait for the next answer; the volume it gives."""
    page.wait_for_function("before => document.querySelector('.mm-volumes').dataset.question !== before", arg=before)
    return volume_cc(page)


def question(page: Page) -> str | None:
    return page.locator(".mm-volumes").get_attribute("data-question")


def test_points_are_dragged_undone_marked_and_saved(page: Page, tmp_path: Path) -> None:
    assert volume_cc(page) == pytest.approx(HALF_BALL_CC, rel=0.01)
    canvas = page.locator("canvas").bounding_box()
    assert canvas is not None
    middle = canvas["x"] + canvas["width"] / 2, canvas["y"] + canvas["height"] / 2

    # Start anew, and draw a boundary of twelve clicks on the front.
    page.get_by_role("button", name="Start anew").click()
    page.wait_for_function("document.querySelector('.mm-volumes').childElementCount === 0")
    radius_px = 0.42 * canvas["height"]
    before = question(page)
    for angle in 2 * np.pi * np.arange(12) / 12:
        page.mouse.click(middle[0] + radius_px * np.cos(angle), middle[1] + radius_px * np.sin(angle))
    page.wait_for_function(
        "document.querySelector('.mm-volumes b') && !document.querySelector('.mm-volumes .mm-problem')"
    )
    page.wait_for_timeout(1500)
    # The ball fills the canvas but for a margin of 8 %: the circle's radius in mm, then its cap's volume.
    radius_mm = radius_px * 1.08 * 2 * test_drawing.RADIUS_MM / canvas["height"]
    tall = test_drawing.RADIUS_MM - np.sqrt(test_drawing.RADIUS_MM**2 - radius_mm**2)
    cap_cc = np.pi * tall**2 * (test_drawing.RADIUS_MM - tall / 3) / 1000
    drawn_cc = volume_cc(page)
    assert drawn_cc == pytest.approx(cap_cc, rel=0.05)

    # Drag one point inwards: smaller; undo: as before; redo: smaller again.
    before = question(page)
    page.mouse.move(middle[0] + radius_px, middle[1])
    page.mouse.down()
    page.mouse.move(middle[0] + 0.8 * radius_px, middle[1], steps=4)
    page.mouse.up()
    measured_anew(page, before)
    page.wait_for_timeout(1000)
    smaller_cc = volume_cc(page)
    assert smaller_cc < 0.97 * drawn_cc
    before = question(page)
    page.keyboard.press("Control+z")
    assert measured_anew(page, before) == pytest.approx(drawn_cc, abs=0.2)
    before = question(page)
    page.keyboard.press("Control+Shift+z")
    assert measured_anew(page, before) == pytest.approx(smaller_cc, abs=0.2)

    # A landmark is one point, however often it is picked; everything is saved.
    page.get_by_label("Draw").select_option(label="nipple")
    page.mouse.click(middle[0] + 60, middle[1])
    page.mouse.click(*middle)
    page.get_by_role("button", name="Save").click()
    page.wait_for_function("document.querySelector('.mm-readout').textContent.startsWith('Saved')")
    marks = json.loads((tmp_path / "landmarks.json").read_text())["landmarks"]
    (nipple,) = marks["nipple_model"]["points"]
    assert np.linalg.norm(np.array(nipple) - [0, 0, test_drawing.RADIUS_MM]) < 1.0
    assert (tmp_path / "boundaries.json").is_file()
