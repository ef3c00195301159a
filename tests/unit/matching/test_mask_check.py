"""Silhouettes of a ball, right, inverted, too small or too large: those that do not fit the others are named."""

from dataclasses import replace

import numpy as np
import pytest
from ball_scene import RADIUS_MM, rig
from scipy import ndimage

from mammometry.geometry.camera import Rig
from mammometry.geometry.transform import Transform
from mammometry.matching.coarse_stereo import _textured
from mammometry.matching.foreground.all_cameras import check_masks

MIDDLE = np.zeros(3)


def three() -> Rig:
    """The rig of two, and a third camera above them that looks at the ball, too."""
    both = rig()
    turn = Transform.from_rotation_vector(np.array([0.35, 0.0, 0.0]), np.zeros(3))
    camera = both.cameras["one_left"]
    above = replace(camera, name="above", camera_from_world=camera.camera_from_world @ turn)
    pairs = {"one": ("one_left", "one_right"), "two": ("one_left", "above")}
    return Rig(name="three", cameras={**both.cameras, "above": above}, pair_names=pairs)


RIG = three()


def sphere(count: int = 3000) -> np.ndarray:
    points = np.random.default_rng(2).normal(size=(count, 3))
    return RADIUS_MM * points / np.linalg.norm(points, axis=1, keepdims=True)


def masks() -> dict[str, np.ndarray]:
    """The ball's true silhouettes, in pixels."""
    found = {}
    for name, camera in RIG.cameras.items():
        v, u = np.mgrid[: camera.size_wh[1], : camera.size_wh[0]]
        rays = camera.rays_world(np.stack([u, v], axis=-1).astype(np.float64))
        along = -(rays @ camera.centre_world)
        found[name] = camera.centre_world @ camera.centre_world - along**2 < RADIUS_MM**2
    return found


def doubted(changed: dict[str, np.ndarray], points: np.ndarray | None = None) -> set[str]:
    seen = [(set(RIG.pair_names["one"]), sphere() if points is None else points)]
    return set(check_masks(RIG, masks() | changed, dict.fromkeys(RIG.cameras, 1), seen, MIDDLE).doubts)


def test_right_silhouettes_are_all_kept_bit_for_bit() -> None:
    right = masks()
    steps = dict.fromkeys(RIG.cameras, 1)
    checked = check_masks(RIG, right, steps, [(set(RIG.pair_names["one"]), sphere())], MIDDLE)
    assert not checked.doubts
    assert all(np.array_equal(checked.masks[name], right[name]) for name in right)


@pytest.mark.parametrize("fault", ["inverted", "1 %", "everywhere"])
def test_a_silhouette_that_does_not_fit_the_others_is_named(fault: str) -> None:
    mask = masks()["above"]
    v, u = np.mgrid[: mask.shape[0], : mask.shape[1]]
    wrong = {"inverted": ~mask, "1 %": np.hypot(u - 30, v - 30) < 16, "everywhere": np.ones_like(mask)}[fault]
    assert doubted({"above": wrong}) == {"above"}
    if fault != "inverted":  # without points of the pairs, the silhouettes alone tell
        assert doubted({"above": wrong}, np.empty((0, 3))) == {"above"}


def test_silhouettes_that_are_all_inverted_hold_nothing_near() -> None:
    assert doubted({name: ~mask for name, mask in masks().items()}) == set(RIG.cameras)


@pytest.mark.requirement("R-MASK-1")
def test_what_stands_beside_the_subject_is_no_evidence_against_a_silhouette() -> None:
    """A rail hides half of the ball from the camera above, and as many points lie on things beside the ball."""
    mask = masks()["above"]
    half = mask & (np.arange(mask.shape[1]) > np.nonzero(mask)[1].mean())
    beside = sphere() + np.array([2.2 * RADIUS_MM, 0.0, 0.0])
    assert not doubted({"above": half}, np.concatenate([sphere(), beside]))


def test_silhouettes_that_agree_on_a_small_part_of_what_is_near_are_all_doubted() -> None:
    """A bright dressing on a body is seen alike by all: it is not the subject."""
    rng = np.random.default_rng(3)
    angle, away = rng.uniform(0, 2 * np.pi, 6000), RADIUS_MM * rng.uniform(1.1, 1.3, 6000)
    around = np.stack([away * np.cos(angle), away * np.sin(angle), rng.uniform(-20, 20, 6000)], axis=1)
    assert doubted({}, np.concatenate([sphere(2000), around])) == set(RIG.cameras)


def test_a_part_that_no_other_camera_sees_is_left_out() -> None:
    """A second disc beside the ball, in one picture alone."""
    mask = masks()["above"]
    v, u = np.mgrid[: mask.shape[0], : mask.shape[1]]
    beside = (np.hypot(u - 28, v - 120) < 22) & ~mask
    steps = dict.fromkeys(RIG.cameras, 1)
    seen = [(set(RIG.pair_names["one"]), sphere())]
    checked = check_masks(RIG, masks() | {"above": mask | beside}, steps, seen, MIDDLE)
    assert not checked.doubts
    assert np.array_equal(checked.masks["above"], mask)


def test_matches_in_a_black_room_are_no_evidence_against_a_silhouette() -> None:
    """Sensor noise, made smaller and rectified as coarse pictures are, beside a cast's mottled skin."""
    rng = np.random.default_rng(5)
    noise = ndimage.shift(rng.normal(0, 0.002, (120, 160)), 0.4).astype(np.float32)
    skin = ndimage.gaussian_filter(rng.normal(0, 1, (120, 160)), 2)
    textured = _textured(
        np.where(np.arange(160) < 80, noise, noise + 0.5 + 0.03 * skin / skin.std()).astype(np.float32)
    )
    assert textured[:, :70].mean() < 0.05
    assert textured[:, 90:].mean() > 0.95
