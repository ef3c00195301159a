"""A report is rendered again from its stored content, with a confirmation or with what a clinic knows."""

import datetime
import re
import time
from dataclasses import asdict, replace

import numpy as np
import pytest
import test_pdf

from mammometry.api.stored_report import packed, unpacked
from mammometry.base.errors import StorageError
from mammometry.base.notices import Notice, words_of
from mammometry.measure.boundary.breasts import NoBreast
from mammometry.measure.boundary.prominence import Prominence
from mammometry.measure.volume.attribution import Attribution, CurveConfirmation
from mammometry.report.content import Clinical, Fact, ReportContent, Signed, StageReport
from mammometry.report.documents.rendering import attributed_content, render
from mammometry.report.first_page import first_page
from mammometry.report.words.describe import absent_report, posture_fact

SEEN = datetime.datetime(2026, 11, 22, 10, 0, tzinfo=datetime.UTC)


def automatic() -> ReportContent:
    made = test_pdf.page_content("left", "right")
    found = tuple(
        replace(each, boundary="automatic: the fold", boundary_remarks=("to-be-confirmed",)) for each in made.breasts
    )
    return replace(made, breasts=found, scene="[]", concerns=(Notice(code="cameras-imported"),))


@pytest.mark.slow
def test_photographs_of_the_board_are_no_matter_of_a_clinics_report() -> None:
    content = replace(
        automatic(),
        calibration_doubts=(Notice(code="photograph-unfitting", about=("a",), values={"pose": "01", "px": 2.0}),),
    )
    assert attributed_content(content, {}, None, named=True).warnings[-1] == content.calibration_doubts[0]
    assert (
        content.calibration_doubts[0] not in attributed_content(content, {}, Clinical(patient="M"), named=True).warnings
    )


@pytest.mark.parametrize(("known", "said"), [("standing", "standing"), ("", "not given")])
def test_the_posture_that_the_clinic_knows_is_that_of_the_report(known: str, said: str) -> None:
    stage = StageReport(stage="surface", title="Mesh", facts=(Fact("Scanner", "X"), posture_fact("")))
    content = replace(automatic(), stages=(stage,))
    (shown,) = attributed_content(content, {}, Clinical(patient="M", posture=known), named=True).stages
    assert shown.facts == (Fact("Scanner", "X"), posture_fact("" if said == "not given" else said))


def test_content_is_stored_and_read_back_whole() -> None:
    content = automatic()
    assert asdict(unpacked(packed(content))) == asdict(content)
    assert packed(content) == packed(unpacked(packed(content)))
    with pytest.raises(StorageError, match=r"content\.zip"):
        unpacked(packed(content)[:-30])


def test_a_scene_from_elsewhere_cannot_leave_its_script_element() -> None:
    assert "<" not in unpacked(packed(replace(automatic(), scene='["</script>"]'))).scene


def test_equal_arguments_give_equal_bytes() -> None:
    content, clinical = automatic(), Clinical(patient="Moser, Anna")
    assert render(content, {}, clinical) == render(unpacked(packed(content)), {}, clinical)


@pytest.mark.requirement("R-VOL-8")
def test_a_boundary_that_nobody_confirmed_is_warned_of() -> None:
    content = automatic()
    warnings = attributed_content(content, {}, None, named=True).warnings
    assert warnings == (
        *content.warnings,
        Notice(code="boundary-not-confirmed", about=("left", "right")),
        Notice(code="boundaries-drawn-with-edit", level="note"),
        Notice(code="cameras-imported"),
    )
    seen = Attribution(
        confirmation=CurveConfirmation(by="C. Eye", at="2026-11-22T10:00:00Z", curve=content.breasts[0].curve)
    )
    told = attributed_content(content, {"left": seen}, None, named=True)
    assert re.fullmatch(r"Automatic: the fold; .*C\. Eye on 2026-11-22\.", told.breasts[0].boundary)
    assert told.warnings[1].about == ("right",)
    assert "C. Eye" not in repr(attributed_content(content, {"left": seen}, None, named=False))
    moved = replace(seen, confirmation=replace(seen.confirmation, curve="another"))
    assert attributed_content(content, {"left": moved}, None, named=True).warnings[1].about == ("left", "right")


def test_a_clinics_confirmation_stands_for_all_boundaries_and_names_no_command() -> None:
    content = automatic()
    asked = attributed_content(content, {}, Clinical(), named=True)
    codes = {each.code for each in asked.warnings}
    assert "boundary-not-confirmed" in codes
    assert "boundaries-drawn-with-edit" not in codes
    confirmed = attributed_content(content, {}, Clinical(confirmed=Signed(by="Dr. Eye", at=SEEN)), named=True)
    assert "boundary-not-confirmed" not in {each.code for each in confirmed.warnings}
    assert all(each.boundary.endswith(" Dr. Eye on 2026-11-22.") for each in confirmed.breasts)


def test_the_first_page_tells_whose_boundary_is_confirmed() -> None:
    content = automatic()
    seen = CurveConfirmation(by="C. Eye", at="2026-11-22T10:00:00Z", curve=content.breasts[0].curve)
    one = {"left": Attribution(confirmation=seen)}
    both = {**one, "right": Attribution(confirmation=replace(seen, curve=content.breasts[1].curve))}

    def words(attributions: dict[str, Attribution], clinical: Clinical | None = None, *, named: bool = True) -> str:
        return first_page(content, attributions, clinical, named=named).confirmation

    assert words({}) == words(both, Clinical()) == "not confirmed"
    assert re.fullmatch(r"left .*C\. Eye, 2026-11-22; right .*", words(one))
    assert words(both) not in words(one).partition("; ")[2]
    assert words(both) == "confirmed by C. Eye, 2026-11-22"
    assert words(both, named=False) == "confirmed"
    assert words({"left": Attribution(confirmation=replace(seen, curve="another"))}) == "not confirmed"
    assert words({}, Clinical(confirmed=Signed(by="Dr. Eye", at=SEEN))) == (
        "confirmed by Dr. Eye, 22 November 2026, 10:00"
    )


@pytest.mark.slow
def test_it_is_rendered_in_a_moment() -> None:
    stored = packed(automatic())
    render(unpacked(stored), {}, Clinical())  # imports
    begun = time.process_time()
    render(unpacked(stored), {}, Clinical(patient="Moser, Anna"))
    assert time.process_time() - begun < 1.0


@pytest.mark.parametrize("prominence", [None, Prominence(top_mm=9.0, volume_cc=31.0, area_cm2=50.0, creased=0.2)])
def test_the_reason_for_a_missing_volume_is_stated_once(prominence: Prominence | None) -> None:
    reason = Notice(code="breast-not-outlined", about=("left",), values={"found": "no fold", "expected": "a fold"})
    side = NoBreast(name="left", place_world=np.zeros(3), prominence=prominence, reason=reason, unclear=True)
    content = replace(automatic(), breasts=(absent_report(side), automatic().breasts[-1]))
    made = render(content, {}, None)
    assert reason in made.warnings
    page = made.html.decode()
    assert page.count(words_of(reason).replace("'", "&#39;")) == 1
    assert ("31\N{NO-BREAK SPACE}cc" in page) == (prominence is not None)
