"""The simulator in place of cameras.

A virtual rig is rendered once, when it is opened. Its pictures are then delivered in the same way as a real rig's, with
times, and with faults that a test or demonstration needs.
"""

from __future__ import annotations

import secrets
import shutil
import tempfile
import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from mammometry.api.job import open_session
from mammometry.base.errors import SettingsError
from mammometry.base.listing import visible
from mammometry.base.photograph import Photograph
from mammometry.calibration.judge.expected_error import middle_world
from mammometry.calibration.targets.lamps import LAMPS
from mammometry.capture.camera import BACKENDS, CameraSettings, Devices, Frame, Health, failed
from mammometry.geometry import Rig, Transform
from mammometry.io.photographs.images import EXTENSIONS, read_photograph
from mammometry.simulate.recipe import SessionRecipe
from mammometry.simulate.rendering.lamps import LampScene, hold_lamps, render_lamps
from mammometry.simulate.rigs.build import flashes
from mammometry.simulate.rigs.targets import BOARD
from mammometry.simulate.session import write_session
from mammometry.simulate.studio import Studio

FAULTS = ("unplugged", "slow", "wrong-size", "card-full", "lost", "late", "old", "swapped", "moved", "blurred")
"""Possible faults of a camera. ``swapped=OTHER`` swaps two cables, and ``late=0.003`` is 3 ms."""
_RECIPE = ("rig", "subject", "scale", "seed", "poses")
_SLOW_S = 1e6  # duration of a transfer that never ends: longer than any time limit
_LATE_MS = 8.0  # default delay of a late camera
_BLUR_PX = 4  # half the width of the box that blurs
_DIM = 0.4  # brightness of white paper while the lamps are photographed, as a share of full scale
_NOISY_ROWS = 64  # number of rows with new noise
_MOVED_PX = 12  # rows by which a moved patient is displaced


@dataclass(frozen=True, slots=True, kw_only=True)
class _Fault:
    kind: str
    size: str = ""

    @classmethod
    def of(cls, camera: str, text: str) -> _Fault:
        kind, _, size = text.partition("=")
        if kind not in FAULTS:
            remedy = "Name a fault, or remove the line"
            expected = f"one of {', '.join(FAULTS)}"
            raise SettingsError(
                f"[capture.options.faults] {camera}", found=repr(text), expected=expected, remedy=remedy
            )
        return cls(kind=kind, size=size)


