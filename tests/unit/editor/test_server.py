"""The editor's page: whom it answers, what it saves, and its mouse and keys in a real browser."""

from __future__ import annotations

import http.client
import json
import shutil
import socket
import stat
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from urllib.parse import unquote, urlencode, urlsplit

import numpy as np
import pytest
import test_drawing
import uvicorn
from django.conf import settings
from playwright.sync_api import Browser, BrowserContext, Page, sync_playwright

from mammometry.base.errors import MeasureError, SessionError
from mammometry.base.identity import Identity
from mammometry.editor import server as served
from mammometry.editor.desk import Desk
from mammometry.editor.door import HOST, LARGEST_BYTES, Door, local_page
from mammometry.editor.messages import PlaceChange, Save
from mammometry.editor.server import Application, editor_app
from mammometry.measure.boundary.boundary import Boundary
from mammometry.measure.settings import MeasureSettings
from mammometry.surface.texture import TexturedMesh

CHROMIUM = shutil.which("chromium")
FLAGS = [
    *("--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"),
    *("--disable-background-networking", "--disable-component-update", "--disable-sync", "--no-first-run"),
]
JSON = {"Content-Type": "application/json"}
HANDLES = [{"point": [60.0, 0.0, 0.0]}, {"point": [0.0, 60.0, 0.0]}, {"point": [-60.0, 0.0, 0.0]}]
HALF_BALL_CC = 2 / 3 * np.pi * test_drawing.RADIUS_MM**3 / 1000


def job(folder: Path, kind: str = "model") -> SimpleNamespace:
    """What the editor asks of a job, on a ball."""
    ball, rig = test_drawing.ball(subdivisions=5), test_drawing.rig()
    colours = np.full((len(ball.mesh.vertices), 3), 180, dtype=np.uint8)
    finished = SimpleNamespace(repaired=ball, textured=TexturedMesh(mesh=ball.mesh, colours=colours))
    circle = test_drawing.circle(0.0, 200)
    found = Boundary(name="model", points_world=circle, method="found", sigma_mm=0.05)
    return SimpleNamespace(
        inputs=SimpleNamespace(subject_kind=kind, boundaries={}, mounting={}),
        session=SimpleNamespace(path=folder),
        identity=Identity.of(folder),
        settings=SimpleNamespace(measure=MeasureSettings()),
        ensure=lambda stage: None,
        plan=SimpleNamespace(
            surfaced=SimpleNamespace(mesh=lambda: finished),
            calibrated=SimpleNamespace(cameras=lambda: SimpleNamespace(rig=rig)),
            measured=SimpleNamespace(boundaries=lambda: (found,)),
        ),
    )


@pytest.fixture
def door() -> Door:
    return Door()


@pytest.fixture(autouse=True)
def alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """As in a process of its own, where no clinic is open."""
    if settings.configured:
        monkeypatch.setattr(settings, "MIDDLEWARE", [])


@pytest.fixture
def app(tmp_path: Path, door: Door) -> Application:
    return editor_app(job(tmp_path), door)  # type: ignore[arg-type]


@dataclass(frozen=True)
class Told:
    status: int
    text: str
    headers: dict[str, str]

    def json(self) -> Any:
        return json.loads(self.text)


class Client:
    """Asks as a browser does that keeps its cookie and says from which page it asks."""

    def __init__(self, address: str) -> None:
        self.address = address
        self.host = urlsplit(address).netloc
        self.cookie = ""

    def ask(
        self,
        method: str,
        path: str,
        content: bytes | Iterator[bytes] | None = None,
        headers: dict[str, str] | None = None,
    ) -> Told:
        connection = http.client.HTTPConnection(urlsplit(self.address).netloc, timeout=30)
        sent = {"Host": self.host, "Origin": self.address, "Cookie": self.cookie, **(headers or {})}
        with suppress(BrokenPipeError, ConnectionResetError):  # it may be refused before all of it was sent
            connection.request(method, path, content, sent)
        answer = connection.getresponse()
        told = Told(answer.status, answer.read().decode(), {k.lower(): v for k, v in answer.getheaders()})
        connection.close()
        self.cookie = told.headers.get("set-cookie", self.cookie).split(";")[0]
        return told

    def get(self, path: str) -> Told:
        return self.ask("GET", path)

    def post(self, path: str, sent: object, headers: dict[str, str] | None = None) -> Told:
        return self.ask("POST", path, json.dumps(sent).encode(), {**JSON, **(headers or {})})

    def enter(self, key: str) -> Told:
        return self.ask(
            "POST",
            "/enter",
            urlencode({"key": key}).encode(),
            {"Content-Type": "application/x-www-form-urlencoded"},
        )


