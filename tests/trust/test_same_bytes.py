"""The same input gives the same bytes: for any number of threads, and however Python orders its sets."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

RIG = Path(__file__).resolve().parents[1] / "unit" / "calibration"  # of the virtual rig
CALIBRATE = """
import sys
from pathlib import Path
import cv2
import virtual_rig as rig
from mammometry.calibration.adjust.bundle import calibrate
from mammometry.io.results.codecs import encode

threads, folder = int(sys.argv[1]), Path(sys.argv[2])
cv2.setNumThreads(threads)
seen = rig.observe(rig.cameras_in_rig(), rig.placements(6))
encode(calibrate(seen, rig.PAIRS, "virtual"), folder, "calibration")
assert cv2.getNumThreads() == threads
"""


@pytest.mark.slow
@pytest.mark.requirement("R-SAME-1")
def test_a_calibration_is_the_same_for_any_number_of_threads(tmp_path: Path) -> None:
    running = {}
    for threads in (1, 2):
        environment = os.environ | {
            "PYTHONPATH": os.pathsep.join([str(RIG), *sys.path]),
            "PYTHONHASHSEED": str(threads),
            "OPENBLAS_NUM_THREADS": str(threads),
        }
        folder = tmp_path / str(threads)
        command = [sys.executable, "-c", CALIBRATE, str(threads), str(folder)]
        running[folder / "calibration.npz"] = subprocess.Popen(command, env=environment)
    assert [process.wait(timeout=120) for process in running.values()] == [0, 0]
    assert len({file.read_bytes() for file in running}) == 1
