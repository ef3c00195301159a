"""The page for aiming and focusing cameras and for capturing, used by the local server and the clinic."""

from __future__ import annotations

import base64
import io
import json
import threading
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from mammometry.base.errors import MammometryError, SessionError
from mammometry.base.photograph import LUMA, Photograph
from mammometry.base.shell import command_line
from mammometry.calibration.detection.detect import detect_in
from mammometry.calibration.targets.table import target_from_table
from mammometry.calibration.targets.target import Target
from mammometry.capture.camera import Backend
from mammometry.capture.checks import Finding, Seen, judge
from mammometry.capture.loop import CaptureResult, OpenRig, PoseResult
from mammometry.geometry.arrays import Array, Bool, Float32, Float64, Int64, UInt8
from mammometry.matching.foreground.block_segmentation import segment
from mammometry.web.local import OneTimeLogin, Page, html_page, listen, local_app, resource
from mammometry.web.replies import Application

WIDTH_PX = 480
"""Approximate width of a live picture on the page, px."""
REGIONS = (4, 6)
"""Rows and columns of the regions in which sharpness and coverage are evaluated."""
_BINS = 32  # bins of the histogram
_FULL = 250  # grey level above which a pixel counts as saturated; not 255, because white balance and encoding round
_UNIT_PX = 676.0  # diagonal for the pixel sizes of `segment`, as in `checks.pixels`
_COARSER = 3  # pixels of the small picture per pixel of the one for finding the subject
_CALM = 30.0  # squared grey levels: above the noise of a uniform region, about 4
_SEARCH_PX = 480  # width at which a target is searched, for which low accuracy is enough


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Aids:
    """Figures of one live picture that help to aim and focus."""

    camera: str
    jpeg: bytes
    """A small picture for the page."""
    sharpness: Float64[Array, "4 6"]
    """By region, 0 to 1: share of the contrast in details of two pixels. Compare only within one camera: turn the focus
    until it is largest.
    """
    histogram: Int64[Array, " bins"]
    """Pixels by brightness, dark to bright, of the small picture."""
    saturated: float
    """Share of overexposed pixels."""
    whole: str
    """Whether the subject is completely in the picture, in one sentence."""
    is_whole: bool
    """The same as a flag. False while the target is searched."""
    target: int | None
    """Number of visible target points. None if it was not searched."""
    covered: Bool[Array, "4 6"]
    """Regions in which the target has been seen, now or before."""

    def as_table(self) -> dict[str, Any]:
        """These figures as JSON, without the picture."""
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
    """Live pictures of a rig's cameras with their figures.

    Records where each camera has seen the target, and so where it has yet to be seen.
    """

    def __init__(
        self, backend: Backend, cameras: tuple[str, ...], subject_kind: str, target: Target | None = None
    ) -> None:
        self._backend, self._cameras = backend, cameras
        self._kind, self._target = subject_kind, target
        self._covered: dict[str, Array] = {name: np.zeros(REGIONS, dtype=bool) for name in cameras}
        self._pool = ThreadPoolExecutor(max(1, len(cameras)))

    def look(self, *, calibrating: bool = False, subject_kind: str | None = None) -> dict[str, Aids | str]:
        """One live picture of every camera, or a sentence if a camera delivers none.

        Args:
            calibrating: whether to search for the target instead of the subject.
            subject_kind: kind of subject. None: the rig's usual one.
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
        """Camera → number of regions in which it has not seen the target yet."""
        return {name: int((~covered).sum()) for name, covered in self._covered.items()}

    def close(self) -> None:
        """Stop the threads of the live view."""
        self._pool.shutdown()


def aids(
    photograph: Photograph,
    camera: str,
    subject_kind: str,
    *,
    target: Target | None = None,
    covered: Bool[Array, "4 6"] | None = None,
) -> Aids:
    """Reduce a live picture and analyse it.

    Args:
        photograph: of any size. Of a large one, only evenly spaced pixels are used, which preserves noise and details.
        camera: name of the camera.
        subject_kind: ``torso``, ``model`` or ``surface``.
        target: target to search for; None: the subject.
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
    """Energy of differences between neighbours, relative to pixels four apart, by region, on some rows."""
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
    """Result of `checks.pixels` for a picture that is already small."""
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
    """Number of visible target points, and the regions in which the target has been seen."""
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