@pytest.fixture
def address(app: Application) -> Iterator[str]:
    with running(app) as address:
        yield address


@pytest.fixture
def client(address: str, door: Door) -> Client:
    """One who came in by a key."""
    client = Client(address)
    assert client.enter(door.new_key()).status == 200
    return client


def untouched(item: dict[str, Any]) -> dict[str, Any]:
    """What the page sends of a boundary whose handles nobody moved."""
    return {"of": item["of"], "handles": item["handles"]}


def given(folder: Path, **more: object) -> bytes:
    """A wavy curve that another program has drawn."""
    entry = {"method": "traced in a CT", "points": test_drawing.wavy().tolist(), **more}
    path = folder / "boundaries.json"
    path.write_text(json.dumps({"boundaries": {"model": entry}}))
    return path.read_bytes()


# --- whom it answers ---


def test_only_those_who_came_in_by_a_key_are_answered(address: str, door: Door) -> None:
    client = Client(address)
    for path in ("/", "/drawing", "/items", "/docs", "/admin/"):
        assert client.get(path).status == 403
    assert client.post("/save", {"author": "A"}).status == 403
    key = door.new_key()
    for guess in ("", "guess", key + "x", "ä"):
        assert client.enter(guess).status == 403
    answer = client.enter(key)
    assert answer.status == 200
    assert {"httponly", "samesite=strict"} <= {part.strip().lower() for part in answer.headers["set-cookie"].split(";")}
    assert key not in answer.text
    page = client.get("/")
    assert page.status == 200
    assert "mm-editor" in page.text
    assert page.headers["cache-control"] == "no-store"
    assert client.get("/admin/").status == 404  # nothing else is here
    assert client.get("/save").status == 405
    assert Client(address).enter(key).status == 403  # it opens once
    client.host = "elsewhere.example"  # a name that was made to point here
    assert client.get("/drawing").status == 404


@pytest.mark.parametrize(
    "headers",
    [
        {"Origin": "http://elsewhere.example"},
        {"Origin": f"http://{HOST}:9"},  # another server on this computer, which gets the cookie too
        {"Origin": "null"},
        {"Origin": ""},
        {"Sec-Fetch-Site": "cross-site"},
        {"Sec-Fetch-Site": "same-site"},
    ],
)
def test_another_page_cannot_save(client: Client, tmp_path: Path, headers: dict[str, str]) -> None:
    sent = {"author": "A", "landmarks": {"nipple_model": {"base": None, "points": [[0, 0, 60]]}}}
    answer = client.post("/save", sent, headers=headers)
    assert answer.status == 403
    assert answer.json()["error"] == "The request comes from another page."
    assert list(tmp_path.iterdir()) == []
    assert client.post("/save", sent, headers={"Sec-Fetch-Site": "same-origin"}).status == 200


def test_what_is_too_large_or_of_another_kind_is_refused_before_it_is_read(client: Client) -> None:
    def endless() -> Iterator[bytes]:
        yield b"{}"

    large = client.ask("POST", "/save", b" " * (LARGEST_BYTES + 1), JSON)
    assert large.status == 413
    assert "larger than 1 MB" in large.json()["error"]
    assert client.ask("POST", "/save", endless(), JSON).status == 411
    assert client.ask("POST", "/save", b"{}", {"Content-Type": "text/plain"}).status == 415
    assert client.ask("PUT", "/save", b"{}", JSON).status == 405


