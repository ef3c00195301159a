"""Aids while cameras are aimed and focused."""

from __future__ import annotations

import io
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from PIL import Image

from mammometry.base.errors import MammometryError
from mammometry.base.photograph import LUMA, Photograph
from mammometry.calibration.detection.detect import detect_in
from mammometry.calibration.targets.target import Target
from mammometry.capture.camera import Backend
from mammometry.capture.checks import Finding, Seen, judge
from mammometry.geometry.arrays import Array, Bool, Float32, Float64, Int64, UInt8
from mammometry.matching.foreground.block_segmentation import segment

WIDTH_PX = 480
"""Columns of a live picture on the page, about."""
REGIONS = (4, 6)
"""Rows and columns into which a picture is divided for sharpness and coverage."""
_BINS = 32  # of the histogram
_FULL = 250  # of 255: brighter counts as saturated, since white balance and encoding round
_UNIT_PX = 676.0  # diagonal to which `segment` counts its pixels, as `checks.pixels`
_COARSER = 3  # pixels of the small picture to one in which the subject is sought
_CALM = 30.0  # squared grey levels: a flat region's noise, some 4 of them, is no sharpness
_SEARCH_PX = 480  # width in which a target is sought: where it is counts, not hundredths of a pixel


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Aids:
    """What one live picture shows."""

    camera: str
    jpeg: bytes
    """Small, for the page."""
    sharpness: Float64[Array, "4 6"]
    """By region, 0 to 1: share of a region's contrast that is in details of two pixels. Only comparable within one
    camera: turn the focus until it is largest."""
    histogram: Int64[Array, " bins"]
    """Pixels by brightness, dark to bright, of the small picture."""
    saturated: float
    """Share of pixels without any drawing because they are too bright."""
    whole: str
    """Whether the subject is whole in the picture, in a sentence."""
    is_whole: bool
    """The same; False while the target is looked for."""
    target: int | None
    """Points of the target seen. None: not looked for."""
    covered: Bool[Array, "4 6"]
    """Regions in which the target has been seen, now or before."""

    def as_table(self) -> dict[str, Any]:
        """The aids as JSON, without the picture."""
        return {
            "camera": self.camera,
            "sharpness": np.round(self.sharpness, 3).tolist(),
            "histogram": self.histogram.tolist(),
            "saturated": round(self.saturated, 4),
            "whole": self.whole,
            "is_whole": self.is_whole,
            "target": self.target,
            "covered": self.covered.tolist(),
        }


class LiveView:
    """Live pictures of a rig's cameras with their aids.

    Keeps where each camera has seen the target, which says where it is still wanted.
    """

    def __init__(
        self, backend: Backend, cameras: tuple[str, ...], subject_kind: str, target: Target | None = None
    ) -> None:
        self._backend, self._cameras = backend, cameras
        self._kind, self._target = subject_kind, target
        self._covered: dict[str, Array] = {name: np.zeros(REGIONS, dtype=bool) for name in cameras}
        self._pool = ThreadPoolExecutor(max(1, len(cameras)))

    def look(self, *, calibrating: bool = False, subject_kind: str | None = None) -> dict[str, Aids | str]:
        """One live picture of every camera. A camera that gives none has a sentence instead.

        Args:
            calibrating: whether to look for the target, and not for the subject.
            subject_kind: where it is another than the rig's usual one.
        """

        def one(camera: str) -> Aids | str:
            try:
                photograph = self._backend.live(camera)
            except MammometryError as error:
                return str(error)
            target = self._target if calibrating else None
            aid = aids(photograph, camera, subject_kind or self._kind, target=target, covered=self._covered[camera])
            self._covered[camera] = aid.covered
            return aid

        return dict(zip(self._cameras, self._pool.map(one, self._cameras), strict=True))

    def wanted(self) -> Mapping[str, int]:
        """Camera → regions in which it has not seen the target yet."""
        return {name: int((~covered).sum()) for name, covered in self._covered.items()}

    def close(self) -> None:
        """End the threads of the live view."""
        self._pool.shutdown()


