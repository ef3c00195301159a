"""The editor's page: whom it answers, what it saves, and its mouse and keys in a real browser."""

from __future__ import annotations

import http.client
import json
import re
import shutil
import stat
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from urllib.parse import unquote, urlsplit

import numpy as np
import pytest
import test_drawing
import uvicorn
from playwright.sync_api import Browser, BrowserContext, Page, expect, sync_playwright
from tests.local_server import running
from tests.patience import patient

from mammometry.base.errors import MeasureError, SessionError
from mammometry.base.identity import Identity
from mammometry.editor import server as served
from mammometry.editor.messages import PlaceChange, Save, SentHandle, Sketch, SketchChange
from mammometry.editor.server import editor_app
from mammometry.editor.session import DrawingSession
from mammometry.job.stages import measure
from mammometry.measure.boundary.boundary import Boundary
from mammometry.measure.settings import MeasureSettings
from mammometry.surface.texture.texture import TexturedMesh
from mammometry.web.local import BODY_BYTES, HOST, REQUEST_S, OneTimeLogin, local_file
from mammometry.web.replies import Application

CHROMIUM = shutil.which("chromium")
FLAGS = [
    *("--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"),
    *("--disable-background-networking", "--disable-component-update", "--disable-sync", "--no-first-run"),
]
JSON = {"Content-Type": "application/json"}
HANDLES = [{"point": [60.0, 0.0, 0.0]}, {"point": [0.0, 60.0, 0.0]}, {"point": [-60.0, 0.0, 0.0]}]
HALF_BALL_CC = 2 / 3 * np.pi * test_drawing.RADIUS_MM**3 / 1000


class Planned(dict[Any, Callable[[], Any]]):
    """Products by definition, all of them current."""

    def value(self, definition: Any) -> Any:
        return self[definition]() if definition in self else None

    current = value


def job(folder: Path, kind: str = "model") -> SimpleNamespace:
    """What the editor asks of a job, on a ball that nobody has measured."""
    ball, rig = test_drawing.ball(subdivisions=5), test_drawing.rig()
    colours = np.full((len(ball.mesh.vertices), 3), 180, dtype=np.uint8)
    finished = SimpleNamespace(repaired=ball, textured=TexturedMesh(mesh=ball.mesh, colours=colours))
    circle = test_drawing.circle(0.0, 200)
    found = Boundary(name="model", points_world=circle, method="found", sigma_mm=0.05)
    return SimpleNamespace(
        inputs=SimpleNamespace(subject_kind=kind, boundaries={}, mounting={}),
        folder=folder,
        identity=Identity.of(folder),
        settings=SimpleNamespace(measure=MeasureSettings()),
        rig=rig,
        surface=lambda: finished,
        plan=Planned({measure.boundaries: lambda: (found,)}),
        mesh=SimpleNamespace(key=None),
        content_key=None,
        render_report=lambda: None,
        store=SimpleNamespace(record=lambda key: None),
        run=lambda: None,
    )


def measured(job: SimpleNamespace, volume_cc: float) -> SimpleNamespace:
    """The same job after the whole surface was measured with what is drawn now."""
    desk = DrawingSession(job)  # type: ignore[arg-type]
    (state,) = desk.state()["boundaries"].values()
    points = np.array(state["curve"])
    measurement = SimpleNamespace(
        name="model", volume_cc=volume_cc, interval_cc=(volume_cc - 1, volume_cc + 1), boundary_world=points
    )
    job.plan[measure.measurements] = lambda: (measurement,)
    return job


@pytest.fixture
def login() -> OneTimeLogin:
    return OneTimeLogin()


@pytest.fixture
def app(tmp_path: Path, login: OneTimeLogin) -> Application:
    return editor_app(lambda: job(tmp_path), login)  # type: ignore[arg-type,return-value]


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
        return self.post("/enter", key)


@pytest.fixture
def address(app: Application) -> Iterator[str]:
    with running(app) as address:
        yield address


@pytest.fixture
def client(address: str, login: OneTimeLogin) -> Client:
    """One who came in by a key."""
    client = Client(address)
    assert client.enter(login.new_key()).status == 200
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


