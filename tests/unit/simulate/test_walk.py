"""A virtual walk: the board as an object, the telephone's positions, the photographs and their truth."""

import json

import numpy as np
import pytest
from PIL import Image

from mammometry.api.photos import read_board
from mammometry.base.errors import SessionError
from mammometry.calibration.targets.sheet import DARK
from mammometry.calibration.targets.table import target_from_table
from mammometry.geometry import Camera, Transform
from mammometry.simulate.disturbances.registry import disturbed
from mammometry.simulate.disturbances.walks import still_walk
from mammometry.simulate.recipe import parse_situation
from mammometry.simulate.rendering.printed_board import bank_card, printed_board
from mammometry.simulate.rigs.poses import looking
from mammometry.simulate.walk import WalkRecipe, smeared, write_walk
from mammometry.walk.region import TELEPHONE_BOARD, region_above

SMALL = WalkRecipe(pictures=2, scale=0.12)
"""One photograph from either side, 484 × 363 pixels: a square of the board is about 14 pixels wide."""


@pytest.fixture(scope="module")
def walk(tmp_path_factory):
    folder = tmp_path_factory.mktemp("walk") / "walk"
    return write_walk(folder, SMALL), json.loads((folder / "truth/truth.json").read_text())


def test_the_faces_of_a_printed_board_are_its_print():
    body = target_from_table(TELEPHONE_BOARD).body
    pose = Transform.from_rotation_vector(np.array([0.3, -0.2, 0.1]), np.array([5.0, -7.0, 40.0]))
    board = printed_board(body, pose)
    corners = pose.inverse().apply(board.props.vertices)[board.props.faces]
    assert np.abs(corners[..., 2]).max() < 1e-9
    middles = corners.mean(axis=1)
    np.testing.assert_array_equal(board.props.material == 0, body.board.sheet().is_dark(middles[:, :2]))
    # The printed side faces −z, with faces that turn the same way, and together they are the paper.
    vectors = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (vectors[:, 2] < 0).all()
    assert -0.5 * vectors[:, 2].sum() == pytest.approx(np.prod(np.diff(body.paper_mm, axis=0)))
    dark_mm2 = -0.5 * vectors[board.props.material == 0, 2].sum()
    sheet = body.board.sheet()
    assert dark_mm2 == pytest.approx((sheet.rectangles[:, 2] * sheet.rectangles[:, 3]).sum())


def test_a_camera_looks_at_its_point_upright():
    centre, target = np.array([300.0, 150.0, 500.0]), np.array([10.0, -20.0, 90.0])
    camera = Camera(
        name="telephone",
        size_wh=(640, 480),
        matrix=np.array([[500.0, 0.0, 319.5], [0.0, 500.0, 239.5], [0.0, 0.0, 1.0]]),
        distortion=np.zeros(5),
        camera_from_world=looking(centre, target),
    )
    np.testing.assert_allclose(camera.centre_world, centre, atol=1e-9)
    at, above = camera.project(np.array([target, target + np.array([0.0, 10.0, 0.0])]))
    np.testing.assert_allclose(at, [319.5, 239.5], atol=1e-9)
    assert above[0] == pytest.approx(at[0])
    assert above[1] < at[1]
    rolled = looking(centre, target, roll_rad=0.1)
    assert np.linalg.det(rolled.rotation) == pytest.approx(1.0)
    assert rolled.rotation[0] @ looking(centre, target).rotation[0] == pytest.approx(np.cos(0.1))


@pytest.mark.slow
def test_the_board_is_photographed_where_the_truth_says(walk):
    made, truth = walk
    body = target_from_table(TELEPHONE_BOARD).body
    body_from_board = Transform.from_matrix(np.array(truth["board_pose"]))
    rows, columns = np.nonzero(body.pattern.cells[:, :, 0, 0] == DARK)
    dark = np.stack([columns + 0.5, rows + 0.5, np.zeros(len(rows))], axis=1) * body.pattern.pitch_mm
    across = np.linspace(body.paper_mm[0, 0], body.paper_mm[1, 0], 20)
    border = np.stack([across, np.full(20, 0.5 * body.paper_mm[0, 1]), np.zeros(20)], axis=1)[1:-1]
    for name, camera in made.cameras.items():
        with Image.open(made.folder / f"photos/{name}.jpg") as picture:
            grey = np.asarray(picture.convert("L"))
        ink, paper = (_at(grey, camera, body_from_board.apply(points)) for points in (dark, border))
        assert ink.max() < 0.6 * paper.min()