def test_the_key_stands_in_no_argument_of_the_browser(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    said: list[str] = []
    files: list[tuple[int, str]] = []

    def ready(address: str, local_page: str) -> None:
        path = Path(unquote(urlsplit(local_page).path))
        said.extend((address, local_page))
        files.append((stat.S_IMODE(path.stat().st_mode), path.read_text()))

    monkeypatch.setattr(uvicorn.Server, "run", lambda self, sockets: None)
    served.serve(job(tmp_path), ready=ready)  # type: ignore[arg-type]
    address, local_page = said
    ((mode, text),) = files
    assert mode == 0o600
    key = text.split('name="key" value="')[1].split('"')[0]
    assert key not in local_page
    assert key not in address  # another one, for who types it
    assert address.startswith(f"http://{HOST}:")
    assert urlsplit(address).fragment  # no part of what a browser asks for
    assert not Path(unquote(urlsplit(local_page).path)).exists()


# --- what it saves ---


def test_a_landmark_is_saved_and_the_boundary_stays_as_it_is(client: Client, tmp_path: Path) -> None:
    before = given(tmp_path)
    state = client.get("/drawing").json()
    assert state["boundaries"]["model"]["how"] == "traced in a CT"
    assert state["boundaries"]["model"]["curve"] == test_drawing.wavy().tolist()
    sent = {"author": " A. Nurse ", "landmarks": {"nipple_model": {"base": None, "points": [[0.0, 0.0, 60.0]]}}}
    assert client.post("/save", sent).json()["saved"] == ["landmarks.json"]
    assert (tmp_path / "boundaries.json").read_bytes() == before
    entry = json.loads((tmp_path / "landmarks.json").read_text())["landmarks"]["nipple_model"]
    assert (entry["author"], entry["method"]) == ("A. Nurse", "picked by hand")
    assert client.get("/items").json()["places"]["nipple_model"]["how"].startswith("picked by hand by A. Nurse on 20")


def test_a_landmark_on_an_automatic_boundary_makes_no_drawn_one(client: Client, tmp_path: Path) -> None:
    state = client.get("/drawing").json()["boundaries"]["model"]
    assert state["automatic"]
    assert len(state["curve"]) == 200
    sent = {"author": "A", "landmarks": {"nipple_model": {"base": None, "points": [[0.0, 0.0, 60.0]]}}}
    client.post("/save", sent)
    assert [path.name for path in tmp_path.iterdir()] == ["landmarks.json"]


def test_the_page_measures_what_stands_there_exactly(client: Client) -> None:
    item = client.get("/drawing").json()["boundaries"]["model"]
    live = client.post("/measure", {"boundaries": {"model": untouched(item)}}).json()["model"]
    assert live["volumeCc"] == pytest.approx(HALF_BALL_CC, rel=0.01)
    assert len(live["curve"]) == 200
    low, high = live["intervalCc"]
    assert high - low < 10.0  # 0.05 mm, as it was found, not 0.5 mm as a hand draws


def test_an_edited_curve_keeps_its_other_points_and_tells_where_it_comes_from(client: Client, tmp_path: Path) -> None:
    first = given(tmp_path, author="Dr. C", drawn="2026-01-02T03:04:05Z")
    item = client.get("/drawing").json()["boundaries"]["model"]
    sketch = untouched(item)
    moved = test_drawing.on_ball(np.add(sketch["handles"][4]["point"], [0.0, 0.0, 8.0]))
    sketch["handles"][4] = {"point": moved.tolist(), "at": None}
    sent = {"author": "A. Nurse", "boundaries": {"model": {"base": item["base"], "sketch": sketch}}}
    answer = client.post("/save", sent)
    assert answer.json()["saved"] == ["boundaries.json"]
    (entry,) = json.loads((tmp_path / "boundaries.json").read_text())["boundaries"].values()
    kept = {tuple(point) for point in entry["points"]} & {tuple(point) for point in test_drawing.wavy()}
    assert len(kept) > 600
    assert (entry["method"], entry["author"]) == ("edited by hand", "A. Nurse")
    assert entry["earlier"] == [{"method": "traced in a CT", "author": "Dr. C", "drawn": "2026-01-02T03:04:05Z"}]
    (history,) = (tmp_path / "history").iterdir()
    assert history.read_bytes() == first
    how = answer.json()["boundaries"]["model"]["how"]
    assert how.endswith(", from traced in a CT by Dr. C on 2026-01-02")

    removed = {"author": "A", "boundaries": {"model": {"base": answer.json()["boundaries"]["model"]["base"]}}}
    removed["boundaries"]["model"]["sketch"] = None  # type: ignore[index]
    state = client.post("/save", removed).json()["boundaries"]["model"]
    assert state["automatic"]
    assert not (tmp_path / "boundaries.json").exists()


def test_an_edited_automatic_boundary_and_a_drawn_one_say_so(client: Client, tmp_path: Path) -> None:
    item = client.get("/drawing").json()["boundaries"]["model"]
    sketch = untouched(item)
    sketch["handles"][0] = {"point": [58.0, 0.0, 10.0], "at": None}
    sent = {"author": "A", "boundaries": {"model": {"base": None, "sketch": sketch}}}
    state = client.post("/save", sent).json()["boundaries"]["model"]
    assert state["how"].endswith(", from the automatic boundary")
    anew = {"of": None, "handles": [{"point": point} for point in test_drawing.circle(10.0, 9).tolist()]}
    sent = {"author": "B", "boundaries": {"model": {"base": state["base"], "sketch": anew}}}
    assert client.post("/save", sent).json()["boundaries"]["model"]["how"].startswith("drawn by hand by B on 20")


def test_confirming_leaves_an_automatic_boundary_automatic(client: Client, tmp_path: Path) -> None:
    item = client.get("/drawing").json()["boundaries"]["model"]
    assert item["confirmed"] is None
    sent = {"author": "C. Eye", "name": "model", "base": item["base"], "curve": item["of"]}
    told = client.post("/confirm", sent).json()["boundaries"]["model"]
    assert told["automatic"]
    assert told["confirmed"]["by"] == "C. Eye"
    assert told["confirmed"]["holds"]
    (entry,) = json.loads((tmp_path / "boundaries.json").read_text())["boundaries"].values()
    assert set(entry) == {"automatic", "confirmed"}

    entry["confirmed"]["curve"] = "that of other settings"
    (tmp_path / "boundaries.json").write_text(json.dumps({"boundaries": {"model": entry}}))
    told = client.get("/items").json()["boundaries"]["model"]
    assert not told["confirmed"]["holds"]
    other = client.post("/confirm", {**sent, "base": told["base"], "curve": "that of other settings"})
    assert other.status == 422
    assert "another curve than the one on the page" in other.json()["error"]


def test_confirming_keeps_the_points_and_method_of_a_given_curve(client: Client, tmp_path: Path) -> None:
    given(tmp_path)
    item = client.get("/drawing").json()["boundaries"]["model"]
    sent = {"author": "C. Eye", "name": "model", "base": item["base"], "curve": item["of"]}
    assert client.post("/confirm", sent).json()["boundaries"]["model"]["confirmed"]["holds"]
    (entry,) = json.loads((tmp_path / "boundaries.json").read_text())["boundaries"].values()
    assert entry["points"] == test_drawing.wavy().tolist()
    assert entry["method"] == "traced in a CT"


@pytest.mark.parametrize(
    ("sent", "said"),
    [
        ({"boundaries": {"elbow": {"base": None, "sketch": None}}}, "elbow"),
        ({"boundaries": {"left": {"base": None, "sketch": None}}}, "left: found an unknown name"),  # this is a cast
        ({"boundaries": {"model": {"base": None, "sketch": {"handles": [{"point": [0, 0, 0]}] * 2}}}}, "at least 3"),
        ({"boundaries": {"model": {"base": None, "sketch": {"handles": [{"point": [0, 0]}] * 3}}}}, "point"),
        ({"boundaries": {"model": {"base": None, "sketch": {"of": "x", "handles": HANDLES}}}}, "does not know"),
        ({"landmarks": {"elbow": {"base": None, "points": [[0, 0, 0]]}}}, "elbow: found an unknown name"),
        ({"landmarks": {"nipple_model": {"base": None, "points": [[0, 0, 0], [1, 1, 1]]}}}, "found 2 points"),
        ({"landmarks": {"nipple_model": {"base": None, "points": [[0, 0, 1e300]]}}}, "1e+297 m away"),
        ({"landmarks": {"nipple_model": {"base": None, "points": [[0, 0, 60_000]]}}}, "59.9 m away"),
        ({"author": "  "}, "enter your name"),
        ({"path": "/etc/passwd"}, "path"),
    ],
)
def test_what_makes_no_sense_is_refused_in_words_and_nothing_is_written(
    client: Client, tmp_path: Path, sent: dict[str, Any], said: str
) -> None:
    client.get("/drawing")
    answer = client.post("/save", {"author": "A", **sent})
    assert answer.status == 422
    assert isinstance(answer.json()["error"], str)
    assert said in answer.json()["error"]
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "body", ["{", "[" * 100_000, '{"author": "A", "landmarks": {"n": {"points": [[1e999, 0, 0]]}}}']
)
def test_a_body_that_is_no_drawing_is_refused_in_words(client: Client, body: str) -> None:
    for path in ("/save", "/measure", "/confirm"):
        answer = client.ask("POST", path, body.encode(), JSON)
        assert answer.status in (400, 422)
        assert isinstance(answer.json()["error"], str)


