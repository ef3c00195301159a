"""A breast whose nipple is lost: what rests on a nipple is left out, not invented."""

import numpy as np
import pytest
from solids import as_surface
from tests.first_cases import first
from trunks import LEFT, RIGHT, edge_of, radius_mm, trunk_mesh

from mammometry.measure.landmarks.landmarks import Landmark
from mammometry.measure.shape.anthropometry import Dimensions, dimensions, find_landmarks
from mammometry.measure.trunk.body import BodyDirections
from mammometry.measure.trunk.mirror_plane import MirrorPlane
from mammometry.measure.volume import volumes
from mammometry.measure.wall import chest_wall
from mammometry.measure.wall.open_breast import OpenBreast

FRAME = np.eye(3)
BODY = BodyDirections(frame=FRAME, point_world=np.zeros(3), plane_sigma_mm=None, scatter_mm=None)
MIDDLE = MirrorPlane(point_world=np.zeros(3), normal_world=FRAME[0], sigma_mm=0.1, scatter_mm=0.5)
AREOLA_MM = 17.0


def on_trunk(theta: float, y: float) -> np.ndarray:
    r = float(radius_mm(np.array(theta), np.array(y)))
    return np.array([[r * np.sin(theta), y, r * np.cos(theta)]])


def found_on(areolae: tuple[str, ...]) -> tuple[tuple[Landmark, ...], Dimensions]:
    """Landmarks and dimensions of a trunk with two breasts, of which these have an areola."""
    surface = as_surface(trunk_mesh(3.0))
    edges = (edge_of(LEFT, "left"), edge_of(RIGHT, "right"))
    measured = [
        volumes.measure(edge, chest_wall.fit(OpenBreast(boundary=edge, surface=surface, boundaries=edges), "membrane"))
        for edge in edges
    ]
    rng = np.random.default_rng(4)
    vertices = surface.mesh.vertices
    linear = np.array([0.55, 0.35, 0.27]) * rng.normal(1, 0.01, (len(vertices), 3))
    for breast in (LEFT, RIGHT):
        if ("left" if breast is LEFT else "right") in areolae:
            linear[np.linalg.norm(vertices - on_trunk(*breast[:2]), axis=1) < AREOLA_MM, 1:] *= 0.85
    colours = np.clip(255 * np.clip(linear, 0, 1) ** (1 / 2.2), 0, 255).astype(np.uint8)
    picked = {
        "sternal_notch": on_trunk(0.0, 150.0),
        "inframammary_fold_left": on_trunk(LEFT[0], LEFT[1] - LEFT[2]),
        "inframammary_fold_right": on_trunk(RIGHT[0], RIGHT[1] - RIGHT[2]),
    }
    marks = find_landmarks(surface, colours, measured, picked, BODY)
    return marks, dimensions(surface.mesh, measured, marks, FRAME, plane=MIDDLE)


@pytest.mark.parametrize("there", first(1, [(("left",),), (("left", "right"),), ((),)]))
def test_what_rests_on_a_nipple_is_only_there_with_the_nipple(there: tuple[str, ...]) -> None:
    marks, found = found_on(there)
    assert {mark.name for mark in marks if "nipple" in mark.name} == {f"nipple_{side}" for side in there}
    lengths = {measure.name for measure in found.lengths}
    for side in ("left", "right"):
        seen = side in there
        assert (f"SN-N {side}" in lengths) == seen
        assert (f"N-midline {side}" in lengths) == seen
        assert (side in {each.name for each in found.ptosis}) == seen
        shape = next(each for each in found.shapes if each.name == side)
        assert (shape.above_nipple_cc is not None) == seen
    assert ("N-N" in lengths) == (len(there) == 2)
    for measure in found.lengths:
        if measure.name == "SN-N left":
            straight = np.linalg.norm(on_trunk(*LEFT[:2]) - on_trunk(0.0, 150.0))
            assert measure.straight_mm == pytest.approx(straight, abs=6.0)  # an areola's middle is known to 4 mm
