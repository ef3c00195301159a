"""The sensor, its lens, and the format of picture files."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from mammometry.base.errors import UnknownWordError

if TYPE_CHECKING:  # the command line uses these defaults and must not import NumPy
    from mammometry.geometry.camera import Camera
    from mammometry.simulate.rendering.sampling import Aperture

_LEAST_NOISE = 1e-3  # smallest noise relative to the usual sensor's: 0 would need infinitely many electrons


@dataclass(frozen=True, slots=True, kw_only=True)
class Film:
    """A sensor and its lens, at the size of the rendered picture."""

    blur_px: float = 0.5
    """Standard deviation of the point spread function, in addition to the pixel's own area, px. 0: none."""
    vignetting: float = 0.08
    """Loss of light in the corners, 0…1."""
    electrons: float = 18000.0
    """Electrons at full scale. Photon noise is the square root of their number."""
    read_noise: float = 12.0
    """Read-out noise, electrons."""
    stray_light: float = 0.004
    """Radiance of the dark room and lens flare, added everywhere, relative to full scale."""
    f_number: float | None = None
    """Focal length divided by the aperture's diameter. None: sharp at all depths."""
    focus_mm: float | None = None
    """Depth of the sharp plane, if there is an f-number. None: for each camera, the depth of the rig's centre."""
    sensor_width_mm: float = 22.3
    """Width of the sensor (APS-C), which determines the focal length in mm."""
    jpeg_quality: int = 95
    """Quality of JPEG files, 1…100."""
    chroma_halved: bool = False
    """Whether files store colour at half resolution (4:2:0), like those of most cameras."""
    gain_rgb: tuple[float, float, float] = (1.0, 1.0, 1.0)
    """Exposure and white balance: factors on red, green and blue light before counting."""
    grey: bool = False
    """Whether the sensor counts light without colour, so that files have one channel."""
    mosaic: bool = False
    """Whether each pixel counts only one colour (Bayer's RGGB), and the others are interpolated."""
    aberration: tuple[float, float] = (0.0, 0.0)
    """Lateral chromatic aberration: relative magnification of red and blue compared with green."""
    sharpening: float = 0.0
    """Share of the difference to a blurred picture (σ 1 px) that is added to the encoded one."""

    def __post_init__(self) -> None:
        for name, low, high in (
            ("blur_px", 0.0, 50.0),
            ("vignetting", 0.0, 1.0),
            ("electrons", 1.0, math.inf),
            ("read_noise", 0.0, math.inf),
            ("f_number", 0.5, 1000.0),
            ("focus_mm", 1.0, math.inf),
            ("sensor_width_mm", 0.1, 1000.0),
            ("jpeg_quality", 1, 100),
            ("sharpening", 0.0, 5.0),
        ):
            value = getattr(self, name)
            if value is not None and not low <= value <= high:
                raise UnknownWordError(f"{name} must be between {low:g} and {high:g}", value)

    @property
    def is_processed(self) -> bool:
        """Whether the camera does more than counting and encoding."""
        return self.mosaic or self.sharpening > 0 or any(self.aberration) or self.gain_rgb != (1.0, 1.0, 1.0)

    def with_noise(self, noise: float) -> Film:
        """A sensor with a multiple of this one's noise. With 0, it has almost none.

        Raises:
            ValueError: it is not between 0 and 100.
        """
        if not 0.0 <= noise <= 100.0:
            raise UnknownWordError("noise must be between 0 and 100", f"{noise:g}")
        grain = max(noise, _LEAST_NOISE)
        return replace(self, electrons=self.electrons / grain**2, read_noise=self.read_noise / grain)

    def aperture(self, camera: Camera) -> Aperture:
        """Aperture of the lens on this camera (focal length in mm divided by the f-number), and its focus."""
        from mammometry.simulate.rendering.sampling import PINHOLE, Aperture

        if self.f_number is None:
            return PINHOLE
        focal_mm = float(camera.matrix[0, 0]) * self.sensor_width_mm / camera.size_wh[0]
        return Aperture(diameter_mm=focal_mm / self.f_number, focus_mm=self.focused_mm(camera))

    def focused_mm(self, camera: Camera) -> float:
        """Depth of this camera's sharp plane, mm from its centre. The camera is in the rig's frame."""
        return float(camera.camera_from_world.translation_mm[2]) if self.focus_mm is None else self.focus_mm
