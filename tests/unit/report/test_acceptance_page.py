"""Page, document and pictures of an acceptance test."""

import datetime

import numpy as np
import pytest
from tests.unit.study.test_acceptance import ARTEFACTS

from mammometry.report.documents.acceptance_page import (
    DOCUMENT,
    PAGE,
    acceptance_page_files,
    picture_names,
    protocol_page,
)
from mammometry.report.figures.canvas import caption_of
from mammometry.simulate.artefacts import DeviceErrors, measured_mesh
from mammometry.simulate.subjects.artefacts import artefact_mesh
from mammometry.study.acceptance.artefacts import KINDS, POSITIONS, AcceptanceTest, Limits
from mammometry.study.acceptance.evaluate import Outcome, evaluate_mesh
from mammometry.study.acceptance.tables import PastTest, acceptance_tables, as_past, meaning, shown


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


@pytest.mark.requirement("R-ACCEPT-2")
def test_the_page_stands_alone_and_has_every_number(outcome: Outcome) -> None:
    earlier = PastTest(date=datetime.date(2026, 5, 1), decision="accept", worst={"sphere/size": (0.1, 0.05, 0.2)})
    files = acceptance_page_files(outcome, [earlier, as_past(outcome)])
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


def test_pages_of_equal_tests_are_equal(outcome: Outcome) -> None:
    first, second = (acceptance_page_files(outcome, [as_past(outcome)]) for _ in range(2))
    assert first == second
    assert "control-chart.png" not in first  # one test is no history


def test_the_meaning_is_computed_from_the_error(outcome: Outcome) -> None:
    for one in outcome.worst.values():
        assert f"{abs(one.effect_cc):.1f} cc" in meaning(one)
        assert shown(one.quantity, one.expanded) in meaning(one)
    worst, *rest = acceptance_tables(outcome)
    assert len(worst.rows) == 6
    assert sum(len(table.rows) for table in rest) == len(outcome.findings)


def test_the_protocol_has_a_box_per_position() -> None:
    page = protocol_page("Rig").decode()
    assert page.count("<li>") == sum(len(POSITIONS[kind]) for kind in KINDS)
    assert page.count("data:image/webp") == len(KINDS)
