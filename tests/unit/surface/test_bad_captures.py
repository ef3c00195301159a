"""Captures with something wrong: what can be said is said, in one sentence; the rest is closed plainly."""

import numpy as np
import pytest
from spheres import camera_towards, ellipsoid_range, range_image, rig_of, silhouette

from mammometry.base.errors import SurfaceError
from mammometry.geometry.transform import Transform
from mammometry.matching.foreground.foreground import Foreground
from mammometry.surface.fusion.fuse import extract
from mammometry.surface.ranges.dents import decompose, remove_dents
from mammometry.surface.repair.repair import Provenance, repair
from mammometry.surface.settings import DentSettings, ExtractSettings

RADII = (30.0, 30.0, 30.0)
FRONT = [(0, 0, 1), (0.6, 0, 1), (-0.6, 0, 1), (0, 0.8, 1)]
COARSE = ExtractSettings(cube_mm=1.0)


def captured():
    cameras = [camera_towards(f"c{k}", direction) for k, direction in enumerate(FRONT)]
    images = [range_image(camera, ellipsoid_range(camera, RADII)) for camera in cameras]
    return images, {camera.name: silhouette(camera, RADII) for camera in cameras}, rig_of(cameras)


def is_closed_ball(mesh):
    return mesh.is_watertight() and mesh.components()[0] == 1 and mesh.euler_number() == 2


@pytest.mark.slow
def test_one_view_empty():
    images, foregrounds, rig = captured()
    images[1] = images[1].keeping(np.zeros(images[1].valid.shape, dtype=bool))
    valid = remove_dents(images, decompose(images))
    result = repair(extract(valid.range_images, foregrounds, rig, COARSE), valid)
    assert is_closed_ball(result.mesh)
    assert (result.pair_bits & 0b0010 == 0).all()  # it measured nothing
    assert result.pair_bits.any()


def test_a_pair_in_another_frame_is_named():
    """A camera moved by two degrees after the calibration: its whole range image is turned about the camera."""
    images, foregrounds, rig = captured()
    camera = images[2].camera
    turn = np.radians(2.0)
    rotation = np.array([[np.cos(turn), 0, np.sin(turn)], [0, 1, 0], [-np.sin(turn), 0, np.cos(turn)]])
    true = camera.camera_from_world
    moved = Transform(rotation=rotation @ true.rotation, translation_mm=rotation @ true.translation_mm)
    believed = type(camera)(
        name=camera.name, size_wh=camera.size_wh, matrix=camera.matrix, distortion=camera.distortion,
        camera_from_world=moved,
    )  # fmt: skip
    images[2] = range_image(believed, np.where(images[2].valid, images[2].range_mm, np.nan), name="c2")
    with pytest.raises(SurfaceError, match=r"c1 and c2: .*7\.0 mm"):
        extract(images, foregrounds, rig, COARSE)


def test_a_pair_that_saw_only_background_is_named():
    """The fourth pair matched the wall behind: its own foreground is unknown, the others' are not."""
    images, foregrounds, rig = captured()
    camera = images[3].camera
    uv = np.stack(np.meshgrid(np.arange(120.0), np.arange(120.0)), axis=-1)
    rays = camera.rays_world(uv)
    to_wall = (-60.0 - camera.centre_world[2]) / rays[..., 2]
    images[3] = range_image(camera, to_wall, name="c3")
    everything = np.ones(camera.shape_hw, dtype=np.float32)
    foregrounds["c3"] = Foreground(camera="c3", coverage=everything, contour_level=0.5, everything=True)
    with pytest.raises(SurfaceError, match=r"^pair c3: .*background"):
        extract(images, foregrounds, rig, COARSE)


def test_a_subject_outside_the_volume_that_all_see():
    """Nothing is in view of any pair."""
    images, foregrounds, rig = captured()
    away = [range_image(i.camera, ellipsoid_range(i.camera, RADII, centre=(400.0, 0, 0)), name=i.name) for i in images]
    with pytest.raises(SurfaceError, match="c0, c1, c2, c3: "):
        extract(away, foregrounds, rig, COARSE)


@pytest.mark.slow
def test_a_hole_as_big_as_the_subject_is_closed_and_called_invented(monkeypatch):
    """Only a rim of data around the subject is left; silhouettes and rim close it."""
    images, foregrounds, rig = captured()
    with np.errstate(invalid="ignore"):
        rims = [image.keeping(np.abs(image.points_world()[..., 2]) < 8.0) for image in images]
    valid = remove_dents(rims, decompose(rims), DentSettings(rule="none"))
    monkeypatch.setattr("mammometry.surface.repair.repair.BRIDGED_REACH_MM", 8.0)
    result = repair(extract(valid.range_images, foregrounds, rig, COARSE), valid)
    assert is_closed_ball(result.mesh)
    assert result.crossings == 0
    top = result.mesh.vertices[:, 2] > 25.0
    assert top.any()
    assert (result.provenance[top] == Provenance.INVENTED).all()
    # the silhouettes of four views hold what was not measured: it bulges, but not without bounds
    assert np.linalg.norm(result.mesh.vertices[top], axis=1).max() < 1.5 * 30.0
