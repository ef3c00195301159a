"""Artefacts of known size, their positions, and the limits of a test."""

from __future__ import annotations

import datetime
import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import Literal, TypeAlias

from mammometry.base.value import value

Kind: TypeAlias = Literal["plane", "sphere", "bar", "cast"]
KINDS: tuple[Kind, ...] = ("sphere", "bar", "plane", "cast")
TITLES: Mapping[Kind, str] = MappingProxyType(
    {"plane": "Plane", "sphere": "Sphere", "bar": "Bar with two spheres", "cast": "Cast of known volume"}
)
Quantity: TypeAlias = Literal["form", "size", "spacing", "length", "flatness", "volume"]
QUANTITIES: Mapping[Kind, tuple[Quantity, ...]] = MappingProxyType(
    {"sphere": ("form", "size"), "bar": ("spacing", "length"), "plane": ("flatness",), "cast": ("volume",)}
)
"""Artefact → quantities whose errors it shows."""

BREAST_CC = 400.0
"""Volume of the breast for which errors are converted to cc: near the median of published series."""
VOLUME_MM = (450.0, 450.0, 250.0)
"""Working volume: width, height and depth in front of the device, mm, of a trunk with both breasts."""
_PER_MM3 = 1000.0  # mm³ in 1 cc


@value
class Position:
    """Position of an artefact in the working volume."""

    name: str
    """Its number. File names for the position start with it."""
    words: str
    centre: tuple[float, float, float]
    """Right, up and towards the device, from the centre of the working volume, as shares of its sides."""
    axis: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Direction of a bar, or of a plane's normal, in the same axes. Zero for a sphere and a cast."""


def _corners() -> tuple[Position, ...]:
    sides = {-1: "left", 1: "right"}
    heights = {1: "upper", -1: "lower"}
    depths = {1: "front", -1: "back"}
    places = [(x, y, z) for z in depths for y in heights for x in sides]
    return tuple(
        Position(
            name=str(number),
            words=f"{heights[y]} {sides[x]}, {depths[z]}",
            centre=(0.35 * x, 0.35 * y, 0.35 * z),
        )
        for number, (x, y, z) in enumerate(places, start=2)
    )


POSITIONS: Mapping[Kind, tuple[Position, ...]] = MappingProxyType(
    {
        "sphere": (
            Position(name="1", words="in the middle", centre=(0.0, 0.0, 0.0)),
            *_corners(),
            Position(name="10", words="in the middle of the front", centre=(0.0, 0.0, 0.4)),
        ),
        "bar": (
            Position(name="1", words="horizontal", centre=(0.0, 0.0, 0.0), axis=(1.0, 0.0, 0.0)),
            Position(name="2", words="upright", centre=(0.0, 0.0, 0.0), axis=(0.0, 1.0, 0.0)),
            Position(name="3", words="one end 30° nearer to the device", centre=(0.0, 0.0, 0.0), axis=(0.87, 0.0, 0.5)),
            Position(
                name="4", words="one end 30° nearer, the other way", centre=(0.0, 0.0, 0.0), axis=(-0.87, 0.0, 0.5)
            ),
            Position(name="5", words="diagonal, rising to the right", centre=(0.0, 0.0, 0.0), axis=(0.7, 0.7, 0.0)),
            Position(name="6", words="diagonal, falling to the right", centre=(0.0, 0.0, 0.0), axis=(0.7, -0.7, 0.0)),
            Position(name="7", words="upright, the top end 30° nearer", centre=(0.0, 0.0, 0.0), axis=(0.0, 0.87, 0.5)),
        ),
        "plane": (
            Position(name="1", words="facing, in the middle", centre=(0.0, 0.0, 0.0), axis=(0.0, 0.0, 1.0)),
            Position(name="2", words="facing, at the front", centre=(0.0, 0.0, 0.35), axis=(0.0, 0.0, 1.0)),
            Position(name="3", words="facing, at the back", centre=(0.0, 0.0, -0.35), axis=(0.0, 0.0, 1.0)),
            Position(name="4", words="turned 30° to the right", centre=(0.0, 0.0, 0.0), axis=(0.5, 0.0, 0.87)),
            Position(name="5", words="turned 30° to the left", centre=(0.0, 0.0, 0.0), axis=(-0.5, 0.0, 0.87)),
            Position(name="6", words="tilted 30° upwards", centre=(0.0, 0.0, 0.0), axis=(0.0, 0.5, 0.87)),
        ),
        "cast": (
            Position(name="1", words="in the middle", centre=(0.0, 0.0, 0.0)),
            Position(name="2", words="10 cm to the left, turned by a third", centre=(-0.25, 0.0, 0.0)),
            Position(name="3", words="10 cm to the right, turned by two thirds", centre=(0.25, 0.0, 0.0)),
        ),
    }
)
"""Artefact → its positions. Ten and seven are the fewest of the standards for a sphere and a bar."""


