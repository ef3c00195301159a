"""ChArUco corners against exact pictures: bias, views that are partial, aslant, mirrored, or of something else."""

import json

import numpy as np
import pytest
from printed import camera, centred, charuco, develop, mirrored, radiance_of_board, read, turned

from mammometry.base.errors import SessionError
from mammometry.base.photograph import Photograph
from mammometry.calibration.detection.detect import detect_in
from mammometry.calibration.targets.kinds.charuco import CharucoTarget

BOARD = CharucoTarget(squares=(8, 6), square_mm=25.0, marker_mm=18.0, dictionary="DICT_5X5_250")
MIDDLE = centred(BOARD.points_target)


def board_in_view(view, points=BOARD.points_target):
    """Where the corners are, the board's middle being the world's origin."""
    return view.project(MIDDLE.apply(points))


def radiance(view, target=BOARD):
    pattern = charuco(target)
    shift = MIDDLE.translation_mm
    return radiance_of_board(view, lambda x, y: pattern(x - shift[0], y - shift[1]))


def shoot(view, sigma_px=0.7):
    return develop(radiance(view), sigma_px)


def find(photograph, target=BOARD):
    return detect_in(photograph, target, camera="camera", pose="00")


@pytest.fixture(scope="module")
def straight():
    view = camera(turn_deg=(12.0, -9.0, 4.0))
    light = radiance(view)
    return view, develop(light), light


@pytest.mark.slow
@pytest.mark.parametrize(
    ("turn_deg", "sigma_px", "distortion"),
    [
        pytest.param((38.0, 20.0, 77.0), 0.9, (0.0, 0.0, 0.0, 0.0, 0.0), marks=pytest.mark.slow),
        pytest.param((-30.0, 34.0, 181.0), 0.6, (-0.12, 0.1, 0.001, -0.001, 0.0), marks=pytest.mark.slow),
        ((5.0, -45.0, -20.0), 1.1, (0.0, 0.0, 0.0, 0.0, 0.0)),
    ],
)
def test_corners_are_where_they_are_projected(turn_deg, sigma_px, distortion):
    view = camera(turn_deg=turn_deg, distortion=distortion)
    found = find(shoot(view, sigma_px=sigma_px))
    assert len(found.ids) > 0.9 * len(BOARD.points_target)
    error = found.uv - board_in_view(view)[found.ids]
    # 8-bit rounding alone leaves about 0.003 px; systematic error is what the calibration cannot average away.
    assert np.abs(error.mean(axis=0)).max() < 0.005
    assert np.sqrt(np.square(error).mean()) < 0.02
    assert np.abs(error).max() < 0.08


@pytest.mark.slow
def test_a_board_half_outside_the_frame_gives_the_corners_inside():
    view = camera(turn_deg=(12.0, -9.0, 4.0), at=(120.0, 60.0, 500.0))
    found = find(shoot(view))
    expected = board_in_view(view)
    inside = ((expected > 12) & (expected < np.array(view.size_wh) - 13)).all(axis=1)
    assert 8 < inside.sum() < 30
    assert set(np.flatnonzero(inside)) - set(found.ids.tolist()) == set()
    assert np.abs(found.uv - expected[found.ids]).max() < 0.1


@pytest.mark.slow
@pytest.mark.parametrize("degrees", [68.0, 76.0, 84.0])
def test_very_oblique_views_lose_corners_but_invent_none(degrees):
    view = camera(turn_deg=(0.0, degrees, 10.0))
    found = find(shoot(view, sigma_px=0.8))
    if found is not None:
        error = found.uv - board_in_view(view)[found.ids]
        assert np.abs(error).max() < 0.25
        whitened = np.einsum("ni,nij,nj->n", error, np.linalg.inv(found.covariance_px2), error)
        assert np.median(whitened) < 8


@pytest.mark.slow
def test_covariance_matches_the_scatter_under_noise(straight, monkeypatch):
    view, _, light = straight
    expected = board_in_view(view)
    whitened = []
    for seed in range(3):
        monkeypatch.setattr("mammometry.calibration.detection.detect._FLOOR_PX", 1e-4)
        found = find(develop(light, noise=0.02, seed=seed))
        error = found.uv - expected[found.ids]
        whitened.append(np.einsum("ni,nij,nj->n", error, np.linalg.inv(found.covariance_px2), error))
    # Mean of χ² with 2 degrees of freedom over 3 × 35 corners: 2 ± 0.2; rounding and lens terms add a little.
    assert 1.2 < np.concatenate(whitened).mean() < 3.5


def test_a_mirrored_photograph_is_no_board(straight):
    assert find(mirrored(straight[1])) is None


