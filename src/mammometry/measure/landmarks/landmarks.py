"""Anthropometric landmarks: their names and their places on one surface.

Picked landmarks are checked, not corrected: a landmark off the surface or on the wrong side of the patient is an error.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal, TypeAlias

import numpy as np

from mammometry.base.errors import MeasureError
from mammometry.base.value import value
from mammometry.geometry import Array, Float64, TriangleMesh

LandmarkKind: TypeAlias = Literal["point", "line"]

_SIDED: Mapping[str, tuple[str, LandmarkKind]] = {
    "nipple": ("nipple", "point"),
    "inframammary_fold": ("lowest point of the inframammary fold", "point"),
    "medial": ("medial end of the breast", "point"),
    "lateral": ("lateral end of the breast", "point"),
    "anterior_axillary_line": ("anterior axillary line", "line"),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class LandmarkName:
    """One landmark of the protocol."""

    name: str
    """Name in files: ``nipple_left``."""
    title: str
    """For the reader: "left nipple". Left and right are the patient's."""
    kind: LandmarkKind
    """One point, or several along a line."""


def _of_torso() -> tuple[LandmarkName, ...]:
    middle = (
        LandmarkName(name="sternal_notch", title="sternal notch", kind="point"),
        LandmarkName(name="midline", title="midline", kind="line"),
        LandmarkName(name="umbilicus", title="umbilicus", kind="point"),
    )
    sided = (
        LandmarkName(name=f"{name}_{side}", title=f"{side} {title}", kind=kind)
        for name, (title, kind) in _SIDED.items()
        for side in ("left", "right")
    )
    return (*middle, *sided)


LANDMARKS: Mapping[str, tuple[LandmarkName, ...]] = MappingProxyType(
    {"torso": _of_torso(), "model": (LandmarkName(name="nipple_model", title="nipple", kind="point"),), "surface": ()}
)
"""Kind of subject → its possible landmarks."""


PICKED_SIGMA_MM = 2.0
"""Standard uncertainty of a picked landmark along the skin, mm. Repeated picks on 3D scans scatter by 1 to 3."""
_OFF_SURFACE_MM = 10.0  # a landmark further off was picked on another surface or in another unit; not critical
_WRONG_SIDE_MM = 5.0  # tolerance beyond the midline, whose position is uncertain by this; not critical


@value(eq=False)
class Landmark:
    """A landmark's position, with its uncertainty.

    Raises:
        ValueError: there is no point, or one is not finite.
    """

    name: str
    """One of `LANDMARKS` (`mammometry.measure.landmarks.landmarks`)."""
    points_world: Float64[Array, "k 3"]
    """One point, or the corners of a line in order, mm, world frame."""
    method: str
    """How it was found, one sentence."""
    sigma_mm: float
    """Standard uncertainty along the skin, mm."""
    probability: float = 1.0
    """Probability that it exists: 1 if it was picked. Below `NippleSettings.least_probability` it is not used."""
    proposed: bool = False
    """Whether it was found automatically and is not confirmed yet."""

    def __post_init__(self) -> None:
        if not len(self.points_world) or not np.isfinite(self.points_world).all():
            raise ValueError(f"landmark {self.name} needs finite points, found {len(self.points_world)}")


def proposed_landmark(
    name: str, points_world: Float64[Array, "k 3"], how: str, sigma_mm: float, probability: float = 1.0
) -> Landmark:
    """A landmark that was found automatically, to be confirmed.

    Args:
        name: its name, e.g. ``nipple_left``.
        points_world: one point or several, mm.
        how: how it was found, as a noun phrase.
        sigma_mm: standard uncertainty of its position.
        probability: probability that it is this landmark.
    """
    return Landmark(
        name=name,
        points_world=points_world,
        method=f"proposed: {how}; to be confirmed by eye",
        sigma_mm=sigma_mm,
        probability=probability,
        proposed=True,
    )


def picked_landmarks(
    places: Mapping[str, Float64[Array, "k 3"]],
    mesh: TriangleMesh,
    frame: Float64[Array, "3 3"] | None,
    *,
    sigma_mm: float,
    middle_world: Float64[Array, 3] | None = None,
) -> tuple[Landmark, ...]:
    """Picked landmarks, projected onto the surface.

    Args:
        places: name → one point or the corners of a line, mm, world frame.
        mesh: the surface.
        frame: rows: the patient's left, the head, straight ahead; None if unknown.
        sigma_mm: standard uncertainty of a picked place, mm.
        middle_world: a point on the body's midline, mm, used if neither notch nor midline was picked.

    Raises:
        MeasureError: a landmark is off the surface or on the wrong side.
    """
    if not places:
        return ()
    from mammometry.geometry.nearest import closest_on_mesh  # loads compiled kernels

    nearest = closest_on_mesh(np.concatenate(list(places.values())), mesh)
    found, stop = [], 0
    for name, points in places.items():
        own = slice(stop, stop + len(points))
        stop = own.stop
        worst = float(nearest.distances_mm[own].max())
        if worst > _OFF_SURFACE_MM:
            raise MeasureError(
                f"landmark {name!r}",
                found=f"a point {worst:.0f} mm off the surface",
                expected=f"one within {_OFF_SURFACE_MM:.0f} mm of it",
                remedy="Pick it again; check that landmarks and surface are of the same session, and in millimetres",
                mesh_remedy="Pick it again; check that landmarks and mesh belong together, in millimetres",
            )
        found.append(
            Landmark(name=name, points_world=nearest.points[own], method="picked by hand, or loaded", sigma_mm=sigma_mm)
        )
    if frame is not None:
        _check_sides({landmark.name: landmark for landmark in found}, frame, middle_world)
    return tuple(found)


def _check_sides(
    landmarks: Mapping[str, Landmark], frame: Float64[Array, "3 3"], middle_world: Float64[Array, 3] | None
) -> None:
    """Raise a MeasureError for a left landmark on the patient's right, and the reverse."""
    across = {name: float(landmark.points_world.mean(axis=0) @ frame[0]) for name, landmark in landmarks.items()}
    central = [across[name] for name in ("sternal_notch", "midline") if name in across]
    if not central and middle_world is not None:
        central = [float(middle_world @ frame[0])]
    for name, place in across.items():
        stem, _, side = name.rpartition("_")
        if side not in ("left", "right"):
            continue
        opposite = "right" if side == "left" else "left"
        other = across.get(f"{stem}_{opposite}")
        middle = float(np.mean(central)) if central else None if other is None else (place + other) / 2
        if middle is None:
            continue
        beyond = (middle - place) * (1.0 if side == "left" else -1.0)
        if beyond > _WRONG_SIDE_MM:
            raise MeasureError(
                f"landmark {name!r}",
                found=f"a point {beyond:.0f} mm to the patient's {opposite} of the middle",
                expected=f"one on the patient's own {side}, which is on the {opposite} in a picture from the front",
                remedy="Swap the left and right landmarks, or pick it again",
            )
