"""Straight and geodesic lengths between landmarks, with standard uncertainties, and grades of ptosis.

A landmark's uncertainty is isotropic in the skin. A straight distance changes with the component along it. A geodesic
distance changes with all of it, since its gradient is a unit tangent.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.spatial import cKDTree

from mammometry.base.normal import COVERAGE_95
from mammometry.geometry import Array, Float64, TriangleMesh
from mammometry.geometry.nearest import point_tree
from mammometry.measure.landmarks.geodesic import geodesic
from mammometry.measure.landmarks.landmarks import Landmark
from mammometry.measure.volume.measurement import VolumeMeasurement

Place = tuple[float, float, float]
PtosisGrade = Literal["none", "I", "II", "III", "pseudoptosis"]
_SIDES = ("left", "right")
_GRADE_II_MM, _GRADE_III_MM, _AT_CONTOUR_MM, _PSEUDO_MM = 10.0, 30.0, 5.0, 20.0  # after Regnault, see `Ptosis`
_HEIGHTS = 41  # heights in the interval at which grades are evaluated


@dataclass(frozen=True, slots=True, kw_only=True)
class LinearMeasure:
    """One length between two landmarks."""

    name: str
    """``SN-N left``, ``N-IMF left``, ``N-N``, ``N-midline left``, ``base width left``."""
    title: str
    """Its name in reports."""
    straight_mm: float
    """Straight distance, mm."""
    straight_sigma_mm: float
    """Standard uncertainty of the straight distance, from that of the landmarks, mm."""
    geodesic_mm: float | None
    """Distance along the skin, mm. None if one end is not on the skin."""
    geodesic_sigma_mm: float | None
    """Standard uncertainty of the distance along the skin, mm."""
    ends_world: tuple[Place, Place]
    """Both ends, mm, world frame."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Ptosis:
    """Ptosis (sagging) of a breast, graded after Regnault (Clin Plast Surg 1976, 3:193)."""

    name: str
    """The patient's ``left`` or ``right``."""
    grade: PtosisGrade
    """Position of the nipple. none: above the fold. I: at its level or up to 1 cm below. II: 1 to 3 cm below. III: more
    than 3 cm below, or more than 1 cm below and within 5 mm of the breast's lowest contour. pseudoptosis: above the
    fold, and the breast reaches more than 2 cm below it."""
    likely: tuple[PtosisGrade, ...]
    """All grades within the 95 % intervals of the nipple's height over the fold and over the lowest contour."""
    nipple_below_fold_mm: float
    """Distance of the nipple below the fold, mm. Negative if it is above."""
    sigma_mm: float
    """Standard uncertainty of that distance, mm."""
    nipple_above_lowest_mm: float
    """Height of the nipple above the breast's lowest contour, mm."""


def linear_measures(
    landmarks: Mapping[str, Landmark],
    mesh: TriangleMesh,
    *,
    midline: tuple[Float64[Array, 3], Float64[Array, 3], float] | None = None,
) -> tuple[LinearMeasure, ...]:
    """All lengths that the landmarks allow.

    Args:
        landmarks: landmarks by name.
        mesh: the surface that they are on, mm, world frame.
        midline: a point and the unit normal of the mid-sagittal plane, and its standard uncertainty, mm. It replaces a
            midline that was not picked.

    Raises:
        MeasureError: the surface does not connect two landmarks.
    """
    skin = _Skin(tree=point_tree(mesh.vertices), normals=mesh.vertex_normals())
    pairs = [("N-N", "nipple to nipple", "nipple_left", "nipple_right")]
    for side in _SIDES:
        pairs += [
            (f"SN-N {side}", f"sternal notch to {side} nipple", "sternal_notch", f"nipple_{side}"),
            (f"N-IMF {side}", f"{side} nipple to fold", f"nipple_{side}", f"inframammary_fold_{side}"),
            (f"base width {side}", f"base width, {side}", f"medial_{side}", f"lateral_{side}"),
        ]
    found = [
        _between(name, title, landmarks[first], landmarks[second], mesh, skin)
        for name, title, first, second in pairs
        if first in landmarks and second in landmarks
    ]
    for side in _SIDES:
        nipple = landmarks.get(f"nipple_{side}")
        if nipple is None:
            continue
        name, title = f"N-midline {side}", f"{side} nipple to midline"
        line = landmarks.get("midline")
        if line is not None and (midline is None or not line.proposed):
            foot = _foot(nipple.points_world[0], line.points_world)
            foot_landmark = Landmark(
                name="midline",
                points_world=foot[None],
                method=line.method,
                sigma_mm=line.sigma_mm,
                proposed=line.proposed,
            )
            found.append(_between(name, title, nipple, foot_landmark, mesh, skin))
        elif midline is not None:
            point, normal, sigma = midline
            from_plane = float((nipple.points_world[0] - point) @ normal)
            foot = nipple.points_world[0] - from_plane * normal
            along = np.hypot(sigma, nipple.sigma_mm * _tangential(nipple, normal, skin))
            found.append(
                LinearMeasure(
                    name=name,
                    title=f"{title} (mid-sagittal plane)",
                    straight_mm=abs(from_plane),
                    straight_sigma_mm=float(along),
                    geodesic_mm=None,
                    geodesic_sigma_mm=None,
                    ends_world=(_place(nipple.points_world[0]), _place(foot)),
                )
            )
    return tuple(sorted(found, key=lambda measure: measure.name))