@BACKENDS.add("virtual")
class VirtualRig:
    """Cameras of a rendered session.

    Options:
        session: a folder with photographs to deliver. Without it, a session is rendered from ``rig``, ``subject``,
            ``scale``, ``seed`` and ``poses``.
        scene: ``capture`` (the subject), a pose of the target, or ``lamps`` (the board with the counting lamps).
        faults: camera → fault.
        skew_ms: camera → delay of its exposure.
    """

    def __init__(self, devices: Devices) -> None:
        options = dict(devices.options)
        self._cameras = devices.cameras
        self._ids = devices.ids
        self._faults = {name: _Fault.of(name, str(text)) for name, text in dict(options.get("faults", {})).items()}
        self._skew_ms: Mapping[str, float] = dict(options.get("skew_ms", {}))
        self._made: Path | None = None
        folder = Path(options["session"]) if "session" in options else self._rendered(options)
        scene = str(options.get("scene", "capture"))
        self._folder = folder
        self._scene, self._files = scene, self._of_scene(scene)
        self._lamps: Rig | None = None
        self._pictures: dict[str, Photograph] = {}
        self._lock = threading.Lock()
        self._settings = CameraSettings()
        self._armed = False
        self._fired_s: float | None = None
        self._number = 0
        self._noise = secrets.randbits(32)

    def settings(self, wanted: CameraSettings) -> None:
        """Store the settings without effect: a rendered picture has its own exposure."""
        self._settings = wanted

    def show(self, scene: str) -> None:
        """Choose the scene that the cameras see.

        ``capture``, a pose of the target, or ``lamps``.

        Raises:
            SettingsError: the session has no such pictures.
        """
        self._scene, self._files = scene, self._of_scene(scene)
        with self._lock:
            self._pictures.clear()

    @property
    def poses(self) -> tuple[str, ...]:
        """Poses of the target that were rendered."""
        folder = self._folder / "calibration"
        return tuple(path.name for path in visible(folder) if path.is_dir())

    def arm(self) -> None:
        """Make the cameras wait for `fire`."""
        self._armed, self._fired_s = True, None

    def fire(self) -> float:
        """Expose all cameras."""
        if not self._armed:
            raise failed("the rig", "a pulse before the cameras were ready", "Arm the cameras, then fire")
        self._fired_s = time.time()
        self._number += 1
        self._armed = False
        return self._fired_s

    def fetch(self, camera: str, timeout_s: float) -> Frame:
        """Return the rendered picture, modified by the camera's fault."""
        fault = self._faults.get(camera, _Fault(kind=""))
        if fault.kind == "unplugged":
            raise failed(camera, "no camera at the end of the cable", "Plug it in and switch it on")
        if fault.kind == "card-full":
            raise failed(camera, "a full memory card", "Empty the card, or put in another")
        if fault.kind in ("slow", "lost") or self._fired_s is None:
            time.sleep(min(timeout_s, _SLOW_S))
            what = "nothing" if fault.kind == "lost" else "a transfer that does not end"
            raise failed(camera, f"{what} within {timeout_s:g} s", "Fire again; if it stays, change the cable")
        source = next((name for name, other in self._swaps() if other == camera), camera)
        number, taken_s = self._number, self._fired_s + 1e-3 * self._skew_ms.get(camera, 0.0)
        if fault.kind == "old":
            number, taken_s = number - 1, taken_s - 60.0
        if self._scene == "lamps":
            photograph = self._of_lamps(source, 1e3 * taken_s)
        else:
            photograph = _noisy(self._picture(source), (self._noise, number + 1))
        if fault.kind == "wrong-size":
            photograph = replace(photograph, pixels=np.ascontiguousarray(photograph.pixels[::2, ::2]))
        elif fault.kind == "late":
            taken_s += float(fault.size or 1e-3 * _LATE_MS)
        elif fault.kind == "moved":
            photograph = replace(photograph, pixels=np.roll(photograph.pixels, _moved_px(photograph), axis=0))
        elif fault.kind == "blurred":
            photograph = replace(photograph, pixels=_blurred(photograph.pixels))
        serial = self._ids.get(camera, "")
        return Frame(camera=camera, content=photograph, taken_s=taken_s, clock="ptp", number=number, serial=serial)

    def live(self, camera: str) -> Photograph:
        """Return the rendered picture at full size, as a fast camera would."""
        if self._faults.get(camera, _Fault(kind="")).kind == "unplugged":
            raise failed(camera, "no camera at the end of the cable", "Plug it in and switch it on")
        return self._picture(camera)

    def health(self, camera: str) -> Health:
        """Report a camera's fault as text."""
        words = {"unplugged": "No camera answers at this cable.", "card-full": "The memory card is full."}
        fault = words.get(self._faults.get(camera, _Fault(kind="")).kind, "")
        size_wh = None if fault else self._picture(camera).size_wh
        return Health(fault=fault, model="virtual camera", serial=self._ids.get(camera, ""), size_wh=size_wh)

    def close(self) -> None:
        """Delete the pictures rendered for this rig."""
        if self._made is not None:
            shutil.rmtree(self._made, ignore_errors=True)

    def _swaps(self) -> list[tuple[str, str]]:
        pairs = [(name, fault.size) for name, fault in self._faults.items() if fault.kind == "swapped"]
        return [*pairs, *((other, name) for name, other in pairs)]

    def _picture(self, camera: str) -> Photograph:
        with self._lock:
            if camera not in self._pictures:
                path = self._files.get(camera)
                if path is None:
                    raise failed(camera, "a camera that does not see the target", "Show it something it can see")
                self._pictures[camera] = read_photograph(path, camera)
            return self._pictures[camera]

    def _of_lamps(self, camera: str, taken_ms: float) -> Photograph:
        """Picture of the board at the centre of the rig, with the lamps as they are at a time of their count."""
        with self._lock:
            if self._lamps is None:
                rig = open_session(self._folder).calibrate().rig
                shift = Transform(rotation=np.eye(3), translation_mm=middle_world(rig))
                moved = {
                    name: replace(camera, camera_from_world=camera.camera_from_world @ shift)
                    for name, camera in rig.cameras.items()
                }
                self._lamps = replace(rig, cameras=moved)
                self._lamps_pose = hold_lamps(self._lamps, BOARD)
        exposure_ms = self._settings.exposure_ms or 1.0
        scene = LampScene(board=BOARD, lights=flashes(_DIM))
        return render_lamps(
            self._lamps.cameras[camera], self._lamps_pose, scene, taken_ms % LAMPS.period_ms, exposure_ms
        )  # fmt: skip

    def _of_scene(self, scene: str) -> dict[str, Path]:
        if scene == "lamps":
            return {}
        folder = self._folder / ("capture" if scene == "capture" else f"calibration/{scene}")
        files = {path.stem: path for path in visible(folder) if path.suffix in EXTENSIONS}
        if scene == "capture" and (missing := [name for name in self._cameras if name not in files]):
            raise SettingsError(
                str(folder), found="no photograph by " + ", ".join(missing), expected="one of every camera of the rig",
                remedy="Name a session of this rig in [capture.options] session, or its own rig",
            )  # fmt: skip
        return {name: files[name] for name in self._cameras if name in files}

    def _rendered(self, options: Mapping[str, Any]) -> Path:
        recipe = SessionRecipe(**{name: options[name] for name in _RECIPE if name in options})
        self._made = Path(tempfile.mkdtemp(prefix="mammometry-virtual-"))
        return write_session(self._made / "session", recipe, Studio(), truth=False).folder


def _moved_px(photograph: Photograph) -> int:
    return max(1, round(_MOVED_PX * photograph.size_wh[0] / 1126))


def _noisy(photograph: Photograph, seed: tuple[int, int]) -> Photograph:
    """Another exposure of the same scene, with new noise in some rows only, which is fast."""
    pixels = photograph.pixels.copy()
    rows = pixels[::_NOISY_ROWS]
    rows ^= np.random.default_rng(seed).integers(0, 2, rows.shape, dtype=pixels.dtype)  # only the lowest bit changes
    return replace(photograph, pixels=pixels)


def _blurred(pixels: np.ndarray) -> np.ndarray:
    from scipy.ndimage import uniform_filter

    size = (2 * _BLUR_PX + 1, 2 * _BLUR_PX + 1, *([1] * (pixels.ndim - 2)))
    return np.asarray(uniform_filter(pixels, size))
