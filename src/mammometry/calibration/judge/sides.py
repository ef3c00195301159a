"""Whether each pair's left camera stands left of its right one."""

from __future__ import annotations

from collections.abc import Collection

from mammometry.base.errors import CalibrationError
from mammometry.geometry.camera import Rig


def require_sides(rig: Rig, upside_down: Collection[str]) -> None:
    """Refuse a pair whose right camera stands left of the left one.

    As seen from behind, or as their pictures show it, which differ for cameras that are upside down. No result depends
    on which one is called left.

    Args:
        rig: as calibrated.
        upside_down: cameras that are mounted with their tops down.

    Raises:
        CalibrationError: names the pair, and what to do.
    """
    for pair in rig.pairs:
        x_mm, y_mm, _ = pair.left.camera_from_world.apply(pair.right.centre_world)
        if pair.left.name in upside_down:
            if pair.right.name in upside_down:
                continue  # left in the pictures is right from behind: either is meant
            x_mm = -x_mm
        if x_mm < 0 and abs(x_mm) > abs(y_mm):
            opposed = pair.left.camera_from_world.rotation[0] @ pair.right.camera_from_world.rotation[0] < 0
            reversed_ = pair.left.name in upside_down or pair.right.name in upside_down
            raise CalibrationError(
                f"pair {pair.name}",
                found=f"{pair.right.name} standing {-x_mm:.0f} mm to the left of {pair.left.name}",
                expected="the right camera to the right of the left one, as their pictures show it",
                remedy="Say in session.toml which of the two is mounted upside down, such as "
                f'rig.mounting = {{ {pair.left.name} = "upside-down" }}'
                if opposed and not reversed_
                else "Exchange left and right in the pair, or the two cameras' files if those are swapped. If all "
                "photographs were mirrored, export them as the cameras took them",
            )