@pytest.mark.requirement("R-SENT-2")
def test_only_those_who_came_in_by_a_key_are_answered(address: str, login: OneTimeLogin) -> None:
    client = Client(address)
    for path in ("/", "/drawing", "/items", "/docs", "/admin/"):
        assert client.get(path).status == 403
    assert client.post("/save", {"author": "A"}).status == 403
    key = login.new_key()
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


def test_a_used_link_is_refused_and_opens_again_for_who_is_inside(address: str, login: OneTimeLogin) -> None:
    inside, key = Client(address), login.new_key()
    browser = {"Accept": "text/html,application/xhtml+xml,*/*;q=0.8"}
    entrance = inside.ask("GET", "/enter", headers=browser)
    assert (entrance.status, entrance.headers["content-type"].split(";")[0]) == (200, "text/html")
    assert inside.enter(key).status == 200
    assert inside.enter(key).status == 200
    used = Client(address).enter(key)
    assert used.status == 403
    assert used.json()["error"]
    assert used.headers["cache-control"] == "no-store"
    bare = Client(address).ask("GET", "/", headers=browser)  # without any key
    assert (bare.status, bare.headers["content-type"].split(";")[0]) == (403, "text/html")
    assert "<h1>" in bare.text


def test_the_page_runs_its_own_script_alone(client: Client) -> None:
    policy = dict(part.split(" ", 1) for part in client.get("/").headers["content-security-policy"].split("; "))
    assert policy["default-src"] == policy["frame-ancestors"] == "'none'"
    assert re.fullmatch(r"'sha256-\S+' blob:", policy["script-src"])


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
@pytest.mark.requirement("R-SENT-2")
def test_another_page_cannot_save(client: Client, tmp_path: Path, headers: dict[str, str]) -> None:
    sent = {"author": "A", "landmarks": {"nipple_model": {"base": None, "points": [[0, 0, 60]]}}}
    answer = client.post("/save", sent, headers=headers)
    assert answer.status == 403
    assert list(tmp_path.iterdir()) == []
    assert client.post("/save", sent, headers={"Sec-Fetch-Site": "same-origin"}).status == 200


def test_what_is_too_large_or_of_another_kind_is_refused_before_it_is_read(client: Client) -> None:
    def endless() -> Iterator[bytes]:
        yield from [b" " * (1 << 16)] * (BODY_BYTES >> 15)

    large = client.ask("POST", "/save", b" " * (BODY_BYTES + 1), JSON)
    assert large.status == 413
    assert large.json()["error"]
    assert client.ask("POST", "/save", endless(), JSON).status == 413
    assert client.ask("POST", "/save", b"{}", {"Content-Type": "text/plain"}).status == 415
    assert client.ask("PUT", "/save", b"{}", JSON).status == 405


