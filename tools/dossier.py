"""Make the generated pages of the dossier: requirements with tests, third-party software, its SBOM.

    python -m tools.dossier          write docs/dossier/{requirements,third-party}.md and sbom.cdx.json
    python -m tools.dossier --check  write nothing

Fails on a requirement without a test, a test of an unknown requirement, code or a section that is not there, a library
without a purpose, and a licence that is neither permissive nor accepted by name.
"""

from __future__ import annotations

import argparse
import ast
import json
import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

from packaging.requirements import Requirement as Dependency
from packaging.utils import canonicalize_name

ROOT = Path(__file__).resolve().parents[1]
DOSSIER = ROOT / "docs" / "dossier"
OPTIONAL = ("sim", "basler", "genicam", "tethered")
"""Extras that `all` does not bring: listed where they are installed."""
ID = re.compile(r"R-[A-Z]+-\d+")
_HEADING = re.compile(r"^#+ (.+)$", re.MULTILINE)
_TROVE = {
    "MIT License": "MIT",
    "BSD License": "BSD-3-Clause",
    "Apache Software License": "Apache-2.0",
    "ISC License (ISCL)": "ISC",
    "Python Software Foundation License": "PSF-2.0",
    "Mozilla Public License 2.0 (MPL 2.0)": "MPL-2.0",
}
"""Licence as PyPI's classifiers say it → SPDX. BSD: packages that say which one have two or three clauses."""


@dataclass(frozen=True, kw_only=True)
class Requirement:
    """One sentence of what the program must do."""

    id: str
    section: str
    text: str
    code: tuple[str, ...]
    """Modules and packages that do it, under src/mammometry."""
    measured: str = ""
    """Section of docs/measured.md with its figure."""


@dataclass(frozen=True, kw_only=True)
class MarkedTest:
    """A test that shows requirements."""

    file: str
    name: str
    requirements: tuple[str, ...]
    slow: bool


@dataclass(frozen=True, kw_only=True)
class Library:
    """A package that is installed with mammometry."""

    name: str
    version: str
    licence: str
    """SPDX expression, as far as the package says one."""
    purpose: str
    """Why it is there, or which packages bring it."""
    direct: bool


def requirements() -> list[Requirement]:
    """All requirements in the order of the registry."""
    rows = tomllib.loads((DOSSIER / "requirements.toml").read_text(encoding="utf-8"))["requirement"]
    return [Requirement(**{**row, "code": tuple(row["code"])}) for row in rows]


def marked_tests() -> Iterator[MarkedTest]:
    """Tests that carry ``@pytest.mark.requirement``, file by file."""
    for path in sorted((ROOT / "tests").rglob("test_*.py")):
        text = path.read_text(encoding="utf-8")
        if "mark.requirement(" not in text:
            continue
        for node in ast.parse(text).body:
            if not isinstance(node, ast.FunctionDef):
                continue
            marks = [ast.unparse(mark) for mark in node.decorator_list]
            shown = [mark for mark in marks if "mark.requirement(" in mark]
            if shown:
                yield MarkedTest(
                    file=path.relative_to(ROOT).as_posix(),
                    name=node.name,
                    requirements=tuple(ID.findall(" ".join(shown))),
                    slow="pytest.mark.slow" in marks,
                )


def faults(rows: Sequence[Requirement], tests: Sequence[MarkedTest]) -> list[str]:
    """What does not hold together, one sentence each."""
    ids = [row.id for row in rows]
    shown = {id for test in tests for id in test.requirements}
    anchors = _anchors(ROOT / "docs" / "measured.md")
    known, package = set(ids), ROOT / "src" / "mammometry"
    wrong = [f"{id}: two requirements have this name" for id in known if ids.count(id) > 1]
    for test in tests:
        wrong += [
            f"{test.file}::{test.name}: no requirement is named {id}" for id in test.requirements if id not in known
        ]
    for row in rows:
        if row.id not in shown:
            wrong.append(f"{row.id}: no test shows it")
        wrong += [f"{row.id}: {code} is not there" for code in row.code if not (package / code).exists()]
        if row.measured and row.measured not in anchors:
            wrong.append(f"{row.id}: docs/measured.md has no section #{row.measured}")
    return wrong


