"""Something before the subject: what silhouettes say there is taken back, and nowhere else."""

from dataclasses import replace

import numpy as np
import pytest
from spheres import camera_towards, ellipsoid_range, range_image, rig_of, silhouette

from mammometry.surface.fusion.fuse import extract
from mammometry.surface.occlusion import _joined, find_occlusions, without_occluded
from mammometry.surface.settings import ExtractSettings

RADIUS_MM = 30.0
FRONT = [(0, 0, 1), (0.6, 0, 1), (-0.6, 0, 1), (0, 0.8, 1)]
BAR_PX = slice(57, 64)  # 7 px, that is 7 mm, in the middle of the first camera's picture
CORNER_PX = slice(60), slice(60)  # of a picture: the sphere has no other side there
BAND_MM = 8.0
EDGE_PX = slice(30, 48)  # beyond it nothing of the sphere is left


def sphere_seen(directions=FRONT):
    cameras = [camera_towards(f"c{k}", direction) for k, direction in enumerate(directions)]
    images = [range_image(camera, ellipsoid_range(camera, (RADIUS_MM,) * 3)) for camera in cameras]
    return images, {camera.name: silhouette(camera, (RADIUS_MM,) * 3) for camera in cameras}, rig_of(cameras)


def behind_a_bar(foreground, columns=BAR_PX):
    coverage = foreground.coverage.copy()
    coverage[:, columns] = 0.0
    return replace(foreground, coverage=coverage)


@pytest.mark.slow
def test_a_bar_in_one_photograph_takes_nothing_of_a_sphere():
    images, foregrounds, rig = sphere_seen()
    settings = ExtractSettings(cube_mm=1.0)
    whole_mm3 = extract(images, foregrounds, rig, settings).volume_mm3()
    barred = foregrounds | {"c0": behind_a_bar(foregrounds["c0"])}
    assert extract(images, barred, rig, settings).volume_mm3() < 0.7 * whole_mm3  # as it would be carved
    blocked = find_occlusions(images, barred, rig)
    assert set(blocked) == {"c0"}
    # Of the disc, a strip of 7 of 60 px: 2 · 7 / (π · 30) = 14.9 %, less a guard of 3 px at both of its sides where
    # other cameras' data do not reach over, and up to what the bar's own width closes.
    assert blocked["c0"].share == pytest.approx(0.149, abs=0.03)
    opened = without_occluded(barred, blocked)
    assert extract(images, opened, rig, settings).volume_mm3() == pytest.approx(whole_mm3, rel=0.01)
    assert all(opened[name] is barred[name] for name in ("c1", "c2", "c3"))


@pytest.mark.slow
def test_where_two_of_three_cameras_are_blocked_the_third_one_decides():
    """One is blocked beside the place, too, where both others see the skin: it has no vote."""
    images, foregrounds, rig = sphere_seen([(0, 0, 1), (0.6, 0, 1), (-0.6, 0, 1), (0.3, 0, 1), (0, 0.8, 1)])
    assert rig.pair_names["c0"] == ("c0", "c1")  # so c2, c3 and c4 vote
    coverage = {name: foregrounds[name].coverage.copy() for name in ("c2", "c3")}
    coverage["c2"][:64] = 0.0
    coverage["c3"][CORNER_PX] = 0.0
    barred = foregrounds | {name: replace(foregrounds[name], coverage=each) for name, each in coverage.items()}
    blocked = find_occlusions([images[0]], barred, rig)
    assert set(blocked) == set(coverage)
    hidden = coverage["c3"] < foregrounds["c3"].coverage
    assert (blocked["c3"].pixels(hidden.shape) & hidden).sum() > 0.8 * hidden.sum()


def test_clean_silhouettes_are_left_as_they_are():
    images, foregrounds, rig = sphere_seen()
    assert find_occlusions(images, foregrounds, rig) == {}


