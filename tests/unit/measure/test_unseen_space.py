"""How far unseen skin could stand out, against a disc before one camera and a wall before one pair, by hand."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from solids import camera_at

from mammometry.geometry.camera import Rig
from mammometry.matching.foreground.foreground import Foreground
from mammometry.measure.settings import MeasureSettings
from mammometry.measure.volume.unseen_space import bounds, outward_room_mm
from mammometry.surface.ranges.range_image import RangeImage

AWAY_MM, FOCAL_PX, RADIUS_PX = 700.0, 900.0, 60.0
CAMERA = camera_at("front_left", np.array([0.0, 0.0, AWAY_MM]), FOCAL_PX)
RIG = Rig(name="one", cameras={"front_left": CAMERA}, pair_names={})
SETTINGS = MeasureSettings(silhouette_doubt_px=1.0, silhouette_doubt_slope=0.25, seen_through_mm=0.5)
FARTHEST_MM = 48.0
STEP_MM = FARTHEST_MM / 24


def disc(fading_px: float) -> Foreground:
    """A disc in the picture's middle; within 40° of straight below its light fades over so many pixels."""
    v, u = np.mgrid[: CAMERA.size_wh[1], : CAMERA.size_wh[0]].astype(float)
    u, v = u - CAMERA.matrix[0, 2], v - CAMERA.matrix[1, 2]
    inside = RADIUS_PX - np.hypot(u, v)
    below = np.abs(np.arctan2(u, v)) < np.deg2rad(40)
    share = np.where(below & (fading_px > 0), inside / max(fading_px, 1e-9), inside + 0.5).clip(0, 1)
    coverage = gaussian_filter(share, 0.7).astype(np.float32)
    return Foreground(camera="front_left", coverage=coverage, contour_level=0.5, everything=False)


def room_mm(views: object, start_px: float = 40.0) -> np.ndarray:
    """From points around the middle, in the plane across the line of sight: below, right, above, left."""
    outwards = np.array([[0.0, -1, 0], [1, 0, 0], [0, 1, 0], [-1, 0, 0]])
    return outward_room_mm(outwards * start_px * AWAY_MM / FOCAL_PX, outwards, views, np.full(4, FARTHEST_MM))  # type: ignore[arg-type]


def test_skin_may_stand_out_to_the_silhouette_and_its_doubt() -> None:
    found = room_mm(bounds({"front_left": disc(0.0)}, (), RIG, SETTINGS))
    wanted = (RADIUS_PX + 1.0 - 40.0) * AWAY_MM / FOCAL_PX
    assert found == pytest.approx(np.full(4, wanted), abs=STEP_MM)
    assert (found >= wanted - 0.8).all()  # half a pixel: which one shows a point


def test_the_border_of_a_shadow_bounds_the_less_the_longer_it_is() -> None:
    """It lies at half the light, 10 px inside; the edge was last seen 40° aside, 39 px along the outline."""
    lost, *sure = room_mm(bounds({"front_left": disc(20.0)}, (), RIG, SETTINGS))
    assert sure == pytest.approx([(RADIUS_PX + 1 - 40) * AWAY_MM / FOCAL_PX] * 3, abs=STEP_MM)
    chord = np.hypot(RADIUS_PX * np.sin(np.deg2rad(40)), RADIUS_PX * np.cos(np.deg2rad(40)) - 50)
    wanted = (50 + np.hypot(1.0, 0.25 * chord) - 40) * AWAY_MM / FOCAL_PX
    assert lost == pytest.approx(wanted, abs=STEP_MM + 1)
    trusting = replace(SETTINGS, silhouette_doubt_slope=0.0)
    assert room_mm(bounds({"front_left": disc(20.0)}, (), RIG, trusting))[0] < lost - 4


def test_nothing_bounds_where_no_silhouette_is_known() -> None:
    everything = replace(disc(0.0), everything=True)
    assert (room_mm(bounds({"front_left": everything}, (), RIG, SETTINGS)) == FARTHEST_MM).all()
    assert (room_mm(()) == FARTHEST_MM).all()


def test_a_pair_looks_through_what_stands_before_its_data() -> None:
    """A wall at z = −20 mm, known to 0.1 mm and not on the right: skin behind it may come out to .8 mm before it."""
    height, width = CAMERA.shape_hw
    v, u = np.mgrid[:height, :width].astype(float)
    rays = CAMERA.rays_world(np.stack([u, v], axis=-1).reshape(-1, 2)).reshape(height, width, 3)
    valid = u < CAMERA.matrix[0, 2] + 30
    image = RangeImage(
        name="front",
        camera=CAMERA,
        range_mm=np.where(valid, (AWAY_MM + 20) / -rays[..., 2], 0).astype(np.float32),
        sigma_mm=np.where(valid, 0.1, 0).astype(np.float32),
        confidence=np.ones((height, width), dtype=np.float32),
        valid=valid,
    )
    points = np.array([[0.0, 5.0, -40.0], [60.0, 0.0, -40.0]])
    towards = np.array([[0.0, 0, 1], [0, 0, 1]])
    found = outward_room_mm(points, towards, bounds({}, (image,), RIG, SETTINGS), np.full(2, FARTHEST_MM))
    assert found[0] == pytest.approx(20.8, abs=STEP_MM)
    assert found[1] == FARTHEST_MM