@pytest.mark.requirement("R-SENT-3")
def test_the_key_stands_in_no_argument_of_the_browser(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    said: list[str] = []
    files: list[tuple[int, str]] = []

    def ready(address: str, local_page: str) -> None:
        path = Path(unquote(urlsplit(local_page).path))
        said.extend((address, local_page))
        files.append((stat.S_IMODE(path.stat().st_mode), path.read_text()))

    limits: list[float] = []
    monkeypatch.setattr(uvicorn.Server, "run", lambda self, sockets: limits.append(self.config.timeout_keep_alive))
    served.serve(lambda: job(tmp_path), ready=ready)  # type: ignore[arg-type,return-value]
    assert limits == [REQUEST_S]
    address, local_page = said
    ((mode, text),) = files
    assert mode == 0o600
    key = text.split("/enter#")[1].split('"')[0]
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
    assert client.post("/save", sent).json()["saved"] == 1
    assert (tmp_path / "boundaries.json").read_bytes() == before
    entry = json.loads((tmp_path / "landmarks.json").read_text())["landmarks"]["nipple_model"]
    assert (entry["author"], entry["method"]) == ("A. Nurse", "picked by hand")
    assert re.search(r"A\. Nurse .*20\d\d-", client.get("/items").json()["places"]["nipple_model"]["how"])


def test_a_landmark_on_an_automatic_boundary_makes_no_drawn_one(client: Client, tmp_path: Path) -> None:
    state = client.get("/drawing").json()["boundaries"]["model"]
    assert state["automatic"]
    assert len(state["curve"]) == 200
    sent = {"author": "A", "landmarks": {"nipple_model": {"base": None, "points": [[0.0, 0.0, 60.0]]}}}
    client.post("/save", sent)
    assert [path.name for path in tmp_path.glob("**/*.json")] == ["landmarks.json"]


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
    assert answer.json()["saved"] == 1
    (entry,) = json.loads((tmp_path / "boundaries.json").read_text())["boundaries"].values()
    kept = {tuple(point) for point in entry["points"]} & {tuple(point) for point in test_drawing.wavy()}
    assert len(kept) > 600
    assert (entry["method"], entry["author"]) == ("edited by hand", "A. Nurse")
    assert entry["earlier"] == [{"method": "traced in a CT", "author": "Dr. C", "drawn": "2026-01-02T03:04:05Z"}]
    (history,) = (tmp_path / "history").glob("*.json")
    assert history.read_bytes() == first
    how = answer.json()["boundaries"]["model"]["how"]
    assert how.endswith("Dr. C on 2026-01-02")

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
    assert re.search(r"\bA on 20.*, .*automatic", state["how"])
    anew = {"of": None, "handles": [{"point": point} for point in test_drawing.circle(10.0, 9).tolist()]}
    sent = {"author": "B", "boundaries": {"model": {"base": state["base"], "sketch": anew}}}
    assert re.search(r"\bB on 20\d\d-", client.post("/save", sent).json()["boundaries"]["model"]["how"])


def test_confirming_leaves_an_automatic_boundary_automatic(client: Client, tmp_path: Path) -> None:
    item = client.get("/drawing").json()["boundaries"]["model"]
    assert item["confirmed"] is None
    sent = {"author": "C. Eye", "curves": {"model": item["of"]}}
    told = client.post("/finish", sent).json()["boundaries"]["model"]
    assert told["automatic"]
    assert told["confirmed"]["by"] == "C. Eye"
    assert told["confirmed"]["holds"]
    (entry,) = json.loads((tmp_path / "boundaries.json").read_text())["boundaries"].values()
    assert set(entry) == {"automatic", "confirmed"}

    entry["confirmed"]["curve"] = "that of other settings"
    (tmp_path / "boundaries.json").write_text(json.dumps({"boundaries": {"model": entry}}))
    told = client.get("/items").json()["boundaries"]["model"]
    assert not told["confirmed"]["holds"]
    other = client.post("/finish", {**sent, "curves": {"model": "that of other settings"}})
    assert other.status == 422
    assert "page" in other.json()["error"]


def test_confirming_keeps_the_points_and_method_of_a_given_curve(client: Client, tmp_path: Path) -> None:
    given(tmp_path)
    item = client.get("/drawing").json()["boundaries"]["model"]
    sent = {"author": "C. Eye", "curves": {"model": item["of"]}}
    assert client.post("/finish", sent).json()["boundaries"]["model"]["confirmed"]["holds"]
    (entry,) = json.loads((tmp_path / "boundaries.json").read_text())["boundaries"].values()
    assert entry["points"] == test_drawing.wavy().tolist()
    assert entry["method"] == "traced in a CT"


def test_a_line_that_crosses_itself_is_shown_where_it_does_and_not_saved(client: Client, tmp_path: Path) -> None:
    ring = test_drawing.circle(20.0, 12)
    ring[[3, 7]] = ring[[7, 3]]
    sketch = {"of": None, "handles": [{"point": point} for point in ring.tolist()]}
    live = client.post("/measure", {"boundaries": {"model": sketch}}).json()["model"]
    assert live["volumeCc"] is None
    assert len(live["crossings"]) >= 1
    away = np.linalg.norm(np.array(live["crossings"])[:, None] - np.array(live["curve"])[None], axis=2).min(axis=1)
    assert away.max() < 2.0  # on the line
    item = client.get("/drawing").json()["boundaries"]["model"]
    sent = {"author": "A", "boundaries": {"model": {"base": item["base"], "sketch": sketch}}}
    refused = client.post("/save", sent)
    assert refused.status == 422
    assert "crosses itself" in refused.json()["error"]
    assert list(tmp_path.iterdir()) == []
    given(tmp_path)
    table = json.loads((tmp_path / "boundaries.json").read_text())
    table["boundaries"]["model"]["points"] = live["curve"]  # by another program
    (tmp_path / "boundaries.json").write_text(json.dumps(table))
    item = client.get("/items").json()["boundaries"]["model"]
    refused = client.post("/finish", {"author": "A", "curves": {"model": item["of"]}})
    assert "crosses itself" in refused.json()["error"]


@pytest.mark.slow
def test_an_untouched_line_has_exactly_the_measured_number(tmp_path: Path, login: OneTimeLogin) -> None:
    whole = measured(job(tmp_path), volume_cc=407.25)
    with running(editor_app(lambda: whole, login)) as address:  # type: ignore[arg-type,return-value]
        client = Client(address)
        client.enter(login.new_key())
        item = client.get("/drawing").json()["boundaries"]["model"]
        assert (item["measured"]["volumeCc"], item["measured"]["of"]) == (407.25, item["of"])
        live = client.post("/measure", {"boundaries": {"model": untouched(item)}}).json()["model"]
        assert (live["volumeCc"], live["intervalCc"], live["preliminary"]) == (407.25, [406.25, 408.25], False)
        moved = untouched(item)
        moved["handles"][0] = {"point": [58.0, 0.0, 10.0], "at": None}
        live = client.post("/measure", {"boundaries": {"model": moved}}).json()["model"]
        assert live["preliminary"]
        assert live["volumeCc"] != 407.25


def test_a_line_that_was_loaded_before_the_server_began_anew_is_still_known(tmp_path: Path) -> None:
    given(tmp_path)
    item = DrawingSession(job(tmp_path)).state()["boundaries"]["model"]  # type: ignore[arg-type]
    sketch = Sketch.model_validate(untouched(item))
    sketch.handles[4] = SentHandle(point=tuple(np.add(sketch.handles[4].point, [0.0, 0.0, 5.0])))
    later = DrawingSession(job(tmp_path))  # type: ignore[arg-type]
    later.save(Save(author="A", boundaries={"model": SketchChange(base=item["base"], sketch=sketch)}))
    assert later.state()["boundaries"]["model"]["how"].startswith("edited by hand by A")


@pytest.mark.parametrize(
    ("sent", "said"),
    [
        ({"boundaries": {"elbow": {"base": None, "sketch": None}}}, "elbow"),
        ({"boundaries": {"left": {"base": None, "sketch": None}}}, "left: "),  # this is a cast
        ({"boundaries": {"model": {"base": None, "sketch": {"handles": [{"point": [0, 0, 0]}] * 2}}}}, "least 3"),
        ({"boundaries": {"model": {"base": None, "sketch": {"handles": [{"point": [0, 0]}] * 3}}}}, "point"),
        ({"boundaries": {"model": {"base": None, "sketch": {"of": "x", "handles": HANDLES}}}}, "page"),
        ({"landmarks": {"elbow": {"base": None, "points": [[0, 0, 0]]}}}, "elbow: "),
        ({"landmarks": {"nipple_model": {"base": None, "points": [[0, 0, 0], [1, 1, 1]]}}}, "found 2 points"),
        ({"landmarks": {"nipple_model": {"base": None, "points": [[0, 0, 1e300]]}}}, "1e+297 m away"),
        ({"landmarks": {"nipple_model": {"base": None, "points": [[0, 0, 60_000]]}}}, "59.9 m away"),
        ({"author": "  "}, "name"),
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
    for path in ("/save", "/measure", "/finish"):
        answer = client.ask("POST", path, body.encode(), JSON)
        assert answer.status in (400, 422)
        assert isinstance(answer.json()["error"], str)


def test_an_unreadable_file_is_told_and_never_replaced(client: Client, tmp_path: Path) -> None:
    item = client.get("/drawing").json()["boundaries"]["model"]
    (tmp_path / "boundaries.json").write_text("{ not what it should be")
    shown = client.get("/drawing")
    assert shown.status == 422
    assert shown.json()["error"].startswith("boundaries.json: found JSON")
    sketch = {"of": None, "handles": HANDLES}
    sent = {"author": "A", "boundaries": {"model": {"base": item["base"], "sketch": sketch}}}
    assert client.post("/save", sent).status == 422
    assert (tmp_path / "boundaries.json").read_text() == "{ not what it should be"
    assert [path.name for path in tmp_path.glob("**/*.json")] == ["boundaries.json"]


def test_a_drawing_of_another_subject_is_neither_shown_nor_replaced(tmp_path: Path) -> None:
    desk = DrawingSession(job(tmp_path), "P-8")  # type: ignore[arg-type]
    points = [(0.0, 0.0, 60.0)]
    sent = Save(author="A", landmarks={"nipple_model": PlaceChange(base=None, points=points)})
    desk.save(sent)
    table = json.loads((tmp_path / "landmarks.json").read_text())
    assert table["subject"] == "P-8"
    (tmp_path / "landmarks.json").write_text(json.dumps({**table, "subject": "P-7"}))
    for act in (desk.state, lambda: desk.save(sent)):
        with pytest.raises(SessionError, match="subject 'P-7'"):
            act()


def test_without_an_automatic_boundary_the_page_says_why(tmp_path: Path, login: OneTimeLogin) -> None:
    def fails() -> None:
        raise MeasureError("base", found="none", expected="one", remedy="Look")

    broken = job(tmp_path)
    broken.plan[measure.boundaries] = fails
    with running(editor_app(lambda: broken, login)) as address:  # type: ignore[arg-type,return-value]
        client = Client(address)
        client.enter(login.new_key())
        state = client.get("/drawing").json()
    assert state["remark"].endswith("base: found none, expected one. Look.")
    assert "curve" not in state["boundaries"]["model"]


def test_an_open_surface_has_nothing_to_draw(tmp_path: Path, login: OneTimeLogin) -> None:
    with pytest.raises(SessionError, match=r"^session\.toml: .*open"):
        editor_app(lambda: job(tmp_path, "surface"), login)  # type: ignore[arg-type,return-value]


# --- in a browser ---


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
def tab(login: OneTimeLogin, browser: Browser, tmp_path: Path) -> Iterator[Callable[[], Page]]:
    """Opens the editor of a measured ball, each time in another tab of one window."""
    wrong: list[str] = []

    def opened_job() -> SimpleNamespace:
        fresh = job(tmp_path)
        fresh.run = lambda: measured(fresh, HALF_BALL_CC)
        return measured(fresh, HALF_BALL_CC) if not (tmp_path / "boundaries.json").exists() else fresh

    with running(editor_app(opened_job, login)) as address:  # type: ignore[arg-type]
        context: BrowserContext = patient(browser.new_context(viewport={"width": 1000, "height": 1100}))

        def opened() -> Page:
            page = context.new_page()
            page.on("pageerror", lambda error: wrong.append(str(error)))
            if len(context.pages) == 1:
                with local_file(address, login.new_key()) as file:
                    page.goto(file.as_uri())
                    page.wait_for_url(f"{address}/")
            else:
                page.goto(f"{address}/")
            page.wait_for_selector("#mm-editor[data-ready]")
            return page

        yield opened
        context.close()
        assert wrong == []


def say_name(page: Page, name: str) -> None:
    page.get_by_label("Your name").fill(name)


def save(page: Page, said: str = "Saved") -> None:
    page.get_by_role("button", name="Save").click()
    expect(page.locator(".mm-readout")).to_contain_text(said)


def go(page: Page, step: str) -> None:
    page.locator(".mm-steps").get_by_role("button", name=step).click()


def change(page: Page) -> None:
    page.get_by_role("button", name="Change the line").click()


def middle_of(page: Page) -> tuple[float, float]:
    page.evaluate("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")  # it is laid out
    canvas = page.locator("canvas").bounding_box()
    assert canvas is not None
    return canvas["x"] + canvas["width"] / 2, canvas["y"] + canvas["height"] / 2


def pick_nipple(page: Page, right_px: float = 0.0) -> None:
    go(page, "Landmarks")
    x, y = middle_of(page)
    page.mouse.click(x + right_px, y)


def volume_cc(page: Page) -> float:
    return float(page.locator(".mm-volume b").inner_text().split()[0])


def estimated(page: Page, before: str | None) -> float:
    """Wait for the next answer; the volume it gives."""
    page.wait_for_function("before => document.getElementById('mm-editor').dataset.question !== before", arg=before)
    return volume_cc(page)


def question(page: Page) -> str | None:
    return page.locator("#mm-editor").get_attribute("data-question")


def drag(page: Page, start: tuple[float, float], stop: tuple[float, float]) -> None:
    before = question(page)
    page.mouse.move(*start)
    page.mouse.down()
    page.mouse.move(*stop, steps=4)
    page.mouse.up()
    page.wait_for_function("before => document.getElementById('mm-editor').dataset.question !== before", arg=before)
    page.wait_for_timeout(800)  # the last of several answers


@pytest.mark.slow
def test_a_line_is_drawn_anew_dragged_undone_and_saved(tab: Callable[[], Page], tmp_path: Path) -> None:
    page = tab()
    say_name(page, "A. Nurse")
    assert volume_cc(page) == pytest.approx(HALF_BALL_CC, abs=0.1)
    expect(page.get_by_text("measured", exact=True)).to_be_visible()
    change(page)
    page.get_by_role("button", name="Start anew").click()
    page.get_by_role("button", name="Front", exact=True).click()
    canvas = page.locator("canvas").bounding_box()
    assert canvas is not None
    middle = middle_of(page)
    radius_px = 0.42 * min(canvas["width"], canvas["height"])
    for angle in 2 * np.pi * np.arange(12) / 12:
        page.mouse.click(middle[0] + radius_px * np.cos(angle), middle[1] + radius_px * np.sin(angle))
    page.wait_for_timeout(2500)
    # The ball fills the canvas but for a margin of 8 %: the circle's radius in mm, then its cap's volume.
    radius_mm = radius_px * 1.08 * 2 * test_drawing.RADIUS_MM / min(canvas["width"], canvas["height"])
    tall = test_drawing.RADIUS_MM - np.sqrt(test_drawing.RADIUS_MM**2 - radius_mm**2)
    cap_cc = np.pi * tall**2 * (test_drawing.RADIUS_MM - tall / 3) / 1000
    drawn_cc = volume_cc(page)
    assert drawn_cc == pytest.approx(cap_cc, rel=0.05)
    expect(page.get_by_text("preliminary, until it is measured")).to_be_visible()

    # Drag one point inwards: smaller; undo: as before; redo: smaller again.
    drag(page, (middle[0] + radius_px, middle[1]), (middle[0] + 0.8 * radius_px, middle[1]))
    smaller_cc = volume_cc(page)
    assert smaller_cc < 0.97 * drawn_cc
    before = question(page)
    page.keyboard.press("Control+z")
    assert estimated(page, before) == pytest.approx(drawn_cc, abs=0.2)
    before = question(page)
    page.keyboard.press("Control+Shift+z")
    assert estimated(page, before) == pytest.approx(smaller_cc, abs=0.2)

    # Drag it over its neighbours: the line crosses itself, and cannot be saved until that is undone.
    across = middle[0] + radius_px * np.cos(np.pi / 3 + 0.3), middle[1] + radius_px * np.sin(np.pi / 3 + 0.3)
    drag(page, (middle[0] + 0.8 * radius_px, middle[1]), across)
    expect(page.get_by_role("alert")).to_contain_text("The line crosses itself at the red mark.")
    expect(page.get_by_role("button", name="Save")).to_be_disabled()
    page.keyboard.press("Control+z")
    expect(page.get_by_role("alert")).to_be_hidden()

    # A landmark is one point, however often it is picked; everything is saved.
    pick_nipple(page, 60)
    page.mouse.click(*middle_of(page))
    save(page)
    marks = json.loads((tmp_path / "landmarks.json").read_text())["landmarks"]
    (nipple,) = marks["nipple_model"]["points"]
    assert np.linalg.norm(np.array(nipple) - [0, 0, test_drawing.RADIUS_MM]) < 1.0
    (drawn,) = json.loads((tmp_path / "boundaries.json").read_text())["boundaries"].values()
    assert (drawn["method"], drawn["author"]) == ("drawn by hand", "A. Nurse")
    expect(page.get_by_role("button", name="Save")).to_be_hidden()
    assert "json" not in page.locator("#mm-editor").inner_text()  # no file names


@pytest.mark.slow
@pytest.mark.requirement("R-LOSS-11")
def test_a_landmark_saved_alone_leaves_a_wavy_given_curve_byte_for_byte(
    tab: Callable[[], Page], tmp_path: Path
) -> None:
    before = given(tmp_path)
    page = tab()
    expect(page.locator(".mm-origin")).to_contain_text("Line: traced in a CT.")
    pick_nipple(page)
    save(page, "First enter your name")
    assert not (tmp_path / "landmarks.json").exists()
    say_name(page, "A. Nurse")
    page.keyboard.press("Backspace")  # in the name: no point is removed
    save(page)
    assert (tmp_path / "boundaries.json").read_bytes() == before
    marks = json.loads((tmp_path / "landmarks.json").read_text())["landmarks"]
    assert marks["nipple_model"]["author"] == "A. Nurs"
    assert tab().get_by_label("Your name").input_value() == "A. Nurs"  # it is remembered


@pytest.mark.slow
def test_a_changed_line_is_saved_measured_and_confirmed(tab: Callable[[], Page], tmp_path: Path) -> None:
    given(tmp_path)
    page = tab()
    say_name(page, "A. Nurse")
    change(page)
    page.get_by_role("button", name="Front", exact=True).click()
    canvas = page.locator("canvas").bounding_box()
    assert canvas is not None
    x, y = middle_of(page)
    first = test_drawing.wavy()[0]  # the first handle, to the right of the middle
    px_per_mm = min(canvas["width"], canvas["height"]) / (1.08 * 2 * test_drawing.RADIUS_MM)
    drag(page, (x + first[0] * px_per_mm, y), (x + (first[0] - 8.0) * px_per_mm, y))
    expect(page.locator(".mm-origin")).to_contain_text("Changed, not saved.")
    expect(page.get_by_role("button", name="Looks right")).to_be_hidden()
    save(page, "Saved. Press “Measure”.")
    (entry,) = json.loads((tmp_path / "boundaries.json").read_text())["boundaries"].values()
    assert entry["method"] == "edited by hand"
    before, after = test_drawing.wavy(), np.array(entry["points"])
    kept = {tuple(point) for point in before} & {tuple(point) for point in after}
    assert 600 < len(kept) < 700
    assert np.linalg.norm(after - first, axis=1).min() > 3.0
    expect(page.locator(".mm-origin")).to_contain_text("edited by hand by A. Nurse on 20")
    page.get_by_role("button", name="Looks right").click()
    finish = page.get_by_role("button", name="Confirm and finish")
    expect(finish).to_be_disabled()
    expect(page.locator(".mm-readout")).to_have_text("Your changes must be measured first.")
    page.get_by_role("button", name="Measure").click()
    expect(page.locator(".mm-readout")).to_have_text("Measured. Check the lines again.")
    finish.click()
    expect(page.locator(".mm-readout")).to_contain_text("Confirmed.")
    (entry,) = json.loads((tmp_path / "boundaries.json").read_text())["boundaries"].values()
    assert entry["confirmed"]["by"] == "A. Nurse"


@pytest.mark.slow
def test_nothing_is_confirmed_that_nobody_looked_at(tab: Callable[[], Page], tmp_path: Path) -> None:
    page = tab()
    say_name(page, "C. Eye")
    go(page, "Landmarks")
    finish = page.get_by_role("button", name="Confirm and finish")
    expect(finish).to_be_disabled()
    expect(page.locator(".mm-readout")).to_have_text("Look at this first: boundary.")
    go(page, "Boundary")
    middle = middle_of(page)
    page.mouse.click(*middle)  # to look is not to draw
    expect(page.locator(".mm-origin")).to_contain_text("Line: found automatically.")
    page.get_by_role("button", name="Looks right").click()
    expect(page.get_by_role("button", name="✓ Boundary")).to_be_visible()
    finish.click()
    expect(page.locator(".mm-readout")).to_contain_text("Confirmed.")
    (entry,) = json.loads((tmp_path / "boundaries.json").read_text())["boundaries"].values()
    assert "points" not in entry


@pytest.mark.slow
@pytest.mark.requirement("R-LOSS-12")
def test_the_second_of_two_tabs_is_told_that_it_is_late(tab: Callable[[], Page], tmp_path: Path) -> None:
    one, two = tab(), tab()
    say_name(one, "A. First")
    say_name(two, "B. Second")
    pick_nipple(one)
    save(one)
    first = (tmp_path / "landmarks.json").read_text()
    pick_nipple(two, 60.0)
    save(two, "a change by somebody else meanwhile (picked by hand by A. First")
    assert (tmp_path / "landmarks.json").read_text() == first
    (kept,) = (tmp_path / "history").glob("*.json")
    assert json.loads(kept.read_text())["landmarks"]["nipple_model"]["author"] == "B. Second"

    # It may replace it by its own: then theirs is kept.
    two.get_by_role("button", name="Replace it by mine").click()
    expect(two.locator(".mm-readout")).to_contain_text("Saved")
    (mine,) = json.loads((tmp_path / "landmarks.json").read_text())["landmarks"].values()
    assert mine["author"] == "B. Second"
    assert first in [path.read_text() for path in (tmp_path / "history").glob("*.json")]

    # Or take theirs.
    pick_nipple(one, -60.0)
    save(one, "a change by somebody else meanwhile")
    one.get_by_role("button", name="Load theirs").click()
    expect(one.locator(".mm-readout")).to_contain_text("Theirs is shown")
    expect(one.get_by_role("button", name="Save")).to_be_hidden()


@pytest.mark.slow
def test_a_save_that_fails_leaves_the_drawing(tab: Callable[[], Page], tmp_path: Path) -> None:
    page = tab()
    say_name(page, "A. Nurse")
    pick_nipple(page)
    page.route("**/save", lambda route: route.abort())
    save(page, "Not saved: the server cannot be reached.")
    page.unroute("**/save")
    save(page, "Saved")
    assert (tmp_path / "landmarks.json").exists()


@pytest.mark.slow
def test_an_unreadable_file_is_told_on_the_page(tab: Callable[[], Page], tmp_path: Path) -> None:
    page = tab()
    (tmp_path / "boundaries.json").write_text("{")
    page.reload()
    expect(page.locator("#mm-editor")).to_contain_text("boundaries.json: found JSON that cannot be read")
    assert (tmp_path / "boundaries.json").read_text() == "{"


@pytest.mark.slow
def test_the_printed_address_takes_its_key_out_of_the_address_bar(
    app: Application, login: OneTimeLogin, browser: Browser
) -> None:
    with running(app) as address:
        page = patient(browser.new_page())
        key = login.new_key()
        page.goto(f"{address}/enter#{key}")
        page.wait_for_selector("#mm-editor[data-ready]")
        assert page.url == f"{address}/"
        page.go_back()
        assert key not in page.url
        page.close()


@pytest.mark.slow
@pytest.mark.parametrize(("width", "height"), [(1366, 768), (1920, 1080), (1024, 768), (390, 844)])
def test_the_picture_fills_the_window_and_only_what_is_in_view_looks_right(
    tab: Callable[[], Page], width: int, height: int
) -> None:
    page = tab()
    page.set_viewport_size({"width": width, "height": height})
    wide = width >= 900
    page.wait_for_function(  # it is laid out anew, on a busy machine after a second
        """([width, height]) => { const canvas = document.querySelector("#mm-editor canvas").getBoundingClientRect();
        return canvas.width > width && canvas.width < innerWidth && canvas.height > height; }""",
        arg=[(0.6 if wide else 0.8) * width, (0.6 if wide else 0.5) * height],
    )
    canvas = page.locator("#mm-editor canvas").bounding_box()
    assert canvas is not None
    right, heading = page.get_by_role("button", name="Looks right"), page.locator(".mm-about h2")
    if wide:  # picture and button are seen together without scrolling
        assert canvas["y"] + canvas["height"] <= height
        press = right.bounding_box()
        assert press is not None
        assert press["y"] + press["height"] < height
    # The line is turned or zoomed out of the picture: the first press shows it.
    page.mouse.move(canvas["x"] + canvas["width"] / 2, canvas["y"] + 0.3 * canvas["height"])
    for _ in range(30):
        page.mouse.wheel(0, -400)
    page.wait_for_timeout(300)
    right.click()
    expect(page.locator(".mm-readout")).to_contain_text("not completely in view")
    expect(heading).to_have_text("Boundary")
    right.click()
    expect(heading).to_have_text("Landmarks")
    # What a button caused is said beside it.
    said, pressed = page.locator(".mm-readout").bounding_box(), page.locator(".mm-acts").bounding_box()
    assert said is not None
    assert pressed is not None
    assert 0 <= said["y"] - pressed["y"] - pressed["height"] < 20