def ptosis(
    measured: VolumeMeasurement,
    up_world: Float64[Array, 3],
    nipple: Landmark,
    fold: Landmark | None,
    *,
    boundary_sigma_mm: float,
) -> Ptosis:
    """Grade of ptosis of one breast.

    Args:
        measured: the closed breast.
        up_world: unit vector towards the patient's head.
        nipple: nipple of this side.
        fold: lowest point of the inframammary fold; None: the boundary's lowest point.
        boundary_sigma_mm: standard uncertainty of the boundary, mm; used if there is no fold.
    """
    level = float((measured.boundary_world @ up_world).min() if fold is None else fold.points_world[0] @ up_world)
    place = float(nipple.points_world[0] @ up_world)
    lowest = float((measured.skin.vertices @ up_world).min())
    below, sigma = level - place, float(np.hypot(nipple.sigma_mm, boundary_sigma_mm if fold is None else fold.sigma_mm))
    spread = COVERAGE_95 * np.linspace(-1, 1, _HEIGHTS)
    heights, above = below + sigma * spread, place - lowest + nipple.sigma_mm * spread
    grades = [_grade(below, place - lowest, level - lowest)]
    grades += [_grade(float(height), float(over), level - lowest) for height in heights for over in above]
    return Ptosis(
        name=measured.name,
        grade=grades[0],
        likely=tuple(dict.fromkeys(grades)),
        nipple_below_fold_mm=below,
        sigma_mm=sigma,
        nipple_above_lowest_mm=place - lowest,
    )


def _grade(below_mm: float, above_lowest_mm: float, overhang_mm: float) -> PtosisGrade:
    if below_mm < 0:
        return "pseudoptosis" if overhang_mm > _PSEUDO_MM else "none"
    if below_mm < _GRADE_II_MM:
        return "I"
    return "III" if below_mm > _GRADE_III_MM or above_lowest_mm < _AT_CONTOUR_MM else "II"


def _between(
    name: str, title: str, first: Landmark, second: Landmark, mesh: TriangleMesh, skin: _Skin
) -> LinearMeasure:
    a, b = first.points_world[0], second.points_world[0]
    straight = float(np.linalg.norm(b - a))
    direction = (b - a) / max(straight, 1e-9)
    moved = [landmark.sigma_mm * _tangential(landmark, direction, skin) for landmark in (first, second)]
    return LinearMeasure(
        name=name,
        title=title,
        straight_mm=straight,
        straight_sigma_mm=float(np.hypot(moved[0], moved[1])),
        geodesic_mm=geodesic(mesh, a, b).length_mm,
        geodesic_sigma_mm=float(np.hypot(first.sigma_mm, second.sigma_mm)),
        ends_world=(_place(a), _place(b)),
    )


def _place(point: Float64[Array, 3]) -> Place:
    return float(point[0]), float(point[1]), float(point[2])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Skin:
    """Vertices of the surface in a search tree, and their normals."""

    tree: cKDTree
    normals: Float64[Array, "n 3"]


def _tangential(landmark: Landmark, direction: Float64[Array, 3], skin: _Skin) -> float:
    """Length of a unit vector's tangential component at a landmark."""
    normal = skin.normals[skin.tree.query(landmark.points_world[0])[1]]
    return float(np.linalg.norm(direction - normal * (direction @ normal)))


def _foot(place: Float64[Array, 3], line: Float64[Array, "k 3"]) -> Float64[Array, 3]:
    """Nearest point of a polyline."""
    if len(line) == 1:
        return line[0]
    a, step = line[:-1], np.diff(line, axis=0)
    share = ((place - a) * step).sum(axis=1) / np.maximum((step**2).sum(axis=1), 1e-12)
    feet = a + step * np.clip(share, 0.0, 1.0)[:, None]
    return np.asarray(feet[np.argmin(np.linalg.norm(feet - place, axis=1))])


def by_name(landmarks: Sequence[Landmark]) -> dict[str, Landmark]:
    """Landmarks by name."""
    return {landmark.name: landmark for landmark in landmarks}