def test_an_unreadable_file_is_told_and_never_replaced(client: Client, tmp_path: Path) -> None:
    item = client.get("/drawing").json()["boundaries"]["model"]
    (tmp_path / "boundaries.json").write_text("{ not what it should be")
    shown = client.get("/drawing")
    assert shown.status == 422
    assert shown.json()["error"].startswith("boundaries.json: found JSON that cannot be read")
    sketch = {"of": None, "handles": HANDLES}
    sent = {"author": "A", "boundaries": {"model": {"base": item["base"], "sketch": sketch}}}
    assert client.post("/save", sent).status == 422
    assert (tmp_path / "boundaries.json").read_text() == "{ not what it should be"
    assert [path.name for path in tmp_path.iterdir()] == ["boundaries.json"]


def test_a_drawing_of_another_subject_is_neither_shown_nor_replaced(tmp_path: Path) -> None:
    desk = Desk(job(tmp_path), "P-8")  # type: ignore[arg-type]
    points = [(0.0, 0.0, 60.0)]
    sent = Save(author="A", landmarks={"nipple_model": PlaceChange(base=None, points=points)})
    desk.save(sent)
    table = json.loads((tmp_path / "landmarks.json").read_text())
    assert table["subject"] == "P-8"
    (tmp_path / "landmarks.json").write_text(json.dumps({**table, "subject": "P-7"}))
    for act in (desk.state, lambda: desk.save(sent)):
        with pytest.raises(SessionError, match="subject 'P-7'"):
            act()


