"""Acceptance tests on a rig's page: the newest decides, and a new one is asked for at the administrator's interval."""

import datetime
import json

import pytest

from mammometry.clinic.config import FILE, read_config
from mammometry.clinic.maintenance.backups import KEPT_FOLDERS
from mammometry.clinic.models import Rig
from mammometry.clinic.rig_history import Today, acceptance_tests, with_acceptance
from mammometry.clinic.roles import Role
from mammometry.study.acceptance.tables import PastTest

DAY = datetime.date(2026, 11, 29)
YES = Today(verdict="yes", sentence="Yes: no camera has moved.")
NO = Today(verdict="no", sentence="No: this rig is not calibrated.", remedy="Calibrate.")


def past(days_ago: int, decision: str = "accept") -> PastTest:
    return PastTest(date=DAY - datetime.timedelta(days=days_ago), decision=decision, worst={})


@pytest.mark.requirement("R-ACCEPT-2")
@pytest.mark.parametrize(
    ("last", "every_days", "verdict", "count"),
    [
        (None, 0, "yes", 0),
        (None, 180, "care", 1),
        (past(180), 180, "yes", 0),
        (past(181), 180, "care", 1),
        (past(900), 0, "yes", 0),
        (past(3, "reject"), 0, "care", 1),
        (past(3, "undecided"), 180, "care", 1),
        (past(200, "reject"), 180, "care", 2),
    ],
)
def test_the_newest_test_counts(last: PastTest | None, every_days: int, verdict: str, count: int) -> None:
    answer = with_acceptance(YES, DAY, last, every_days)
    assert (answer.verdict, len(answer.reasons)) == (verdict, count)
    refused = with_acceptance(NO, DAY, last, every_days)
    assert (refused.verdict, refused.sentence, refused.remedy) == ("no", NO.sentence, NO.remedy)


def test_the_interval_is_a_setting_of_the_clinic(clinic) -> None:
    assert clinic.rigs.acceptance_days == 0
    path = clinic.folder / FILE
    before = path.read_text(encoding="utf-8")
    try:
        path.write_text(before + "\n[rigs]\nacceptance_days = 180\n", encoding="utf-8")
        assert read_config(clinic.folder).rigs.acceptance_days == 180
    finally:
        path.write_text(before, encoding="utf-8")
    assert "acceptance" in KEPT_FOLDERS


def test_the_rigs_page_lists_its_own_tests(clinic, client_of) -> None:
    rig = Rig.objects.create(name="Room 7", definition={})
    finding = {"artefact": "bar", "quantity": "spacing", "error": 0.41, "expanded_uncertainty": 0.06, "limit": 0.3}
    for number, device in enumerate(("Room 7", "Room 8")):
        place = clinic.folder / "acceptance" / f"test-{number}" / "results"
        place.mkdir(parents=True)
        table = {"format": 1, "device": device, "date": "2026-11-29", "decision": "reject", "findings": [finding]}
        (place / "acceptance.json").write_text(json.dumps(table))
    (test,) = acceptance_tests(rig)
    assert test.worst == {"bar/spacing": (0.41, 0.06, 0.3)}
    page = client_of(Role.TECHNICIAN).get(f"/rigs/{rig.pk}/").content.decode()
    assert "+0.41 ± 0.06 mm" in page
    assert "rejected" in page


@pytest.mark.parametrize(("decision", "chip"), [("accept", "good"), ("reject", "bad"), ("undecided", "care")])
def test_each_decision_has_its_colour_and_damaged_results_are_left_out(clinic, client_of, decision, chip) -> None:
    rig = Rig.objects.create(name=f"Room {decision}", definition={})
    whole = {"format": 1, "device": rig.name, "date": "2026-11-29", "decision": decision, "findings": []}
    damaged = {**whole, "findings": [{"artefact": "bar", "quantity": "spacing", "error": "much"}]}
    undated = {**whole, "date": "yesterday"}
    texts = [json.dumps(whole), "{", "[]", "null", json.dumps(damaged), json.dumps(undated), "\x00"]
    for number, text in enumerate(texts):
        place = clinic.folder / "acceptance" / f"{decision}-{number}" / "results"
        place.mkdir(parents=True)
        (place / "acceptance.json").write_text(text)
    (test,) = acceptance_tests(rig)
    assert test.decision == decision
    answer = client_of(Role.TECHNICIAN).get(f"/rigs/{rig.pk}/")
    assert answer.status_code == 200
    assert f'class="chip {chip}"' in answer.content.decode()
