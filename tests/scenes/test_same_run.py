"""A whole run gives the same bytes again: on one, two or four cores, whatever Python's hashes are."""

import hashlib
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

RUN = """
import os, sys
from mammometry.api.job import Job
from mammometry.report.words import describe

cores, session, settings = int(sys.argv[1]), sys.argv[2], sys.argv[3]
os.sched_getaffinity = lambda process: set(range(cores))
describe.created_words = lambda moment=None: "then"  # all that a report says of time
Job._all_seconds = lambda self: {}

import cv2
from mammometry.cli import main

cv2.setNumThreads(cores)
sys.exit(main.run(["run", session, "--settings", settings, "--quiet"]))
"""


def products(results: Path) -> dict[str, Any]:
    """Digest of every file; of a record what it says but for times."""
    said: dict[str, Any] = {}
    for path in sorted(results.rglob("*")):
        name = str(path.relative_to(results))
        if path.name == "provenance.json":
            table = json.loads(path.read_text())
            said[name] = {
                product: {key: value for key, value in record.items() if key not in ("made", "seconds")}
                for product, record in table["products"].items()
            }
        elif path.is_file():
            said[name] = hashlib.sha256(path.read_bytes()).hexdigest()
    return said


@pytest.mark.slow
@pytest.mark.requirement("R-SAME-1")
def test_a_whole_run_gives_the_same_bytes_on_any_number_of_cores(
    tmp_path: Path, tiny_original: Path, tiny_settings: Path
) -> None:
    found = []
    for run, cores in enumerate((1, 2, 4)):
        session = tmp_path / str(run) / "session"  # the report's title is the folder's name
        shutil.copytree(tiny_original, session)
        environment = os.environ | {
            "PYTHONPATH": os.pathsep.join(sys.path),
            "PYTHONHASHSEED": str(run),
            "OPENBLAS_NUM_THREADS": str(cores),
        }
        command = [sys.executable, "-c", RUN, str(cores), str(session), str(tiny_settings)]
        subprocess.run(command, env=environment, check=True, timeout=600)
        found.append(products(session / "results"))
    assert "report/report.pdf" in found[0]
    assert len(found[0]) > 50
    for again in found[1:]:
        assert again == found[0]
