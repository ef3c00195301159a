"""GenICam cameras of any maker, through Aravis.

Needs the extra ``genicam``, or Debian's ``gir1.2-aravis-0.8`` and ``python3-gi``.

``ids`` are those that ``arv-tool-0.8`` lists: identifiers or IP addresses. The option ``line`` is the input for the
trigger pulse (``Line1``). ``ptp = true`` synchronises the cameras' clocks.
"""

import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from mammometry.base.photograph import Photograph
from mammometry.capture.camera import BACKENDS, CameraSettings, Devices, Frame, Health, failed, library, missing
from mammometry.io.photographs.images import demosaiced

_DEBIAN = Path("/usr/lib/python3/dist-packages")  # python3-gi; not on a virtual environment's path
_BUFFERS = 4  # number of pictures in the queue
_LIVE_US = 1_000_000  # time limit for a live picture, µs; slower pictures are of no use for aiming
_MONO8, _RGB8 = 0x01080001, 0x02180014  # pixel formats, GigE Vision 2.0 appendix; GenICam PFNC 2.4
_BAYER8 = {0x01080008: "GR", 0x01080009: "RG", 0x0108000A: "GB", 0x0108000B: "BG"}


def _library() -> Any:
    """The Aravis library, through GObject introspection."""
    try:
        import gi
    except ImportError:
        if _DEBIAN.is_dir() and str(_DEBIAN) not in sys.path:
            sys.path.append(str(_DEBIAN))
    try:
        import gi

        gi.require_version("Aravis", "0.8")
        aravis = library("gi.repository.Aravis")
    except (ImportError, ValueError):
        raise missing(
            "aravis", "Aravis", "apt-get install gir1.2-aravis-0.8 python3-gi, with the system's own Python version"
        ) from None
    return aravis


def attached() -> list[str]:
    """Identifiers of the cameras that are connected.

    Raises:
        SettingsError: Aravis is not installed.
    """
    aravis = _library()
    aravis.update_device_list()
    return [aravis.get_device_id(number) for number in range(aravis.get_n_devices())]


