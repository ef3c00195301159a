"""The local page: who may ask, what it answers, and one firing in a real browser."""

import asyncio
import json
import shutil
import threading
import time

import pytest
from tests.unit.capture.virtual_capture import rig_file

from mammometry.base.errors import SessionError
from mammometry.capture.loop import OpenRig
from mammometry.capture.page import CameraService, Goal, capture_app, firing_table, serve
from mammometry.web.local import OneTimeLogin

CHROMIUM = shutil.which("chromium")


@pytest.fixture
def page(place):
    with OpenRig(rig_file(place, faults='left_left = "unplugged"')) as rigged:
        service = CameraService(rigged)
        yield service
        service.close()


@pytest.mark.slow
def test_the_page_shows_states_and_live_pictures_and_fires(page, place):
    assert set(page.state("it", place / "s")["faults"]) == {"left_left"}
    seen = page.look(b'{"calibrating": false}')
    assert "cable" in seen["cameras"]["left_left"]["fault"]
    assert seen["cameras"]["front_left"]["is_whole"]
    json.dumps(seen)  # all of it may be sent
    fired = firing_table(page.fire(place / "s", subject_id="P-1"), "next")
    assert fired["accepted"] is False
    assert any("left_left" in sentence for sentence in fired["said"])
    assert 'id = "P-1"' in (place / "s/session.toml").read_text()
    with pytest.raises(SessionError):
        page.look(b"[]")


@pytest.mark.requirement("R-SENT-2")
def test_nobody_without_the_key_may_look_or_fire(page, place):
    app = capture_app(page, Goal(session=place / "s"), OneTimeLogin("capture --page"))
    for method, path in (("GET", "/"), ("GET", "/state"), ("POST", "/look"), ("POST", "/fire")):
        assert asyncio.run(status_of(app, method, path)) == 403
    assert not (place / "s").exists()


async def status_of(app, method, path):
    sent = []
    headers = [(b"host", b"127.0.0.1:80"), (b"origin", b"http://127.0.0.1:80"), (b"content-length", b"2")]
    headers.append((b"content-type", b"application/json"))
    scope = {"type": "http", "method": method, "path": path, "headers": headers, "query_string": b""}

    async def receive():
        return {"type": "http.request", "body": b"{}", "more_body": False}

    async def send(message):
        sent.append(message)

    await app(scope, receive, send)
    return sent[0]["status"]


@pytest.mark.slow
def test_a_technician_aims_and_fires_in_the_browser(place, monkeypatch):
    playwright = pytest.importorskip("playwright.sync_api")
    if CHROMIUM is None:
        pytest.skip("no chromium")
    import uvicorn
    from tests.patience import patient

    servers = []
    monkeypatch.setattr(uvicorn.Server, "capture_signals", quietly)
    started = uvicorn.Server.__init__

    def begin(self, config):
        started(self, config)
        servers.append(self)

    monkeypatch.setattr(uvicorn.Server, "__init__", begin)
    addresses = []

    def run():
        with OpenRig(rig_file(place)) as rigged:
            serve(rigged, Goal(session=place / "s"), ready=lambda address, local: addresses.append(address))

    thread = threading.Thread(target=run)
    thread.start()
    until = time.monotonic() + 20
    while not addresses and time.monotonic() < until:
        time.sleep(0.05)
    try:
        with playwright.sync_playwright() as driver:
            browser = driver.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
            shown = patient(browser.new_page())
            shown.goto(addresses[0])
            shown.wait_for_selector(".cap-said.cap-good")
            assert shown.locator("figure").count() == 8
            shown.get_by_text("The subject is complete in every view.").wait_for()
            shown.get_by_role("button", name="Fire").click()
            shown.wait_for_selector(".cap-verdict.good")
            browser.close()
    finally:
        servers[0].should_exit = True
        thread.join(20)
    assert len(list((place / "s/capture").iterdir())) == 8


def quietly(self):
    """Signals are the main thread's."""
    import contextlib

    return contextlib.nullcontext()
