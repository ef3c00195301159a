"""Reasons visible in a photograph why the target was not found."""

from __future__ import annotations

import numpy as np

from mammometry.base.photograph import Photograph
from mammometry.calibration.features.found_points import Cause
from mammometry.calibration.features.pixels import grey_bytes, reduced
from mammometry.calibration.targets.target import Target
from mammometry.geometry.arrays import Array, UInt8

_WHITE, _MAX_WHITE_SHARE = 252, 0.35
"""Overexposed grey level of 255, and its share in an over-exposed picture. Chosen by eye."""
_DARK = 40
"""Brightest grey level of a picture that is nearly black. Chosen by eye."""
_MIN_STEP = 0.16
"""Share of the picture's contrast that a sharp edge climbs from one reduced pixel to the next. A smeared one climbs
less.
"""
_MIN_CONTRAST = 50
"""Grey levels between dark and bright above which a picture without edges is called blurred. Chosen by eye."""

NOT_IN_VIEW = Cause(found="no target", remedy="")
"""Nothing in the photograph says that the target should have been found."""


def diagnose(photograph: Photograph, target: Target, *, search_width_px: int) -> Cause:
    """Say why a photograph has no detection."""
    small, _ = reduced(grey_bytes(photograph), search_width_px)
    return target.explain_miss(small) or _about_exposure(small) or NOT_IN_VIEW


def _about_exposure(small: UInt8[Array, "h w"]) -> Cause | None:
    low, high = (float(level) for level in np.percentile(small, (1, 99.5)))
    white = float((small >= _WHITE).mean())
    if white > _MAX_WHITE_SHARE:
        return Cause(found=f"an over-exposed picture: {100 * white:.0f} % of it is white", remedy="Expose it less")
    if high < _DARK:
        return Cause(found="a picture that is nearly black", remedy="Expose it more, or check its flash")
    steps = np.abs(np.diff(small.astype(np.float32), axis=1))
    if high - low > _MIN_CONTRAST and float(np.percentile(steps, 99.9)) < _MIN_STEP * (high - low):
        return Cause(
            found="a picture without one sharp edge: blurred by motion or focus, or without the target",
            remedy="Focus on the board and hold it still while it is exposed",
        )
    return None
