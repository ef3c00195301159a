"""A ball is the subject whatever is behind it: its true silhouette is known in closed form."""

from dataclasses import replace

import numpy as np
import pytest
from alone import foreground
from ball_scene import RADIUS_MM, Look, photograph, rig
from tests.first_cases import first

from mammometry.base.photograph import Photograph
from mammometry.geometry.camera import Rig
from mammometry.geometry.transform import Transform
from mammometry.matching.coarse_stereo import coarse_depths, depth_seeds, smaller_camera, sort_depths, subject_middle
from mammometry.matching.foreground.seeded_segmentation import DepthSeeds, agreed

SKIN, DARK_SKIN, PLASTER = Look((0.75, 0.58, 0.5), 0.06), Look((0.36, 0.24, 0.18), 0.06), Look((0.7, 0.7, 0.68), 0.06)
DARK, WALL, SMOOTH_WALL = Look((0.06, 0.06, 0.06), 0.0), Look((0.8, 0.8, 0.78), 0.04), Look((0.8, 0.8, 0.78), 0.0)
TABLE = Look((0.75, 0.74, 0.7), 0.06)
FAR_MM, LAID_MM = 700.0, 20.0
AXES_MEET = rig()
RIG = replace(AXES_MEET, target_middle_world=np.zeros(3))


def seeds_of(rig: Rig, shots: list[Photograph]) -> tuple[DepthSeeds, ...]:
    depths = coarse_depths(rig, "one", (shots[0], shots[1]))
    assert depths is not None
    middle = subject_middle(rig, [depths])
    assert middle is not None
    return depth_seeds(sort_depths([depths], middle)[0])


def found(ball: Look, behind: Look, plane_z_mm: float) -> list[tuple[np.ndarray, np.ndarray]]:
    """Mask and truth of both photographs."""
    shots = [photograph(RIG.cameras[name], plane_z_mm, ball, behind) for name in RIG.pair_names["one"]]
    seeds = seeds_of(RIG, [shot for shot, _ in shots])
    masks = []
    for name, (shot, true) in zip(RIG.pair_names["one"], shots, strict=True):
        own = [one for one in seeds if one.camera == name]
        masks.append((foreground(shot, name, seeds=own).mask, true))
    return masks


@pytest.mark.parametrize("ball", first(1, [DARK_SKIN, SKIN]), ids=["dark skin", "skin"])
@pytest.mark.parametrize("wall", first(1, [WALL, SMOOTH_WALL]), ids=["textured", "smooth"])
def test_a_ball_before_a_pale_wall_is_the_subject(ball: Look, wall: Look) -> None:
    """Its outline is 520 px long: 1 % of the ball's area is half a pixel all around."""
    for mask, true in found(ball, wall, FAR_MM):
        assert np.count_nonzero(mask & ~true) < 0.02 * np.count_nonzero(true)
        assert np.count_nonzero(true & ~mask) < 0.02 * np.count_nonzero(true)


@pytest.mark.slow
def test_a_dark_ball_on_a_pale_table_is_the_subject() -> None:
    """The table goes through the ball nearly at its middle: as near as the ball itself, and a plane."""
    for mask, true in found(DARK_SKIN, TABLE, LAID_MM):
        assert np.count_nonzero(mask & ~true) < 0.03 * np.count_nonzero(true)
        assert np.count_nonzero(true & ~mask) < 0.03 * np.count_nonzero(true)


@pytest.mark.slow
@pytest.mark.parametrize("plane_z_mm", [FAR_MM, LAID_MM])
def test_before_a_dark_background_brightness_has_the_last_word(plane_z_mm: float) -> None:
    """The same outline, bit for bit, as without any stereo."""
    shots = [photograph(RIG.cameras[name], plane_z_mm, SKIN, DARK)[0] for name in RIG.pair_names["one"]]
    seeds = seeds_of(RIG, shots)
    assert {one.camera for one in seeds} == set(RIG.cameras)
    for name, shot in zip(RIG.pair_names["one"], shots, strict=True):
        own = [one for one in seeds if one.camera == name]
        alone, both = foreground(shot, name), foreground(shot, name, seeds=own)
        assert np.array_equal(alone.coverage, both.coverage)


