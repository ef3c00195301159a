"""What the clinic's pages import is what its extra installs; what is missing all the same is said to whom it helps."""

import ast
import re
import sys
import tomllib
from collections.abc import Callable, Iterator
from importlib.metadata import PackageNotFoundError, packages_distributions, requires
from pathlib import Path

import pytest
from django.test import Client
from django.urls import reverse
from packaging.requirements import Requirement

import mammometry
from mammometry.clinic import deliveries
from mammometry.clinic.models import Destination, Visit
from mammometry.clinic.roles import Role
from mammometry.clinic.views import study

PROJECT = tomllib.loads((Path(mammometry.__file__).parents[2] / "pyproject.toml").read_text())["project"]


def distribution(name: str) -> str:
    return name.lower().replace("_", "-")


def installed_by(*extras: str) -> set[str]:
    """Distributions of the dependencies and these extras, with what they bring."""
    wanted = [Requirement(text) for text in PROJECT["dependencies"]]
    wanted.append(Requirement(f"mammometry[{','.join(extras)}]"))
    done: set[str] = set()
    while wanted:
        requirement = wanted.pop()
        if str(requirement) in done:
            continue
        done.add(str(requirement))
        if requirement.name == "mammometry":
            of_extras = [PROJECT["optional-dependencies"][extra] for extra in requirement.extras]
            wanted += [Requirement(text) for texts in of_extras for text in texts]
            continue
        try:
            brought = [Requirement(text) for text in requires(requirement.name) or ()]
        except PackageNotFoundError:
            continue
        environments = [{"extra": extra} for extra in ("", *requirement.extras)]
        wanted += [
            each for each in brought if each.marker is None or any(each.marker.evaluate(one) for one in environments)
        ]
    return {distribution(Requirement(text).name) for text in done}


def imported(tree: ast.AST) -> Iterator[str]:
    """Top packages that a module imports, also within functions; not those that it can do without."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.Try) and any("ImportError" in ast.dump(handler) for handler in node.handlers):
            continue
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test):
            continue
        if isinstance(node, ast.Import):
            yield from (alias.name.partition(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            yield node.module.partition(".")[0]
        yield from imported(node)


@pytest.mark.slow
def test_the_extra_brings_all_that_the_pages_import() -> None:
    root = Path(mammometry.__file__).parent
    files = [path for folder in ("clinic", "hospital") for path in (root / folder).rglob("*.py")]
    names = {name for path in files for name in imported(ast.parse(path.read_text()))}
    of = packages_distributions()
    needed = {distribution(of[name][0]) for name in names - set(sys.stdlib_module_names) - {"mammometry"}}
    assert {"django", "pydicom", "pynetdicom", "highdicom"} <= needed
    needed.add("fhir.resources")  # imported by its name
    assert needed - installed_by("clinic") == set()


@pytest.mark.parametrize("address", ["visit-dicom", "visit-fhir"])
def test_a_missing_library_is_for_the_administrator(
    client_of: Callable[..., Client], visit: Visit, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, address: str
) -> None:
    monkeypatch.setattr(study, "report_file", lambda *_: tmp_path)
    monkeypatch.setattr(deliveries, "missing", lambda *modules: [modules[0]])
    arguments = [visit.pk] if address == "visit-dicom" else [visit.pk, "r4"]
    answer = client_of(Role.CLINICIAN).get(reverse(address, args=arguments))
    assert answer.status_code == 501
    page = answer.content.decode()
    assert "administrator" in page
    assert "pip" not in page


def test_an_archive_cannot_be_tested_without_it(
    client_of: Callable[..., Client], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(deliveries, "missing", lambda *modules: list(modules))
    archive = Destination.objects.create(name="PACS", address="PACS@127.0.0.1:1")
    page = client_of(Role.ADMINISTRATOR).post(reverse("destination-test", args=[archive.pk]), follow=True)
    assert re.search("pydicom, .*pynetdicom", page.content.decode())
