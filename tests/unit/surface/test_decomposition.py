"""Visibility labels, patches and dents: 2.6.1 and 2.6.2."""

from dataclasses import replace

import numpy as np
import pytest
from spheres import camera_towards, ellipsoid_range, range_image

from mammometry.base.errors import SurfaceError
from mammometry.surface.ranges.dents import KeepMasks, decompose, patch_angle_rad, remove_dents
from mammometry.surface.ranges.visibility import Label, check_agreement, compare, disagreement_mm, gap_mm
from mammometry.surface.settings import DecomposeSettings, DentSettings


def view(direction, radius=30.0, centre=(0, 0, 0), **camera):
    made = camera_towards(str(direction), direction, **camera)
    return range_image(made, ellipsoid_range(made, (radius,) * 3, centre))


def two_spheres(direction):
    """A small sphere before a large one, seen from +z."""
    camera = camera_towards("two", direction)
    small, large = ellipsoid_range(camera, (10.0,) * 3, (0, 0, 60)), ellipsoid_range(camera, (40.0,) * 3)
    return range_image(camera, np.fmin(small, large))


def test_labels_of_points_around_two_spheres():
    seen = two_spheres((0, 0, 1))
    points = np.array([[0, 0, 80.0], [0, 0, 70.2], [0, 0, 60.0], [0, 0, 45.0], [200.0, 0, 0], [0, 0, 500.0]])
    labels = compare(points, seen, 0.5)
    expected = [Label.IN_FRONT, Label.OVERLAPPING, Label.BEHIND, Label.BEHIND, Label.OUTSIDE, Label.OUTSIDE]
    assert labels.tolist() == expected
    gap = gap_mm(points, seen)
    # The image has its centre between four pixels of .9 mm: interpolated, less than .1 mm on a 10 mm sphere.
    np.testing.assert_allclose(gap[:4], [10.0, 0.2, -10.0, -25.0], atol=0.1)
    assert np.isnan(gap[4:]).all()


def test_epsilon_widens_the_overlap():
    seen = two_spheres((0, 0, 1))
    point = np.array([[0, 0, 71.0]])
    assert compare(point, seen, 0.5)[0] == Label.IN_FRONT
    assert compare(point, seen, 1.5)[0] == Label.OVERLAPPING


def test_decomposition_agrees_with_geometry():
    front, side = view((0, 0, 1)), view((1, 0, 0.2))
    patches = decompose([front, side], DecomposeSettings(epsilon_mm=0.5))
    label = patches.labels[front.name, side.name][front.valid]
    # Both see the true sphere: wherever the side view sees a front element's point it overlaps or is hidden.
    normal = front.valid_points_world() / 30.0
    towards = side.camera.centre_world - front.valid_points_world()
    facing = np.einsum("ij,ij->i", normal, towards) / np.linalg.norm(towards, axis=1)
    assert (label[facing > 0.35] == Label.OVERLAPPING).mean() > 0.99
    assert (label[facing < -0.2] == Label.BEHIND).mean() > 0.99
    assert (patches.labels[front.name, side.name][~front.valid] == Label.OUTSIDE).all()


def test_patches_are_connected_and_of_one_label():
    front, other = view((0, 0, 1)), two_spheres((0.2, 0, 1))
    patches = decompose([front, other])
    numbers, labels = patches.patches[other.name, front.name], patches.labels[other.name, front.name]
    assert (numbers > 0).sum() == other.valid.sum()
    for number in range(1, numbers.max() + 1):
        assert len(np.unique(labels[numbers == number])) == 1
    neighbours = (numbers[:, 1:] != numbers[:, :-1]) & (numbers[:, 1:] > 0) & (numbers[:, :-1] > 0)
    assert (labels[:, 1:][neighbours] != labels[:, :-1][neighbours]).all()


@pytest.mark.parametrize("tilt_deg", [0.0, 40.0, 65.0])
def test_patch_angle_of_a_tilted_plane(tilt_deg):
    """Eq. 2–3 on a plane: the angle is the tilt."""
    tilt = np.radians(tilt_deg)
    u, v = np.meshgrid(np.linspace(-20, 20, 81), np.linspace(-20, 20, 81))
    points = np.stack([u * np.cos(tilt), v, u * np.sin(tilt)], axis=-1).reshape(-1, 3)
    angle = patch_angle_rad(points, np.array([0.0, 0.0, 1000.0]), 5.0)
    assert np.degrees(angle) == pytest.approx(tilt_deg, abs=0.01)


