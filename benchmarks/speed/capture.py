"""Time of a firing of eight 13.5 megapixel cameras, and live pictures per second.

    python -m benchmarks.speed.capture [FOLDER]

FOLDER keeps the pictures, which take some minutes to make, for the next time.
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from pathlib import Path

from tests.unit.capture.virtual_capture import make_pictures, rig_file

from mammometry.base.machine.cores import available_cores
from mammometry.capture.loop import OpenRig
from mammometry.capture.page import LiveView

_FIRINGS, _ROUNDS = 5, 20


def main(folder: Path) -> None:
    """Fire, look live, and print what it took."""
    if not (folder / "calibrated").exists():
        make_pictures(folder / "calibrated", 1.0)
    with OpenRig(rig_file(folder, timeout_s=10)) as rigged, tempfile.TemporaryDirectory(dir=folder) as place:
        rigged.faults()  # reads the pictures
        fired = []
        for number in range(_FIRINGS + 1):
            cpu_s = time.process_time()
            one = rigged.fire_into(Path(place) / "session")
            fired.append((one.written_s, one.verdict.seconds, time.process_time() - cpu_s))
            assert one.accepted, (number, one.verdict.sentences)
        written, verdict, cpu = (sorted(values)[_FIRINGS // 2] for values in zip(*fired[1:], strict=True))
        live = LiveView(rigged.backend, rigged.cameras, "model")
        live.look()
        begun, cpu_s = time.monotonic(), time.process_time()
        for _ in range(_ROUNDS):
            seen = live.look()
        seconds, cpu_live_s = time.monotonic() - begun, time.process_time() - cpu_s
        live.close()
    assert all(not isinstance(one, str) for one in seen.values())
    width, height = rigged.rig.cameras["front_left"].size_wh  # type: ignore[union-attr]
    print(
        f"{len(rigged.cameras)} cameras of {width} x {height} pixels, {available_cores()} cores, load {os.getloadavg()}"
    )
    print(f"on the disk {written:.2f} s, verdict {verdict:.2f} s after the pulse, {cpu:.2f} CPU s a firing")
    print(f"live pictures of all cameras: {_ROUNDS / seconds:.1f} a second, {cpu_live_s / _ROUNDS:.3f} CPU s a round")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(tempfile.mkdtemp()))
