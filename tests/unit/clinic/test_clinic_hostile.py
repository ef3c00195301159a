"""What somebody sends who means harm: forged forms, foreign hosts, HTML in names, paths that climb, line breaks."""

import logging
import socket
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import pytest
from django.conf import settings
from django.db import OperationalError
from django.template import Context, Template
from django.test import Client, RequestFactory
from django.urls import reverse
from tests.clinic_server import command, served
from tests.local_server import dribbled

from mammometry.clinic.config import ClinicConfig
from mammometry.clinic.models import Person, Visit
from mammometry.clinic.roles import Role
from mammometry.clinic.site import Plain
from mammometry.clinic.web.security import report_policy


@pytest.mark.requirement("R-SEC-3")
def test_a_form_from_elsewhere_changes_nothing(person_of: Callable[..., Person]) -> None:
    client = Client(enforce_csrf_checks=True)
    client.force_login(person_of(Role.ADMINISTRATOR), backend=settings.AUTHENTICATION_BACKENDS[1])
    data = {"username": "mallory", "roles": ["administrator"], "is_active": "on"}
    for headers in ({}, {"Origin": "https://evil.example"}, {"X-CSRFToken": "a" * 64}):
        answer = client.post(reverse("person-new"), data, headers=headers)
        assert answer.status_code == 403
        assert b"out of date" in answer.content
    assert not Person.objects.filter(username="mallory").exists()


def test_a_login_form_needs_its_token(clinic: object) -> None:
    client = Client(enforce_csrf_checks=True)
    assert client.post(reverse("account_login"), {"login": "a", "password": "b"}).status_code == 403


@pytest.mark.parametrize("host", ["evil.example", "testserver.evil.example", "testserver:80@evil", "a b"])
@pytest.mark.requirement("R-SEC-3")
def test_another_host_is_refused(clinic: object, client: Client, host: str) -> None:
    assert client.get(reverse("account_login"), headers={"Host": host}).status_code == 400


@pytest.mark.requirement("R-SEC-3")
def test_html_in_names_stays_text(client_of: Callable[..., Client], clinic: object) -> None:
    client = client_of(Role.ADMINISTRATOR)
    evil = "<script>alert(1)</script><img src=x onerror=alert(2)>"
    person = Person.objects.create(username="x", full_name=evil, roles=["administrator"])
    for path in (reverse("people"), reverse("person", args=[person.pk]), reverse("audit")):
        page = client.get(path).content.decode()
        assert "alert(1)" in page
        assert "<script>alert(1)" not in page
        assert "<img src=x" not in page
    client.force_login(person, backend=settings.AUTHENTICATION_BACKENDS[1])
    assert "<img src=x" not in client.get("/").content.decode()


def test_a_patients_name_is_escaped_in_templates(visit: Visit) -> None:
    visit.patient.family_name = '"><script>'
    shown = Template("{{ patient.name }}").render(Context({"patient": visit.patient}))
    assert "<" not in shown
    assert '"' not in shown


@pytest.mark.parametrize(
    "path",
    [
        "/static/../clinic.toml",
        "/static/%2e%2e/%2e%2e/secret.key",
        "/static/..%2f..%2fsecret.key",
        "/static//etc/passwd",
        "/static/clinic/%00",
        "/static/clinic/../../../config.py",
        "/static/admin/../../../../../../../../etc/passwd",
    ],
)
@pytest.mark.requirement("R-SEC-3")
def test_paths_that_climb_find_nothing(clinic: object, client: Client, path: str) -> None:
    answer = client.get(path)
    assert answer.status_code in (302, 400, 404)
    assert b"root:" not in answer.content


@pytest.mark.parametrize("key", ["1", "../1", "' OR 1=1 --", "00000000-0000-0000-0000-000000000000", "\r\nX-Evil: 1"])
def test_keys_that_name_nothing_find_nothing(client_of: Callable[..., Client], key: str) -> None:
    client = client_of(Role.ADMINISTRATOR)
    from urllib.parse import quote

    answer = client.get(f"/people/{quote(key, safe='')}/")
    assert answer.status_code in (302, 404)
    assert "X-Evil" not in answer.headers


def test_a_line_break_in_a_value_makes_no_header(clinic: object, client: Client) -> None:
    answer = client.get("/?x=%0d%0aSet-Cookie:%20evil=1")
    assert "evil" not in answer.cookies
    assert "\n" not in answer["Location"]


