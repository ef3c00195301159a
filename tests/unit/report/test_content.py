"""What the report says: digits, warnings, sides; and that nothing is claimed that is not known."""

import re
from dataclasses import replace
from typing import Any, get_args

import numpy as np
import pytest
import synthetic
import test_pdf

from mammometry.base.notices import Notice
from mammometry.base.notices.words import caution_of, words_of
from mammometry.calibration.judge.findings import CalibrationFinding
from mammometry.calibration.judge.quality import assess
from mammometry.measure.volume.measurement import DefinedVolume, Meaning
from mammometry.report.figures.thinning import thinned_ranges
from mammometry.report.first_page import first_page
from mammometry.report.warnings import RunResults, photograph_doubts, run_concerns, warnings
from mammometry.report.words import describe
from mammometry.report.words.anthropometry import comparison
from mammometry.report.words.describe import skin_shares
from mammometry.report.words.volumes import MEANINGS, meaning_sentences, measured_words, volume_words
from mammometry.settings import Settings
from mammometry.surface.occlusion import Occlusion
from mammometry.surface.repair.repair import Provenance


@pytest.fixture(scope="module")
def rig():
    return synthetic.rig()


@pytest.mark.parametrize(
    ("volume", "interval", "words"),
    [
        (354.44, None, "354.4 cc"),
        (354.44, (352.0, 357.0), "354.4 cc"),
        (354.44, (300.0, 410.0), "354 cc"),
        (-0.3, (-60.0, 60.0), "0 cc"),
    ],
)
def test_a_volume_has_no_more_digits_than_its_interval_justifies(
    volume: float, interval: tuple[float, float] | None, words: str
) -> None:
    assert volume_words(volume, interval) == words


def test_the_interval_is_given_or_its_absence_said() -> None:
    assert measured_words(354.55, (352.04, 357.06)) == "354.6 ± 2.5 cc (95 %: 352.0 to 357.1 cc)"
    assert measured_words(284.4, (229.5, 339.3)) == "284 ± 55 cc (95 %: 230 to 339 cc)"
    assert measured_words(40.0, (0.0, 110.4)) == "40 cc (95 %: 0 to 110 cc)"  # the volume is not in its middle
    assert measured_words(25.3, (-47.7, 98.3), sign=True) == "+25 ± 73 cc (95 %: −48 to +98 cc)"
    assert measured_words(354.55, None) == "354.6 cc (its error is not known)"


def test_a_breast_in_words() -> None:
    section = describe.breast_report(synthetic.measurement("left", interval_cc=(440.0, 460.0)))
    assert section.title == "Left breast"
    assert section.wall == "Plane: the plane through the boundary."
    assert section.boundary == "the equator"
    terms, walls = section.tables
    assert terms.rows[0][0] == "wall"
    assert "membrane" in [row[0] for row in walls.rows]
    assert {fact.label: fact.value for fact in section.facts}["Projection"] == "60.0 mm"


def test_every_meaning_of_the_breast_has_an_interval_of_its_own() -> None:
    measured = synthetic.measurement("left", interval_cc=(300.0, 600.0))
    meant = DefinedVolume(meaning="named wall", volume_cc=450.0, interval_cc=(420.0, 480.0), sentence="To compare by.")
    (meaning,) = describe.meanings([replace(measured, definitions=(meant,))])
    assert meaning.title == "In front of one fixed surface, to compare visits"
    assert "(plane)" in meaning.sentences
    # .97 × 450 g; √((.97 × 30)² + (1.96 × .04 × 450)²) = 45.7 g
    (volume,) = meaning.volumes
    assert (volume.label, volume.value) == (
        "Left breast",
        "450 ± 30 cc (95 %: 420 to 480 cc), weight 436 ± 46 g at 0.97 g/cc",
    )


def test_every_meaning_is_said_in_plain_words() -> None:
    for name in get_args(Meaning):
        words = f"{MEANINGS[name]} {meaning_sentences(name, 'plane')}"
        assert not re.search(r"lies before|flat chest, whose|named wall|membrane", words), words
        assert all(len(each) < 160 for each in words.split(". "))