def requirements_page(rows: Sequence[Requirement], tests: Sequence[MarkedTest]) -> str:
    """Requirement, code, tests and figure, one table a section."""
    lines = [
        "# Requirements and what shows them",
        "",
        "`make dossier` makes this page from `requirements.toml` and the marks of the tests. It fails on a requirement",
        "without a test. A test's name is a sentence, its file lies in `tests/`. Slow ones: `make test-slow`.",
    ]
    section = ""
    for row in rows:
        if row.section != section:
            section = row.section
            lines += ["", f"## {section}", "", "| | required | code | shown by | measured |", "| --- " * 5 + "|"]
        shown = "<br>".join(_sentence(test) for test in tests if row.id in test.requirements)
        code = "<br>".join(f"`{code}`" for code in row.code)
        figure = f"[figure](../measured.md#{row.measured})" if row.measured else ""
        lines.append(f"| {row.id} | {row.text} | {code} | {shown} | {figure} |")
    return "\n".join(lines) + "\n"


def libraries(registry: Mapping[str, Mapping[str, str]]) -> list[Library]:
    """Every package that the extras of ``all`` bring, and optional ones that are installed, by name.

    Raises:
        SystemExit: a package that `all` needs is not installed.
    """
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = project["optional-dependencies"]
    direct: set[str] = set()
    brought_by: dict[str, set[str]] = {}
    todo = [(Dependency(text), "", False) for text in (*project["dependencies"], *extras["all"])]
    todo += [(Dependency(text), "", True) for extra in OPTIONAL for text in extras[extra]]
    seen: set[tuple[str, frozenset[str]]] = set()
    while todo:
        dependency, parent, may_lack = todo.pop()
        if dependency.marker and not any(
            dependency.marker.evaluate({"extra": extra}) for extra in ("", *_extras_of(parent))
        ):
            continue
        name = canonicalize_name(dependency.name)
        if name == "mammometry":
            todo += [(Dependency(text), "", may_lack) for extra in dependency.extras for text in extras[extra]]
            continue
        if not parent:
            direct.add(name)
        else:
            brought_by.setdefault(name, set()).add(parent.partition("[")[0])
        if (name, frozenset(dependency.extras)) in seen:
            continue
        seen.add((name, frozenset(dependency.extras)))
        try:
            needs = metadata.requires(name) or []
        except metadata.PackageNotFoundError:
            if may_lack:
                direct.discard(name)
                brought_by.pop(name, None)
                continue
            raise SystemExit(f"{name} is not installed: run make .venv/.installed-dev") from None
        todo += [(Dependency(text), f"{name}[{','.join(dependency.extras)}]", may_lack) for text in needs]
    purposes = {canonicalize_name(name): purpose for name, purpose in registry["purpose"].items()}
    return [
        Library(
            name=name,
            version=metadata.version(name),
            licence=registry["said"].get(name) or _licence(metadata.metadata(name)),
            purpose=purposes.get(name, "") if name in direct else "for " + ", ".join(sorted(brought_by[name])),
            direct=name in direct,
        )
        for name in sorted(direct | brought_by.keys())
    ]