def test_without_an_automatic_boundary_the_page_says_why(tmp_path: Path, door: Door) -> None:
    def fails(stage: str) -> None:
        if stage == "measure":
            raise MeasureError("base", found="none", expected="one", remedy="Look")

    broken = job(tmp_path)
    broken.ensure = fails
    with running(editor_app(broken, door)) as address:  # type: ignore[arg-type]
        client = Client(address)
        client.enter(door.new_key())
        state = client.get("/drawing").json()
    assert state["remark"] == "No automatic boundary: base: found none, expected one. Look."
    assert "curve" not in state["boundaries"]["model"]


def test_an_open_surface_has_nothing_to_draw(tmp_path: Path, door: Door) -> None:
    with pytest.raises(SessionError, match="open surface"):
        editor_app(job(tmp_path, "surface"), door)  # type: ignore[arg-type]


# --- in a browser ---


@contextmanager
def running(app: Application) -> Iterator[str]:
    """The address of a page that really listens."""
    listener = socket.socket()
    listener.bind((HOST, 0))
    listener.listen()
    server = uvicorn.Server(uvicorn.Config(app, log_config=None, log_level="error", lifespan="off"))
    thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]}, daemon=True)
    thread.start()
    try:
        yield f"http://{HOST}:{listener.getsockname()[1]}"
    finally:
        server.should_exit = True
        thread.join(10)
        listener.close()


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    """One for all tests, each of which opens windows that share nothing with those of others."""
    if CHROMIUM is None:
        pytest.skip("no chromium on this machine: apt-get install chromium")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        yield browser
        browser.close()


