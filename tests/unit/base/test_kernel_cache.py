"""Kernels on disk: stamped by what their source says, loaded wherever it lies, compiled anew where they do not fit."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numba
import pytest
from numba.core import config

import mammometry
from mammometry.base.machine import compiled
from mammometry.matching import filters

_PROGRAM = """
import numpy as np
from mammometry.matching import filters
image = np.arange(48, dtype=np.float32).reshape(6, 8)
half = filters.halve(image, np.array([0.25, 0.5, 0.25], dtype=np.float32))
print(filters.__file__, sum(filters.halve.stats.cache_hits.values()), float(half.sum()))
"""


@pytest.fixture
def package(tmp_path, monkeypatch):
    """A package of two modules, the first of which imports the second."""
    monkeypatch.setattr(compiled, "_PACKAGE", tmp_path)
    compiled.source_stamp.cache_clear()
    (tmp_path / "inner").mkdir()
    (tmp_path / "one.py").write_text("from mammometry.inner.two import (\n    f,\n)\n")
    (tmp_path / "inner" / "two.py").write_text("f = 1\n")
    (tmp_path / "three.py").write_text("g = 1\n")
    yield tmp_path
    compiled.source_stamp.cache_clear()


def stamp(path: Path) -> str:
    compiled.source_stamp.cache_clear()
    return compiled.source_stamp(path)


@pytest.mark.parametrize("text", ["from mammometry.inner import two\n", "from mammometry.inner.two import f\n"])
def test_a_stamp_tells_what_a_module_and_its_imports_say(package, text):
    one, two = package / "one.py", package / "inner" / "two.py"
    one.write_text(text)
    first = stamp(one)
    os.utime(one, (1, 1))
    (package / "three.py").write_text("g = 2\n")
    assert stamp(one) == first
    two.write_text("f = 2\n")
    assert stamp(one) != first
    two.write_text("f = 1\n")
    assert stamp(one) == first
    one.write_text(text + "x = 1\n")
    assert stamp(one) != first


def test_imports_over_several_lines_count(package):
    first = stamp(package / "one.py")
    (package / "inner" / "two.py").write_text("f = 2\n")
    assert stamp(package / "one.py") != first


def test_kernels_are_compiled_for_the_common_processor_or_for_this_one():
    _, name, features = filters.halve.targetctx.codegen().magic_tuple()
    chosen = compiled.llvm.get_host_cpu_features()
    if all(chosen.get(one) for one in compiled._COMMON_FEATURES) and "NUMBA_CPU_NAME" not in os.environ:
        assert (name, features) == (compiled.COMMON_CPU, "")
    else:
        assert name == (config.CPU_NAME or compiled.llvm.get_host_cpu_name())


@pytest.mark.parametrize("missing", compiled._COMMON_FEATURES)
def test_a_processor_that_lacks_something_gets_its_own_code(monkeypatch, missing):
    monkeypatch.setattr(config, "CPU_NAME", None)
    monkeypatch.setattr(config, "CPU_FEATURES", None)
    features = dict.fromkeys(compiled._COMMON_FEATURES, True) | {missing: False}
    monkeypatch.setattr(compiled.llvm, "get_host_cpu_features", lambda: features)
    compiled.choose_cpu()
    assert config.CPU_NAME is None


def test_what_cannot_be_read_is_compiled(tmp_path, monkeypatch):
    """An index of this version whose rest is no pickle: numba alone would raise."""
    monkeypatch.setattr(config, "CACHE_DIR", str(tmp_path))
    (tmp_path / "source").mkdir()
    source = tmp_path / "source" / "kernels.py"
    source.write_text("def twice(x):\n    return 2 * x\n")
    space: dict[str, object] = {}
    exec(compile(source.read_text(), str(source), "exec"), space)
    monkeypatch.setitem(sys.modules, "kernels", type(sys)("kernels"))
    kernel = compiled.cached(numba.njit(space["twice"]))
    assert not compiled.is_cached(kernel)
    assert kernel(2) == 4
    assert compiled.is_cached(kernel)
    (index,) = tmp_path.rglob("*.nbi")
    index.write_bytes(index.read_bytes()[:40])
    again = compiled.cached(numba.njit(space["twice"]))
    assert not compiled.is_cached(again)
    assert again(2) == 4


@pytest.mark.slow
def test_a_copy_of_the_package_uses_what_was_compiled_elsewhere(tmp_path):
    """As a wheel does: other folders, other times. A change of an imported module makes it compile again."""
    package = tmp_path / "first" / "mammometry"
    shutil.copytree(Path(mammometry.__file__).parent, package, ignore=shutil.ignore_patterns("__pycache__"))

    def run(place: Path) -> tuple[str, str, str]:
        environment = {name: value for name, value in os.environ.items() if not name.startswith("NUMBA_")}
        environment["PYTHONPATH"] = str(place)
        done = subprocess.run(
            [sys.executable, "-P", "-c", _PROGRAM], env=environment, capture_output=True, text=True, check=True
        )
        file, hits, value = done.stdout.split()
        assert file.startswith(str(place))
        return hits, value, file

    assert run(package.parent)[0] == "0"
    moved = tmp_path / "second"
    package.parent.rename(moved)
    for path in moved.rglob("*.py"):
        os.utime(path, (1, 1))
    hits, value, _ = run(moved)
    assert hits == "1"
    with (moved / "mammometry" / "geometry" / "arrays.py").open("a") as source:
        source.write("# changed\n")
    assert run(moved)[:2] == ("0", value)
