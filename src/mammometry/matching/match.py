"""Dense correspondence of a rectified pair (paper 2.3, Eq. 1)."""

from dataclasses import dataclass

from mammometry.geometry.arrays import Array, Bool, Float32, read_only
from mammometry.geometry.camera import Camera
from mammometry.matching.rectify import RectifiedPair
from mammometry.matching.settings import MatchSettings
from mammometry.progress import Progress, no_progress


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DisparityMap:
    """Where each left pixel is seen in the right image: (u, v) → (u − d_h, v − d_v)."""

    name: str
    left: Camera
    """Ideal rectified camera at the map's resolution; the map's pixels are its pixels."""
    right: Camera
    """Its partner at the same resolution, same orientation; only the principal column differs."""
    d_h_px: Float32[Array, "h w"]
    """Horizontal disparity u_left − u_right; 0 where not valid."""
    d_v_px: Float32[Array, "h w"]
    """Vertical disparity v_left − v_right, ~0 with a right calibration; 0 where not valid."""
    confidence: Float32[Array, "h w"]
    """Zero-mean normalised cross-correlation c(i, j) of the matched windows, −1…1; 0 where not valid."""
    sigma_px: Float32[Array, "h w"]
    """Expected standard deviation of d_h_px; 0 where not valid."""
    valid: Bool[Array, "h w"]

    def __post_init__(self) -> None:
        for name in ("d_h_px", "d_v_px", "confidence", "sigma_px", "valid"):
            object.__setattr__(self, name, read_only(getattr(self, name)))


def match(
    pair: RectifiedPair, settings: MatchSettings = MatchSettings(), *, progress: Progress = no_progress
) -> DisparityMap:
    """Find d_H and d_V that maximise the correlation of the local areas around each left pixel (Eq. 1)."""
    raise NotImplementedError