@pytest.mark.parametrize("contrast", first(1, [PLASTER.contrast, 0.0]), ids=["textured", "smooth"])
def test_of_what_colour_does_not_part_from_its_background_no_silhouette_is_known(contrast: float) -> None:
    """Plaster before a wall of the same colour and light: everything is matched."""
    for mask, _ in found(PLASTER, replace(PLASTER, contrast=contrast), FAR_MM):
        assert mask.all()


def test_what_the_subject_lies_on_is_not_taken_with_it() -> None:
    """Near all over, as a cast and the board under it: the disc that is brighter stays the subject, bit for bit."""
    v, u = np.mgrid[:120, :160]
    disc = np.hypot(u - 80, v - 60) < 30
    rng = np.random.default_rng(0)
    light = np.where(disc, 0.7, 0.3) * rng.uniform(0.9, 1.1, disc.shape)
    encoded = (light[..., None] * [1.0, 0.8, 0.7]).astype(np.float32)
    seeds = DepthSeeds(camera="a", step=2, near=np.ones((120, 160), dtype=bool), far=np.zeros((120, 160), dtype=bool))
    assert agreed(encoded, disc, [seeds], 2, 0.5) is disc


@pytest.mark.requirement("R-MASK-1")
@pytest.mark.parametrize(("beside", "kept"), [("rim", True), ("strip", False)])
def test_a_rim_of_a_block_is_no_contradiction_of_a_small_subject(beside: str, kept: bool) -> None:
    """Its penumbra is a fifth of its area, a block or two wide. As much in one piece is another thing."""
    v, u = np.mgrid[:120, :160]
    disc = np.hypot(u - 80, v - 60) < 20
    rim = (np.hypot(u - 80, v - 60) < 22) & ~disc
    strip = (np.abs(v - 60) < 12) & (u >= 98) & (u < 112) & ~disc
    added = rim if beside == "rim" else strip
    assert 0.15 < np.count_nonzero(added) / np.count_nonzero(disc) < 0.3
    light = np.where(disc, 0.7, np.where(added, 0.15, 0.05)) * np.random.default_rng(0).uniform(0.9, 1.1, disc.shape)
    encoded = (light[..., None] * [1.0, 0.8, 0.7]).astype(np.float32)
    near = np.hypot(u - 80, v - 60) < 18
    seeds = DepthSeeds(camera="a", step=2, near=near, far=np.hypot(u - 80, v - 60) > 30)
    subject = agreed(encoded, disc | added, [seeds], 2, 0.5)
    assert subject is not None
    assert np.array_equal(subject, disc | added) is kept


def a_body_with(far: np.ndarray, bright: np.ndarray) -> np.ndarray | None:
    """Subject of a bright picture of which a ball is near, and `far` is far. Light falls off beside the ball."""
    v, u = np.mgrid[:120, :160]
    rng = np.random.default_rng(0)
    light = np.where(bright, np.where(u > 105, 0.4, 0.7), 0.03) * rng.uniform(0.9, 1.1, bright.shape)
    encoded = (light[..., None] * [1.0, 0.8, 0.7]).astype(np.float32)
    near = np.hypot(u - 60, v - 60) < 40
    return agreed(encoded, bright, [DepthSeeds(camera="a", step=2, near=near, far=far)], 2, 0.5)


def test_an_arm_held_away_from_the_camera_is_subject() -> None:
    """A part of it, 3 % of the subject, is as far as background. Depth must not cut the arm off there."""
    v, u = np.mgrid[:120, :160]
    arm = (np.abs(v - 60) < 12) & (u >= 60) & (u < 150)
    bright = (np.hypot(u - 60, v - 60) < 45) | arm
    strip = arm & (u > 123) & (u < 145)  # less 4 at its rim: 13 × 15 of 7,400
    assert a_body_with(strip, bright) is bright