@value
class Plane:
    """A flat plate with a speckled face."""

    flatness_std_mm: float
    """Standard uncertainty of its own flatness, mm."""
    source: str
    """Origin of the values."""


@value
class Sphere:
    """A ball of known diameter."""

    diameter_mm: float
    diameter_std_mm: float
    """Standard uncertainty of the diameter, mm."""
    form_std_mm: float
    """Standard uncertainty of the ball's own roundness, mm."""
    source: str


@value
class Bar:
    """Two equal balls on a bar."""

    distance_mm: float
    """Distance between the balls' centres, mm."""
    distance_std_mm: float
    diameter_mm: float
    """Diameter of both balls, mm."""
    diameter_std_mm: float
    source: str


@value
class Cast:
    """A body of known volume."""

    volume_cc: float
    volume_std_cc: float
    source: str


Artefact: TypeAlias = Plane | Sphere | Bar | Cast


@value
class Limits:
    """Largest errors of an accepted device.

    The defaults follow from a breast of 400 cc. 0.1 % in length is 0.3 % in volume, 1.2 cc. An error of form or
    flatness changes the volume by at most 1 %, 4 cc, even if it has the same sign on the whole breast. The limit of
    size is half as large, because this error always has the same sign.
    """

    form_mm: float = 0.4
    """Thickness of the shell that contains 95 % of a sphere's points."""
    size_mm: float = 0.2
    """Error of a sphere's diameter."""
    length_share: float = 0.001
    """Error of a length, as a share of it."""
    flatness_mm: float = 0.4
    """Distance between two planes that contain 95 % of a plane's points."""
    volume_share: float = 0.01
    """Error of a volume, as a share of it."""


@value
class AcceptanceTest:
    """Description of one acceptance test, from its TOML file."""

    device: str
    software: str
    """Software that made the meshes. Empty: mammometry."""
    person: str
    date: datetime.date
    units: str
    """Unit of meshes whose file states none. Empty: not given."""
    artefacts: Mapping[Kind, Artefact]
    limits: Limits = Limits()


def breast_area_mm2(volume_cc: float = BREAST_CC) -> float:
    """Area of a breast's skin, mm²: that of a hemisphere of this volume."""
    radius_mm = (3 * volume_cc * _PER_MM3 / (2 * math.pi)) ** (1 / 3)
    return 2 * math.pi * radius_mm**2


def effect_cc(quantity: Quantity, error: float, reference: float, volume_cc: float = BREAST_CC) -> float:
    """Change of a breast's volume due to an error, cc.

    An error of length scales the breast. An error of size moves all skin outwards by half of it. An error of form or
    flatness moves it by at most half the error.

    Args:
        quantity: quantity that has the error.
        error: mm, or cc for a volume.
        reference: measured reference value, in the same unit. Not used for form and flatness.
        volume_cc: volume of the breast.
    """
    if quantity in ("form", "flatness", "size"):
        return error / 2 * breast_area_mm2(volume_cc) / _PER_MM3
    return volume_cc * (error / reference if quantity == "volume" else (1 + error / reference) ** 3 - 1)
