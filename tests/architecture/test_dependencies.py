"""Every library that we ask for is used: imported, or named where another one loads it."""

import ast
import re
import tomllib
from importlib.metadata import PackageNotFoundError, files

import pytest
from tests.architecture.test_imports import modules, nodes, syntax

LOADED_BY = {
    "embreex": "trimesh: trimesh.ray finds it",
    "tzdata": "zoneinfo, where the system has no time zones",
    "argon2-cffi": "Django's hasher of passwords",
    "psycopg": "Django's PostgreSQL backend",
    "bokeh": "Dask's own pages",
    "s3fs": "fsspec, for s3://",
    "sshfs": "fsspec, for sftp:// and ssh://",
    "pygobject": "Aravis, which is installed by hand beside it",
}
"""Libraries that another one loads."""
_MODULE = re.compile(r"[A-Za-z_][A-Za-z0-9_.]*")
_NOT_OURS = {"dev", "docs"}  # groups of tools


def asked_for(repository):
    """Names of the distributions in pyproject.toml that the program itself needs."""
    project = tomllib.loads((repository / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    groups = [project["dependencies"]]
    groups += [lines for name, lines in project["optional-dependencies"].items() if name not in _NOT_OURS]
    names = {re.match(r"[A-Za-z0-9._-]+", line)[0].lower() for lines in groups for line in lines}
    return sorted(names - {"mammometry"})


def modules_of(distribution):
    """Top-level modules that a distribution installs. Empty where it is not installed."""
    try:
        listed = files(distribution) or ()
    except PackageNotFoundError:
        return set()
    tops = {path.parts[0].split(".")[0] for path in listed if path.suffix in (".py", ".so", ".pyd")}
    return {top for top in tops if top.isidentifier()}


@pytest.fixture(scope="module")
def named(repository):
    """Modules that the source imports, or names in a text of its own."""
    found = set()
    for path in modules(repository):
        for node in nodes(syntax(path)):
            if isinstance(node, ast.Import):
                found |= {name.name.split(".")[0] for name in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
                found.add(node.module.split(".")[0])
            elif isinstance(node, ast.Constant) and isinstance(node.value, str) and _MODULE.fullmatch(node.value):
                found.add(node.value.split(".")[0])  # an app, or a module that is loaded by name
    return found


def test_every_library_is_used(repository, named):
    unused = []
    for distribution in asked_for(repository):
        modules = modules_of(distribution)
        if modules and distribution not in LOADED_BY and not modules & named:
            unused.append(distribution)
    assert unused == []


def test_what_another_library_loads_is_asked_for(repository):
    assert set(LOADED_BY) <= set(asked_for(repository))
