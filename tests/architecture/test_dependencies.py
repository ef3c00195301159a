"""Every library that we ask for is used: imported, or named where another one loads it."""

import re
import tomllib
from importlib.metadata import PackageNotFoundError, files

from tests.architecture.test_imports import modules

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
_MODULE = re.compile(r"""^ *(?:from|import) ([A-Za-z_]\w*)|["']([A-Za-z_]\w*)[\w.]*["']""", re.MULTILINE)
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


def named(repository):
    """Modules that the source imports, or names in quotes: an app, or what is loaded by name."""
    return {
        imported or quoted
        for path in modules(repository)
        for imported, quoted in _MODULE.findall(path.read_text(encoding="utf-8"))
    }


def test_every_library_is_used(repository):
    unused, found = [], named(repository)
    for distribution in asked_for(repository):
        modules = modules_of(distribution)
        if modules and distribution not in LOADED_BY and not modules & found:
            unused.append(distribution)
    assert unused == []


def test_what_another_library_loads_is_asked_for(repository):
    assert set(LOADED_BY) <= set(asked_for(repository))
