"""The disk is full at any moment: one sentence, earlier results stay whole, and with room a rerun gives equal bytes."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from recorded_disk import FullDisk
from small_products import NAMES, contents, key, make

from mammometry.base.errors import FullDiskError
from mammometry.io.results.store import Store
from mammometry.io.results.verify import verify

HERE = Path(__file__).parent


def filled(results: Path, version: int) -> None:
    store = Store(results)
    with store.taken():
        for name in NAMES:
            make(store, name, version)


@pytest.mark.slow
@pytest.mark.usefixtures("quick")
@pytest.mark.requirement("R-LOSS-3")
def test_the_disk_is_full_after_any_step(tmp_path: Path) -> None:
    filled(tmp_path / "wanted", 1)
    filled(tmp_path / "wanted", 2)
    refused, step = True, 0
    while refused:
        results = tmp_path / f"{step}"
        filled(results, 1)
        before = contents(results)
        said = ""
        with FullDisk(step).below(results) as disk:
            try:
                filled(results, 2)
            except FullDiskError as error:  # the last one succeeds
                said = str(error)
        assert "\n" not in said
        refused = disk.refused > 0
        assert bool(said) == refused, step
        store = Store(results)
        with store.taken():
            assert all(store.has(key(name, 1)) or store.has(key(name, 2)) for name in NAMES), step
        if store.has(key("mesh", 1)):
            assert contents(results)["surface/mesh.ply"] == before["surface/mesh.ply"]
        filled(results, 2)
        assert contents(results) == contents(tmp_path / "wanted")
        assert not verify(results).damaged
        assert not verify(results).leftovers
        step += 1
    assert step > 60


@pytest.fixture(scope="session")
def can_mount(tmp_path_factory: pytest.TempPathFactory) -> None:
    place = tmp_path_factory.mktemp("mount")
    try:
        tried = subprocess.run(["unshare", "-rm", "mount", "-t", "tmpfs", "none", str(place)], capture_output=True)
    except FileNotFoundError:
        tried = None
    if tried is None or tried.returncode:
        pytest.skip("mounting a small disk is not permitted here; the injected ENOSPC above ran")


SMALL_DISK = """
set -e
mount -t tmpfs -o size={size} none {results}
code=0; {command} > {out}/first 2>&1 || code=$?
echo $code > {out}/code
cp -a {results} {out}/left
mount -o remount,size=200m {results}
{command} > {out}/second 2>&1
cp -a {results} {out}/results
"""


def on_a_small_disk(results: Path, size: str, command: str, out: Path) -> tuple[int, str]:
    """Run a command twice, its results on a disk of that size and then with room; say how the first went."""
    results.mkdir()
    out.mkdir()
    script = SMALL_DISK.format(size=size, results=results, command=command, out=out)
    subprocess.run(["unshare", "-rm", "sh", "-c", script], check=True)
    return int((out / "code").read_text()), (out / "first").read_text()


@pytest.mark.slow
@pytest.mark.usefixtures("can_mount")
@pytest.mark.parametrize("size", ["16k", *(pytest.param(size, marks=pytest.mark.slow) for size in ("32k", "48k"))])
@pytest.mark.requirement("R-LOSS-3")
def test_a_disk_that_is_really_full(tmp_path: Path, size: str) -> None:
    command = f"{sys.executable} {HERE / 'small_products.py'} {tmp_path / 'results'} 1"
    code, said = on_a_small_disk(tmp_path / "results", size, command, tmp_path / "out")
    assert code == 1
    assert "FullDiskError" in said.splitlines()[-1]
    assert not verify(tmp_path / "out" / "left").damaged
    filled(tmp_path / "wanted", 1)
    assert contents(tmp_path / "out" / "results") == contents(tmp_path / "wanted")


@pytest.mark.slow
@pytest.mark.usefixtures("can_mount")
@pytest.mark.parametrize("stage", ["calibrate", "surface", "report"])
def test_a_disk_that_is_full_in_each_stage(
    tiny_original: Path, tiny_finished_original: Path, tiny_settings: Path, tmp_path: Path, stage: str
) -> None:
    session = shutil.copytree(tiny_original, tmp_path / tiny_original.name)
    whole = tiny_finished_original / "results"
    stages = ["calibrate", "match", "surface", "measure", "report"]
    sizes = {name: sum(-(-path.stat().st_size // 4096) * 4 for path in (whole / name).rglob("*")) for name in stages}
    room = sum(sizes[name] for name in stages[: stages.index(stage)]) + sizes[stage] // 2
    command = f"{sys.executable} -m mammometry run {session} --settings {tiny_settings} --json"
    code, said = on_a_small_disk(session / "results", f"{room}k", command, tmp_path / "out")
    assert code == 9, said
    assert json.loads(said.splitlines()[-1])["code"] == FullDiskError.code
    assert not verify(tmp_path / "out" / "left").damaged
    made = {name: data for name, data in contents(tmp_path / "out" / "results").items() if "report/" not in name}
    assert made == {name: data for name, data in contents(whole).items() if "report/" not in name}