def aids(
    photograph: Photograph,
    camera: str,
    subject_kind: str,
    *,
    target: Target | None = None,
    covered: Bool[Array, "4 6"] | None = None,
) -> Aids:
    """Reduce a live picture and say what it shows.

    Args:
        photograph: at any size; of a large one only some pixels count, evenly spread, which keeps noise and details.
        camera: its name.
        subject_kind: ``torso``, ``model`` or ``surface``.
        target: what to look for; None for the subject.
        covered: regions in which the target was seen before.
    """
    pixels = photograph.pixels if photograph.pixels.dtype == np.uint8 else (photograph.pixels >> 8).astype(np.uint8)
    step = max(1, round(pixels.shape[1] / WIDTH_PX))
    sharpness = _sharpness(pixels[..., 1] if pixels.ndim == 3 else pixels, step)
    small = np.ascontiguousarray(pixels[step // 2 :: step, step // 2 :: step])
    grey = small @ LUMA if small.ndim == 3 else small.astype(np.float32)
    file = io.BytesIO()
    Image.fromarray(small).save(file, format="JPEG", quality=80)
    brightest = small.max(axis=2) if small.ndim == 3 else small
    before = np.zeros(REGIONS, dtype=bool) if covered is None else covered
    seen, regions = (None, before) if target is None else _target_in(photograph, camera, target, before)
    whole = None if target is not None else _whole(small, subject_kind)
    return Aids(
        camera=camera,
        jpeg=file.getvalue(),
        sharpness=sharpness,
        histogram=np.bincount((grey * (_BINS / 256)).astype(np.intp).ravel(), minlength=_BINS)[:_BINS],
        saturated=float((brightest >= _FULL).mean()),
        whole="" if whole is None else whole.sentence,
        is_whole=whole is not None and whole.level == "ok",
        target=seen,
        covered=regions,
    )


def _sharpness(grey: UInt8[Array, "h w"], step: int) -> Float64[Array, "4 6"]:
    """Energy of differences of neighbours over that of pixels four apart, by region; rows thinned for speed."""
    rows, columns = REGIONS
    thin = grey[step // 2 :: 2 * step].astype(np.float32)
    near = np.square(thin[:, 1:-4] - thin[:, :-5])
    far = np.square(thin[:, 4:-1] - thin[:, :-5])
    height, width = near.shape[0] // rows * rows, near.shape[1] // columns * columns

    def by_region(values: Float32[Array, "h w"]) -> Float64[Array, "4 6"]:
        blocks = values[:height, :width].reshape(rows, height // rows, columns, width // columns)
        return blocks.mean(axis=3).mean(axis=1).astype(np.float64)

    return np.clip(by_region(near) / (by_region(far) + _CALM), 0.0, 1.0)


def _whole(small: UInt8[Array, "h w *c"], subject_kind: str) -> Finding:
    """What `checks.pixels` says, of a picture that is small already."""
    encoded = np.atleast_3d(small)[::_COARSER, ::_COARSER].astype(np.float32) / 255
    unit = float(np.hypot(*encoded.shape[:2])) / (2 * _UNIT_PX)
    subject = segment(encoded, unit)
    where = np.ones(encoded.shape[:2], dtype=bool) if subject is None else subject
    seen = Seen(
        cover=0.0 if subject is None else float(where.mean()),
        borders=(
            float(where[0].mean()), float(where[-1].mean()), float(where[:, 0].mean()), float(where[:, -1].mean())
        ),
        centre=float(np.nonzero(where)[1].mean() + 0.5) / where.shape[1],
        median=0.5,
        clipped=0.0,
        blur=0.0,
    )  # fmt: skip
    return next(finding for finding in judge(seen, subject_kind) if finding.check == "whole")


def _target_in(
    photograph: Photograph, camera: str, target: Target, before: Bool[Array, "4 6"]
) -> tuple[int, Bool[Array, "4 6"]]:
    """How many points of the target are seen, and the regions in which it has been seen."""
    points = detect_in(photograph, target, camera=camera, pose="", search_width_px=_SEARCH_PX)
    if points is None:
        return 0, before
    width, height = photograph.size_wh
    rows, columns = REGIONS
    row = np.clip(points.uv[:, 1] * rows / height, 0, rows - 1).astype(int)
    column = np.clip(points.uv[:, 0] * columns / width, 0, columns - 1).astype(int)
    now = before.copy()
    now[row, column] = True
    return len(points.ids), now
