"""Time differences between the cameras' exposures, measured with counting lamps in their pictures."""

from __future__ import annotations

import datetime
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from mammometry.base.errors import CaptureError, SessionError
from mammometry.base.parse import read_text
from mammometry.base.photograph import LUMA, Photograph
from mammometry.base.value import value
from mammometry.calibration.detection.detect import detect_in
from mammometry.calibration.targets.board import Board
from mammometry.calibration.targets.lamps import LAMPS
from mammometry.geometry.arrays import Array, Float64
from mammometry.io.write import write_text

SKEW = "skew.json"
_FORMAT = 1  # version of skew.json


@value
class Skew:
    """Time of each camera's exposure."""

    offset_ms: Mapping[str, float]
    """Camera → start of its exposure relative to the median camera's. Read-only."""
    std_ms: float
    """Standard uncertainty of an offset, the largest of all cameras."""
    measured: str
    """Time of the measurement, UTC, ISO 8601."""
    exposure_ms: float
    """Exposure time of the measurement."""

    @property
    def spread_ms(self) -> float:
        """Time between the first and the last exposure."""
        return max(self.offset_ms.values()) - min(self.offset_ms.values())

    @property
    def worst(self) -> str:
        """The camera farthest from the median."""
        return max(self.offset_ms, key=lambda name: abs(self.offset_ms[name]))

    def as_table(self) -> dict[str, object]:
        """The time differences as JSON."""
        return {
            "format": _FORMAT,
            "measured": self.measured,
            "exposure_ms": self.exposure_ms,
            "spread_ms": round(self.spread_ms, 4),
            "std_ms": round(self.std_ms, 4),
            "offset_ms": {name: round(value, 4) for name, value in self.offset_ms.items()},
        }


def write_skew(folder: Path, skew: Skew) -> Path:
    """Write skew.json into a session.

    Raises:
        StorageError: the disk is full or refuses.
    """
    path = folder / SKEW
    write_text(path, json.dumps(skew.as_table(), indent=1) + "\n")
    return path


def read_skew(folder: Path) -> Skew | None:
    """Read a session's skew.json. None if there is none.

    Raises:
        SessionError: it is not from `write_skew`.
    """
    path = folder / SKEW
    if not path.is_file():
        return None
    try:
        table = json.loads(read_text(path, SKEW, "a skew.json", most_mib=1))
        if table["format"] != _FORMAT:
            raise ValueError("another format")
        return Skew(
            offset_ms={str(name): float(value) for name, value in table["offset_ms"].items()},
            std_ms=float(table["std_ms"]),
            measured=str(table["measured"]),
            exposure_ms=float(table["exposure_ms"]),
        )
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        remedy = "Remove it, and measure the skew again"
        expected = "the file as `mammometry skew` wrote it"
        raise SessionError(str(path), found="no record of a measured skew", expected=expected, remedy=remedy) from None


_STEPS_MS = (0.1, 0.01)  # steps between tested times: first over the whole count, then around the best one
_WITHIN = 0.9  # side of the square in which a lamp's light is summed, relative to the pitch
_CLIPPED = 0.98  # share of full scale above which a reference lamp may be saturated, so that shares are wrong
_LEAST_CONTRAST = 0.02  # least contrast between a reference lamp and its surroundings, as a share of full scale
# least standard deviation of a share: lamps differ in brightness by viewing angle, even without noise
_LEAST_STD = 0.01
_MISFIT = 0.15  # RMS residual of the shares above which the lamps show no valid count
_LONGEST_SHARE = 0.25  # largest difference between cameras, as a share of the period; beyond it, their order is unknown


@dataclass(frozen=True, slots=True, kw_only=True)
class Moment:
    """Time at which the exposure of one picture started."""

    begin_ms: float
    """Time since the counter's 0, modulo its period."""
    std_ms: float