def test_what_most_cameras_see_beside_the_subject_is_none_of_it():
    """A pair has matched something beside the sphere; the other cameras' silhouettes go on carving it."""
    images, foregrounds, rig = sphere_seen()
    beside = np.array(images[0].range_mm)
    beside[10:30, 10:30] = 400.0
    wrong = range_image(images[0].camera, np.where(beside > 0, beside, np.nan))
    assert find_occlusions([wrong, *images[1:]], foregrounds, rig) == {}


def test_unknown_silhouettes_have_no_say():
    images, foregrounds, rig = sphere_seen()
    unknown = {name: replace(each, everything=True) for name, each in foregrounds.items()}
    assert find_occlusions(images, unknown | {"c0": behind_a_bar(foregrounds["c0"], EDGE_PX)}, rig) == {}


def test_a_single_other_camera_is_outvoted_by_none():
    """One camera sees the skin, one sees none of it: nobody else tells which is right, and the silhouette holds."""
    images, foregrounds, rig = sphere_seen()
    few = {"c0": behind_a_bar(foregrounds["c0"], EDGE_PX), "c1": foregrounds["c1"]}
    assert find_occlusions([images[0]], few, rig) == {}


@pytest.mark.slow
def test_a_band_that_no_camera_matches_takes_nothing():
    """A dark band around the sphere: beside the subject for all, measured by none. The skin on both sides spans it."""
    images, foregrounds, rig = sphere_seen()
    banded, unmeasured = {}, []
    for image in images:
        camera = image.camera
        band = np.abs(image.points_world()[..., 1]) < BAND_MM / 2
        unmeasured.append(image.keeping(~band))
        cut = replace(
            foregrounds[camera.name], coverage=np.where(band, 0.0, foregrounds[camera.name].coverage).astype(np.float32)
        )
        banded[camera.name] = cut
    settings = ExtractSettings(cube_mm=1.0)
    whole_mm3 = extract(images, foregrounds, rig, settings).volume_mm3()
    assert extract(unmeasured, banded, rig, settings).volume_mm3() < 0.7 * whole_mm3  # half of it is carved away
    blocked = find_occlusions(unmeasured, banded, rig)
    assert set(blocked) == set(banded)
    # 8 mm of a sphere of 30 mm, less what the band itself could bulge: a cap between two chords, 8² / (8 · 30) = .3 mm.
    opened = without_occluded(banded, blocked)
    assert extract(unmeasured, opened, rig, settings).volume_mm3() == pytest.approx(whole_mm3, rel=0.03)


def test_between_two_blocked_places_a_bar_goes_on_but_a_window_is_none():
    subject = np.zeros((60, 160), dtype=bool)
    subject[5:55, 5:155] = True
    subject[25:35, :] = False  # a bar across the subject, hit at both ends
    subject[40:52, 60:100] = False  # background seen through the subject, beside nothing that is blocked
    hit = np.zeros_like(subject)
    hit[25:35, 5:40] = hit[25:35, 120:155] = True
    joined = _joined(hit, subject)
    assert joined[25:35, 5:155].all()
    assert not joined[40:52, 60:100].any()
    subject[10:25, 60:100] = False  # a window that the bar crosses
    assert not _joined(hit, subject)[10:35, 72:88].any()


def test_a_blocked_bar_is_opened_to_where_it_leaves_the_subject():
    subject = np.zeros((60, 160), dtype=bool)
    subject[5:55, 20:140] = True
    subject[25:35, :] = False  # a bar before all of it, hit in its middle alone
    subject[5:25, 80:84] = False  # a slit of background, narrower than half of the bar
    hit = np.zeros_like(subject)
    hit[25:35, 60:100] = True
    joined = _joined(hit, subject)
    assert joined[25:35, 25:135].all()
    assert not joined[:, :18].any()
    assert not joined[:, 142:].any()
    assert not joined[5:12, 80:84].any()
    short = hit & (np.arange(160) >= 94)  # shorter than wide, as hair may be
    assert not _joined(short, subject)[26:34, 25:70].any()
