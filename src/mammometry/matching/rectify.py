"""Resample a converging pair so that corresponding points lie on the same row."""

from dataclasses import dataclass

from mammometry.geometry.arrays import Array, Bool, Float32, read_only
from mammometry.geometry.camera import Camera, StereoPair
from mammometry.matching.foreground import Foreground
from mammometry.photograph import Photograph


@dataclass(frozen=True, slots=True, kw_only=True)
class RectifySettings:
    """How a pair is resampled."""

    margin_px: int = 16
    """Pixels kept around the subject's silhouette in either rectified image."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RectifiedPair:
    """Two images of one size whose rows correspond, seen by ideal cameras at the original perspective centres."""

    name: str
    left: Camera
    """Ideal (no distortion); `right` has its orientation, focal length and principal row, not its principal column."""
    right: Camera
    left_image: Float32[Array, "h w"]
    """Luma, 0…1; cubic B-spline resampling at the photographs' own resolution."""
    right_image: Float32[Array, "h w"]
    left_mask: Bool[Array, "h w"]
    """Pixels that show the subject and lie inside the photograph."""
    right_mask: Bool[Array, "h w"]

    def __post_init__(self) -> None:
        for name in ("left_image", "right_image", "left_mask", "right_mask"):
            object.__setattr__(self, name, read_only(getattr(self, name)))


def rectify(
    pair: StereoPair,
    left: Photograph,
    right: Photograph,
    left_foreground: Foreground,
    right_foreground: Foreground,
    settings: RectifySettings = RectifySettings(),
) -> RectifiedPair:
    """Turn both cameras parallel about their own centres and resample the subject's region."""
    raise NotImplementedError