def test_what_changes_a_volumes_meaning_stands_beside_it(rig) -> None:
    sound = synthetic.measurement("left")
    calibration = synthetic.calibration(rig)
    repaired = synthetic.repaired(synthetic.ball())
    unseen = replace(repaired, provenance=repaired.provenance * 0)

    def cautions(**changes: Any) -> list[str]:
        known = {"calibration": calibration, "measurements": [sound], "repaired": repaired, **changes}
        run = RunResults(quality=None, shares={}, matching={}, foregrounds={}, **known)
        return [caution for notice in (*warnings(run), *run_concerns(run)) if (caution := caution_of(notice))]

    assert cautions() == []
    leaking = replace(sound, watertight=False)
    assert cautions(measurements=[leaking], repaired=unseen) == [
        "Do not use this volume: its solid is not watertight.",
        "Only 0 % of its skin was measured.",
    ]
    assert cautions(measurements=[replace(sound, boundary_remarks=("head-not-shown",))]) == [
        "Left and right may be exchanged: the body does not show where its head is. See the warnings.",
    ]
    moved = Notice(code="motion-corrected", values={"mm": 1.0, "std_mm": 0.1, "before_mm": 1.0, "after_mm": 0.1})
    assert cautions(moved=[moved]) == ["Cameras or body moved: see the warnings."]
    assert cautions(calibration=None) == ["The interval does not cover the cameras' errors."]


@pytest.mark.slow
def test_a_caution_names_the_breast_that_it_is_about() -> None:
    content = test_pdf.page_content("left", "right")
    notices = (Notice(code="solid-not-watertight", about=("left",)), Notice(code="cameras-imported"))
    made = first_page(replace(content, warnings=notices), {}, None, named=True)
    assert made.cautions[0].startswith("Left breast: do not use this volume")
    assert made.cautions[1].startswith("The interval")


def test_the_skins_origin_is_looked_up_on_the_surface() -> None:
    """The half ball towards the cameras is where `synthetic.repaired` says it was measured."""
    shares = skin_shares(synthetic.measurement(), synthetic.repaired(synthetic.ball(5)))
    assert shares[Provenance.MEASURED] > 0.97
    assert sum(shares.values()) == pytest.approx(1.0)


def test_both_sides_are_compared() -> None:
    left = replace(synthetic.measurement("left"), volume_cc=660.0)
    right = replace(synthetic.measurement("right"), volume_cc=330.0)
    lines = comparison([right, left])
    assert [(line.label, line.value) for line in lines] == [
        ("Difference in volume", "left larger by 330.0 cc (its error is not known)"),
        ("Right as a share of left", "50 %"),
    ]
    assert comparison([left]) == ()
    known = [
        replace(each, interval_cc=(each.volume_cc - 3, each.volume_cc + 3), interval_terms_cc={"surface": 3.0})
        for each in (left, right)
    ]
    gap = comparison(known)[0].value
    low, high = (330.0 - 3.0 * 2**0.5, 330.0 + 3.0 * 2**0.5)  # independent on either side
    said = f"left larger by 330.0 ± 4.2 cc (95 %: {low:.1f} to {high:.1f} cc): more than the measurement error. "
    assert gap == f"{said}The interval of the difference covers surface."


LITTLE = Notice(code="space-little-covered", values={"percent": 9.0})
WELL = CalibrationFinding("pass", Notice(code="target-not-measured", level="note"))


def finding(notice: Notice) -> CalibrationFinding:
    return CalibrationFinding("warn", notice)


def warned(rig, **changes) -> str:
    calibration = synthetic.calibration(rig)
    values = {
        "quality": assess(calibration),
        "calibration": calibration,
        "shares": {"one": 0.95, "two": 0.95},
        "matching": synthetic.matching(rig),
        "foregrounds": synthetic.foregrounds(rig),
        "measurements": [synthetic.measurement()],
        "repaired": synthetic.repaired(synthetic.ball()),
    }
    run = RunResults(**(values | changes))
    notices = [*warnings(run), *run_concerns(run), *photograph_doubts(run.quality)]
    return "\n".join(map(words_of, notices))


def test_a_clean_run_warns_of_nothing_but_what_the_calibration_says(rig) -> None:
    calibration = synthetic.calibration(rig)
    quality = replace(assess(calibration), findings=(WELL,))
    assert warned(rig, quality=quality) == ""