class CameraService:
    """Open cameras for a page, with one request at a time.

    A capture waits for a live picture to finish, and vice versa.
    """

    def __init__(self, rigged: OpenRig) -> None:
        self.rigged = rigged
        table = rigged.file.target
        self._target = None if table is None else target_from_table(table)
        self._live = LiveView(rigged.backend, rigged.cameras, rigged.file.subject.kind, self._target)
        self._one = threading.Lock()

    def state(self, title: str, session: Path, *, posing: bool = False) -> dict[str, Any]:
        """State of the rig before the first capture.

        Args:
            title: title of the page.
            session: session for captures.
            posing: whether the calibration board is photographed, one pose per capture.
        """
        with self._one:
            faults = self.rigged.faults()
            guidance = _guidance(self.rigged.guidance(session)) if posing else {}
        return {
            "title": title,
            "cameras": list(self.rigged.cameras),
            "faults": faults,
            "calibrated": self.rigged.rig is not None,
            "board": self._target is not None,
            "posing": posing,
            **guidance,
        }

    def look(self, body: bytes, *, subject_kind: str | None = None) -> dict[str, Any]:
        """A live picture of every camera, with its aids.

        Raises:
            SessionError: the request is not ``{"calibrating": true or false}``.
        """
        with self._one:
            seen = self._live.look(calibrating=_asked(body, "calibrating"), subject_kind=subject_kind)
        return {"cameras": {name: _shown(aids) for name, aids in seen.items()}, "wanted": dict(self._live.wanted())}

    def fire(self, session: Path, *, subject_id: str | None = None) -> CaptureResult:
        """Make one capture, written and checked (`OpenRig.fire_into`)."""
        with self._one:
            return self.rigged.fire_into(session, subject_id=subject_id)

    def pose(self, session: Path) -> dict[str, Any]:
        """Photograph one pose of the calibration board, for the page."""
        with self._one:
            posed = self.rigged.fire_pose(session)
        lines = [f"Pose {posed.pose} is stored, {posed.count} in all."]
        lines.append(f"Not calibrated yet: {posed.why}" if posed.progress is None else posed.progress.sentence)
        good = posed.progress is not None and posed.progress.good_enough
        return {"accepted": True, "said": lines, "good_enough": good, **_guidance(posed)}

    def close(self) -> None:
        """Stop the live pictures, and release the cameras."""
        self._live.close()
        self.rigged.close()


def firing_table(fired: CaptureResult, then: str) -> dict[str, Any]:
    """Result of a capture as JSON for the page.

    Args:
        fired: the result.
        then: the next step if the pictures may be measured.
    """
    return {
        "accepted": fired.accepted,
        "shot": fired.shot.name,
        "said": list(fired.verdict.sentences),
        "next": then if fired.accepted else "",
        **fired.verdict.as_table(),
    }


def _guidance(posed: PoseResult) -> dict[str, Any]:
    suggestion = posed.suggestion
    outlines = (
        {} if suggestion is None else {name: outline.round(4).tolist() for name, outline in suggestion.outlines.items()}
    )
    return {"next": posed.sentence, "outlines": outlines}


def _asked(body: bytes, name: str) -> bool:
    try:
        value = json.loads(body)[name]
    except (ValueError, KeyError, TypeError, RecursionError):
        value = None
    if not isinstance(value, bool):
        raise SessionError("the request", found="something else", expected=f"{name}: true or false", remedy="Reload")
    return value


def _shown(aids: Aids | str) -> dict[str, Any]:
    if isinstance(aids, str):
        return {"fault": aids}
    return {**aids.as_table(), "picture": base64.b64encode(aids.jpeg).decode("ascii")}


@dataclass(frozen=True, slots=True, kw_only=True)
class Goal:
    """Session into which the page captures."""

    session: Path
    """Created if it does not exist."""
    subject_id: str | None = None
    """Pseudonym of the patient."""
    posing: bool = False
    """Whether each capture is a pose of the calibration board."""


def capture_app(service: CameraService, goal: Goal, login: OneTimeLogin) -> Application:
    """Create the page's server."""
    title = f"{'Calibrate' if goal.posing else 'Capture'} {goal.session.name} with rig {service.rigged.file.rig.name}"

    def document(body: bytes) -> str:
        page, style = (resource("mammometry.capture", f"capture.{kind}") for kind in ("html", "css"))
        return html_page(page, title, style=style, script=resource("mammometry.report", "capture.js"))

    def fire(body: bytes) -> dict[str, Any]:
        if goal.posing:
            return service.pose(goal.session)
        fired = service.fire(goal.session, subject_id=goal.subject_id)
        return firing_table(fired, command_line("mammometry", "run", goal.session))

    pages: Mapping[str, Page] = {
        "GET /": document,
        "GET /state": lambda body: service.state(title, goal.session, posing=goal.posing),
        "POST /look": service.look,
        "POST /fire": fire,
    }
    return local_app(pages, login)


def serve(rigged: OpenRig, goal: Goal, *, ready: Callable[[str, str], None]) -> None:
    """Serve the page until interrupted.

    Args:
        rigged: open cameras, which are released at the end.
        goal: session for captures.
        ready: see `listen`.
    """
    login, service = OneTimeLogin("capture --page"), CameraService(rigged)
    try:
        listen(capture_app(service, goal, login), login, ready=ready)
    finally:
        service.close()
