"""Basler cameras through pypylon (extra ``basler``).

``ids`` are serial numbers. The option ``line`` is the input for the trigger pulse (``Line1``). Cameras synchronised by
PTP add a common time to their pictures.
"""

import time
from typing import Any

import numpy as np

from mammometry.base.errors import SettingsError
from mammometry.base.photograph import Photograph
from mammometry.capture.camera import BACKENDS, CameraSettings, Devices, Frame, Health, failed, library, missing

_READY_MS = 1000  # time limit until a camera waits for its pulse, which takes some ms
_LIVE_MS = 1000  # time limit for a live picture; slower pictures are of no use for aiming
_QUEUE = 4  # number of pictures in the queue; one is needed, `arm` drops others
_INSTALL = "python -m pip install 'mammometry[basler]'"


def _library() -> Any:
    try:
        return library("pypylon.pylon")
    except ImportError:
        raise missing("pylon", "pypylon", _INSTALL) from None


def attached() -> list[str]:
    """Serial numbers of the cameras that are connected.

    Raises:
        SettingsError: pypylon is not installed.
    """
    return [info.GetSerialNumber() for info in _library().TlFactory.GetInstance().EnumerateDevices()]


@BACKENDS.add("pylon")
class PylonRig:
    """Basler cameras, connected by cable or in one network."""

    def __init__(self, devices: Devices) -> None:
        pylon = _library()
        self._pylon, self._devices = pylon, devices
        self._line = str(devices.options.get("line", "Line1"))
        self._cameras: dict[str, Any] = {}
        self._absent: dict[str, str] = {}
        self._settings = CameraSettings()
        factory = pylon.TlFactory.GetInstance()
        attached = {info.GetSerialNumber(): info for info in factory.EnumerateDevices()}
        if not attached:
            remedy = "Check power and cables; pylon's own IP Configurator shows cameras with a wrong address"
            expected = "the cameras of the rig's file"
            raise SettingsError("back-end pylon", found="no camera on any bus", expected=expected, remedy=remedy)
        for name in devices.cameras:
            serial = devices.ids.get(name, "")
            if serial not in attached:
                others = sorted(set(attached) - set(devices.ids.values()))
                self._absent[name] = f"no camera with serial number {serial or '(none in the rig’s file)'}" + (
                    f"; not used: {', '.join(others)}" if others else ""
                )
                continue
            try:
                camera = pylon.InstantCamera(factory.CreateDevice(attached[serial]))
                camera.MaxNumBuffer.Value = _QUEUE
                camera.Open()
            except pylon.GenericException as error:  # another program or computer uses it
                self._absent[name] = f"a camera that does not open ({_first(error)})"
                continue
            self._cameras[name] = camera

    def settings(self, wanted: CameraSettings) -> None:
        """Set exposure, gain and trigger of all cameras."""
        self._settings = wanted
        for name, camera in self._cameras.items():
            try:
                camera.StopGrabbing()
                self._set(camera, ("ExposureTime", "ExposureTimeAbs"), _us(wanted.exposure_ms))
                self._set(camera, ("Gain",), wanted.gain_db)
                camera.TriggerSelector.Value = "FrameStart"
                camera.TriggerSource.Value = "Software" if wanted.trigger == "software" else self._line
                camera.TriggerMode.Value = "On"
            except self._pylon.GenericException as error:
                raise failed(name, f"a setting refused ({_first(error)})", "Correct the rig's file") from None

    def arm(self) -> None:
        """Drop pictures from earlier pulses."""
        for camera in self._cameras.values():
            camera.StopGrabbing()
            camera.TriggerMode.Value = "On"
            camera.StartGrabbing(self._pylon.GrabStrategy_OneByOne)
            camera.WaitForFrameTriggerReady(_READY_MS, self._pylon.TimeoutHandling_Return)

    def fire(self) -> float:
        """Send the trigger command, unless the cameras are triggered by wire."""
        fired_s = time.time()
        if self._settings.trigger == "software":
            for camera in self._cameras.values():
                camera.ExecuteSoftwareTrigger()
        return fired_s

    def fetch(self, camera: str, timeout_s: float) -> Frame:
        """Return the picture triggered by the last pulse."""
        device = self._require(camera)
        try:
            result = device.RetrieveResult(round(1e3 * timeout_s), self._pylon.TimeoutHandling_Return)
        except self._pylon.GenericException as error:
            raise failed(camera, f"a broken connection ({_first(error)})", "Check its cable, and fire again") from None
        if not result.IsValid():
            raise failed(camera, f"nothing within {timeout_s:g} s", "Check its trigger wire, and fire again")
        try:
            photograph = self._photograph(camera, result)
            stamp = int(result.TimeStamp)
            shared = stamp > 0 and self._follows_ptp(device)
            return Frame(
                camera=camera,
                content=photograph,
                taken_s=1e-9 * stamp if shared else None,
                clock="ptp" if shared else "none",
                number=int(result.ImageNumber),
                serial=device.GetDeviceInfo().GetSerialNumber(),
            )
        finally:
            result.Release()

    def live(self, camera: str) -> Photograph:
        """Take one picture without a pulse."""
        device = self._require(camera)
        device.StopGrabbing()
        device.TriggerMode.Value = "Off"
        result = device.GrabOne(_LIVE_MS)
        try:
            return self._photograph(camera, result)
        finally:
            result.Release()

    def health(self, camera: str) -> Health:
        """Report model, picture size and temperature."""
        if camera in self._absent:
            return Health(fault=f"{self._absent[camera][:1].upper()}{self._absent[camera][1:]}.")
        device = self._cameras[camera]
        info = device.GetDeviceInfo()
        if device.IsCameraDeviceRemoved():
            return Health(fault="It was unplugged.", serial=info.GetSerialNumber())
        warm = device.GetNodeMap().GetNode("DeviceTemperature")
        return Health(
            model=info.GetModelName(),
            serial=info.GetSerialNumber(),
            size_wh=(int(device.Width.Value), int(device.Height.Value)),
            temperature_c=float(warm.Value) if warm is not None and warm.IsReadable() else None,
        )

    def close(self) -> None:
        """Release the cameras."""
        for camera in self._cameras.values():
            camera.StopGrabbing()
            camera.Close()

    def _require(self, camera: str) -> Any:
        if camera not in self._cameras:
            raise failed(camera, self._absent.get(camera, "no such camera"), "Plug it in, or correct the rig's file")
        return self._cameras[camera]

    def _photograph(self, camera: str, result: Any) -> Photograph:
        if not result.IsValid() or not result.GrabSucceeded():
            why = str(result.ErrorDescription).rstrip(".") if result.IsValid() else "nothing"
            raise failed(camera, f"a damaged picture ({why})", "Fire again; if it stays, change the network cable")
        if self._pylon.IsMono(result.PixelType):
            return Photograph(name=camera, pixels=np.array(result.Array))
        converter = self._pylon.ImageFormatConverter()
        converter.OutputPixelFormat = self._pylon.PixelType_RGB8packed
        return Photograph(name=camera, pixels=np.array(converter.Convert(result).GetArray()))

    def _follows_ptp(self, device: Any) -> bool:
        for name in ("PtpEnable", "GevIEEE1588"):
            node = device.GetNodeMap().GetNode(name)
            if node is not None and node.IsReadable() and bool(node.Value):
                return True
        return False

    def _set(self, camera: Any, names: tuple[str, ...], value: float | None) -> None:
        for name in names if value is not None else ():
            node = camera.GetNodeMap().GetNode(name)
            if node is not None and node.IsWritable():
                node.Value = value
                return


def _us(milliseconds: float | None) -> float | None:
    return None if milliseconds is None else 1e3 * milliseconds


def _first(error: Exception) -> str:
    return (str(error).splitlines() or ["no reason given"])[0].split(" : ")[0].rstrip(".")
