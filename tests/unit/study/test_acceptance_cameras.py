"""A turned camera and a wrong lens are found with their size: artefacts triangulated with cameras that are not true.

Each point is projected by the true cameras and triangulated with the believed ones. The same is done with the exact
centres of the balls, so that the expected error does not depend on any fit.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tests.first_cases import first

from mammometry.geometry.camera import Camera
from mammometry.geometry.mesh import TriangleMesh
from mammometry.geometry.transform import Transform
from mammometry.simulate.subjects.artefacts import artefact_mesh
from mammometry.study.acceptance.artefacts import POSITIONS, VOLUME_MM, Bar, Limits, Plane
from mammometry.study.acceptance.evaluate import evaluate_mesh

BAR = Bar(distance_mm=300.0, distance_std_mm=0.01, diameter_mm=60.0, diameter_std_mm=0.01, source="drawn")
FLAT = Plane(flatness_std_mm=0.01, source="drawn")


def camera(name: str, x_mm: float) -> Camera:
    """A camera 900 mm in front of the working volume, looking at its middle."""
    centre = np.array([x_mm, 0.0, 900.0])
    ahead = -centre / np.linalg.norm(centre)
    right = np.cross(ahead, [0.0, 1.0, 0.0])
    right /= np.linalg.norm(right)
    turn = np.stack([right, np.cross(ahead, right), ahead])
    matrix = np.array([[4000.0, 0, 2000.0], [0, 4000.0, 1500.0], [0, 0, 1]])
    return Camera(
        name=name, size_wh=(4000, 3000), matrix=matrix, distortion=np.zeros(5),
        camera_from_world=Transform(rotation=turn, translation_mm=-turn @ centre),
    )  # fmt: skip


LEFT, RIGHT = camera("left", -150.0), camera("right", 150.0)


def turned(given: Camera, degrees: float) -> Camera:
    """The camera, turned about its own upright axis in its place."""
    turn = Rotation.from_euler("y", degrees, degrees=True).as_matrix() @ given.camera_from_world.rotation
    return replace(given, camera_from_world=Transform(rotation=turn, translation_mm=-turn @ given.centre_world))


def measured(points: np.ndarray, true: tuple[Camera, Camera]) -> np.ndarray:
    """Middle of the shortest line between the believed rays of what the true cameras see, mm."""
    one, other = (believed.rays_world(seen.project(points)) for believed, seen in zip((LEFT, RIGHT), true, strict=True))
    between = RIGHT.centre_world - LEFT.centre_world
    along = (one * other).sum(axis=1)
    a, b = one @ between, other @ between
    s, t = (a - along * b) / (1 - along**2), (along * a - b) / (1 - along**2)
    return (LEFT.centre_world + s[:, None] * one + RIGHT.centre_world + t[:, None] * other) / 2


TURNED = (LEFT, turned(RIGHT, 0.05))
LENS = (LEFT, replace(RIGHT, distortion=np.array([0.1, 0.0, 0.0, 0.0, 0.0])))


def test_true_cameras_give_the_true_points() -> None:
    points = np.random.default_rng(0).uniform(-150, 150, (50, 3))
    np.testing.assert_allclose(measured(points, (LEFT, RIGHT)), points, atol=1e-6)


@pytest.mark.requirement("R-ACCEPT-1")
@pytest.mark.parametrize("true", [TURNED, LENS], ids=["camera turned by 0.05°", "lens"])
@pytest.mark.parametrize("place", first(1, [0, 1, 2]))
def test_the_spacing_error_is_that_of_the_centres(true: tuple[Camera, Camera], place: int) -> None:
    position = POSITIONS["bar"][place]
    mesh = artefact_mesh(BAR, position, edge_mm=3.0)
    mesh = TriangleMesh(vertices=measured(mesh.vertices, true), faces=mesh.faces)
    spacing = evaluate_mesh(mesh, "bar", position.name, BAR, Limits()).findings[0]
    axis = np.array(position.axis) / np.linalg.norm(position.axis)
    ends = np.array(position.centre) * VOLUME_MM + np.outer([-150.0, 150.0], axis)
    expected = np.linalg.norm(np.diff(measured(ends, true), axis=0)) - 300.0
    assert abs(expected) > 0.05
    # A lens also deforms each ball, of which the front alone is seen: its fitted centre moves by up to 0.1 mm.
    assert spacing.error == pytest.approx(expected, abs=0.04 if true is TURNED else 0.12)


@pytest.mark.requirement("R-ACCEPT-1")
def test_a_wrong_lens_bends_the_plane() -> None:
    mesh = artefact_mesh(FLAT, POSITIONS["plane"][0])
    bent = TriangleMesh(vertices=measured(mesh.vertices, LENS), faces=mesh.faces)
    (flatness,) = evaluate_mesh(bent, "plane", "1", FLAT, Limits()).findings
    (true,) = evaluate_mesh(mesh, "plane", "1", FLAT, Limits()).findings
    inside = np.abs(mesh.vertices[:, :2]).max(axis=1) < 80.0
    points = measured(mesh.vertices[inside], LENS)
    rows = np.column_stack([points[:, :2], np.ones(len(points))])
    rest = points[:, 2] - rows @ np.linalg.lstsq(rows, points[:, 2], rcond=None)[0]
    assert true.error < 1e-6
    assert flatness.error == pytest.approx(np.ptp(rest), rel=0.5)  # of a smaller part, and of all points
    assert flatness.error > 0.05
