"""Select the photographs of a walk that are matched with each other.

Two photographs make a pair if they see the body from directions 8 to 25 degrees apart, at about the same distance.
Wider pairs measure depth more precisely and suffer less from motion of the body between the two photographs: an error
across the line of sight becomes 6 times as large in depth at 10 degrees, 3 times at 20. Beyond 25 degrees matching
fails where the skin turns away.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations, pairwise
from typing import NamedTuple

import numpy as np

from mammometry.base.errors import CalibrationError
from mammometry.calibration.judge.expected_error import sees
from mammometry.geometry import Array, Camera, Float64, Rig

NARROWEST_DEG, BEST_DEG, WIDEST_DEG = 8.0, 14.0, 25.0
"""Angle between the directions from which a pair sees the body. From three virtual walks (decision 52)."""
MOST = 20
"""Largest number of pairs of a walk: more take time and measure the same skin again."""
_FORWARD = 0.15  # largest relative difference of the two distances: beyond it, the scales differ too much
_ALONG = 0.5
"""Largest cosine between the baseline and the viewing direction: beyond it, the rectified images become very large."""
_FORWARD_DEG = 40.0  # cost of a relative difference of 1 between the distances, degrees
_AGAIN_DEG = 6.0  # cost of each other pair with the same photograph, degrees
_NEAR_DEG = 12.0  # a pair closer than this to the direction of an earlier one adds little
_GAP_DEG = 35.0  # largest gap between neighbouring photographs: beyond it, no pair sees the skin in between
_ASIDE_DEG = 30.0  # least extent of the arc to either side of the board's normal: shows the breasts' sides


_MOST_SHOW, _FEW_SHOW = 0.75, 0.25
"""Shares of the photographs that show the skin below the board, and above it, from which on a board counts as upside
down. Of right walks, 92 to 100 % show that above it, and at most 4 % that below it."""


class Candidate(NamedTuple):
    """Two photographs that may form a pair."""

    left: str
    right: str
    angle_deg: float
    cost_deg: float
    """Difference from the best angle, plus penalties."""
    direction: Float64[Array, 3]
    """Unit vector from the body to the middle between the two cameras."""


def candidates(cameras: Sequence[Camera], middle_world: Float64[Array, 3]) -> list[Candidate]:
    """All pairs of photographs that can be matched, best first."""
    found = []
    for one, other in combinations(cameras, 2):
        to_one, to_other = one.centre_world - middle_world, other.centre_world - middle_world
        far_one, far_other = float(np.linalg.norm(to_one)), float(np.linalg.norm(to_other))
        angle = float(np.degrees(np.arccos(np.clip(to_one @ to_other / (far_one * far_other), -1, 1))))
        forward = abs(far_other / far_one - 1)
        ahead = one.camera_from_world.rotation[2] + other.camera_from_world.rotation[2]
        baseline = other.centre_world - one.centre_world
        along = abs(float(ahead @ baseline)) / float(np.linalg.norm(ahead) * np.linalg.norm(baseline))
        if not NARROWEST_DEG <= angle <= WIDEST_DEG or forward > _FORWARD or along > _ALONG:
            continue
        right_of_one = one.camera_from_world.rotation @ baseline
        left, right = (one, other) if right_of_one[0] > 0 else (other, one)
        towards = to_one / far_one + to_other / far_other
        found.append(
            Candidate(
                left=left.name,
                right=right.name,
                angle_deg=angle,
                cost_deg=abs(angle - BEST_DEG) + _FORWARD_DEG * forward,
                direction=towards / np.linalg.norm(towards),
            )
        )
    return sorted(found, key=lambda pair: (pair.cost_deg, pair.left, pair.right))


def choose_pairs(rig: Rig, middle_world: Float64[Array, 3], most: int = MOST) -> dict[str, tuple[str, str]]:
    """Pairs that see the body from all directions of the walk: name → left and right photograph.

    Pairs are selected one by one, by cost: it is low for a new direction, for an angle near the best one, and for
    photographs that are in few other pairs.

    Args:
        rig: the photographs' cameras, in the board's frame.
        middle_world: centre of the body's region, mm.
        most: largest number of pairs.

    Raises:
        CalibrationError: the photographs leave a gap, or no two of them can be matched.
    """
    require_arc(tuple(rig.cameras.values()), middle_world)
    waiting = candidates(tuple(rig.cameras.values()), middle_world)
    if not waiting:
        raise CalibrationError(
            "the photographs",
            found="no two from about the same distance and from directions 8 to 25 degrees apart",
            expected="a walk around the body with a photograph every 10 to 15 degrees",
            remedy="Take more photographs, closer together, all from about the same distance",
        )
    chosen: list[Candidate] = []
    used: dict[str, int] = {}
    while waiting and len(chosen) < most:

        def cost(pair: Candidate) -> float:
            near = [np.degrees(np.arccos(np.clip(pair.direction @ other.direction, -1, 1))) for other in chosen]
            crowded = sum(max(0.0, _NEAR_DEG - angle) for angle in near)
            again = _AGAIN_DEG * (used.get(pair.left, 0) + used.get(pair.right, 0))
            return pair.cost_deg + float(crowded) + again

        best = min(waiting, key=cost)
        waiting.remove(best)
        chosen.append(best)
        for name in (best.left, best.right):
            used[name] = used.get(name, 0) + 1
    chosen.sort(key=lambda pair: (pair.left, pair.right))
    return {f"{pair.left}-{pair.right}": (pair.left, pair.right) for pair in chosen}


def require_arc(cameras: Sequence[Camera], middle_world: Float64[Array, 3]) -> None:
    """Refuse photographs that do not cover the front of the body.

    Args:
        cameras: in the board's frame (x along its rows, z away from the reader).
        middle_world: centre of the body's region, mm.

    Raises:
        CalibrationError: states the gap, in degrees from the board's normal, positive to the patient's left.
    """
    away = [camera.centre_world - middle_world for camera in cameras]
    around = sorted(float(np.degrees(np.arctan2(place[0], -place[2]))) for place in away)
    gaps = [(low, high) for low, high in pairwise(around) if high - low > _GAP_DEG]
    if around[0] > -_ASIDE_DEG:
        gaps.append((-_ASIDE_DEG, around[0]))
    if around[-1] < _ASIDE_DEG:
        gaps.append((around[-1], _ASIDE_DEG))
    if gaps:
        low, high = max(gaps, key=lambda gap: gap[1] - gap[0])
        raise CalibrationError(
            "the photographs",
            found=f"none between {low:+.0f}° and {high:+.0f}° (0°: in front of the board, +: the patient's left)",
            expected=f"some from {_ASIDE_DEG:.0f}° or more on either side, and gaps of at most {_GAP_DEG:.0f}°",
            remedy="Photograph again from there, with the whole board in each picture",
        )


def require_upright(
    cameras: Sequence[Camera], region_middle: Float64[Array, 3], board_middle: Float64[Array, 3]
) -> None:
    """Refuse a board that is upside down on the patient, by which side of it is photographed.

    Args:
        cameras: in the board's frame.
        region_middle: centre of the body's region above the board, mm.
        board_middle: centre of the board, mm.

    Raises:
        CalibrationError: most photographs show the place below the board, and few that above it.
    """
    opposite = np.append((2.0 * board_middle - region_middle)[:2], region_middle[2])
    above, below = (
        float(np.mean([sees(camera, place[None])[0] for camera in cameras])) for place in (region_middle, opposite)
    )
    if below > _MOST_SHOW and above < _FEW_SHOW:
        raise CalibrationError(
            "the board",
            found=f"what is below its text in {below:.0%} of the photographs, and what is above it in {above:.0%}",
            expected="a board with its text upright, and the breasts above it",
            remedy="Turn the board so that its text is upright, and photograph again",
        )
