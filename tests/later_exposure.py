"""Photographs as of a later exposure, made of another one's."""

from pathlib import Path

import numpy as np
from PIL import Image


def later_exposure(source: Path, goal: Path, *, lighter: int = 1, taken: str = "") -> Path:
    """A folder of the same pictures lighter by some levels of 255: PNG, or JPEG where it has a time stamp.

    Args:
        source: folder with a photograph a camera.
        goal: where they are written.
        lighter: 0 for the same pixels in other files.
        taken: time stamp of EXIF, such as ``2026:03:01 08:00:00``.
    """
    goal.mkdir(parents=True)
    for path in source.iterdir():
        with Image.open(path) as picture:
            pixels = np.clip(np.asarray(picture).astype(int) + lighter, 0, 255).astype(np.uint8)
        exif = Image.Exif()
        if taken:
            exif.get_ifd(0x8769)[0x9003] = taken
        ending = "jpg" if taken else "png"
        Image.fromarray(pixels).save(goal / f"{path.stem}.{ending}", exif=exif)
    return goal
