"""A breast bounded by landmarks, on a round trunk whose breasts end in circles that are known exactly."""

from functools import cache

import numpy as np
import pytest
from solids import as_surface
from trunks import LEFT, RADIUS_MM, RIGHT, edge_of, radius_mm, trunk_mesh, volume_cc

from mammometry.base.errors import MeasureError
from mammometry.measure.boundary.boundary import Boundary, landmark_boundaries
from mammometry.measure.boundary.protocol import PROTOCOL, sides_of
from mammometry.measure.settings import MeasureSettings, ProtocolJoin
from mammometry.measure.wall import chest_wall
from mammometry.measure.wall.open_breast import OpenBreast
from mammometry.surface.repair.repair import RepairedSurface

BREASTS = {"left": LEFT, "right": RIGHT}
Places = dict[str, np.ndarray]


@cache
def torso() -> RepairedSurface:
    mesh = trunk_mesh(3.0)
    return as_surface(mesh, mesh.vertices[:, 2] > -0.35 * RADIUS_MM)


def skin(theta: float, y: float) -> np.ndarray:
    r = float(radius_mm(np.array(theta), np.array(y)))
    return np.array([[r * np.sin(theta), y, r * np.cos(theta)]])


def landmarks() -> Places:
    """The true ones; the breast's edge is a circle on the unrolled skin."""
    places = {}
    for side, sign in (("left", 1.0), ("right", -1.0)):
        angle, height, reach, _ = BREASTS[side]
        places[f"medial_{side}"] = skin(angle - sign * reach / RADIUS_MM, height)
        places[f"lateral_{side}"] = skin(angle + sign * reach / RADIUS_MM, height)
        places[f"inframammary_fold_{side}"] = skin(angle, height - reach)
        aside = angle + sign * (reach + 6) / RADIUS_MM
        places[f"anterior_axillary_line_{side}"] = np.concatenate(
            [skin(aside, height + up) for up in (-20.0, 10.0, reach)]
        )
    return places


def drawn(places: Places, join: ProtocolJoin = "arc") -> dict[str, Boundary]:
    found = landmark_boundaries(places, torso(), np.eye(3), MeasureSettings(protocol_join=join))
    return {boundary.name: boundary for boundary in found}


def measured_cc(name: str, boundaries: dict[str, Boundary]) -> float:
    """Before the cylinder membrane: this torso's chest is a cylinder."""
    straight = MeasureSettings(wall="cylinder-membrane")
    drawn_now = tuple(boundaries.values())
    wall = chest_wall.fit(
        OpenBreast(boundary=boundaries[name], surface=torso(), boundaries=drawn_now, frame=np.eye(3), settings=straight)
    )
    return wall.closed.volume_mm3() / 1000


@pytest.mark.slow
def test_four_landmarks_on_a_circle_give_the_circle_and_its_volume() -> None:
    found = drawn(landmarks())
    assert list(found) == ["left", "right"]
    true = {name: edge_of(BREASTS[name], name) for name in BREASTS}
    for name, boundary in found.items():
        edge = edge_of(BREASTS[name], name, n=4000).points_world
        away = np.linalg.norm(boundary.points_world[:, None] - edge[None], axis=2).min(axis=1)
        assert away.max() < 2.5  # a pixel of the relief, half a face, and the trunk's axis
        assert measured_cc(name, found) == pytest.approx(measured_cc(name, true), rel=0.01)
        assert measured_cc(name, found) == pytest.approx(volume_cc(BREASTS[name]), rel=0.03)
        assert boundary.method.startswith(f"protocol {PROTOCOL}: ")
        for border in ("inframammary fold", "sternum", "pectoral transition", "axillary line", "quarter ellipses"):
            assert border in boundary.method


@pytest.mark.slow
def test_shortest_paths_go_past_every_corner_and_around_the_breast() -> None:
    places = landmarks()
    found = drawn(places, "geodesic")
    for name in BREASTS:
        curve = found[name].points_world
        for stem in ("medial", "lateral", "inframammary_fold"):
            corner = places[f"{stem}_{name}"][0]
            assert np.linalg.norm(curve - corner, axis=1).min() < 2.5
        closing = np.linalg.norm(curve - np.roll(curve, 1, axis=0), axis=1)
        assert closing.max() < 15  # closed: no leg is left out
        # The upper corners lie on the trunk, where skin is wall. A smooth cap has no fold to go around: the lower legs
        # cut across its edge, at most along chords of the circle, which leaves out a sixth.
        assert 0.8 < measured_cc(name, found) / volume_cc(BREASTS[name]) < 1.03
        assert "paths" in found[name].method


def test_one_side_alone_is_bounded_alone() -> None:
    one = {name: points for name, points in landmarks().items() if name.endswith("right")}
    assert sides_of(one) == ("right",)
    assert list(drawn(one)) == ["right"]


def test_missing_landmarks_are_named() -> None:
    places = landmarks()
    for side in BREASTS:
        del places[f"medial_{side}"], places[f"anterior_axillary_line_{side}"]
    with pytest.raises(MeasureError, match=r"breast: .*medial_left, anterior_axillary_line_left"):
        drawn(places)
    with pytest.raises(MeasureError, match=r"breast: .*\binframammary_fold_left"):
        drawn({})


def _exchanged(places: Places, first: str, second: str) -> Places:
    return {**places, first: places[second], second: places[first]}


@pytest.mark.parametrize(
    ("first", "second", "said"),
    [
        ("medial_left", "medial_right", "middle"),
        ("medial_left", "lateral_left", r"\d+ mm"),
        ("medial_left", "inframammary_fold_left", "fold"),
    ],
)
def test_landmarks_in_the_wrong_place_are_named(first: str, second: str, said: str) -> None:
    with pytest.raises(MeasureError, match=said):
        drawn(_exchanged(landmarks(), first, second))


def test_a_line_below_the_breast_is_no_axillary_line() -> None:
    places = landmarks()
    places["anterior_axillary_line_left"] = np.concatenate([skin(0.9, -60.0), skin(0.9, -90.0)])
    with pytest.raises(MeasureError, match=r"breast: .*anterior"):
        drawn(places)
    places = landmarks()
    places["inframammary_fold_left"] = skin(LEFT[0], LEFT[1] + LEFT[2])
    with pytest.raises(MeasureError, match=r"breast: .*\bfold"):
        drawn(places)