@pytest.fixture
def tab(app: Application, door: Door, browser: Browser) -> Iterator[Callable[[], Page]]:
    """Opens the editor, each time in another tab of one window."""
    wrong: list[str] = []

    with running(app) as address:
        context: BrowserContext = browser.new_context(viewport={"width": 1000, "height": 900})

        def opened() -> Page:
            page = context.new_page()
            page.on("pageerror", lambda error: wrong.append(str(error)))
            if len(context.pages) == 1:
                with local_page(address, door.new_key()) as file:
                    page.goto(file.as_uri())
                    page.wait_for_url(f"{address}/")
            else:
                page.goto(f"{address}/")
            page.wait_for_selector(".mm-volumes b")
            return page

        yield opened
        context.close()
        assert wrong == []


def say_name(page: Page, name: str) -> None:
    page.get_by_label("Your name").fill(name)


def save(page: Page, said: str = "Saved") -> None:
    page.get_by_role("button", name="Save").click()
    waiting(page, ".mm-readout", said)


def waiting(page: Page, selector: str, said: str) -> None:
    page.wait_for_function(
        "([selector, said]) => document.querySelector(selector).textContent.includes(said)", arg=[selector, said]
    )


def middle_of(page: Page) -> tuple[float, float]:
    canvas = page.locator("canvas").bounding_box()
    assert canvas is not None
    return canvas["x"] + canvas["width"] / 2, canvas["y"] + canvas["height"] / 2


def pick_nipple(page: Page, right_px: float = 0.0) -> None:
    page.get_by_label("Draw").select_option(label="nipple")
    x, y = middle_of(page)
    page.mouse.click(x + right_px, y)


def volume_cc(page: Page) -> float:
    return float(page.locator(".mm-volumes b").inner_text().split()[0])


def measured_anew(page: Page, before: str | None) -> float:
    """Wait for the next answer; the volume it gives."""
    page.wait_for_function("before => document.querySelector('.mm-volumes').dataset.question !== before", arg=before)
    return volume_cc(page)


def question(page: Page) -> str | None:
    return page.locator(".mm-volumes").get_attribute("data-question")


@pytest.mark.slow
def test_points_are_dragged_undone_marked_and_saved(tab: Callable[[], Page], tmp_path: Path) -> None:
    page = tab()
    say_name(page, "A. Nurse")
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
    save(page)
    marks = json.loads((tmp_path / "landmarks.json").read_text())["landmarks"]
    (nipple,) = marks["nipple_model"]["points"]
    assert np.linalg.norm(np.array(nipple) - [0, 0, test_drawing.RADIUS_MM]) < 1.0
    assert (tmp_path / "boundaries.json").is_file()
    (drawn,) = json.loads((tmp_path / "boundaries.json").read_text())["boundaries"].values()
    assert (drawn["method"], drawn["author"]) == ("drawn by hand", "A. Nurse")
    assert page.get_by_role("button", name="Save").get_attribute("data-dirty") == "false"


@pytest.mark.slow
def test_a_landmark_saved_alone_leaves_a_wavy_given_curve_byte_for_byte(
    tab: Callable[[], Page], tmp_path: Path
) -> None:
    before = given(tmp_path)
    page = tab()
    volume = page.locator(".mm-volumes").inner_text()
    pick_nipple(page)
    save(page, "Type your name first")
    assert not (tmp_path / "landmarks.json").exists()
    say_name(page, "A. Nurse")
    page.keyboard.press("Backspace")  # in the name: no point is removed
    save(page)
    assert (tmp_path / "boundaries.json").read_bytes() == before
    marks = json.loads((tmp_path / "landmarks.json").read_text())["landmarks"]
    assert marks["nipple_model"]["author"] == "A. Nurs"
    again = tab()
    assert again.locator(".mm-volumes").inner_text() == volume
    assert again.get_by_label("Your name").input_value() == "A. Nurs"  # it is remembered
    waiting(again, ".mm-origin", "traced in a CT; not confirmed by eye")


