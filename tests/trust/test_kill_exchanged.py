"""A photograph is exchanged in a run, and the run is killed: never the old number under the new photograph."""

import json
import random
import shutil
import subprocess
import sys
import time
from pathlib import Path

import cv2
import pytest
from test_kill import same_bytes
from tests.made_once import made_once

from mammometry.io.results.verify import verify


def exchanged(photograph: Path) -> bytes:
    """Another exposure of the same scene, a little darker."""
    pixels = cv2.imread(str(photograph), cv2.IMREAD_UNCHANGED)
    done, data = cv2.imencode(photograph.suffix, (pixels * 0.97).astype(pixels.dtype))
    assert done
    return bytes(data)


def run(session: Path, settings: Path) -> "subprocess.Popen[bytes]":
    command = [sys.executable, "-m", "mammometry", "run", str(session), "--settings", str(settings), "--json"]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)


@pytest.fixture(scope="module")
def other(tmp_path_factory: pytest.TempPathFactory, tiny_original: Path, tiny_settings: Path) -> Path:
    """The session with the other photograph, measured without any disturbance."""

    def make(folder: Path) -> None:
        session = shutil.copytree(tiny_original, folder / tiny_original.name)
        (photograph,) = (session / "capture").glob("front_left.*")
        photograph.write_bytes(exchanged(photograph))
        process = run(session, tiny_settings)
        out, _ = process.communicate()
        assert process.returncode == 0
        (folder / "answer.json").write_bytes(out)

    return made_once(tmp_path_factory, "exchanged", make) / tiny_original.name


@pytest.mark.slow
@pytest.mark.parametrize("part", range(3))
@pytest.mark.requirement("R-LOSS-1")
def test_a_photograph_exchanged_while_a_run_is_killed(
    tiny_original: Path, tiny_finished_original: Path, other: Path, tiny_settings: Path, tmp_path: Path, part: int
) -> None:
    """Part 0 begins with the old photograph's finished results, the others with none."""
    source = tiny_finished_original if part == 0 else tiny_original
    session = shutil.copytree(source, tmp_path / tiny_original.name)  # its name stands in the report
    if part == 0:
        shutil.rmtree(session / "results" / "measure")
    (photograph,) = (session / "capture").glob("front_left.*")
    new, chance = exchanged(photograph), random.Random(40 + part)
    process = run(session, tiny_settings)
    time.sleep(chance.uniform(2.0, 20.0))
    fresh = photograph.with_name(".fresh")
    fresh.write_bytes(new)
    fresh.replace(photograph)
    time.sleep(chance.uniform(0.0, 5.0))
    process.kill()
    process.communicate()
    again = run(session, tiny_settings)
    out, _ = again.communicate()
    assert again.returncode == 0
    expected = json.loads((other.parent / "answer.json").read_bytes())
    assert json.loads(out)["volumes_cc"] == expected["volumes_cc"]
    assert same_bytes(session / "results") == same_bytes(other / "results")
    assert not verify(session / "results", session).damaged
    old = json.loads((tiny_finished_original / "results" / "match" / "provenance.json").read_bytes())
    now = json.loads((session / "results" / "match" / "provenance.json").read_bytes())
    for product, record in now["products"].items():
        if "capture/front_left" in record["inputs"]:
            assert record["inputs"] != old["products"][product]["inputs"]
