"""A breast's boundary from landmarks, by a named protocol.

The four borders are those of Wesselius (2018): inframammary fold, sternum, pectoral transition, axillary line. There is
a landmark on each: the fold's lowest point, the medial end beside the sternum, the lateral end on the axillary line,
and the upper end of the anterior axillary line, at whose height the pectoral muscle passes into the breast.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from mammometry.base.errors import MeasureError
from mammometry.geometry import Array, Float64, TriangleMesh
from mammometry.geometry.nearest import closest_on_mesh
from mammometry.measure.landmarks.geodesic import geodesic
from mammometry.measure.landmarks.landmarks import Landmark
from mammometry.measure.settings import ProtocolJoin
from mammometry.measure.trunk.skin_map import Relief, dense_samples, lay_flat
from mammometry.measure.trunk.thorax import Thorax, find_trunk, fit_thorax, seen_faces, seen_skin
from mammometry.surface.repair.repair import RepairedSurface

PROTOCOL = "wesselius2018-like"
"""Name of the protocol in results."""
NEEDED = ("inframammary_fold", "medial", "lateral", "anterior_axillary_line")
"""Required landmarks of one side."""
_JOINS: Mapping[ProtocolJoin, str] = {
    "arc": "quarter ellipses of the skin laid flat around the trunk, one a quadrant",
    "geodesic": "shortest paths over the skin",
}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ProtocolOutline:
    """A boundary from landmarks."""

    points_world: Float64[Array, "n 3"]
    """Closed curve on the surface, mm, world frame."""
    definition: str
    """The protocol's name, and its definition of the breast."""


def sides_of(landmarks: Mapping[str, object]) -> tuple[str, ...]:
    """Sides, ``left`` and ``right``, with all landmarks of the protocol."""
    return tuple(side for side in ("left", "right") if all(f"{name}_{side}" in landmarks for name in NEEDED))


def outline_by_protocol(
    landmarks: Sequence[Landmark], surface: RepairedSurface, frame: Float64[Array, "3 3"], join: ProtocolJoin
) -> dict[str, ProtocolOutline]:
    """Side (``left``, ``right``) → boundary, for each side with all landmarks.

    Args:
        landmarks: checked landmarks on the surface (`landmarks.picked_landmarks`).
        surface: the repaired mesh, mm, world frame.
        frame: patient's left, head, straight ahead (rows), approximately.
        join: how the landmarks are joined.

    Raises:
        MeasureError: no side has all landmarks, or they are not around a breast.
    """
    places = {landmark.name: landmark.points_world for landmark in landmarks}
    sides = sides_of(places)
    if not sides:
        have = [side for side in ("left", "right") if any(f"{name}_{side}" in places for name in NEEDED)] or ["left"]
        missing = [f"{name}_{have[0]}" for name in NEEDED if f"{name}_{have[0]}" not in places]
        raise MeasureError(
            f"landmarks of the {have[0]} breast",
            found=f"no {', '.join(missing)}",
            expected=f"for the protocol {PROTOCOL}: {', '.join(NEEDED)}",
            remedy="Pick them, or draw the boundary",
        )
    ends = np.concatenate([places[f"{name}_{side}"] for side in sides for name in ("medial", "lateral")])
    skin = seen_skin(surface)
    trunk = find_trunk(skin, frame, height_of=ends.mean(axis=0))
    thorax = fit_thorax(trunk, skin, breasts_left_out=False)
    relief = lay_flat(thorax, dense_samples(surface.mesh.submesh(seen_faces(surface))))
    return {side: _outline(side, places, thorax, relief, surface.mesh, join) for side in sides}


