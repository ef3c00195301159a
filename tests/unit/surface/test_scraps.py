"""What flies about the subject, or lies far behind it, is left out of its range data."""

import numpy as np

from mammometry.geometry.camera import Camera
from mammometry.geometry.transform import Transform
from mammometry.surface.ranges.dents import subject_data
from mammometry.surface.ranges.range_image import RangeImage

SHAPE = (90, 120)
V, U = np.mgrid[: SHAPE[0], : SHAPE[1]]
BODY, SCRAP, WALL = np.hypot(U - 60, V - 45) < 28, np.hypot(U - 105, V - 12) < 3, V > 78


def view(depth_mm: np.ndarray, valid: np.ndarray) -> RangeImage:
    camera = Camera(
        name="left",
        size_wh=(SHAPE[1], SHAPE[0]),
        matrix=np.array([[200.0, 0.0, 59.5], [0.0, 200.0, 44.5], [0.0, 0.0, 1.0]]),
        distortion=np.zeros(5),
        camera_from_world=Transform.identity(),
    )
    rays = np.stack([(U - 59.5) / 200, (V - 44.5) / 200, np.ones(SHAPE)], axis=-1)
    ranges = np.where(valid, depth_mm * np.linalg.norm(rays, axis=-1), 0.0).astype(np.float32)
    even = np.where(valid, 0.5, 0.0).astype(np.float32)
    return RangeImage(name="one", camera=camera, range_mm=ranges, sigma_mm=even, confidence=even, valid=valid)


def test_a_small_piece_that_touches_the_subject_nowhere_is_left_out() -> None:
    image = view(np.where(SCRAP, 540.0, 600.0), BODY | SCRAP)
    for blind in ((), ("one",)):
        (keep,) = subject_data([image], blind, np.array([0.0, 0.0, 600.0]))
        assert np.array_equal(keep, BODY)


def test_a_wall_far_behind_is_left_out_where_no_silhouette_is_known() -> None:
    """As large as the subject; without a middle, and with silhouettes, it stays."""
    wall = WALL | (V < 12)
    image = view(np.where(wall, 1200.0, 600.0), BODY | wall)
    (keep,) = subject_data([image], ["one"], np.array([0.0, 0.0, 600.0]))
    assert np.array_equal(keep, BODY)
    (keep,) = subject_data([image], (), np.array([0.0, 0.0, 600.0]))
    assert keep[BODY].all()
    assert keep[wall].any()


def test_pieces_of_two_views_that_lie_on_one_another_are_one() -> None:
    left, right = BODY & (U < 62), BODY & (U > 58)
    keep = subject_data([view(np.full(SHAPE, 600.0), left), view(np.full(SHAPE, 600.4), right)], ["one"], None)
    assert np.array_equal(keep[0], left)
    assert np.array_equal(keep[1], right)
    assert not subject_data([view(np.full(SHAPE, 600.0), np.zeros(SHAPE, dtype=bool))], ["one"], None)[0].any()
