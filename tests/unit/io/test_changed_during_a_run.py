"""A photograph, mask or table that is replaced after its digest was taken is refused, not measured."""

import os
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from mammometry.base.errors import ImageError
from mammometry.io.session import Session

MANIFEST = """\
format = 1
units = "mm"
rig = { name = "two", pairs = [{ name = "front", left = "l", right = "r" }] }
target = { kind = "chessboard", squares = [5, 4], square_mm = 25.0 }
subject = { kind = "model" }
"""


def grey(value: int) -> Image.Image:
    return Image.fromarray(np.full((20, 30), value, np.uint8))


@pytest.fixture
def session(tmp_path: Path) -> Path:
    for place in ("capture", "masks", "calibration/00"):
        (tmp_path / place).mkdir(parents=True)
        for camera in ("l", "r"):
            grey(128).save(tmp_path / place / f"{camera}.png")
    (tmp_path / "session.toml").write_text(MANIFEST)
    return tmp_path


@pytest.mark.parametrize("times_kept", [False, True])
@pytest.mark.parametrize("place", ["capture", "masks", "calibration/00"])
@pytest.mark.requirement("R-IN-18")
def test_what_is_replaced_after_it_was_planned_is_refused(session: Path, place: str, times_kept: bool) -> None:
    inputs = Session.open(session).inputs()
    look_up = {
        "capture": lambda: inputs.photographs["l"],
        "masks": lambda: inputs.masks["l"],
        "calibration/00": lambda: inputs.calibration_photographs["00", "l"],
    }[place]
    digest = inputs.digests[f"{place}/l"]
    look_up()
    path = session / place / "l.png"
    before = path.stat()
    grey(129).save(path)
    if times_kept:
        os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))
    with pytest.raises(ImageError, match=rf"{place}/l\.png: .*changed"):
        look_up()
    assert inputs.digests[f"{place}/l"] == digest
    again = Session.open(session).inputs()
    assert again.digests[f"{place}/l"] != digest
    assert again.photographs["l"].pixels.size
