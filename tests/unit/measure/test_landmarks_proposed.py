"""Landmarks proposed from shape: where they are, and nothing where nothing is seen."""

import numpy as np
import pytest
from scipy.spatial import Delaunay

from mammometry.geometry.mesh import TriangleMesh
from mammometry.measure.landmarks.landmarks import Landmark
from mammometry.measure.landmarks.proposals import EndSigmas, propose_ends, propose_on_midline

NOTCH, NAVEL = np.array([0.0, 170.0]), np.array([0.0, -190.0])
LOWEST, HIGHEST = -90.0, 100.0
SIGMAS = EndSigmas(lower_mm=2.0, medial_mm=2.0, lateral_mm=3.8)


def front(*hollows: tuple[np.ndarray, float], noise_mm: float = 0.0, groove_mm: float = 4.0) -> TriangleMesh:
    """A round chest with a groove over the breastbone, and these hollows with their depths."""
    x, y = (each.ravel() for each in np.meshgrid(np.arange(-100, 101, 3.0), np.arange(-240, 221, 3.0)))
    z = 60.0 - x**2 / 300 - groove_mm * np.exp(-((x / 17) ** 2))
    for middle, depth in hollows:
        z -= depth * np.exp(-((x - middle[0]) ** 2 + (y - middle[1]) ** 2) / 11.0**2)
    z += noise_mm * np.random.default_rng(4).normal(size=len(x))
    faces = Delaunay(np.stack([x, y], axis=1)).simplices.astype(np.int32)
    vertices = np.stack([x, y, z], axis=1)
    turned = TriangleMesh(vertices=vertices, faces=faces).face_vectors()[:, 2] < 0
    faces[turned] = faces[turned][:, ::-1]
    return TriangleMesh(vertices=vertices, faces=faces)


def proposed(mesh: TriangleMesh) -> dict[str, Landmark]:
    found = propose_on_midline(mesh, np.eye(3), np.zeros(3), 0.2, LOWEST, HIGHEST)
    return {mark.name: mark for mark in found}


@pytest.mark.parametrize("noise_mm", [0.0, 0.5])
def test_notch_and_navel_are_found_by_their_hollows(noise_mm):
    found = proposed(front((NOTCH, 7.0), (NAVEL, 4.0), noise_mm=noise_mm))
    assert set(found) == {"sternal_notch", "umbilicus", "midline"}
    notch, navel = (found[name].points_world[0] for name in ("sternal_notch", "umbilicus"))
    assert np.hypot(*(notch[:2] - NOTCH - [0, -6])) < 4.0  # the bone's edge, below the hollow's middle
    assert np.hypot(*(navel[:2] - NAVEL)) < 4.0
    assert all(mark.proposed and mark.sigma_mm > 0 for mark in found.values())


def test_a_hollow_in_skin_that_no_camera_saw_is_not_proposed():
    mesh = front((NOTCH, 7.0), (NAVEL, 4.0))
    invented = np.hypot(*(mesh.vertices[:, :2] - NAVEL).T) < 15.0
    found = propose_on_midline(mesh, np.eye(3), np.zeros(3), 0.2, LOWEST, HIGHEST, claimed=~invented)
    assert {mark.name for mark in found} == {"sternal_notch", "midline"}


def test_a_groove_and_noise_are_no_hollow():
    assert set(proposed(front(noise_mm=0.5))) == {"midline"}


@pytest.mark.slow
def test_a_hollow_beside_the_midline_or_among_the_breasts_is_none_of_them():
    for place in ([30.0, 170.0], [0.0, 40.0], [0.0, -110.0], [25.0, -190.0]):
        assert set(proposed(front((np.array(place), 7.0)))) == {"midline"}


@pytest.mark.slow
def test_the_flank_of_a_hollow_below_the_breasts_is_no_navel():
    for below_mm in (30.0, 57.0, 68.0):  # the navel is looked for from 80 mm on
        assert set(proposed(front((np.array([0.0, LOWEST - below_mm]), 9.0)))) == {"midline"}


def test_the_midline_ends_at_the_notch_and_lies_on_the_skin():
    mesh = front((NOTCH, 7.0))
    line = proposed(mesh)["midline"].points_world
    assert np.abs(line[:, 0]).max() < 0.1
    assert line[:, 1].max() <= NOTCH[1]
    assert np.abs(line[:, 2] - 56.0).max() < 3.0


def test_another_frame_gives_the_same_places():
    mesh = front((NOTCH, 7.0), (NAVEL, 4.0))
    turn = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])  # rows: left is z, up is x, ahead is y of the world
    world = TriangleMesh(vertices=mesh.vertices @ turn, faces=mesh.faces)
    found = propose_on_midline(world, turn, np.zeros(3), 0.2, LOWEST, HIGHEST)
    own = proposed(mesh)
    for mark in found:
        assert np.allclose(mark.points_world @ turn.T, own[mark.name].points_world, atol=1e-6)


@pytest.mark.parametrize(("side", "sign"), [("left", 1.0), ("right", -1.0)])
def test_ends_of_a_boundary(side, sign):
    turn = np.linspace(0, 2 * np.pi, 200, endpoint=False)
    curve = np.stack([sign * 80 + 60 * np.cos(turn), 70 * np.sin(turn), 5 * np.cos(2 * turn)], axis=1)
    found = {mark.name: mark for mark in propose_ends(side, curve, np.eye(3), SIGMAS)}
    expected = {"inframammary_fold": (80, -70), "medial": (20, 0), "lateral": (140, 0)}
    for name, (x, y) in expected.items():
        mark = found[f"{name}_{side}"]
        assert np.hypot(mark.points_world[0, 0] - sign * x, mark.points_world[0, 1] - y) < 1.0
        assert 2.0 < mark.sigma_mm < 12.0  # along a round boundary its end is less sure than across


def test_a_flat_fold_has_an_unsure_lowest_point():
    corners = np.array([[0, 0, 0], [100, 0, 0], [100, 80, 0], [0, 80, 0]], dtype=float)
    curve = np.concatenate([np.linspace(corners[k], corners[(k + 1) % 4], 50, endpoint=False) for k in range(4)])
    fold = next(mark for mark in propose_ends("left", curve, np.eye(3), SIGMAS) if mark.name.startswith("infra"))
    assert fold.sigma_mm > 20.0


def test_ends_of_a_border_that_the_skin_hardly_shows_are_as_unsure_as_it_is():
    turn = np.linspace(0, 2 * np.pi, 200, endpoint=False)
    curve = np.stack([80 + 60 * np.cos(turn), 70 * np.sin(turn), 5 * np.cos(2 * turn)], axis=1)
    vague = np.where(np.cos(turn) < 0, 12.0, 0.0)  # towards the midline
    unsure = EndSigmas(lower_mm=2.0, medial_mm=2.0, lateral_mm=3.8, across_mm=vague)
    sure, own = (
        {mark.name: mark.sigma_mm for mark in propose_ends("left", curve, np.eye(3), s)} for s in (SIGMAS, unsure)
    )
    assert own["medial_left"] > np.hypot(12.0, sure["medial_left"]) > 1.5 * sure["medial_left"]
    assert own["lateral_left"] == pytest.approx(sure["lateral_left"], rel=0.01)