def licence_faults(found: Sequence[Library], registry: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """Libraries without a purpose, and licences that nobody accepted."""
    permissive, accepted = set(registry["permissive"]["licences"]), registry["accepted"]
    return [
        *(f"{library.name}: say in third-party.toml what it is for" for library in found if not library.purpose),
        *(
            f"{library.name}: its licence is {library.licence or 'not stated'}, which is not permissive"
            for library in found
            if library.name not in accepted and not is_permissive(library.licence, permissive)
        ),
    ]


def is_permissive(licence: str, permissive: set[str]) -> bool:
    """Whether all parts of an SPDX expression are permissive, or one of those that are offered."""
    if not licence:
        return False
    offered = re.split(r" OR ", licence.replace("(", "").replace(")", ""))
    return any(all(part in permissive for part in re.split(r" AND | WITH ", choice)) for choice in offered)


def third_party_page(found: Sequence[Library], registry: Mapping[str, Mapping[str, str]]) -> str:
    """Name, version, licence and purpose, what we name ourselves first."""
    packages = json.loads((ROOT / "viewer" / "package.json").read_text(encoding="utf-8"))["dependencies"]
    lines = [
        "# Third-party software",
        "",
        "`make dossier` makes this page from the installed packages: all that `pip install '.[all]'` brings, and",
        "optional ones where they are installed. The same for machines: [sbom.cdx.json](sbom.cdx.json), CycloneDX 1.6.",
        "A test fails on a licence that is neither permissive nor accepted here by name.",
    ]
    for title, direct in (("What we use ourselves", True), ("What these bring", False)):
        lines += ["", f"## {title}", "", "| package | version | licence | purpose |", "| --- " * 4 + "|"]
        lines += [
            f"| {library.name} | {library.version} | {library.licence} | {library.purpose} |"
            for library in found
            if library.direct is direct
        ]
    lines += ["", "## In the pages' scripts", "", "| package | version | licence and purpose |", "| --- " * 3 + "|"]
    lines += [f"| {name} | {packages[name]} | {why} |" for name, why in registry["scripts"].items()]
    names = {library.name for library in found}
    lines += ["", "## Not permissive, and why it may be there", "", "| package | |", "| --- | --- |"]
    lines += [f"| {name} | {why} |" for name, why in registry["accepted"].items() if name in names]
    return "\n".join(lines) + "\n"


def sbom(found: Sequence[Library]) -> str:
    """Bill of materials as CycloneDX 1.6 in JSON. The same packages give the same bytes."""
    from cyclonedx.contrib.license.factories import LicenseFactory
    from cyclonedx.model.bom import Bom
    from cyclonedx.model.component import Component, ComponentType
    from cyclonedx.output.json import JsonV1Dot6
    from packageurl import PackageURL

    import mammometry

    licences = LicenseFactory()
    own = Component(
        name="mammometry",
        version=mammometry.__version__,
        type=ComponentType.APPLICATION,
        licenses=[licences.make_from_string("Apache-2.0")],
        bom_ref=f"pkg:pypi/mammometry@{mammometry.__version__}",
    )
    components = [
        Component(
            name=library.name,
            version=library.version,
            type=ComponentType.LIBRARY,
            licenses=[licences.make_from_string(library.licence)],
            purl=PackageURL("pypi", None, library.name, library.version),
            bom_ref=f"pkg:pypi/{library.name}@{library.version}",
        )
        for library in found
    ]
    bom = Bom(components=components)
    bom.metadata.component = own
    direct = {library.name for library in found if library.direct}
    bom.register_dependency(own, [component for component in components if component.name in direct])
    table = json.loads(JsonV1Dot6(bom).output_as_string())
    del table["serialNumber"], table["metadata"]["timestamp"]
    return json.dumps(table, indent=1, sort_keys=True) + "\n"


def third_party() -> dict[str, Any]:
    """Purposes, accepted licences and what packages fail to say."""
    return tomllib.loads((DOSSIER / "third-party.toml").read_text(encoding="utf-8"))


def main() -> None:
    """Write the pages, or say what hinders them."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--check", action="store_true", help="write nothing")
    arguments = parser.parse_args()
    rows, tests, registry = requirements(), list(marked_tests()), third_party()
    found = libraries(registry)
    wrong = faults(rows, tests) + licence_faults(found, registry)
    if wrong:
        raise SystemExit("\n".join(wrong))
    if not arguments.check:
        (DOSSIER / "requirements.md").write_text(requirements_page(rows, tests), encoding="utf-8")
        (DOSSIER / "third-party.md").write_text(third_party_page(found, registry), encoding="utf-8")
        (DOSSIER / "sbom.cdx.json").write_text(sbom(found), encoding="utf-8")


def _sentence(test: MarkedTest) -> str:
    words = test.name.removeprefix("test_").replace("_", " ")
    return f"{words}{' (slow)' if test.slow else ''}, `{test.file.removeprefix('tests/')}`"


def _anchors(page: Path) -> set[str]:
    titles = _HEADING.findall(page.read_text(encoding="utf-8"))
    return {re.sub(r"[^\w -]", "", title.lower()).strip().replace(" ", "-") for title in titles}


def _extras_of(parent: str) -> list[str]:
    return [extra for extra in parent.partition("[")[2].rstrip("]").split(",") if extra]


def _licence(package: metadata.PackageMetadata) -> str:
    """SPDX expression of a package; empty where it says none."""
    if expression := package.get("License-Expression"):
        return expression
    classifiers = [text.rpartition(" :: ")[2] for text in package.get_all("Classifier") or [] if "License" in text]
    named = [_TROVE.get(text, text) for text in classifiers if text != "OSI Approved"]
    if named:
        return " AND ".join(named)
    text = (package.get("License") or "").strip()
    if text.startswith(("Apache 2.0", "Apache License")):
        return "Apache-2.0"
    return "BSD-3-Clause" if text == "BSD" else text


if __name__ == "__main__":
    main()
