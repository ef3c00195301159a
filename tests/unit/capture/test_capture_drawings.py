"""What the how-to shows and flashes is the design that the software reads."""

import re
from pathlib import Path

import numpy as np
from benchmarks.capture_drawings import drawings

from mammometry.calibration.targets.lamps import LAMPS

PICTURES = Path(__file__).parents[3] / "docs/how-to/pictures"


def test_the_drawings_are_those_that_the_command_makes():
    for name, text in drawings().items():
        assert (PICTURES / name).read_text(encoding="utf-8") == text, (
            f"run python -m benchmarks.capture_drawings ({name})"
        )


def test_the_firmware_counts_as_the_software_reads():
    """The sketch's counter, played here: pins by its own shifts and masks."""
    sketch = (PICTURES / "counting-lamps.ino").read_text(encoding="utf-8")
    number = {name: int(re.search(rf"{name} = (\d+)", sketch)[1]) for name in ("TICK_US", "COUNTS")}
    assert number["TICK_US"] == 1e3 * LAMPS.tick_ms
    assert number["COUNTS"] == 2**LAMPS.bits
    mask, left = (int(text, 0) for text in re.search(r"gray & (0x\w+)\) << (\d)", sketch).groups())
    right = int(re.search(r"gray >> (\d)\);", sketch)[1])
    for count in (0, 1, 2, 777, 4095):
        gray = count ^ (count >> 1)
        pins = ((gray & mask) << left) >> 2 | (gray >> right) << 6  # pins 2 to 13, the lowest first
        shares = LAMPS.lit_share(LAMPS.tick_ms * (np.array([float(count)]) + 0.25), 0.5 * LAMPS.tick_ms)[0]
        assert [pins >> bit & 1 for bit in range(LAMPS.bits)] == shares[::-1].astype(int).tolist()