def test_a_patch_around_a_hole_has_no_normal():
    ring = np.array([[np.cos(t) * 20, np.sin(t) * 20, 0.0] for t in np.linspace(0, 6, 50)])
    assert np.isnan(patch_angle_rad(ring, np.array([0.0, 0.0, 1000.0]), 5.0))


def plane_view(tilt_deg, name="plane"):
    camera = camera_towards(name, (0, 0, 1))
    normal = np.array([np.sin(np.radians(tilt_deg)), 0, np.cos(np.radians(tilt_deg))])
    grid = np.stack(np.meshgrid(np.arange(120.0), np.arange(120.0)), axis=-1)
    range_mm = -(camera.centre_world @ normal) / (camera.rays_world(grid) @ normal)
    range_mm[:, :30] = range_mm[:, 90:] = np.nan
    return range_image(camera, range_mm)


@pytest.mark.parametrize("rule", ["patch", "element"])
@pytest.mark.parametrize(("tilt_deg", "stays"), [(50.0, True), (72.0, False)])
def test_steep_surfaces_are_removed(rule, tilt_deg, stays):
    steep, flat = plane_view(tilt_deg, "steep"), view((0, 0, 1))
    settings = DentSettings(rule=rule, angle_deg=60.0, neighbourhood_mm=5.0, drop_seen_through=False)
    valid = remove_dents([steep, flat], decompose([steep, flat]), settings)
    assert valid.range_images[0].valid.any() == stays
    assert [image.name for image in valid.range_images] == ["steep", flat.name]


def test_each_element_is_judged_by_its_own_normal():
    image = view((0, 0, 1), radius=40.0)
    kept = remove_dents([image], decompose([image]), DentSettings(angle_deg=60.0)).range_images[0]
    towards = image.camera.centre_world - image.points_world()
    towards /= np.linalg.norm(towards, axis=-1, keepdims=True)
    true = np.degrees(np.arccos(np.einsum("ijk,ijk->ij", image.points_world() / 40.0, towards)))
    # windows of 2.5 mm on a 40 mm sphere: the normal is known within ~2°
    assert kept.valid[image.valid & (true < 57)].all()
    assert not kept.valid[image.valid & (true > 63)].any()


def test_what_another_view_looks_through_is_dropped():
    camera = camera_towards("a", (0, 0, 1))
    range_mm = ellipsoid_range(camera, (40.0,) * 3)
    range_mm[50:60, 50:60] -= 10.0  # a false surface, 10 mm before the sphere
    wrong, right = range_image(camera, range_mm), view((0.3, 0, 1), radius=40.0)
    kept = remove_dents([wrong, right], decompose([wrong, right])).range_images[0]
    assert not kept.valid[52:58, 52:58].any()
    assert kept.valid[70:80, 50:60].all()


def test_one_view_that_is_too_deep_is_outvoted_by_those_that_agree():
    camera = camera_towards("deep", (0, 0, 1))
    range_mm = ellipsoid_range(camera, (40.0,) * 3)
    range_mm[50:70, 50:70] += 10.0  # a false hole, 10 mm deep, that faces its camera as well as the sphere does
    deep = range_image(camera, range_mm)
    others = [view(direction, radius=40.0) for direction in ((0.3, 0, 1), (-0.3, 0, 1), (0, 0.3, 1))]
    kept = remove_dents([deep, *others], None).range_images
    assert not kept[0].valid[53:67, 53:67].any()
    assert kept[0].valid[75:85, 50:60].all()
    whole = remove_dents(others, None).range_images
    for image, alone in zip(kept[1:], whole, strict=True):
        assert image.valid.sum() > 0.99 * alone.valid.sum()


