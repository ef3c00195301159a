"""Plans of virtual rigs: where cameras and flashes should stand.

Rig frame: origin in the middle of the working volume; x right as the front pair sees it, y up, z from the subject
towards the front pair; mm. The subject leans forward by 45°, over the floor pair, unless the plan says otherwise.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

FULL_SIZE_WH = (4504, 3000)
"""Width and height of the reference rig's photographs, pixels: 13.5 megapixels."""
FULL_FOCAL_PX = 8100.0
"""Focal length of the reference rig's cameras, pixels: about 0.1 mm a pixel at `DISTANCE_MM`."""
DISTANCE_MM = 780.0
"""Distance of the reference rig's cameras from its middle, mm."""

Triple = tuple[float, float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class LensPlan:
    """A camera and its lens as designed: at full size, without errors."""

    size_wh: tuple[int, int] = FULL_SIZE_WH
    """Width and height of the picture, pixels."""
    focal_px: float = FULL_FOCAL_PX
    """Focal length, pixels."""
    distortion: tuple[float, float, float, float, float] = (-0.05, 0.1, 0.0, 0.0, 0.0)
    """Brown's k1, k2, p1, p2, k3."""
    principal_point_px: tuple[float, float] | None = None
    """Principal point, pixels. None: the picture's middle."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraPlan:
    """One camera, by where it stands."""

    name: str
    centre_mm: Triple
    """Perspective centre, rig frame, mm."""
    target_mm: Triple = (0.0, 0.0, 0.0)
    """Point that it looks at, rig frame, mm."""
    right: Triple = (1.0, 0.0, 0.0)
    """Direction, rig frame, that is about to the right in its picture."""
    lens: LensPlan = LensPlan()


@dataclass(frozen=True, slots=True, kw_only=True)
class PairPlan:
    """A convergent pair, by where its middle stands. Directions in the rig frame."""

    name: str
    """Its cameras are called NAME_left and NAME_right."""
    towards: Triple
    """Direction from the subject to the middle between the cameras."""
    along: Triple
    """Approximate direction from the left camera to the right one."""
    distance_mm: float = DISTANCE_MM
    """Distance of each camera from the rig's middle, mm."""
    distance_spread: float = 0.0
    """The distance is drawn uniformly within ± this share of it."""
    convergence_deg: tuple[float, float] = (16.0, 16.0)
    """Range of the angle between the two lines of sight, degrees."""
    lens: LensPlan = LensPlan()


@dataclass(frozen=True, slots=True, kw_only=True)
class RigErrors:
    """Standard deviations of a built rig's differences from its plan. Defaults are chosen by eye."""

    position_mm: float = 8.0
    """Of each coordinate of a camera, mm."""
    aim_mm: float = 4.0
    """Of each coordinate of the point it looks at, mm."""
    roll_deg: float = 1.0
    """Of its turn about the line of sight, degrees."""
    focal: float = 0.01
    """Of the focal length, relative."""
    aspect: float = 1e-4
    """Of the pixel's height over its width."""
    principal_point: float = 0.007
    """Of each coordinate of the principal point, in heights of the picture."""
    distortion: tuple[float, float, float, float] = (0.03, 0.1, 3e-4, 3e-4)
    """Of k1, k2, p1 and p2."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RigPlan:
    """All that stands around the subject: cameras and flashes."""

    name: str
    stations: tuple[PairPlan | CameraPlan, ...]
    """Pairs, and single cameras that `pairs` names."""
    pairs: tuple[tuple[str, str, str], ...] = ()
    """Name, left and right camera of each pair made of single cameras."""
    flashes_mm: tuple[Triple, ...]
    """Places of the flashes, rig frame, mm."""
    strengths: tuple[float, ...] | None = None
    """Strengths of the flashes relative to one another. None: all alike."""
    facing: Triple
    """Normal of the white surface in the rig's middle to which the flashes are set."""
    errors: RigErrors = RigErrors()
    lean_rad: float | None = None
    """Forward lean of the subject, rad. None: the subject's own."""


def _reference_pair(name: str, towards: Triple, along: Triple) -> PairPlan:
    return PairPlan(name=name, towards=towards, along=along, distance_spread=0.03, convergence_deg=(13.0, 19.0))


REFERENCE = RigPlan(
    name="reference",
    stations=(
        _reference_pair("front", (0.0, -0.074, 0.997), (1.0, 0.0, 0.0)),
        _reference_pair("floor", (0.0, -0.998, 0.063), (1.0, 0.0, 0.0)),
        _reference_pair("left", (-0.826, -0.439, 0.354), (0.58, -0.62, 0.53)),
        _reference_pair("right", (0.826, -0.439, 0.354), (0.58, 0.62, -0.53)),
    ),
    flashes_mm=((0.0, 260.0, 880.0), (0.0, -860.0, 190.0), (-830.0, -180.0, 430.0), (830.0, -180.0, 430.0)),
    facing=(0.0, -math.sqrt(0.5), math.sqrt(0.5)),
)
"""Eight cameras of 4504 × 3000 pixels in four convergent pairs, about 0.1 mm a pixel. Four flashes."""