@pytest.mark.slow
def test_a_dragged_handle_of_a_given_curve_changes_it_only_there(tab: Callable[[], Page], tmp_path: Path) -> None:
    given(tmp_path)
    page = tab()
    say_name(page, "A. Nurse")
    canvas = page.locator("canvas").bounding_box()
    assert canvas is not None
    x, y = middle_of(page)
    first = test_drawing.wavy()[0]  # the first handle, to the right of the middle
    px_per_mm = canvas["height"] / (1.08 * 2 * test_drawing.RADIUS_MM)
    page.mouse.move(x + first[0] * px_per_mm, y)
    page.mouse.down()
    page.mouse.move(x + (first[0] - 8.0) * px_per_mm, y, steps=4)
    page.mouse.up()
    waiting(page, ".mm-origin", "changed, not saved")
    assert page.get_by_role("button", name="Confirm by eye").is_disabled()
    save(page)
    (entry,) = json.loads((tmp_path / "boundaries.json").read_text())["boundaries"].values()
    assert entry["method"] == "edited by hand"
    before, after = test_drawing.wavy(), np.array(entry["points"])
    kept = {tuple(point) for point in before} & {tuple(point) for point in after}
    assert 600 < len(kept) < 700
    assert np.linalg.norm(after - first, axis=1).min() > 3.0
    waiting(page, ".mm-origin", "edited by hand by A. Nurse on 20")


@pytest.mark.slow
def test_an_automatic_boundary_is_confirmed_by_name(tab: Callable[[], Page], tmp_path: Path) -> None:
    page = tab()
    interval = page.locator(".mm-volumes").inner_text()
    waiting(page, ".mm-origin", "automatic; not confirmed by eye")
    say_name(page, "C. Eye")
    page.get_by_role("button", name="Confirm by eye").click()
    waiting(page, ".mm-origin", "automatic; confirmed by eye by C. Eye on 20")
    again = tab()
    waiting(again, ".mm-origin", "automatic; confirmed by eye by C. Eye on 20")
    assert again.locator(".mm-volumes").inner_text() == interval
    (entry,) = json.loads((tmp_path / "boundaries.json").read_text())["boundaries"].values()
    assert "points" not in entry


@pytest.mark.slow
def test_the_second_of_two_tabs_is_told_that_it_is_late(tab: Callable[[], Page], tmp_path: Path) -> None:
    one, two = tab(), tab()
    say_name(one, "A. First")
    say_name(two, "B. Second")
    pick_nipple(one)
    save(one)
    first = (tmp_path / "landmarks.json").read_text()
    pick_nipple(two, 60.0)
    save(two, "found a change by somebody else meanwhile (picked by hand by A. First")
    assert (tmp_path / "landmarks.json").read_text() == first
    (kept,) = (tmp_path / "history").iterdir()
    assert json.loads(kept.read_text())["landmarks"]["nipple_model"]["author"] == "B. Second"

    # It may replace it by its own: then theirs is kept.
    two.get_by_role("button", name="Replace it by mine").click()
    waiting(two, ".mm-readout", "Saved landmarks.json")
    (mine,) = json.loads((tmp_path / "landmarks.json").read_text())["landmarks"].values()
    assert mine["author"] == "B. Second"
    assert first in [path.read_text() for path in (tmp_path / "history").iterdir()]

    # Or take theirs; what each tab changed beside that goes into one file.
    pick_nipple(one, -60.0)
    save(one, "found a change by somebody else meanwhile")
    one.get_by_role("button", name="Load theirs").click()
    waiting(one, ".mm-readout", "Theirs is shown")
    assert one.get_by_role("button", name="Save").get_attribute("data-dirty") == "false"
    waiting(one, ".mm-origin", "picked by hand by B. Second")
    one.get_by_label("Draw").select_option(label="boundary")
    one.get_by_role("button", name="Confirm by eye").click()
    waiting(one, ".mm-origin", "confirmed by eye by A. First")
    pick_nipple(two)
    save(two)
    assert (tmp_path / "boundaries.json").exists()


@pytest.mark.slow
def test_an_unreadable_file_is_told_on_the_page(tab: Callable[[], Page], tmp_path: Path) -> None:
    page = tab()
    (tmp_path / "boundaries.json").write_text("{")
    page.reload()
    waiting(page, "#mm-editor", "boundaries.json: found JSON that cannot be read")
    assert (tmp_path / "boundaries.json").read_text() == "{"


@pytest.mark.slow
def test_the_printed_address_takes_its_key_out_of_the_address_bar(
    app: Application, door: Door, browser: Browser
) -> None:
    with running(app) as address:
        page = browser.new_page()
        key = door.new_key()
        page.goto(f"{address}/enter#{key}")
        page.wait_for_selector(".mm-volumes b")
        assert page.url == f"{address}/"
        page.go_back()
        assert key not in page.url
        page.close()