@pytest.mark.requirement("R-SEC-3")
def test_every_answer_has_its_headers(clinic: object, client_of: Callable[..., Client], client: Client) -> None:
    answers = [client.get("/"), client.get("/alive/"), client.get("/nowhere"), client_of(Role.CLINICIAN).get("/")]
    answers += [client_of(Role.CLINICIAN).get(reverse("administration")), client.get("/static/clinic/clinic.css")]
    for answer in answers:
        policy = answer["Content-Security-Policy"]
        assert "unsafe" not in policy
        assert "default-src 'none'" in policy
        assert answer["X-Content-Type-Options"] == "nosniff"
        assert answer["X-Frame-Options"] == "SAMEORIGIN"
        assert answer["Referrer-Policy"] == "same-origin"
    answers.pop().close()  # the style sheet's file
    for answer in answers:
        assert "no-store" in answer["Cache-Control"]


def test_a_reports_policy_names_its_own_scripts_and_shuts_it_in() -> None:
    policy = report_policy(b"<script>a()</script><script type='module'>b()\n</script><script src='x'></script>")
    # echo -n 'a()' | openssl dgst -sha256 -binary | base64
    assert policy.count("'sha256-") == 2
    assert "'sha256-qVpDBgj7bpq5hMAcGp3AOc79J3Y1Z4HvySTwKrWDoy4='" in policy
    assert "sandbox allow-scripts" in policy
    assert "allow-same-origin" not in policy
    assert "script-src 'unsafe" not in policy


@pytest.mark.requirement("R-SEC-6")
def test_a_request_that_fails_leaves_no_trace_of_the_patient(
    visit: Visit, rf: RequestFactory, caplog: pytest.LogCaptureFixture
) -> None:
    """A message of an exception may hold what was typed; the log does not."""
    name = visit.patient.family_name
    request = rf.get("/", {"q": name})
    try:
        raise ValueError(f"no such patient {name}")
    except ValueError:
        logger = logging.getLogger("django.request")
        record = logger.makeRecord(
            "django.request", logging.ERROR, __file__, 1, "Internal Server Error: %s", (f"/?q={name}",),
            sys.exc_info(), extra={"request": request, "status_code": 500},
        )  # fmt: skip
    line = Plain().format(record)
    assert name not in line
    assert "ValueError in test_a_request_that_fails_leaves_no_trace_of_the_patient" in line
    assert " 500 GET /" in line


def test_without_its_database_the_clinic_says_so(
    client_of: Callable[..., Client], monkeypatch: pytest.MonkeyPatch
) -> None:
    def gone(*_: object, **__: object) -> None:
        raise OperationalError("server closed the connection: DETAIL secret")

    client = client_of(Role.CLINICIAN)
    client.raise_request_exception = False
    with monkeypatch.context() as without:
        without.setattr("django.db.backends.base.base.BaseDatabaseWrapper.cursor", gone)
        answer = client.get("/")
    assert answer.status_code == 500
    assert b"in the program" in answer.content
    assert b"secret" not in answer.content


def test_the_log_holds_no_link_that_sets_a_password(rf: RequestFactory) -> None:
    record = logging.LogRecord("django.request", logging.WARNING, "", 1, "Not Found", (), None)
    record.request = rf.get("/account/invitation/1-dihc8w-4cf6/set/")
    assert "dihc8w" not in Plain().format(record)


def test_a_log_line_is_one_line() -> None:
    record = logging.LogRecord("mammometry.clinic", logging.INFO, "", 1, "a\nERROR forged\x1b[2J", (), None)
    assert "\n" not in Plain().format(record)
    assert "\x1b" not in Plain().format(record)


@pytest.mark.requirement("R-SEC-6")
def test_no_name_gets_into_files_or_their_names(clinic: ClinicConfig, visit: Visit) -> None:
    visit.folder.mkdir(parents=True)
    everything = "".join(str(path.relative_to(clinic.folder)) for path in clinic.folder.rglob("*"))
    assert "Zypern" not in everything
    assert str(visit.pk) in everything
    for log in Path(clinic.folder / "logs").glob("*"):
        assert "Zypern" not in log.read_text()


def test_keys_are_random(clinic: object) -> None:
    from mammometry.clinic.models import (
        Calibration,
        DailyCheck,
        Drawing,
        Job,
        Measurement,
        Patient,
        Rig,
        Upload,
        Volume,
    )

    for model in (Calibration, DailyCheck, Drawing, Job, Measurement, Patient, Person, Rig, Upload, Visit, Volume):
        first, second = model().pk, model().pk
        assert first.version == second.version == 4
        assert first != second


