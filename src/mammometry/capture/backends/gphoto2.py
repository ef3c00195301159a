"""Tethered cameras through gphoto2 (extra ``tethered``), set by USB and triggered by wire.

``ids`` are ports listed by ``gphoto2 --auto-detect`` (``usb:001,004``). Each camera has its own process, because the
library blocks during transfers, and a camera that hangs must not stop the others.
"""

import io
import multiprocessing
import time
from multiprocessing.connection import Connection
from typing import Any

import numpy as np
from PIL import Image

from mammometry.base.errors import CaptureError
from mammometry.base.photograph import Photograph
from mammometry.capture.camera import BACKENDS, CameraSettings, Devices, Frame, Health, failed, library, missing
from mammometry.io.photographs.images import FORMATS

_OPEN_S = 20.0  # a sleeping camera takes some seconds to answer
_ANSWER_S = 5.0  # time for settings and health
_GRACE_S = 2.0  # additional time after the camera's own limit before its process counts as hung
_POLL_MS = 100  # duration of the library's wait for an event
_EXPOSURES = ("shutterspeed", "shutterspeed2")  # names in different makers' cameras
_SPOOL = "capturetarget"  # where pictures are stored: in the camera's memory, so that a full card does not matter


def _library() -> Any:
    try:
        return library("gphoto2")
    except ImportError:
        raise missing("gphoto2", "python package gphoto2", "python -m pip install 'mammometry[tethered]'") from None


def attached() -> list[str]:
    """Ports of the cameras that are connected.

    Raises:
        SettingsError: gphoto2 is not installed.
    """
    return [port for _, port in _library().Camera.autodetect()]


@BACKENDS.add("gphoto2")
class TetheredRig:
    """Reflex cameras connected by USB."""

    def __init__(self, devices: Devices) -> None:
        _library()
        self._workers = {name: _Worker(name, devices.ids.get(name, "")) for name in devices.cameras}
        for worker in self._workers.values():
            worker.wait_open()
        self._software = False

    def settings(self, wanted: CameraSettings) -> None:
        """Set shutter time and storage. The gain is not changed: ISO steps differ between cameras."""
        self._software = wanted.trigger == "software"
        for worker in self._workers.values():
            if not worker.fault:
                worker.ask("settings", wanted.exposure_ms, within_s=_ANSWER_S)

    def arm(self) -> None:
        """Drop pictures from earlier exposures."""
        for worker in self._workers.values():
            if not worker.fault:
                worker.ask("arm", within_s=_ANSWER_S)

    def fire(self) -> float:
        """Send the trigger command, unless a wire triggers. By USB it takes 0.3 to 8 s: for tests only."""
        fired_s = time.time()
        if self._software:
            for worker in self._workers.values():
                if not worker.fault:
                    worker.send("fire")
        return fired_s

    def fetch(self, camera: str, timeout_s: float) -> Frame:
        """Return the camera's file."""
        worker = self._workers[camera]
        if self._software:
            worker.receive(timeout_s + _GRACE_S)
        content, number = worker.ask("fetch", timeout_s, within_s=timeout_s + _GRACE_S)
        return Frame(camera=camera, content=content, number=number, serial=worker.serial)

    def live(self, camera: str) -> Photograph:
        """Return the camera's own live picture, a small JPEG."""
        content = self._workers[camera].ask("live", within_s=_ANSWER_S)
        try:
            with Image.open(io.BytesIO(content), formats=FORMATS) as image:
                return Photograph(name=camera, pixels=np.array(image.convert("RGB")))
        except OSError:
            raise failed(camera, "a damaged live picture", "Switch live view on in the camera's menu") from None

    def health(self, camera: str) -> Health:
        """Report model, serial number and free space on the card."""
        worker = self._workers[camera]
        if worker.fault:
            return Health(fault=f"{worker.fault[:1].upper()}{worker.fault[1:]}.")
        try:
            model, serial, free_kb = worker.ask("health", within_s=_ANSWER_S)
        except CaptureError as error:
            return Health(fault=f"{error.found[:1].upper()}{error.found[1:]}.")
        return Health(fault="The memory card is full." if free_kb == 0 else "", model=model, serial=serial)

    def close(self) -> None:
        """End the cameras' processes."""
        for worker in self._workers.values():
            worker.close()


class _Worker:
    """Connection to a camera's process."""

    def __init__(self, camera: str, port: str) -> None:
        self.camera, self.serial = camera, ""
        self.fault = "" if port else "no port in the rig's file"
        self._closed = not port
        if port:
            context = multiprocessing.get_context("spawn")
            self._ours, theirs = context.Pipe()
            self._process = context.Process(target=_serve, args=(theirs, port), daemon=True)
            self._process.start()
            theirs.close()

    def wait_open(self) -> None:
        """Wait until the camera has answered or reported a fault."""
        if self.fault:
            return
        try:
            self.serial = str(self.receive(_OPEN_S))
        except CaptureError as error:
            self.fault = error.found

    def ask(self, what: str, *arguments: Any, within_s: float) -> Any:
        """Send a request to the camera's process, and return its answer.

        Raises:
            CaptureError: it failed, hung or ended.
        """
        self.send(what, *arguments)
        return self.receive(within_s)

    def send(self, what: str, *arguments: Any) -> None:
        """Send a request to the camera's process without waiting for the answer."""
        self._require_well()
        try:
            self._ours.send((what, *arguments))
        except OSError:
            raise self._gone() from None

    def receive(self, within_s: float) -> Any:
        """Receive the next answer from the camera's process."""
        self._require_well()
        try:
            if not self._ours.poll(within_s):
                self.fault = f"a camera that does not answer within {within_s:g} s"
                raise failed(self.camera, self.fault, "Switch it off and on, then open the rig again")
            kind, value = self._ours.recv()
        except (OSError, EOFError):
            raise self._gone() from None
        if kind == "failed":
            raise failed(self.camera, str(value), "Check camera and cable, and fire again")
        return value

    def close(self) -> None:
        """End the process, by force if needed."""
        if self._closed:
            return
        self._closed = True
        self._ours.close()
        self._process.join(_GRACE_S)
        if self._process.is_alive():
            self._process.kill()
            self._process.join(_GRACE_S)

    def _require_well(self) -> None:
        if self.fault:
            raise failed(self.camera, self.fault, "Plug it in and switch it on, then open the rig again")

    def _gone(self) -> CaptureError:
        self.fault = "a camera whose program ended"
        return failed(self.camera, self.fault, "Open the rig again")


