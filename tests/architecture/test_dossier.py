"""The dossier: every requirement has its test, every library a purpose and a licence that may be there."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import pytest
from tools import dossier

ROWS = dossier.requirements()


@cache
def marked() -> list[dossier.MarkedTest]:
    """All tests with the requirements that they show; not while tests are collected, which each worker does."""
    return list(dossier.marked_tests())


def test_every_requirement_has_a_test_and_every_mark_a_requirement() -> None:
    assert len(ROWS) > 70
    assert dossier.faults(ROWS, marked()) == []


def test_the_page_of_requirements_is_that_of_today(repository: Path) -> None:
    page = (repository / "docs" / "dossier" / "requirements.md").read_text(encoding="utf-8")
    assert page == dossier.requirements_page(ROWS, marked()), "call make dossier"


def test_what_does_not_hold_together_is_named() -> None:
    row = replace(ROWS[0], id="R-NONE-1", code=("no_such_module.py",), measured="no-such-section")
    mark = replace(marked()[0], requirements=("R-NONE-2",))
    wrong = dossier.faults([*ROWS, row, ROWS[0]], [*marked(), mark])
    assert [sentence.partition(": ")[2] for sentence in wrong] == [
        "two requirements have this name",
        "no requirement is named R-NONE-2",
        "no test shows it",
        "no_such_module.py is not there",
        "docs/measured.md has no section #no-such-section",
    ]


def test_every_risk_names_requirements_that_exist(repository: Path) -> None:
    known = {row.id for row in ROWS}
    for page in ("risks", "security"):
        text = (repository / "docs" / "dossier" / f"{page}.md").read_text(encoding="utf-8")
        named = set(dossier.ID.findall(text))
        assert named
        assert named <= known


def test_every_library_has_a_purpose_and_a_licence_that_may_be_there() -> None:
    registry = dossier.third_party()
    found = dossier.libraries(registry)
    assert dossier.licence_faults(found, registry) == []
    names = {library.name for library in found}
    assert {"numpy", "django", "psycopg-binary", "llvmlite"} <= names
    assert not names & {"pytest", "mypy", "zensical"}


@pytest.mark.parametrize(
    ("licence", "may"),
    [
        ("MIT", True),
        ("Apache-2.0 OR GPL-2.0-only", True),
        ("BSD-2-Clause AND Apache-2.0 WITH LLVM-exception", True),
        ("MIT AND GPL-3.0-only", False),
        ("LGPL-3.0-only", False),
        ("", False),
    ],
)
def test_licences_are_judged_by_all_their_parts(licence: str, may: bool) -> None:
    assert dossier.is_permissive(licence, set(dossier.third_party()["permissive"]["licences"])) is may


def test_the_list_for_machines_names_every_library() -> None:
    import json

    registry = dossier.third_party()
    found = dossier.libraries(registry)
    table = json.loads(dossier.sbom(found))
    assert (table["bomFormat"], table["specVersion"]) == ("CycloneDX", "1.6")
    assert {part["name"] for part in table["components"]} == {library.name for library in found}
