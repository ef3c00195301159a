"""A session in which another run is at work is busy: the clinic waits, and does not call the disk full."""

import json
from types import SimpleNamespace
from uuid import uuid4

import pytest
from django.http import HttpRequest, HttpResponse
from django.test import RequestFactory

from mammometry.base.errors import BusyError, MammometryError, StorageError
from mammometry.batch.engine import Ended
from mammometry.clinic.jobs import runner
from mammometry.clinic.views.responses import json_view

PARTS = {"found": "b", "expected": "c", "remedy": "d"}


@pytest.mark.parametrize(("error", "status"), [(BusyError("a", **PARTS), 409), (StorageError("a", **PARTS), 507)])
def test_a_program_is_told_which(error: MammometryError, status: int) -> None:
    @json_view("GET")
    def view(request: HttpRequest) -> HttpResponse:
        raise error

    answer = view(RequestFactory().get("/"))
    assert (answer.status_code, list(json.loads(answer.content))) == (status, ["error"])


@pytest.mark.parametrize(("code", "acts"), [("busy", ["release"]), ("storage", ["failed"]), ("", ["failed"])])
def test_a_job_is_given_back_where_its_session_is_busy(
    code: str, acts: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    done: list[str] = []
    for act in ("release", "failed"):
        monkeypatch.setattr(runner.queue, act, lambda *given, act=act: done.append(act) or True)
    me = SimpleNamespace(owner="o", _config=SimpleNamespace(folder="/clinic"))
    key = uuid4()
    runner.Runner._end(me, key, Ended(name=str(key), failed="A sentence.", code=code, exit_code=9))
    assert done == acts