def _serve(pipe: Connection, port: str) -> None:
    """Main loop of a camera's process: answer requests until the pipe is closed."""
    gphoto2: Any = library("gphoto2")
    camera: Any = None
    try:
        camera = _opened(gphoto2, port)
        serial = _value(gphoto2, camera, "serialnumber")
        pipe.send(("done", serial or ""))
        number = 0
        while True:
            what, *arguments = pipe.recv()
            value: Any = None
            try:
                if what == "settings":
                    _set(gphoto2, camera, *arguments)
                elif what == "arm":
                    _drain(gphoto2, camera)
                elif what == "fire":
                    camera.trigger_capture()
                elif what == "fetch":
                    number += 1
                    value = (_fetched(gphoto2, camera, *arguments), number)
                elif what == "live":
                    value = bytes(memoryview(camera.capture_preview().get_data_and_size()))
                else:
                    value = (camera.get_abilities().model, serial or "", _free_kb(gphoto2, camera))
                pipe.send(("done", value))
            except (gphoto2.GPhoto2Error, TimeoutError) as error:
                pipe.send(("failed", getattr(error, "string", str(error)).lower()))
    except gphoto2.GPhoto2Error as error:
        pipe.send(("failed", f"no camera at {port} ({error.string})"))
    except (EOFError, OSError, KeyboardInterrupt):
        pass  # the rig was closed
    finally:
        if camera is not None:
            camera.exit()


def _opened(gphoto2: Any, port: str) -> Any:
    ports = gphoto2.PortInfoList()
    ports.load()
    camera = gphoto2.Camera()
    camera.set_port_info(ports[ports.lookup_path(port)])
    camera.init()
    return camera


def _set(gphoto2: Any, camera: Any, exposure_ms: float | None) -> None:
    """Set the nearest available shutter time, and store pictures in the camera's memory."""
    for name in _EXPOSURES if exposure_ms is not None else ():
        try:
            widget = camera.get_single_config(name)
            known = {_seconds(choice): choice for choice in widget.get_choices()}
        except gphoto2.GPhoto2Error:
            continue
        known.pop(None, None)
        if known:
            assert exposure_ms is not None
            nearest = min(
                (seconds for seconds in known if seconds), key=lambda seconds: abs(seconds - 1e-3 * exposure_ms)
            )
            widget.set_value(known[nearest])
            camera.set_single_config(name, widget)
            break
    try:
        widget = camera.get_single_config(_SPOOL)
        memory = [choice for choice in widget.get_choices() if "ram" in choice.lower()]
        if memory:
            widget.set_value(memory[0])
            camera.set_single_config(_SPOOL, widget)
    except gphoto2.GPhoto2Error:
        return  # the camera stores pictures only on its card


def _seconds(choice: str) -> float | None:
    """Convert ``1/250``, ``0.0100s`` or ``2`` to seconds. None for words."""
    text = choice.strip().removesuffix("s")
    try:
        above, _, below = text.partition("/")
        return float(above) / float(below or 1)
    except (ValueError, ZeroDivisionError):
        return None


def _drain(gphoto2: Any, camera: Any) -> None:
    for _ in range(100):  # events in the queue; limited, because some cameras never stop reporting
        kind, _data = camera.wait_for_event(1)
        if kind == gphoto2.GP_EVENT_TIMEOUT:
            return


def _fetched(gphoto2: Any, camera: Any, timeout_s: float) -> bytes:
    end = time.monotonic() + timeout_s
    while time.monotonic() < end:
        kind, data = camera.wait_for_event(_POLL_MS)
        if kind == gphoto2.GP_EVENT_FILE_ADDED:
            file = camera.file_get(data.folder, data.name, gphoto2.GP_FILE_TYPE_NORMAL)
            return bytes(memoryview(file.get_data_and_size()))
    raise TimeoutError(f"nothing within {timeout_s:g} s")


def _value(gphoto2: Any, camera: Any, name: str) -> str | None:
    try:
        return str(camera.get_single_config(name).get_value())
    except gphoto2.GPhoto2Error:
        return None


def _free_kb(gphoto2: Any, camera: Any) -> int | None:
    try:
        stores = camera.get_storageinfo()
        return int(stores[0].freekbytes) if stores else None
    except gphoto2.GPhoto2Error:
        return None
