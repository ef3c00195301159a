"""Page, document and pictures of an acceptance test."""

import datetime
from dataclasses import replace

import numpy as np
import pytest
from tests.unit.study.test_acceptance import ARTEFACTS

from mammometry.report.documents.acceptance_page import (
    DOCUMENT,
    PAGE,
    acceptance_page_files,
    acceptance_pictures,
    picture_names,
    protocol_page,
)
from mammometry.report.figures.canvas import caption_of
from mammometry.simulate.artefacts import DeviceErrors, measured_mesh
from mammometry.simulate.subjects.artefacts import artefact_mesh
from mammometry.study.acceptance.artefacts import KINDS, POSITIONS, AcceptanceTest, Limits
from mammometry.study.acceptance.evaluate import Outcome, evaluate_mesh
from mammometry.study.acceptance.tables import PastTest, acceptance_tables, as_past, meaning, shown

EARLIER = PastTest(date=datetime.date(2026, 5, 1), decision="accept", worst={"sphere/size": (0.1, 0.05, 0.2)})


@pytest.fixture(scope="module")
def outcome() -> Outcome:
    """One position of each artefact, with a wrong scale."""
    results = []
    for kind, artefact in ARTEFACTS.items():
        place = POSITIONS[kind][0]
        mesh = measured_mesh(
            artefact_mesh(artefact, place, edge_mm=3.0), DeviceErrors(scale=0.002), np.random.default_rng(0)
        )
        results.append(evaluate_mesh(mesh, kind, place.name, artefact, Limits()))
    about = AcceptanceTest(
        device="Scanner <b>3</b>", software="", person="ab", date=datetime.date(2026, 11, 29), units="mm",
        artefacts=ARTEFACTS,
    )  # fmt: skip
    return Outcome(test=about, results=tuple(results))


@pytest.fixture(scope="module")
def files(outcome: Outcome) -> dict[str, bytes]:
    """Page, document and pictures of it and of an earlier test of the device."""
    return acceptance_page_files(outcome, [EARLIER, as_past(outcome)])


@pytest.mark.slow
@pytest.mark.requirement("R-ACCEPT-2")
def test_the_page_stands_alone_and_has_every_number(outcome: Outcome, files: dict[str, bytes]) -> None:
    page = files[PAGE].decode()
    assert set(files) <= {PAGE, DOCUMENT, *picture_names()}
    assert files[DOCUMENT].startswith(b"%PDF")
    assert "control-chart.png" in files
    assert "&lt;b&gt;3&lt;/b&gt;" in page
    assert "http" not in page
    assert page.count("data:image/webp") == len(files) - 2
    for png in (content for name, content in files.items() if name.endswith(".png")):
        assert caption_of(png).text
    for one in outcome.findings:
        assert shown(one.quantity, one.limit).replace(" ", "\u00a0") in page


@pytest.mark.slow
def test_pages_of_equal_tests_are_equal(outcome: Outcome, files: dict[str, bytes]) -> None:
    assert acceptance_page_files(outcome, [EARLIER, as_past(outcome)]) == files


def test_one_test_is_no_history(outcome: Outcome) -> None:
    assert acceptance_pictures(replace(outcome, results=()), [as_past(outcome)]) == {}


def test_the_meaning_is_computed_from_the_error(outcome: Outcome) -> None:
    for one in outcome.worst.values():
        assert f"{abs(one.effect_cc):.1f} cc" in meaning(one)
        assert shown(one.quantity, one.expanded) in meaning(one)
    worst, tables = acceptance_tables(outcome)
    assert len(worst.rows) == 6
    assert sum(len(table.rows) for table in tables.values()) == len(outcome.findings)


@pytest.mark.slow
def test_the_protocol_has_a_box_per_position() -> None:
    page = protocol_page("Rig").decode()
    assert page.count("<li>") == sum(len(POSITIONS[kind]) for kind in KINDS)
    assert page.count("data:image/webp") == len(KINDS)