def test_two_views_that_share_a_false_surface_do_not_outvote_the_one_that_sees_through_it():
    camera = camera_towards("a", (0, 0, 1))
    range_mm = ellipsoid_range(camera, (40.0,) * 3)
    range_mm[50:60, 50:60] -= 10.0  # a false surface, 10 mm before the sphere
    wrong, alike = range_image(camera, range_mm), range_image(replace(camera, name="b"), range_mm)
    right = view((0.3, 0, 1), radius=40.0)
    kept = remove_dents([wrong, alike, right], None).range_images
    assert not any(image.valid[52:58, 52:58].any() for image in kept[:2])
    assert kept[2].valid.sum() > 0.99 * remove_dents([right], None).range_images[0].valid.sum()


def test_nothing_left_names_the_pairs():
    steep = plane_view(80.0, "floor")
    with pytest.raises(SurfaceError, match=r"floor .*\d{3,}"):
        remove_dents([steep], decompose([steep]))


def test_rule_none_keeps_all():
    steep = plane_view(80.0)
    assert remove_dents([steep], decompose([steep]), DentSettings(rule="none")).range_images[0].valid.sum() > 0


def test_views_of_one_sphere_agree_and_a_moved_camera_is_named():
    directions = [(0, 0, 1), (0.4, 0, 1), (0, 0.4, 1)]
    views = [view(direction, radius=40.0) for direction in directions]
    assert max(apart for apart, _ in disagreement_mm(views).values()) < 0.1
    check_agreement(views)
    moved = view(directions[1], radius=40.0, centre=(0, 0, 7.0))
    with pytest.raises(SurfaceError, match=r"moved"):
        check_agreement([views[0], moved, views[2]])


def test_skin_that_is_hidden_from_the_other_view_contradicts_nothing(monkeypatch):
    """One camera sees a small sphere; the other sees the large one behind it, there alone. Both face alike."""
    near = camera_towards("near", (0, 0, 1))
    near = range_image(near, ellipsoid_range(near, (20.0,) * 3, (0, 0, 60)))
    whole = camera_towards("hidden", (0.5, 0, 1))
    whole = range_image(whole, ellipsoid_range(whole, (40.0,) * 3))
    behind = np.zeros(whole.valid.shape, dtype=bool)
    behind[whole.valid] = gap_mm(whole.valid_points_world(), near) < -20
    hidden = range_image(whole.camera, np.where(behind, whole.range_mm, np.nan))
    assert behind.sum() > 400
    monkeypatch.setattr("mammometry.surface.ranges.visibility._FEWEST_COMMON", 100)
    check_agreement([near, hidden])


@pytest.mark.parametrize(("sigma_mm", "refused"), [(0.1, True), (0.4, True), (1.0, False)])
def test_errors_that_the_views_expect_of_themselves_are_no_moved_camera(sigma_mm, refused):
    """One view is 2 mm too near all over: more than three times .1 · √2 and .4 · √2 mm, less than three times √2 mm."""
    views = []
    for direction, error_mm in (((0, 0, 1), 0.0), ((0.4, 0, 1), 2.0)):
        exact = view(direction, radius=40.0)
        sigma = np.full_like(exact.sigma_mm, sigma_mm)
        views.append(replace(exact, range_mm=exact.range_mm - np.float32(error_mm), sigma_mm=sigma))
    ((apart_mm, expected_mm),) = disagreement_mm(views).values()
    assert 1.0 < apart_mm < 2.0  # along the rays, which meet the normals at 0 to 60°
    assert expected_mm / apart_mm == pytest.approx(np.sqrt(2) * sigma_mm / 2.0, rel=0.1)
    if refused:
        with pytest.raises(SurfaceError, match=r"within 1(\.\d)? mm"):
            check_agreement(views)
    else:
        check_agreement(views)


def test_a_mask_over_the_views_gives_the_kept_data_again_to_the_bit():
    views = [view((0, 0, 1)), view((1, 0, 0.2))]
    valid = remove_dents(views, decompose(views), DentSettings(angle_deg=40.0))
    kept = KeepMasks(keep=tuple(image.valid for image in valid.range_images), angles_rad=valid.angles_rad)
    again = kept.of(views)
    assert 0 < sum(keep.sum() for keep in kept.keep) < sum(image.valid.sum() for image in views)
    for ours, theirs in zip(valid.range_images, again.range_images, strict=True):
        for name in ("range_mm", "sigma_mm", "confidence", "valid"):
            assert getattr(ours, name).tobytes() == getattr(theirs, name).tobytes()