def _outline(
    side: str,
    places: Mapping[str, Float64[Array, "_ 3"]],
    thorax: Thorax,
    relief: Relief,
    mesh: TriangleMesh,
    join: ProtocolJoin,
) -> ProtocolOutline:
    fold, medial, lateral = (thorax.trunk.cylindrical(places[f"{name}_{side}"])[0, :2] for name in NEEDED[:3])
    line = thorax.trunk.cylindrical(places[f"anterior_axillary_line_{side}"])[:, :2]
    top = line[np.argmax(line[:, 1])]
    _check_order(side, fold, medial, lateral, top)
    if join == "arc":
        world = _raised(_arcs(fold, medial, lateral, float(top[1])), relief, thorax)
    else:
        corners = np.stack([fold, lateral, top, np.array([medial[0], top[1]]), medial])
        stops = closest_on_mesh(_raised(corners, relief, thorax), mesh).points
        legs = [geodesic(mesh, a, b).points_world for a, b in zip(stops, np.roll(stops, -1, axis=0), strict=True)]
        world = np.concatenate([leg[:-1] for leg in legs])
    definition = (
        f"protocol {PROTOCOL}: the breast lies between the inframammary fold (lowest point), the sternum (medial end), "
        "the pectoral transition (height of the anterior axillary line's upper end) and the axillary line (lateral "
        f"end); these landmarks were picked, and joined by {_JOINS[join]}"
    )
    return ProtocolOutline(points_world=closest_on_mesh(world, mesh).points, definition=definition)


def _check_order(
    side: str, fold: Float64[Array, 2], medial: Float64[Array, 2], lateral: Float64[Array, 2], top: Float64[Array, 2]
) -> None:
    """Raise a MeasureError if landmarks are not around a breast."""
    outwards = 1.0 if side == "left" else -1.0
    between = sorted([medial[0] * outwards, lateral[0] * outwards])
    wrong = None
    if medial[0] * outwards >= lateral[0] * outwards:
        wrong = f"a medial end {abs(medial[0] - lateral[0]):.0f} mm lateral of the lateral end"
    elif not between[0] < fold[0] * outwards < between[1]:
        wrong = "a fold that is not between the medial and the lateral end"
    elif fold[1] >= min(medial[1], lateral[1]):
        wrong = "a fold that is not below the medial and the lateral end"
    elif top[1] <= max(medial[1], lateral[1]):
        wrong = "an anterior axillary line that ends below the medial or the lateral end"
    if wrong is not None:
        raise MeasureError(
            f"landmarks of the {side} breast",
            found=wrong,
            expected="landmarks around a breast: medial end, fold, lateral end, axillary line from the armpit down",
            remedy="Pick them again, and check that no two are swapped",
        )


def _arcs(
    fold: Float64[Array, 2], medial: Float64[Array, 2], lateral: Float64[Array, 2], top: float
) -> Float64[Array, "n 2"]:
    """Quarter ellipses through the protocol's four landmarks, on the flattened trunk, mm.

    They run from the fold through the lateral end, the top above the fold and the medial end. They are vertical at the
    medial and lateral end, and horizontal at fold and top.
    """
    upper = np.array([fold[0], top])
    quarter = np.arange(0.0, 90.0, 2.0) * np.pi / 180
    rise, run = (1 - np.cos(quarter))[:, None], np.sin(quarter)[:, None]

    def arc(level: Float64[Array, 2], upright: Float64[Array, 2]) -> Float64[Array, "k 2"]:
        return level + np.concatenate([(upright - level)[0] * run, (upright - level)[1] * rise], axis=1)

    def back(level: Float64[Array, 2], upright: Float64[Array, 2]) -> Float64[Array, "k 2"]:
        return np.concatenate([upright[None], arc(level, upright)[:0:-1]])

    return np.concatenate([arc(fold, lateral), back(upper, lateral), arc(upper, medial), back(fold, medial)])


def _raised(flat: Float64[Array, "n 2"], relief: Relief, thorax: Thorax) -> Float64[Array, "n 3"]:
    """World points on the innermost skin at flattened places, mm."""
    radius = thorax.radius_mm(flat) + relief.at(flat, relief.bulge_mm)
    return thorax.trunk.world(np.concatenate([flat, radius[:, None]], axis=1))