@BACKENDS.add("aravis")
class AravisRig:
    """GigE Vision and USB3 Vision cameras."""

    def __init__(self, devices: Devices) -> None:
        self._aravis = _library()
        from gi.repository import GLib

        self._error: type[Exception] = GLib.Error
        self._devices = devices
        self._line = str(devices.options.get("line", "Line1"))
        self._ptp = bool(devices.options.get("ptp", False))
        self._cameras: dict[str, Any] = {}
        self._streams: dict[str, Any] = {}
        self._absent: dict[str, str] = {}
        self._settings = CameraSettings()
        for interface in devices.options.get("interfaces", ()):  # for example Fake, which is off by default
            self._aravis.enable_interface(str(interface))
        self._aravis.update_device_list()
        for name in devices.cameras:
            self._open(name, devices.ids.get(name, ""))

    def settings(self, wanted: CameraSettings) -> None:
        """Set exposure, gain and trigger of all cameras."""
        self._settings = wanted
        for name, camera in self._cameras.items():
            try:
                self._stop(name)
                if wanted.exposure_ms is not None:
                    camera.set_exposure_time(1e3 * wanted.exposure_ms)
                if wanted.gain_db is not None:
                    camera.set_gain(wanted.gain_db)
                camera.set_trigger("Software" if wanted.trigger == "software" else self._line)
            except self._error as error:
                raise failed(name, f"a setting refused ({_words(error)})", "Correct the rig's file") from None

    def arm(self) -> None:
        """Drop pictures from earlier pulses."""
        for name, camera in self._cameras.items():
            self._stop(name)
            camera.set_trigger("Software" if self._settings.trigger == "software" else self._line)
            self._start(name)

    def fire(self) -> float:
        """Send the trigger command, unless the cameras are triggered by wire."""
        fired_s = time.time()
        if self._settings.trigger == "software":
            for camera in self._cameras.values():
                camera.software_trigger()
        return fired_s

    def fetch(self, camera: str, timeout_s: float) -> Frame:
        """Return the picture triggered by the last pulse."""
        self._require(camera)
        buffer = self._streams[camera].timeout_pop_buffer(round(1e6 * timeout_s))
        if buffer is None:
            raise failed(camera, f"nothing within {timeout_s:g} s", "Check its trigger wire, and fire again")
        try:
            photograph = self._photograph(camera, buffer)
            return Frame(
                camera=camera,
                content=photograph,
                taken_s=1e-9 * buffer.get_timestamp() if self._ptp else None,
                clock="ptp" if self._ptp else "none",
                serial=self._cameras[camera].get_device_serial_number(),
            )
        finally:
            self._streams[camera].push_buffer(buffer)

    def live(self, camera: str) -> Photograph:
        """Take one picture without a pulse."""
        self._require(camera)
        self._stop(camera)
        self._cameras[camera].clear_triggers()
        self._start(camera)
        buffer = self._streams[camera].timeout_pop_buffer(_LIVE_US)
        if buffer is None:
            raise failed(camera, "no live picture within 1 s", "Check its cable")
        try:
            return self._photograph(camera, buffer)
        finally:
            self._streams[camera].push_buffer(buffer)

    def health(self, camera: str) -> Health:
        """Report model, serial number and picture size."""
        if camera in self._absent:
            return Health(fault=f"{self._absent[camera][:1].upper()}{self._absent[camera][1:]}.")
        device = self._cameras[camera]
        try:
            *_, width, height = device.get_region()
            return Health(
                model=device.get_model_name(), serial=device.get_device_serial_number(), size_wh=(width, height)
            )  # fmt: skip
        except self._error as error:
            return Health(fault=f"It does not answer ({_words(error)}).")

    def close(self) -> None:
        """Release the cameras."""
        for name in list(self._cameras):
            self._stop(name)
        self._streams.clear()
        self._cameras.clear()

    def _open(self, name: str, identifier: str) -> None:
        if not identifier:
            self._absent[name] = "no identifier in the rig's file"
            return
        try:
            camera = self._aravis.Camera.new(identifier)
            if self._ptp and camera.is_feature_available("PtpEnable"):
                camera.set_boolean("PtpEnable", True)
        except self._error as error:
            self._absent[name] = f"no camera that answers as {identifier} ({_words(error)})"
            return
        self._cameras[name] = camera

    def _start(self, name: str) -> None:
        """Start waiting for pictures with a new stream, which contains no old ones."""
        camera = self._cameras[name]
        stream = camera.create_stream(None, None)
        for _ in range(_BUFFERS):
            stream.push_buffer(self._aravis.Buffer.new_allocate(camera.get_payload()))
        self._streams[name] = stream
        camera.start_acquisition()

    def _stop(self, name: str) -> None:
        if self._streams.pop(name, None) is not None:
            try:
                self._cameras[name].stop_acquisition()
            except self._error:
                return  # it was unplugged, which `fetch` and `health` report

    def _require(self, camera: str) -> None:
        if camera not in self._cameras:
            raise failed(camera, self._absent.get(camera, "no such camera"), "Plug it in, or correct the rig's file")

    def _photograph(self, camera: str, buffer: Any) -> Photograph:
        status = buffer.get_status()
        if status != self._aravis.BufferStatus.SUCCESS:
            word = str(getattr(status, "value_nick", status))
            raise failed(camera, f"a damaged picture ({word})", "Fire again; if it stays, change the network cable")
        width, height, form = buffer.get_image_width(), buffer.get_image_height(), buffer.get_image_pixel_format()
        data = np.frombuffer(buffer.get_data(), dtype=np.uint8)
        if form == _RGB8:
            return Photograph(name=camera, pixels=data[: 3 * width * height].reshape(height, width, 3).copy())
        pixels = data[: width * height].reshape(height, width)
        if form in _BAYER8:
            return Photograph(name=camera, pixels=demosaiced(pixels, _BAYER8[form]))
        if form != _MONO8:
            raise failed(camera, f"pixels of format {form:#010x}", "Set its PixelFormat to Mono8, BayerRG8 or RGB8")
        return Photograph(name=camera, pixels=pixels.copy())


def _words(error: Exception) -> str:
    return str(getattr(error, "message", error)).rstrip(".")
