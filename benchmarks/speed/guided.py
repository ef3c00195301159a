"""How long a guided calibration of eight 13.5 megapixel cameras takes at the computer, pose by pose.

    python -m benchmarks.speed.guided [FOLDER]

FOLDER keeps the pictures, which take some minutes to make, for the next time.
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from PIL import Image
from tests.unit.capture.virtual_capture import RIG_TOML

from mammometry.base.machine.cores import available_cores
from mammometry.capture.guide import POSES
from mammometry.capture.loop import OpenRig
from mammometry.simulate.recipe import SessionRecipe
from mammometry.simulate.session import write_session

_WANTED_S = 300.0  # issue 24: under five minutes with twelve poses, a person's movements included


def main(folder: Path) -> None:
    """Take twelve poses, one after the other, and print what each took."""
    rendered = folder / "rendered"
    if not rendered.exists():
        write_session(rendered, SessionRecipe(scale=1.0, poses=POSES), truth=False)
        _fill(rendered / "calibration")
    rig = folder / "rig.toml"
    print(f"{available_cores()} cores, load {os.getloadavg()}")
    seconds = []
    with tempfile.TemporaryDirectory(dir=folder) as place:
        for pose in sorted(path.name for path in (rendered / "calibration").iterdir()):
            options = f'session = "{rendered}"\nscene = "{pose}"'
            text = RIG_TOML.format(backend="virtual", subject="torso", timeout_s=20, lines="", options=options)
            rig.write_text(text.replace('calibration = "calibrated"\n', ""))
            with OpenRig(rig) as rigged:
                rigged.faults()  # reads the pictures
                begun = time.monotonic()
                posed = rigged.fire_pose(Path(place) / "calibration")
                seconds.append(time.monotonic() - begun)
            error = "" if posed.progress is None else f", expected {posed.progress.error_mm:.4f} mm"
            print(f"pose {posed.count}: {seconds[-1]:.1f} s from the pulse to where to hold the board next{error}")
    left = (_WANTED_S - sum(seconds)) / len(seconds)
    print(f"{len(seconds)} poses: {sum(seconds):.0f} s; of five minutes {left:.0f} s a pose are left to move the board")


def _fill(poses: Path) -> None:
    """Give cameras that do not see the board a picture of nothing: a fired camera always delivers one."""
    names = {picture.name for picture in poses.glob("*/*")}
    with Image.open(next(poses.glob("*/*"))) as picture:
        plain = np.random.default_rng(0).integers(20, 30, (picture.height, picture.width), dtype=np.uint8)
    for pose in poses.iterdir():
        for name in names - {picture.name for picture in pose.iterdir()}:
            Image.fromarray(plain).save(pose / name, quality=90)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(tempfile.mkdtemp()))
