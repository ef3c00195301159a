"""Poses of the board that a calibration has, and those that it still needs."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from mammometry.calibration.adjust.initialise import least_views
from mammometry.calibration.targets.table import target_from_table


def poses_needed(definition: Mapping[str, Any], cameras: Sequence[str], photographs: Iterable[tuple[str, str]]) -> str:
    """How many poses of the board are still needed, in a sentence. Empty: it can be calibrated.

    Args:
        definition: of the rig.
        cameras: of the rig.
        photographs: pose and camera of each.
    """
    table = definition.get("target")
    least = least_views(target_from_table(table)) if table else 1
    of_camera = Counter(camera for _, camera in photographs)
    missing = max((least - of_camera[camera] for camera in cameras), default=least)
    if missing <= 0:
        return ""
    poses = "one more pose" if missing == 1 else f"{missing} more poses"
    return f"Add {poses} of the board: each camera must see it {least} times at least; ten poses are better."
