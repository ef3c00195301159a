"""rig.toml: a rig, and how its cameras are driven. Pairs, target and subject are as in session.toml."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from mammometry.base.errors import SessionError
from mammometry.base.parse import read_text, shown, toml_table
from mammometry.capture.camera import CameraSettings, Devices
from mammometry.io.manifest import Manifest

_STRICT = ConfigDict(extra="forbid", strict=True, frozen=True)


class CaptureEntry(BaseModel):
    """How the cameras are driven."""

    model_config = _STRICT

    backend: str
    """A name in `registry.BACKENDS`."""
    calibration: str | None = None
    """Session folder of the rig's calibration, relative to the rig's file."""
    trigger: Literal["wire", "software"] = "wire"
    exposure_ms: Annotated[float, Field(strict=False, gt=0)] | None = None
    gain_db: Annotated[float, Field(strict=False)] | None = None
    timeout_s: Annotated[float, Field(strict=False, gt=0, le=600)] = 10.0
    """How long a picture may take from the pulse to this computer."""
    format: Literal["jpg", "png", "tif"] = "jpg"
    """File of pictures that come as bare pixels. Cameras' own files are kept as they come."""
    skew_limit_ms: Annotated[float, Field(strict=False, gt=0)] = 1.0
    """Largest measured difference of the cameras' exposures for a patient. Skin moves by breath at some 20 mm/s, which
    makes 0.02 mm in 1 ms."""
    cameras: dict[str, str] = {}
    """Camera → its serial number, address or port."""
    options: dict[str, Any] = {}
    """Of the back-end."""


class RigFile(Manifest):
    """The whole of rig.toml."""

    capture: CaptureEntry

    @property
    def camera_names(self) -> tuple[str, ...]:
        """All cameras of the pairs, each once."""
        return tuple(dict.fromkeys(name for pair in self.rig.pairs for name in (pair.left, pair.right)))

    @property
    def settings(self) -> CameraSettings:
        """How all cameras expose."""
        entry = self.capture
        return CameraSettings(exposure_ms=entry.exposure_ms, gain_db=entry.gain_db, trigger=entry.trigger)

    @property
    def devices(self) -> Devices:
        """What the back-end opens."""
        return Devices(cameras=self.camera_names, ids=self.capture.cameras, options=self.capture.options)


def read_rig_file(path: Path) -> RigFile:
    """Read a rig.toml.

    Raises:
        SessionError: it is missing, no TOML, or has an unknown or unfit key; the message names it.
    """
    expected = "a rig's description with a table [capture]"
    table = toml_table(read_text(path, str(path), expected, most_mib=1), str(path), expected)
    try:
        file = RigFile.model_validate(table)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"])) or "rig.toml"
        unknown, value = first["type"] == "extra_forbidden", first.get("input")
        found = "nothing" if first["type"] == "missing" else "an unknown key" if unknown else (
            shown(value) if isinstance(value, str | int | float | bool) else "an unfit value"
        )  # fmt: skip
        wanted = "only known keys" if unknown else first["msg"].removeprefix("Value error, ")
        remedy = "Correct it; docs/how-to/capture.md has a whole one"
        raise SessionError(f"{path}: {where}", found=found, expected=wanted, remedy=remedy) from None
    strangers = [name for name in file.capture.cameras if name not in file.camera_names]
    if strangers:
        raise SessionError(
            f"{path}: capture.cameras", found=strangers[0], expected=f"one of {', '.join(file.camera_names)}",
            remedy="Name the cameras as the pairs do",
        )  # fmt: skip
    twice = [
        camera for camera in file.capture.cameras.values() if list(file.capture.cameras.values()).count(camera) > 1
    ]
    if twice:
        raise SessionError(
            f"{path}: capture.cameras", found=f"{twice[0]!r} for two cameras", expected="a device each",
            remedy="Correct the serial numbers",
        )  # fmt: skip
    return file
