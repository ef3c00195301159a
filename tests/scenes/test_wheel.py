"""The wheel in an empty environment, without compiler and Node; and what other systems install."""

import os
import re
import subprocess
import sys
import tomllib
import venv
from pathlib import Path

import pytest
from tests.clinic_day_one import spend
from tests.clinic_server import free_port


@pytest.fixture(scope="module")
def index() -> None:
    """Skips where no packages can be fetched."""
    asked = [sys.executable, "-m", "pip", "index", "versions", "--quiet", "filelock"]
    if subprocess.run(asked, capture_output=True, check=False).returncode:
        pytest.skip("the package index cannot be reached")


@pytest.mark.slow
@pytest.mark.usefixtures("index")
def test_a_wheel_measures_where_there_is_neither_compiler_nor_node(repository: Path, tmp_path: Path) -> None:
    made = ["make", "-o", f"{sys.prefix}/.installed", f"VENV={sys.prefix}", f"DIST={tmp_path}", "wheel"]
    subprocess.run(made, cwd=repository, check=True, timeout=1800)
    (wheel,) = tmp_path.glob("mammometry-*.whl")
    venv.create(tmp_path / "empty", with_pip=True)
    bin_folder = tmp_path / "empty" / ("Scripts" if os.name == "nt" else "bin")
    with pytest.MonkeyPatch.context() as patch:
        for name in ("PYTHONPATH", "CC", "CXX"):
            patch.delenv(name, raising=False)
        patch.chdir(tmp_path)
        install = [bin_folder / "python", "-m", "pip", "install", "--quiet", "-c", repository / "constraints.txt"]
        patch.setenv("PATH", str(bin_folder))  # no cc, no node, no git
        subprocess.run([*install, "--only-binary=:all:", f"{wheel}[all]"], check=True, timeout=900)
        (package,) = (tmp_path / "empty").rglob("site-packages/mammometry")
        brought = {path: path.stat().st_mtime_ns for path in package.rglob("*.nb?")}
        assert len(brought) > 100
        command = str(bin_folder / "mammometry")
        version = subprocess.run([command, "--version"], capture_output=True, text=True, check=True).stdout
        assert ("(commit " in version) == (repository / ".git").exists(), version
        for line in (["demo", "cast"], ["demo", "scan", "--scan"]):
            done = subprocess.run([command, *line], capture_output=True, text=True, check=False, timeout=900)
            assert done.returncode == 0, done.stderr
            (page,) = Path(line[1]).rglob("report.html")
            assert "// mammometry viewer, sources " in page.read_text(encoding="utf-8")
        assert {path: path.stat().st_mtime_ns for path in package.rglob("*.nb?")} == brought, "it compiled something"
        spend([command, "clinic", "demo", "clinic", "--address", f"127.0.0.1:{free_port()}"])


@pytest.mark.slow
@pytest.mark.usefixtures("index")
@pytest.mark.parametrize("platform", ["win_amd64", "macosx_14_0_arm64"])
def test_each_core_dependency_has_a_wheel(repository: Path, tmp_path: Path, platform: str) -> None:
    """Those of the newest Python; whatever they need in turn as well."""
    project = tomllib.loads((repository / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    newest = max(re.findall(r"Python :: (3\.\d+)", str(project["classifiers"])), key=lambda text: int(text[2:]))
    asked = [
        *(sys.executable, "-m", "pip", "install", "--quiet", "--dry-run", "--ignore-installed"),
        *("--target", str(tmp_path), "--platform", platform, "--python-version", newest, "--only-binary=:all:"),
        *("-c", str(repository / "constraints.txt"), *project["dependencies"]),
    ]
    done = subprocess.run(asked, capture_output=True, text=True, check=False, timeout=600)
    assert done.returncode == 0, done.stderr
