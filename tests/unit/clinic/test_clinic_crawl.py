"""A crawl like a scanner's: every page a role can reach by links, every form filled with what does harm."""

import re
from collections import deque
from collections.abc import Callable, Iterator
from datetime import timedelta
from html.parser import HTMLParser
from itertools import cycle
from urllib.parse import urljoin, urlsplit

import pytest
from django.http import HttpResponseBase
from django.test import Client

from mammometry.clinic.models import Measurement, Visit, Volume
from mammometry.clinic.roles import CARE, Role

PAYLOADS = (
    "\"><script>alert('crawl')</script>",
    "'\"><img src=x onerror=alert('crawl')>",
    "../../../../etc/passwd",
    "{{ 7191*7191 }}{% debug %}",
    "' OR '1'='1' --",
    "x\r\nX-Crawl: injected",
    "ü" * 3000 + "\u202e\u0000",
)
IN_QUERIES = (PAYLOADS[0], PAYLOADS[2], PAYLOADS[5])
"""What is put into the address and the headers of the pages, of each page one of them."""
WORDS = ("q", "next", "page", "sort", "first", "second", "photographs", "state", "from", "to")
PAGES = 60
"""Pages a role: more than there are links to of different form."""
_UUID = re.compile(r"[0-9a-f]{8}-[0-9a-f-]{27}")


class Page(HTMLParser):
    """Links, forms and what a policy against inline scripts forbids."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.links: list[str] = []
        self.forms: list[tuple[str, str, list[str]]] = []
        self.inline: list[str] = []
        self._in_script = False
        self.feed(text)

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        named = {name: value or "" for name, value in attributes}
        if tag == "a" and "href" in named:
            self.links.append(named["href"])
        if tag == "form":
            self.forms.append((named.get("action", ""), named.get("method", "get").lower(), []))
        if tag in ("input", "textarea", "select") and self.forms and named.get("name"):
            self.forms[-1][2].append(named["name"])
        self.inline += [f"{tag} {name}" for name in named if name.startswith("on") or name == "style"]
        self.inline += [f"{tag} {name}" for name, value in named.items() if value.strip().startswith("javascript:")]
        if tag == "style":
            self.inline.append("style element")
        self._in_script = tag == "script" and "src" not in named and "json" not in named.get("type", "")

    def handle_data(self, data: str) -> None:
        if self._in_script and data.strip():
            self.inline.append("script element")


def faults(answer: HttpResponseBase, where: str) -> Iterator[str]:
    """What must be on no page."""
    if answer.status_code >= 500:
        yield f"{where}: {answer.status_code}"
    if "X-Crawl" in answer.headers:
        yield f"{where}: a header was injected"
    if "unsafe-" in answer.headers.get("Content-Security-Policy", "unsafe-missing"):
        yield f"{where}: policy {answer.headers.get('Content-Security-Policy')}"
    if not answer.headers.get("Content-Type", "").startswith("text/html") or answer.streaming:
        return
    text = answer.content.decode()  # type: ignore[attr-defined]
    for each in Page(text).inline:
        yield f"{where}: inline {each}"
    for sign in ("<script>alert('crawl')", "<img src=x onerror", "51710481", "root:x:0", "Traceback (most recent"):
        if sign in text:
            yield f"{where}: {sign}"


def crawl(client: Client, secrets: tuple[str, ...] = ()) -> tuple[set[str], list[str]]:
    """Follow links from the first page; fill each form once with each payload. Pages seen, and what is wrong.

    Whoever may not see patients by name passes what no page may hold.
    """
    turns = cycle(IN_QUERIES)
    waiting, seen, wrong, tried = deque(["/"]), set[str](), list[str](), set[str]()
    while waiting and len(seen) < PAGES:
        path = waiting.popleft()
        answer = client.get(path)
        wrong += faults(answer, f"GET {path}")
        content = b"" if answer.streaming else answer.content
        wrong += [f"GET {path}: holds {secret}" for secret in secrets if secret.encode() in content]
        if answer.status_code in (301, 302):
            links = [answer.headers["Location"]]
        elif answer.headers.get("Content-Type", "").startswith("text/html") and not answer.streaming:
            page = Page(answer.content.decode())
            links = page.links
            for action, method, names in page.forms:
                target = urljoin(path, action)
                key = f"{method} {_UUID.sub('*', urlsplit(target).path)}"
                if key in tried or "logout" in target:
                    continue
                tried.add(key)
                for payload in PAYLOADS:
                    fields = {name: payload for name in names if name != "csrfmiddlewaretoken"}
                    sent = client.post(target, fields) if method == "post" else client.get(target, fields)
                    wrong += faults(sent, f"{method} {target} {payload!r}")
            payload = next(turns)
            told = {"Referer": f"https://evil.example/{payload!r}", "User-Agent": repr(payload)}
            asked = client.get(path.partition("?")[0], dict.fromkeys(WORDS, payload), headers=told)
            wrong += faults(asked, f"GET {path} with {payload!r} in every word")
            if urlsplit(asked.headers.get("Location", "")).netloc:
                wrong.append(f"GET {path}: {payload!r} leads away")
        else:
            links = []
        for link in links:
            parts = urlsplit(urljoin(path, link))
            if parts.netloc and parts.netloc != "testserver":
                wrong.append(f"{path}: leads away, to {link}")
                continue
            key = _UUID.sub("*", parts.path)
            if key not in seen and "logout" not in key and parts.scheme in ("", "http"):
                seen.add(key)
                waiting.append(parts.path + (f"?{parts.query}" if parts.query else ""))
    return seen, wrong


@pytest.mark.parametrize(
    "role",
    [
        *(None, Role.RESEARCHER),
        *(pytest.param(role, marks=pytest.mark.slow) for role in Role if role != Role.RESEARCHER),
    ],
)
def test_no_page_and_no_form_does_harm(client_of: Callable[..., Client], visit: Visit, role: Role | None) -> None:
    client = Client(raise_request_exception=False) if role is None else client_of(role)
    client.raise_request_exception = False
    patient = visit.patient
    for days in (0, 90):  # results, changes and a time line, so that their pages have something to show
        other = Visit.objects.create(
            patient=patient, rig=visit.rig, taken_at=visit.taken_at - timedelta(days=days), state="measured"
        )
        result = Measurement.objects.create(visit=other, digest=f"{days:064d}", made_at=other.taken_at, software="1")
        for side in ("left", "right"):
            Volume.objects.create(
                measurement=result,
                side=side,
                definition="named wall",
                leads=True,
                volume_cc=300 + days,
                low_cc=290,
                high_cc=400,
            )
    secrets = (patient.family_name, patient.given_name, patient.record_number, str(patient.born))
    by_name = role is not None and role in CARE
    seen, wrong = crawl(client, () if by_name else secrets)
    assert wrong == []
    assert len(seen) >= (1 if role is None else 3), seen


def test_the_crawl_sees_what_it_looks_for() -> None:
    page = Page(
        "<p style='a'><a href='/x' onclick='y()'>x</a><script>z()</script><style>b</style><script src=s></script>"
    )
    assert page.inline == ["p style", "a onclick", "script element", "style element"]
    assert page.links == ["/x"]