def raw(address: str, request: bytes) -> bytes:
    """What the server answers to these bytes, which no well-behaved program would send."""
    host, port = address.split(":")
    answer = b""
    with socket.create_connection((host, int(port)), timeout=10) as line, suppress(TimeoutError, ConnectionError):
        line.sendall(request)
        while more := line.recv(65536):
            answer += more
    return answer


@pytest.mark.slow
@pytest.mark.requirement("R-SEC-4")
def test_the_running_server_stands_hostile_bytes(tmp_path: Path) -> None:
    """Over the wire: nothing between us and the server puts a request in order before it arrives."""
    command("init", str(tmp_path / "clinic"))
    secret = (tmp_path / "clinic" / "secret.key").read_bytes().strip()
    with served(tmp_path / "clinic", "--no-jobs") as (address, server):
        head = b"Host: " + address.encode() + b"\r\nConnection: close\r\n"

        def status(line: bytes, more: bytes = b"\r\n") -> int:
            answer = raw(address, line + b" HTTP/1.1\r\n" + head + more)
            assert secret not in answer
            assert b"root:" not in answer
            assert b"Traceback" not in answer
            assert b"\nx-crawl" not in answer.partition(b"\r\n\r\n")[0].lower()
            return int(answer.split(b" ")[1]) if answer else 0

        assert status(b"GET /alive/") == 200
        for path in (b"/static/../../secret.key", b"/static/../../../../../etc/passwd", b"/../secret.key"):
            assert status(b"GET " + path) in (302, 400, 404), path
        assert status(b"GET /static/%2e%2e/%2e%2e/secret.key") in (302, 400, 404)
        assert status(b"GET /account/login/?next=%0d%0aX-Crawl:%201") in (200, 302)
        assert status(b"GET /%0d%0aX-Crawl:%201") in (302, 404)
        large = b"Content-Type: application/octet-stream\r\nContent-Length: 99999999999\r\n\r\n"
        assert status(b"POST /account/login/", large + b"x" * (2 << 20)) == 413
        both = b"Content-Length: 5\r\nTransfer-Encoding: chunked\r\n\r\n0\r\n\r\nGET /alive/ HTTP/1.1\r\n\r\n"
        answer = raw(address, b"POST /account/login/ HTTP/1.1\r\n" + head + both)
        assert answer.count(b"HTTP/1.1 ") <= 1  # the second request is not smuggled in
        assert status(b"GET /", b"X-Long: " + b"a" * 200_000 + b"\r\n\r\n") in (0, 400, 431)
        assert status(b"TRACE /") in (302, 400, 403, 405)
        assert raw(address, b"\x16\x03\x01 no http at all\r\n\r\n").startswith((b"HTTP/1.1 400", b""))
        assert status(b"GET /alive/") == 200
        assert server.poll() is None


@pytest.mark.slow
@pytest.mark.requirement("R-SEC-4")
def test_silent_and_slow_callers_are_hung_up_on(tmp_path: Path) -> None:
    """Else a thousand of them would shut everybody out. A browser that has asked before keeps its connection."""
    folder = tmp_path / "clinic"
    command("init", str(folder))
    with (folder / "clinic.toml").open("a") as file:
        file.write("\n[limits]\nrequest_s = 2\n")
    with served(folder, "--no-jobs") as (address, _):
        host, port = address.split(":")
        head = b"GET /alive/ HTTP/1.1\r\nHost: " + address.encode() + b"\r\n"
        post = b"POST /account/login/ HTTP/1.1\r\nHost: " + address.encode() + b"\r\nContent-Length: 90\r\n\r\nab"
        slow = "GET /alive/ HTTP/1.1\r\nX-Long: " + "a" * 100
        for begun, then, status in (
            (b"", "", None), (b"", slow, None), (head + b"\r\n", slow, 200), (post, "a" * 50, 408),
        ):  # fmt: skip
            with socket.create_connection((host, int(port)), timeout=10) as line:
                line.sendall(begun)
                passed, answer = dribbled(line, then, byte_s=0.5)  # longer than ten seconds fails
                assert 1 < passed < 6, begun
                assert (int(answer.split(b" ")[1]) if answer else None) == status