def _at(grey, camera, points):
    column, row = np.rint(camera.project(points)).astype(int).T
    return grey[row, column].astype(float)


@pytest.mark.slow
def test_both_breasts_are_in_the_region_above_the_board(walk):
    made, truth = walk
    region = region_above(read_board(made.folder / "photos"))
    nipples = Transform.from_matrix(np.array(truth["board_pose"])).inverse().apply(np.array(truth["nipples"]))
    assert region.contains(nipples).all()
    assert set(truth["true_volumes_cc"]) == {"left", "right"} == set(made.true_volumes_cc)


def test_a_walks_disturbances_change_what_they_say():
    walk = disturbed(still_walk(200), "walk", parse_situation("breath=0.4,autofocus=0.5,misprint=-1"), seed=3)
    assert np.abs(walk.breath_mm).max() <= 0.4
    assert walk.breath_mm.std() == pytest.approx(0.4 / np.sqrt(3.0), rel=0.15)
    assert walk.focal.std() == pytest.approx(0.005, rel=0.15)
    assert walk.print_scale == pytest.approx(0.99)
    assert not walk.card
    assert disturbed(walk, "walk", parse_situation("card=white"), seed=3).card == "white"


def test_blur_ghosts_breaths_and_the_prints_form_are_what_they_say():
    said = "unsharp=4,ghost=10,two-breaths=0.6,stretched=0.5,bowed=2"
    walk = disturbed(still_walk(40), "walk", parse_situation(said), seed=3)
    assert 2.0 < walk.blur_px.max() <= 4.0
    shifts = np.linalg.norm(walk.ghost_px, axis=1)
    assert sorted(set(shifts.round(9))) == [0.0, 10.0]
    assert np.count_nonzero(shifts) == 10
    assert walk.breath_mm.tolist() == [0.0] * 20 + [0.6] * 20
    flat, formed = (
        printed_board(target_from_table(TELEPHONE_BOARD).body, Transform.identity(), **form).props.vertices
        for form in ({}, {"stretch": walk.stretch, "bow_mm": walk.bow_mm})
    )
    assert np.ptp(formed[:, 0]) == pytest.approx(1.005 * np.ptp(flat[:, 0]))
    assert np.ptp(formed[:, 1]) == pytest.approx(np.ptp(flat[:, 1]))
    edges = np.isin(flat[:, 0], (flat[:, 0].min(), flat[:, 0].max()))
    assert np.allclose(formed[edges, 2], 0.0)
    assert formed[:, 2].min() == pytest.approx(-2.0, abs=0.05)  # towards the reader


def test_smearing_has_the_stated_width():
    image = np.zeros((61, 61, 3), np.float32)
    image[30, 30] = 1.0
    blurred = smeared(image, 3.0, np.zeros(2))[:, :, 0]
    across = np.arange(61) - 30.0
    assert (blurred.sum(axis=0) * across**2).sum() == pytest.approx(9.0, rel=0.02)
    doubled = smeared(image, 0.0, np.array([5.0, -2.0]))[:, :, 0]
    assert doubled[30, 30] == doubled[28, 35] == 0.5
    assert smeared(image, 0.0, np.zeros(2)) is image


def test_a_bank_card_is_a_box_before_the_board():
    pose = Transform.from_rotation_vector(np.array([0.3, -0.2, 0.1]), np.array([5.0, 6.0, 7.0]))
    card = bank_card(np.array([50.0, 40.0]), 0.02, pose, 0.3).props
    points = pose.inverse().apply(card.vertices)
    corners = points[card.faces]
    outwards = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    volume_mm3 = np.einsum("ij,ij->i", corners[:, 0] - [50.0, 40.0, 0.0], outwards).sum() / 6  # its base is in z = 0
    assert volume_mm3 == pytest.approx(85.60 * 53.98 * 0.76)
    assert np.ptp(points[:, 2]) == pytest.approx(0.76)
    assert points[:, 2].min() < -0.7  # towards the reader
    normals = pose.inverse().rotate(card.normals)[card.faces[:, 0]]
    assert (np.einsum("ij,ij->i", normals, outwards) > 0).all()


def test_a_rigs_disturbance_and_a_cast_are_refused(tmp_path):
    for recipe in (WalkRecipe(situation=parse_situation("drift=0.02")), WalkRecipe(subject="plaster_2")):
        with pytest.raises(SessionError):
            write_walk(tmp_path / "walk", recipe)
    assert not list(tmp_path.iterdir())
