"""Slits between skin that faces the camera are spanned; gaps between things that end are not."""

import numpy as np
import pytest

from mammometry.geometry.camera import Camera
from mammometry.geometry.transform import Transform
from mammometry.surface.occlusion import points_world, spanned_mm

STEP = 2
BLOCKS = 120
FOCAL_PX = 400.0
MM_PER_BLOCK = STEP * 500.0 / FOCAL_PX  # 2.5 mm, 500 mm before the camera
AWAY = Transform.from_matrix(np.block([[np.eye(3), np.array([[10.0], [-20.0], [30.0]])], [np.zeros((1, 3)), 1.0]]))


def camera():
    middle = (STEP * BLOCKS - STEP) / 2
    return Camera(
        name="c",
        size_wh=(STEP * BLOCKS, STEP * BLOCKS),
        matrix=np.array([[FOCAL_PX, 0, middle], [0, FOCAL_PX, middle], [0, 0, 1.0]]),
        distortion=np.zeros(5),
        camera_from_world=AWAY,
    )


def rays():
    at = STEP * (np.arange(BLOCKS) - (BLOCKS - 1) / 2) / FOCAL_PX
    return np.meshgrid(at, at)


def plane_mm(slope):
    """Depth of z = 500 + slope · x."""
    return 500.0 / (1.0 - slope * rays()[0])


def ball_mm(centre, radius):
    """Depth of a ball's near side, infinite beside it."""
    x, y = rays()
    along = np.stack([x, y, np.ones_like(x)], axis=-1)
    a, b, c = (along**2).sum(-1), along @ np.array(centre), np.dot(centre, centre) - radius**2
    with np.errstate(invalid="ignore"):
        depth = (b - np.sqrt(b**2 - a * c)) / a
    return np.where(np.isfinite(depth), depth, np.inf)


@pytest.mark.parametrize("slope", [0.0, 0.5, -1.2])
@pytest.mark.parametrize("along", [False, True])
def test_a_strip_across_a_plane_is_spanned_by_the_plane(slope, along):
    """Inverse depth is linear on a plane, so what spans the strip is exact, whichever way the plane leans."""
    depth = plane_mm(slope)
    strip = np.zeros_like(depth, dtype=bool)
    strip[50:62] = True
    strip = strip.T if along else strip
    spans = spanned_mm(camera(), ~strip, STEP, np.where(strip, np.inf, depth))
    assert np.isfinite(spans[strip]).all()
    assert not np.isfinite(spans[~strip]).any()
    assert spans[strip] == pytest.approx(depth[strip], rel=1e-9)


def test_a_band_around_a_ball_is_spanned_along_the_ball():
    """Across 30 mm a chord of a ball of 150 mm is 30² / (8 · 150) = .75 mm off. The cubic continues both sides."""
    depth = ball_mm((0.0, 0.0, 650.0), 150.0)
    subject = np.isfinite(depth)
    strip = np.zeros_like(subject)
    strip[54:66, 35:85] = True
    spans = spanned_mm(camera(), subject & ~strip, STEP, np.where(strip, np.inf, depth))
    assert np.isfinite(spans[strip]).mean() > 0.95
    on = strip & np.isfinite(spans)
    assert np.abs(spans[on] - depth[on]).max() < 0.25


def test_the_gap_between_two_balls_is_background():
    """Arm and trunk: skin turns away on both sides of the gap."""
    left, right = (ball_mm((x, 0.0, 560.0), 55.0) for x in (-62.0, 62.0))
    depth = np.minimum(left, right)
    assert not np.isfinite(spanned_mm(camera(), np.isfinite(depth), STEP, depth)).any()


def test_a_gap_between_skin_at_different_depths_is_background():
    """Half of what is seen stands 60 mm before the other half, and 25 mm beside it."""
    depth = plane_mm(0.0)
    depth[60:] -= 60.0
    depth[55:65] = np.inf
    assert not np.isfinite(spanned_mm(camera(), np.isfinite(depth), STEP, depth)).any()


def test_what_is_as_wide_as_a_body_is_background():
    depth = plane_mm(0.0)
    depth[40:80] = np.inf  # 100 mm
    assert not np.isfinite(spanned_mm(camera(), np.isfinite(depth), STEP, depth)).any()


def test_skin_that_is_not_measured_up_to_the_slit_spans_nothing():
    depth = plane_mm(0.0)
    strip = np.zeros_like(depth, dtype=bool)
    strip[50:62] = True
    depth[40:72] = np.inf
    assert not np.isfinite(spanned_mm(camera(), ~strip, STEP, depth)).any()


def test_a_bent_outline_has_chords_and_no_slits():
    """A valley 60 mm wide and 5 mm deep in the outline of skin that faces the camera."""
    depth = plane_mm(0.0)
    column = np.arange(BLOCKS) - (BLOCKS - 1) / 2
    valley = 40 - np.minimum(2.0 * (column / 12) ** 2, 2.0)
    subject = np.arange(BLOCKS)[:, None] > valley
    assert not np.isfinite(spanned_mm(camera(), subject, STEP, depth)).any()


def test_points_lie_on_the_rays_of_their_blocks():
    depth = np.full((BLOCKS, BLOCKS), np.inf)
    depth[30, 70], depth[90, 5] = 480.0, 530.0
    points = points_world(camera(), STEP, depth)
    assert camera().project(points) == pytest.approx(np.array([[140.0, 60.0], [10.0, 180.0]]), abs=1e-9)
    assert AWAY.apply(points)[:, 2] == pytest.approx([480.0, 530.0])
