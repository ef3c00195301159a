"""Fire all cameras once, and write what they give."""

from __future__ import annotations

import time
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from mammometry.base.errors import CaptureError, MammometryError
from mammometry.base.value import value
from mammometry.calibration.features.keypoints import Keypoints, keypoints
from mammometry.capture.camera import Backend, Frame
from mammometry.capture.checks.pixels import QUICK_PX, Seen, look
from mammometry.capture.shots import Shot
from mammometry.io.photographs.images import read_photograph
from mammometry.io.write import file_digest


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Delivered:
    """One camera's picture, on the disk, and what it shows."""

    path: Path
    size_wh: tuple[int, int]
    sha256: str
    taken_s: float | None
    clock: str
    number: int | None
    serial: str
    seen: Seen
    features: Keypoints | None
    """None where no calibration is there to compare them with."""
    seconds: float
    """From the pulse until it was on the disk."""


@value(eq=False)
class Firing:
    """One firing."""

    fired_s: float
    """By ``time.time()``."""
    frames: Mapping[str, Delivered]
    """Camera → what it gave. Read-only."""
    faults: Mapping[str, MammometryError]
    """Camera → why it gave nothing. Read-only."""
    seconds: float
    """From the pulse until all were on the disk and looked at."""


def take(backend: Backend, cameras: tuple[str, ...], shot: Shot, *, timeout_s: float, features: bool = True) -> Firing:
    """Arm, fire and fetch all cameras.

    One camera's failure, or the disk's, is its own fault: the others' pictures are written.

    Args:
        backend: open.
        cameras: of the rig.
        shot: where the pictures are written.
        timeout_s: for one picture from the pulse to this computer.
        features: whether to find what pairs are compared by.
    """
    backend.arm()
    fired_s = backend.fire()
    begun = time.monotonic()

    def one(camera: str) -> Delivered | MammometryError:
        try:
            frame = backend.fetch(camera, timeout_s)
            path = shot.keep(frame)
            seconds = time.monotonic() - begun
            return _looked_at(frame, path, seconds, features)
        except MammometryError as error:
            return error

    # Waiting for a slow camera holds a thread, and must hold nobody else up.
    with ThreadPoolExecutor(max(1, len(cameras))) as pool:
        got = dict(zip(cameras, pool.map(one, cameras), strict=True))
    return Firing(
        fired_s=fired_s,
        frames={name: outcome for name, outcome in got.items() if isinstance(outcome, Delivered)},
        faults={name: outcome for name, outcome in got.items() if isinstance(outcome, MammometryError)},
        seconds=time.monotonic() - begun,
    )


def _looked_at(frame: Frame, path: Path, seconds: float, features: bool) -> Delivered:
    photograph = frame.content
    if isinstance(photograph, bytes):
        try:
            photograph = read_photograph(path, frame.camera)
        except MammometryError as error:
            path.unlink(missing_ok=True)
            raise CaptureError(
                frame.camera, found=error.found, expected="a whole photograph", remedy="Fire again; change the cable"
            ) from None
    return Delivered(
        path=path,
        size_wh=photograph.size_wh,
        sha256=file_digest(path),
        taken_s=frame.taken_s,
        clock=frame.clock,
        number=frame.number,
        serial=frame.serial,
        seen=look(photograph, looked_at_px=QUICK_PX),
        features=keypoints(photograph) if features else None,
        seconds=seconds,
    )
