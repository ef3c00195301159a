"""Photographs (pixels and a name), and image points measured by another program."""

import numpy as np
from jaxtyping import Float32, Float64, Int64, Shaped

from mammometry.base.errors import ImageError
from mammometry.base.value import value

LUMA = np.array([0.2126, 0.7152, 0.0722], dtype=np.float32)
"""Weights of red, green and blue, encoded, in Rec. 709 luma."""


@value(eq=False)
class Photograph:
    """One exposure by one camera, in the orientation of the sensor.

    Raises:
        ImageError: the pixels are neither 8 nor 16 bit, or neither grey nor RGB.
    """

    name: str
    """Name for messages: the path inside the session, e.g. ``capture/front_left.jpg``."""
    pixels: Shaped[np.ndarray, "h w *channels"]
    """uint8 or uint16, (h, w) grey or (h, w, 3) RGB, sRGB-encoded. Read-only."""

    def __post_init__(self) -> None:
        if self.pixels.dtype not in (np.uint8, np.uint16) or (self.pixels.ndim, *self.pixels.shape[2:]) not in (
            (2,),
            (3, 3),
        ):
            raise ImageError(
                self.name,
                found=f"an array of {self.pixels.dtype} and shape {self.pixels.shape}",
                expected="8 or 16 bit, grey or RGB",
                remedy="Export it as an ordinary JPEG, PNG or TIFF",
            )

    @property
    def size_wh(self) -> tuple[int, int]:
        """Width and height, pixels."""
        return self.pixels.shape[1], self.pixels.shape[0]

    def encoded(self) -> Float32[np.ndarray, "h w *channels"]:
        """Values as recorded (sRGB-encoded), scaled to 0…1."""
        return self.pixels.astype(np.float32) / np.float32(np.iinfo(self.pixels.dtype).max)

    def linear(self) -> Float32[np.ndarray, "h w *channels"]:
        """Linear light, 0…1, by the inverse sRGB transfer function (IEC 61966-2-1)."""
        linear: Float32[np.ndarray, "h w *channels"] = linear_of(self.pixels.dtype)[self.pixels]
        return linear


@value(eq=False)
class MeasuredPoints:
    """Image points of one photograph, read from a table and not yet compared with a target."""

    name: str
    """Name of the table for messages, e.g. ``calibration/00/front_left.csv``."""
    ids: Int64[np.ndarray, " n"]
    """Number of each point in the target's list, from 0."""
    uv: Float64[np.ndarray, "n 2"]
    """Distorted pixels, integers at pixel centres."""


def linear_of(kind: np.dtype) -> Float32[np.ndarray, " levels"]:
    """Linear light, 0…1, of every level of an unsigned integer type (sRGB, IEC 61966-2-1)."""
    levels = np.linspace(0, 1, np.iinfo(kind).max + 1)
    return np.where(levels <= 0.04045, levels / 12.92, ((levels + 0.055) / 1.055) ** 2.4).astype(np.float32)