def read_moment(photograph: Photograph, board: Board, exposure_ms: float, *, camera: str = "it") -> Moment:
    """Read the time of a picture's exposure.

    Args:
        photograph: picture of the board with its strip of lamps.
        board: the board, which has the strip.
        exposure_ms: exposure time.
        camera: name of the camera, for messages.

    Raises:
        CaptureError: board or lamps are not in the picture, or too bright.
    """
    points = detect_in(photograph, board, camera=camera, pose="lamps")
    if points is None:
        raise _unread(camera, "no board", "Show the board with the lamps to all cameras, the lamps down")
    places = LAMPS.places_mm(board)
    image_from_board = _homography(board.points_target[points.ids, :2], points.uv)
    half_mm = 0.5 * _WITHIN * min(LAMPS.pitch_mm, 2 * (LAMPS.below_mm - LAMPS.lamp_mm))
    light = photograph.linear()
    grey = light @ LUMA if light.ndim == 3 else light
    lamps = [_lamp(grey, image_from_board, place[:2], half_mm, camera) for place in places]
    totals = np.array([total for total, _ in lamps])
    references = [lamps[0], lamps[-1]]
    if max(peak for _, peak in references) > _CLIPPED:
        raise _unread(camera, "lamps too bright to compare", "Close the aperture, or dim the lamps")
    if min(peak for _, peak in references) < _LEAST_CONTRAST:
        raise _unread(camera, "no light at the ends of the strip", "Switch the lamps on; both end lamps must shine")
    across = np.linspace(0.0, 1.0, len(totals))[1:-1]
    full = (1 - across) * totals[0] + across * totals[
        -1
    ]  # brightness varies linearly along the strip, with distance and angle
    return moment_of(totals[1:-1] / full, exposure_ms, camera=camera)


def moment_of(shares: Float64[Array, " bits"], exposure_ms: float, *, camera: str = "it") -> Moment:
    """The time that fits the shares of light best, by least squares.

    Args:
        shares: share of the exposure for which each counting lamp was lit, highest bit first.
        exposure_ms: exposure time.
        camera: name of the camera, for messages.

    Raises:
        CaptureError: no time fits.
    """
    coarse, table = _table(exposure_ms)
    begun = float(coarse[((table - shares) ** 2).sum(axis=1).argmin()])
    tried = begun + np.arange(-_STEPS_MS[0], _STEPS_MS[0] + _STEPS_MS[1], _STEPS_MS[1])
    misfit = ((LAMPS.lit_share(tried, exposure_ms) - shares) ** 2).sum(axis=1)
    best = int(misfit.argmin())
    rms = float(np.sqrt(misfit[best] / len(shares)))
    if rms > _MISFIT:
        raise _unread(
            camera, "lamps that show no count", "Check exposure_ms, the lamps' order, and that none is hidden"
        )
    before, after = LAMPS.lit_share(tried[best] + _STEPS_MS[1] * np.array([-1.0, 1.0]), exposure_ms)
    weight = float((((after - before) / (2 * _STEPS_MS[1])) ** 2).sum())
    noise = max(rms, _LEAST_STD)
    std_ms = float(np.hypot(noise / np.sqrt(weight), _STEPS_MS[1] / np.sqrt(12))) if weight > 0 else LAMPS.tick_ms
    return Moment(begin_ms=float(tried[best]) % LAMPS.period_ms, std_ms=std_ms)


@lru_cache(maxsize=4)
def _table(exposure_ms: float) -> tuple[Float64[Array, " n"], Float64[Array, "n bits"]]:
    """Times over the whole count, and the state of the lamps at each."""
    moments = np.arange(0.0, LAMPS.period_ms, _STEPS_MS[0])
    return moments, LAMPS.lit_share(moments, exposure_ms)