def test_a_long_arm_hangs_on_the_body_by_a_neck() -> None:
    """It makes a fifth of the subject. What is as large and borders on the body along more of its rim is no arm."""
    v, u = np.mgrid[:120, :160]
    ball = np.hypot(u - 60, v - 60) < 41
    arm, board = (np.abs(v - 60) < 13) & (u >= 60) & (u < 155), (np.abs(v - 60) < 35) & (u >= 60) & (u < 125)
    far = (u > 103) & (u < 121) & (np.abs(v - 60) < 12)
    for beside, is_arm in ((arm, True), (board, False)):
        bright = ball | beside
        assert 0.2 < np.count_nonzero(beside & ~ball) / np.count_nonzero(bright) < 0.3
        assert (a_body_with(far & beside, bright) is bright) is is_arm


def test_a_part_that_a_rail_cuts_off_is_subject() -> None:
    """No seed is in it and it does not touch the rest, but it has its colour, and nothing says that it is far."""
    v, u = np.mgrid[:120, :160]
    bright = (np.hypot(u - 60, v - 60) < 41) | ((u > 108) & (u < 135) & (np.abs(v - 60) < 40))
    undisputed, far = (a_body_with(there, bright) for there in (np.zeros_like(bright), (u > 108) & (u < 135)))
    assert undisputed is bright
    assert far is not bright


def test_a_bright_wall_that_is_mostly_far_is_no_subject() -> None:
    v, u = np.mgrid[:120, :160]
    wall = u > 105
    subject = a_body_with(wall, (np.hypot(u - 60, v - 60) < 45) | wall)
    assert subject is None or not subject[:, 115:].any()


def test_seeds_are_where_they_say() -> None:
    """Most of the ball is near, none of it far; parts of the wall that one camera alone sees may match by chance."""
    shots = [photograph(RIG.cameras[name], FAR_MM, SKIN, WALL) for name in RIG.pair_names["one"]]
    for one, (_, true) in zip(seeds_of(RIG, [shot for shot, _ in shots]), shots, strict=True):
        ball = true[:: one.step, :: one.step][: one.near.shape[0], : one.near.shape[1]]
        assert (one.near & ball).sum() > 0.8 * ball.sum()
        assert not (one.far & ball).any()
        assert (one.far & ~ball).sum() > 0.3 * (~ball).sum()


@pytest.mark.parametrize(
    "turn_deg", first(1, [-9.0, 0.0, 7.2]), ids=["axes meet before it", "in it", "axes are parallel"]
)
@pytest.mark.parametrize("held", first(1, [np.zeros(3), None]), ids=["target seen", "no target seen"])
def test_the_subject_is_where_the_target_was_held_and_not_where_axes_meet(
    turn_deg: float, held: np.ndarray | None
) -> None:
    """Both cameras turned about the vertical; without a target the nearest things have the middle."""
    cameras = {}
    for name, camera in AXES_MEET.cameras.items():
        angle = np.radians(turn_deg if name.endswith("left") else -turn_deg)
        turn = Transform.from_rotation_vector(np.array([0.0, angle, 0.0]), np.zeros(3)).rotation
        rotation = turn @ camera.camera_from_world.rotation
        pose = Transform(rotation=rotation, translation_mm=-rotation @ camera.centre_world)
        cameras[name] = replace(camera, camera_from_world=pose)
    turned = replace(AXES_MEET, cameras=cameras, target_middle_world=held)
    shots = [photograph(camera, FAR_MM, SKIN, WALL) for camera in cameras.values()]
    depths = coarse_depths(turned, "one", (shots[0][0], shots[1][0]))
    assert depths is not None
    middle = subject_middle(turned, [depths])
    assert middle is not None
    assert np.linalg.norm(middle) <= RADIUS_MM
    for one, (_, true) in zip(depth_seeds(sort_depths([depths], middle)[0]), shots, strict=True):
        ball = true[:: one.step, :: one.step][: one.near.shape[0], : one.near.shape[1]]
        assert (one.near & ball).sum() > 0.7 * ball.sum()
        assert not (one.far & ball).any()


def test_a_smaller_camera_sees_blocks_where_their_middle_is() -> None:
    camera = RIG.cameras["one_left"]
    points = np.random.default_rng(0).uniform(-100, 100, (20, 3))
    small = smaller_camera(camera, 4)
    assert np.allclose(small.project(points), (camera.project(points) + 0.5) / 4 - 0.5)
    assert small.size_wh == (80, 60)
