"""Time and peak memory of matching, from photographs to disparities, compared with OpenCV's SGBM.

    python -m benchmarks.speed.matching --out build/matching
    python -m benchmarks.speed.matching SESSION [SESSION …]

Renders a plaster and a torso at full size with their true cameras for a calibration, unless sessions are given. Each is
matched in a process of its own, after a small session has loaded the kernels. "Matching" is decoding, foreground,
rectification, matching both ways and its check; "with files" adds writing the products and drawing the previews, which
is `mammometry match`. The peer gets our rectified pictures and the range of disparities that was found, and no
left-right check. "all foreground" takes every pixel for subject (`matching.foreground.mode=all`): the most that a pair
can ask for. Pairs are matched one after the other on two cores, so that their number does not count.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import shutil
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np

import mammometry as mm
from benchmarks.speed.whole_job import make_session
from mammometry.io.session import Session
from mammometry.job.stages import calibrate, match
from mammometry.matching.settings import ForegroundSettings, MatchSettings
from mammometry.settings import Settings

_WARM = 0.1
_SUBJECTS = ("plaster_5", "torso_3")


def _peak_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def _timed(work: Any) -> dict[str, float]:
    wall, processor = time.monotonic(), time.process_time()
    work()
    return {"wall_s": time.monotonic() - wall, "cpu_s": time.process_time() - processor, "peak_mb": _peak_mb()}


def _fresh(session: Path, settings: Settings = Settings()) -> mm.Job:
    shutil.rmtree(session / "results", ignore_errors=True)
    job = mm.open_session(session, settings)
    job.calibrate()
    return job


def matched(session: Path, settings: Settings = Settings()) -> dict[str, float]:
    """Match all pairs, no previews; products are written, for memory is bounded by letting them go."""
    job = _fresh(session, settings)
    with job.store.taken():
        return _timed(lambda: job.plan.ensure("match"))


def all_foreground(session: Path) -> dict[str, float]:
    """The same where every pixel may be surface."""
    return matched(session, Settings(matching=MatchSettings(foreground=ForegroundSettings(mode="all"))))


def with_files(session: Path) -> dict[str, float]:
    """What `mammometry match` does after it has started."""
    job = _fresh(session)
    return _timed(lambda: job.ensure("match"))


def peer(session: Path) -> dict[str, float]:
    """OpenCV's SGBM-3WAY alone on the rectified pairs."""
    job = mm.open_session(session)
    job.ensure("match")
    rows = []
    for found in job.plan[match.disparity].values():
        disparity = found.uncached()
        low, high = (float(value) for value in np.percentile(disparity.d_h_px[disparity.valid], (0.1, 99.9)))
        lowest, count = int(np.floor(low)) - 8, 16 * int(np.ceil((high - low + 16) / 16))
        photographs = [job.inputs.photographs[name] for name in job.inputs.pair_names[disparity.name]]
        grey = []
        for photograph, ideal in zip(photographs, (disparity.left, disparity.right), strict=True):
            camera = job.plan[calibrate.cameras]().rig.cameras[ideal.name]
            turn = ideal.camera_from_world.rotation @ camera.camera_from_world.rotation.T
            maps = cv2.initUndistortRectifyMap(
                camera.matrix, camera.distortion, turn, ideal.matrix, ideal.size_wh, cv2.CV_32FC1
            )
            grey.append(cv2.cvtColor(cv2.remap(photograph.pixels, *maps, cv2.INTER_CUBIC), cv2.COLOR_RGB2GRAY))
        matcher = cv2.StereoSGBM.create(
            minDisparity=lowest, numDisparities=count, blockSize=5, P1=200, P2=800, mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY
        )
        del disparity, photographs
        rows.append(_timed(lambda: matcher.compute(*grey)))  # noqa: B023  # called at once
    return {
        "wall_s": sum(row["wall_s"] for row in rows),
        "cpu_s": sum(row["cpu_s"] for row in rows),
        "peak_mb": max(row["peak_mb"] for row in rows),
    }


_KINDS = {"matching": matched, "with files": with_files, "all foreground": all_foreground, "SGBM-3WAY": peer}


def measured(session: Path, warm: Path, kind: str) -> dict[str, float]:
    """One kind of work in a process of its own, whose kernels a small session has loaded."""
    command = [sys.executable, "-m", "benchmarks.speed.matching", "--work", kind, str(warm), str(session)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(done.stderr.strip() or done.stdout.strip())
    row: dict[str, float] = json.loads(done.stdout.splitlines()[-1])
    return row


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("sessions", type=Path, nargs="*", help="with cameras.json; default: rendered ones")
    parser.add_argument("--out", type=Path, default=Path("build/matching"), help="for rendered sessions")
    parser.add_argument("--work", nargs=3, metavar=("KIND", "WARM", "SESSION"), help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.work:
        kind, warm, session = arguments.work
        with_files(Path(warm))
        print(json.dumps(_KINDS[kind](Path(session))))
        return
    warm = make_session(arguments.out / "warm", _WARM, _SUBJECTS[0])
    sessions = arguments.sessions or [make_session(arguments.out / name, 1.0, name) for name in _SUBJECTS]
    print(f"{len(os.sched_getaffinity(0))} cores, load {os.getloadavg()[0]:.1f}\n")
    print("| session | pairs | | wall s | CPU s | peak MB of the process |\n" + "| --- " * 6 + "|")
    for session in sessions:
        pairs = len(Session.open(session).pair_names)
        for kind in _KINDS:
            row = measured(session, warm, kind)
            figures = f"{row['wall_s']:.1f} | {row['cpu_s']:.1f} | {row['peak_mb']:.0f}"
            print(f"| {session.name} | {pairs} | {kind} | {figures} |", flush=True)


if __name__ == "__main__":
    main()