def skew_of(firings: Sequence[Mapping[str, Moment]], exposure_ms: float, *, when: str | None = None) -> Skew:
    """Time differences between the cameras, from one or several exposures.

    Args:
        firings: camera → time, for each exposure.
        exposure_ms: exposure time of all pictures.
        when: time of the measurement, UTC, ISO 8601. None: now.

    Raises:
        CaptureError: there are fewer than two cameras, or they differ by more than a quarter of the counter's period.
    """
    cameras = list(dict.fromkeys(name for moments in firings for name in moments))
    if len(cameras) < 2:
        raise CaptureError(
            "the skew", found=f"lamps in pictures of {len(cameras)} cameras", expected="at least two",
            remedy="Hold the lamps where all cameras see them",
        )  # fmt: skip
    offsets: dict[str, list[float]] = {name: [] for name in cameras}
    for moments in firings:
        phases = np.exp(2j * np.pi * np.array([moment.begin_ms for moment in moments.values()]) / LAMPS.period_ms)
        around = np.angle(phases * np.conj(phases[0])) * LAMPS.period_ms / (2 * np.pi)
        if np.ptp(around) > _LONGEST_SHARE * LAMPS.period_ms:
            raise CaptureError(
                "the skew", found=f"exposures {np.ptp(around):.0f} ms apart", expected="less than a quarter count",
                remedy="Fire by wire: released by USB, cameras are up to seconds apart",
            )  # fmt: skip
        for name, offset in zip(moments, around - np.median(around), strict=True):
            offsets[name].append(float(offset))
    return Skew(
        offset_ms={name: float(np.median(values)) for name, values in offsets.items()},
        std_ms=max(moment.std_ms for moments in firings for moment in moments.values()),
        measured=when or datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        exposure_ms=exposure_ms,
    )


def _lamp(
    grey: Float64[Array, "h w"],
    image_from_board: Float64[Array, "3 3"],
    place: Float64[Array, 2],
    half_mm: float,
    who: str,
) -> tuple[float, float]:
    """Light of one lamp above its surroundings: sum over pixels and peak, as shares of full scale."""
    corners = place + half_mm * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    uv = _mapped(image_from_board, corners)
    (left, top), (right, bottom) = np.floor(uv.min(axis=0)).astype(int), np.ceil(uv.max(axis=0)).astype(int) + 1
    if left < 0 or top < 0 or right > grey.shape[1] or bottom > grey.shape[0]:
        raise _unread(who, "lamps outside the picture", "Hold the board so that the whole strip is in all pictures")
    cut = np.asarray(grey[top:bottom, left:right], dtype=np.float64)
    border = np.concatenate([cut[0], cut[-1], cut[:, 0], cut[:, -1]])
    return float((cut - np.median(border)).sum()), float(cut.max() - np.median(border))


def _homography(xy: Float64[Array, "n 2"], uv: Float64[Array, "n 2"]) -> Float64[Array, "3 3"]:
    """Homography from a plane to a picture (Hartley and Zisserman 2004, algorithm 4.2)."""
    (norm_xy, a), (norm_uv, b) = _normalised(xy), _normalised(uv)
    ones, none = np.ones(len(a)), np.zeros((len(a), 3))
    p = np.column_stack([a, ones])
    rows = np.concatenate([
        np.hstack([p, none, -b[:, :1] * p]), np.hstack([none, p, -b[:, 1:] * p])
    ])  # fmt: skip
    solved: Float64[Array, "3 3"] = np.linalg.inv(norm_uv) @ np.linalg.svd(rows)[2][-1].reshape(3, 3) @ norm_xy
    return solved


def _normalised(points: Float64[Array, "n 2"]) -> tuple[Float64[Array, "3 3"], Float64[Array, "n 2"]]:
    middle, scale = points.mean(axis=0), 1.0 / points.std()
    return np.array([[scale, 0, -scale * middle[0]], [0, scale, -scale * middle[1]], [0, 0, 1]]), scale * (
        points - middle
    )


def _mapped(matrix: Float64[Array, "3 3"], xy: Float64[Array, "n 2"]) -> Float64[Array, "n 2"]:
    mapped = np.column_stack([xy, np.ones(len(xy))]) @ matrix.T
    points: Float64[Array, "n 2"] = mapped[:, :2] / mapped[:, 2:]
    return points


def _unread(camera: str, found: str, remedy: str) -> CaptureError:
    return CaptureError(camera, found=found, expected="the board with its counting lamps", remedy=remedy)
