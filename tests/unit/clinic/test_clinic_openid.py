"""The hospital's own login, played by a small OpenID Connect server of the test's."""

import json
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any
from urllib.parse import parse_qs, urlsplit

import jwt
import pytest
from cryptography.hazmat.primitives.asymmetric import rsa
from django.test import Client
from django.urls import reverse
from pytest_django import Settings

from mammometry.clinic.config import ClinicConfig, OpenId
from mammometry.clinic.models import Person
from mammometry.clinic.roles import Role
from mammometry.clinic.site import hospital_login

CLIENT, SECRET = "mammometry", "of the hospital"


@dataclass
class Hospital:
    """Whom it lets in, and what it was asked."""

    address: str = ""
    claims: dict[str, Any] = field(default_factory=dict)
    asked: list[dict[str, list[str]]] = field(default_factory=list)
    nonce: str = ""


@pytest.fixture(scope="module")
def hospital() -> Iterator[Hospital]:
    state = Hospital()
    key = rsa.generate_private_key(public_exponent=65537, key_size=2048)
    public = json.loads(jwt.algorithms.RSAAlgorithm.to_jwk(key.public_key())) | {"kid": "1", "alg": "RS256"}

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            if self.path.endswith("/openid-configuration"):
                self.answer(
                    {"issuer": state.address}
                    | {
                        f"{name}_endpoint" if name != "jwks_uri" else name: f"{state.address}/{name}"
                        for name in ("authorization", "token", "userinfo", "jwks_uri")
                    }
                )
            elif self.path == "/jwks_uri":
                self.answer({"keys": [public]})
            else:
                self.answer(state.claims)

        def do_POST(self) -> None:
            body = self.rfile.read(int(self.headers["Content-Length"])).decode()
            state.asked.append(parse_qs(body))
            now = int(time.time())
            claims = {"iss": state.address, "aud": CLIENT, "iat": now, "exp": now + 60, **state.claims}
            claims |= {"nonce": state.nonce} if state.nonce else {}
            token = jwt.encode(claims, key, algorithm="RS256", headers={"kid": "1"})
            self.answer({"access_token": "a", "token_type": "Bearer", "expires_in": 60, "id_token": token})

        def answer(self, table: dict[str, Any]) -> None:
            content = json.dumps(table).encode()
            self.send_response(200)
            self.send_header("Content-Type", "application/json")
            self.send_header("Content-Length", str(len(content)))
            self.end_headers()
            self.wfile.write(content)

        def log_message(self, *_: object) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    state.address = f"http://127.0.0.1:{server.server_port}"
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    yield state
    server.shutdown()
    server.server_close()
    thread.join()


@pytest.fixture
def come(clinic: ClinicConfig, hospital: Hospital, settings: Settings) -> Callable[..., Client]:
    """Logs somebody in whom the hospital describes so; their browser."""
    chosen = OpenId(name="Hospital", server=hospital.address, client=CLIENT)
    settings.CLINIC = clinic.model_copy(update={"openid": chosen})
    settings.SOCIALACCOUNT_PROVIDERS = hospital_login(chosen, SECRET)

    def walk(**claims: Any) -> Client:
        hospital.claims = {"sub": "0815", "email_verified": True, **claims}
        hospital.asked.clear()
        browser = Client()
        away = browser.post(reverse("openid_connect_login", args=["hospital"]))
        assert away.status_code == 302
        assert away["Location"].startswith(hospital.address + "/authorization")
        query = parse_qs(urlsplit(away["Location"]).query)
        assert query["code_challenge_method"] == ["S256"]
        hospital.nonce = query.get("nonce", [""])[0]
        browser.get(reverse("openid_connect_callback", args=["hospital"]), {"code": "c", "state": query["state"][0]})
        return browser

    return walk


def test_somebody_who_was_entered_comes_in(come: Callable[..., Client], hospital: Hospital) -> None:
    Person.objects.create(username="carla", email="carla@hospital.example", roles=[Role.CLINICIAN])
    browser = come(email="carla@hospital.example")
    assert browser.get("/").status_code == 200
    assert hospital.asked[0]["code"] == ["c"]
    assert "code_verifier" in hospital.asked[0]


def test_nobody_is_entered_by_logging_in(come: Callable[..., Client]) -> None:
    browser = come(email="stranger@hospital.example")
    assert browser.get("/").status_code == 302
    assert not Person.objects.exists()


def test_an_address_that_the_hospital_has_not_verified_opens_nothing(come: Callable[..., Client]) -> None:
    Person.objects.create(username="carla", email="carla@hospital.example", roles=[Role.CLINICIAN])
    assert come(email="carla@hospital.example", email_verified=False).get("/").status_code == 302


def test_an_inactive_person_stays_out(come: Callable[..., Client]) -> None:
    Person.objects.create(username="c", email="c@hospital.example", roles=[Role.CLINICIAN], is_active=False)
    assert come(email="c@hospital.example").get("/").status_code == 302


def test_an_answer_that_nobody_asked_for_is_refused(come: Callable[..., Client], hospital: Hospital) -> None:
    Person.objects.create(username="carla", email="carla@hospital.example", roles=[Role.CLINICIAN])
    hospital.asked.clear()
    thief = Client()
    back = reverse("openid_connect_callback", args=["hospital"])
    assert thief.get(back, {"code": "c", "state": "forged"}).status_code < 500
    assert hospital.asked == []
    assert thief.get("/").status_code == 302