@pytest.mark.slow
def test_each_fault_has_its_warning(rig) -> None:
    quality = replace(assess(synthetic.calibration(rig)), findings=(finding(LITTLE),))
    assert words_of(LITTLE) in warned(rig, quality=quality)
    assert "cameras were imported" in warned(rig, calibration=None, quality=None)
    assert "vertical disparity of 0.50 ± 0.00 px" in warned(rig, matching=synthetic.matching(rig, d_v_px=0.5))
    assert "matched only 40 %" in warned(rig, shares={"one": 0.4, "two": 0.9})
    assert "not separated from the background" in warned(rig, foregrounds=synthetic.foregrounds(rig, everything=True))
    blind = synthetic.foregrounds(rig, everything=True)
    reasons = {"one_left": "it does not fit the others", "one_right": "its partner's silhouette is not known"}
    said = warned(rig, foregrounds=blind, shares={}, unseparated=reasons)
    assert "No outline of the subject is used in the photographs of one_left, one_right: it does not fit the" in said
    assert "not separated from the background in two_left, two_right." in said  # as the settings asked
    assert "matched only" not in said
    rail = Occlusion(camera="one_left", blocks=np.ones((2, 2), dtype=bool), step=2, share=0.123)
    strap = replace(rail, camera="two_left", share=0.004)
    hidden = warned(rig, blocked={"one_left": rail, "two_left": strap})
    assert "Something hides part of the subject in the photographs of one_left (12 %)." in hidden
    leaking = replace(synthetic.measurement(), watertight=False)
    assert warned(rig, measurements=[leaking]).startswith("The closed solid of the cast is not watertight")


@pytest.mark.slow
def test_a_poor_photograph_of_the_board_comes_last_and_the_rig_first(rig) -> None:
    calibration = synthetic.calibration(rig)
    view = calibration.observations.detections[0]
    poor = Notice(
        code="points-left-out",
        about=(view.camera,),
        photographs=(f"calibration/{view.pose}/{view.camera}",),
        values={"pose": view.pose, "points": 9, "total": 50},
    )
    findings = (finding(poor), finding(LITTLE))
    said = warned(rig, quality=replace(assess(calibration), findings=findings)).splitlines()
    assert (said[0], said[-1]) == (words_of(LITTLE), words_of(poor))
    alone = warned(rig, quality=replace(assess(calibration), findings=findings[:1]))
    assert alone == words_of(poor)


def test_sides_that_rest_on_the_mounting_alone_are_warned_of(rig) -> None:
    headless = replace(synthetic.measurement("left"), boundary_remarks=("head-not-shown",))
    assert "Check that none is upside down." in warned(rig, measurements=[headless])


def test_a_mostly_invented_breast_is_warned_of(rig) -> None:
    repaired = synthetic.repaired(synthetic.ball())
    unseen = replace(repaired, provenance=repaired.provenance * 0)
    assert "Only 0 % of the skin" in warned(rig, repaired=unseen)


def test_changed_settings_are_told_from_the_recommended_ones() -> None:
    changed, everything = describe.settings_facts(Settings())
    assert changed == ()
    assert len(everything) > 20
    changed, _ = describe.settings_facts(Settings().overridden(["surface.repair.rho=3.0"]))
    assert [(line.label, line.value) for line in changed] == [("surface.repair.rho", "3 (recommended: 1)")]


def test_reports_of_the_stages_have_one_row_a_pair_or_camera(rig) -> None:
    calibration = synthetic.calibration(rig)
    section = describe.calibration_report(rig, calibration, assess(calibration))
    assert [len(table.rows) for table in section.tables] == [2, 4]
    assert all(len(row) == len(table.columns) for table in section.tables for row in table.rows)
    imported = describe.calibration_report(rig, None, None)
    assert "imported" in imported.facts[0].value
    assert all(len(row) == len(table.columns) for table in imported.tables for row in table.rows)
    matched = describe.matching_report(synthetic.foregrounds(rig), synthetic.matching(rig), {"one": 0.5, "two": 1.0})
    assert matched.tables[0].rows[0][2] == "50.0"
    blind = describe.matching_report(synthetic.foregrounds(rig), synthetic.matching(rig), {"two": 1.0})
    assert [row[2] for row in blind.tables[0].rows] == ["–", "100.0"]
    images = synthetic.ranges(rig)
    surfaced = describe.surface_report(
        thinned_ranges(images, synthetic.valid(images)), synthetic.repaired(synthetic.ball())
    )
    assert {fact.label: fact.value for fact in surfaced.facts}["Topology"] == "watertight, Euler number 2"
    assert float(surfaced.tables[0].rows[0][2]) == pytest.approx(50, abs=1)