def test_a_photograph_turned_by_a_quarter_has_the_same_corners(straight):
    view, photograph, _ = straight
    upright, lying = find(photograph), find(turned(photograph, 1))
    # rot90 counterclockwise: (u, v) → (v, width − 1 − u).
    back = np.stack([view.size_wh[0] - 1 - lying.uv[:, 1], lying.uv[:, 0]], axis=1)
    common, i, j = np.intersect1d(upright.ids, lying.ids, return_indices=True)
    assert len(common) == len(upright.ids)
    assert np.abs(upright.uv[i] - back[j]).max() < 0.02


def test_another_dictionary_or_a_blank_picture_is_no_board(straight):
    other = CharucoTarget(squares=(8, 6), square_mm=25.0, marker_mm=18.0, dictionary="DICT_4X4_250")
    assert find(straight[1], other) is None
    assert find(Photograph(name="blank", pixels=np.full((384, 512, 3), 128, np.uint8))) is None
    assert (
        find(Photograph(name="grey noise", pixels=np.random.default_rng(1).integers(0, 255, (480, 640), np.uint8)))
        is None
    )


def test_a_16_bit_photograph_gives_the_same_corners(straight):
    _, photograph, light = straight
    eight, sixteen = find(photograph), find(develop(light, bits=16))
    assert np.array_equal(eight.ids, sixteen.ids)
    assert np.abs(eight.uv - sixteen.uv).max() < 0.01


def test_an_unknown_dictionary_is_named():
    target = CharucoTarget(squares=(8, 6), square_mm=25.0, marker_mm=18.0, dictionary="DICT_9X9")
    with pytest.raises(SessionError, match="DICT_9X9"):
        find(Photograph(name="blank", pixels=np.zeros((48, 64), np.uint8)), target)


def test_a_dictionary_with_too_few_markers_is_named():
    target = CharucoTarget(squares=(14, 10), square_mm=25.0, marker_mm=18.0, dictionary="DICT_5X5_50")
    with pytest.raises(SessionError, match=r"\b70 markers"):
        find(Photograph(name="blank", pixels=np.zeros((48, 64), np.uint8)), target)


@pytest.mark.slow
@pytest.mark.data
def test_corners_of_an_independent_renderer(shared_data):
    folder = shared_data / "rendered"
    cameras = json.loads((folder / "truth" / "cameras.json").read_text())["cameras"]
    boards = json.loads((folder / "truth" / "boards.json").read_text())["rig_from_board"]
    target = CharucoTarget(squares=(14, 10), square_mm=25.0, marker_mm=18.0, dictionary="DICT_5X5_250")
    errors = []
    for pose, name in (("00", "front_left"), ("02", "floor_right"), ("07", "front_left"), ("09", "left_right")):
        found = detect_in(read(folder / "calibration" / pose / f"{name}.jpg"), target, camera=name, pose=pose)
        truth, rig_from_board = cameras[name], np.array(boards[pose])
        points = (target.points_target @ rig_from_board[:3, :3].T + rig_from_board[:3, 3]) @ np.array(truth["R"]).T
        points += np.array(truth["t"])
        view = camera(size_wh=tuple(truth["image_size"]), distortion=truth["dist"])
        xy = view.pixels_from_normalised(points[:, :2] / points[:, 2:])
        k = np.array(truth["K"])
        uv = (xy - view.matrix[:2, 2]) / view.matrix[[0, 1], [0, 1]] * k[[0, 1], [0, 1]] + k[:2, 2]
        errors.append(found.uv - uv[found.ids])
    assert np.sqrt(np.square(np.concatenate(errors)).mean()) < 0.03


@pytest.mark.slow
@pytest.mark.parametrize("corners", [4, 6])
def test_a_few_corners_of_a_board_are_of_use(corners):
    """Of a board that leaves the picture: its markers say which corners they are."""
    view = camera(turn_deg=(10.0, 8.0, 3.0), at=(0.0, 0.0, 330.0))
    whole = shoot(view)
    columns = corners // 2
    at = np.arange(len(BOARD.points_target)).reshape(BOARD.squares[1] - 1, -1)[:2, :columns]
    last = board_in_view(view)[at[-1, -1]] + 0.55 * BOARD.square_mm * 900.0 / 330.0
    cropped = Photograph(name="a", pixels=np.ascontiguousarray(whole.pixels[: int(last[1]), : int(last[0])]))
    found = find(cropped)
    np.testing.assert_array_equal(found.ids, at.ravel())
    assert np.abs(found.uv - board_in_view(view)[found.ids]).max() < 0.1
