"""What the tests have the runner's processes do, in place of measuring."""

import time
from pathlib import Path

from mammometry.base.errors import MeasureError

ANSWER = {"digest": "d" * 64, "made_at": None, "software": "0", "volumes": [], "megapixels": 1.0}


def measure(progress, session, calibration, settings):
    """Note in the session's folder that it was begun and ended."""
    notes = Path(session) / "notes"
    with notes.open("a") as file:
        file.write("began\n")
    progress("match", 0.5)
    if (Path(session) / "long").exists():
        time.sleep(60)
    if (Path(session) / "bad").exists():
        raise MeasureError(f"{session}/capture", found="nothing", expected="a breast", remedy="Look")
    with notes.open("a") as file:
        file.write("ended\n")
    return ANSWER
