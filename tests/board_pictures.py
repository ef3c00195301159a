"""Pictures for pages on which nothing is measured."""

from pathlib import Path

import numpy as np
from PIL import Image


def board_picture(path: Path, seed: int) -> Path:
    """Squares in other greys for each seed."""
    noise = np.random.default_rng(seed).integers(0, 255, (8, 12, 3), dtype=np.uint8)
    Image.fromarray(noise).resize((600, 400), Image.Resampling.NEAREST).save(path, quality=90)
    return path
