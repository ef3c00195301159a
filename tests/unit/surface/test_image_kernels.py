"""The compiled kernels on range images against plain NumPy and SciPy."""

import numpy as np
import pytest
from matplotlib.path import Path
from scipy import ndimage
from scipy.spatial import cKDTree
from spheres import camera_towards, ellipsoid_range, range_image, sphere_mesh

from mammometry.surface.ranges import image_kernels
from mammometry.surface.ranges.visibility import gap_mm
from mammometry.surface.repair.correspond import Gates, correspond, view_data


def seen_ellipsoid(name="a", direction=(0.2, 0.1, 1)):
    camera = camera_towards(name, direction)
    image = range_image(camera, ellipsoid_range(camera, (40.0, 30.0, 25.0)))
    holes = np.random.default_rng(4).uniform(size=image.valid.shape) > 0.1
    return image.keeping(holes)


@pytest.mark.parametrize("share", [0.002, 0.05, 0.6])
def test_nearest_pixels_are_those_of_an_exact_transform(share):
    mask = np.random.default_rng(3).uniform(size=(90, 130)) < share
    row, column = image_kernels.nearest_true(mask)
    rows, columns = np.indices(mask.shape)
    assert mask[row, column].all()
    exact = ndimage.distance_transform_edt(~mask)
    # Danielsson's vectors miss the nearest by a fraction of a pixel, and rarely
    error = np.hypot(row - rows, column - columns) - exact
    assert error.min() > -1e-9
    assert error.max() < 0.3
    assert (error > 1e-9).mean() < 0.01


def test_an_empty_mask_has_no_nearest_pixel():
    row, column = image_kernels.nearest_true(np.zeros((3, 4), dtype=bool))
    assert (row == -1).all()
    assert (column == -1).all()


def test_normals_are_those_of_planes_fitted_one_by_one():
    image = seen_ellipsoid()
    normals = image.normals_world(4.0)
    half = max(1, round(4.0 / image.pixel_mm()))
    matrix, rotation = image.camera.matrix, image.camera.camera_from_world.rotation
    rows, columns = np.nonzero(np.isfinite(normals[..., 0]))
    for k in np.random.default_rng(1).choice(len(rows), 40, replace=False):
        row, column = rows[k], columns[k]
        window = np.s_[max(row - half, 0) : row + half + 1, max(column - half, 0) : column + half + 1]
        i, j = np.nonzero(image.valid[window])
        i, j = i + window[0].start, j + window[1].start
        x, y = (j - matrix[0, 2]) / matrix[0, 0], (i - matrix[1, 2]) / matrix[1, 1]
        q = np.sqrt(1 + x * x + y * y) / image.range_mm[i, j]
        plane = np.linalg.lstsq(np.stack([x, y, np.ones_like(x)], axis=1), q, rcond=None)[0]
        expected = -plane / np.linalg.norm(plane) @ rotation
        np.testing.assert_allclose(normals[row, column], expected, atol=1e-4)  # kept in single precision


def test_points_of_a_view_are_those_of_its_rays():
    image = seen_ellipsoid()
    view = view_data(image, spacing_mm=5.0, normal_mm=2.5, taper_mm=0.0)  # so coarse that data are left out
    stride = image.camera.size_wh[0] // view.camera.size_wh[0]
    assert stride > 1
    known = np.isfinite(view.points[..., 0])
    world = image.points_world()[::stride, ::stride][known]
    np.testing.assert_allclose(view.points[known], image.camera.camera_from_world.apply(world), atol=1e-4)
    np.testing.assert_array_equal(known, np.isfinite(image.normals_world(2.5)[::stride, ::stride, 0]))
    towards = -view.points[known] / np.linalg.norm(view.points[known], axis=1, keepdims=True)
    facing = np.einsum("ij,ij->i", towards, view.normals[known])
    np.testing.assert_allclose(view.cosine[known], np.clip(facing, 0.05, 1.0), atol=1e-5)


def test_gaps_are_interpolated_between_data_of_one_surface():
    image = seen_ellipsoid()
    points = np.random.default_rng(2).uniform(-45, 45, (3000, 3))
    gaps = gap_mm(points, image)
    uv = image.camera.project(points)
    assert np.isfinite(gaps).sum() > 1000
    for k in range(0, 3000, 7):
        u, v = uv[k]
        inside = -0.5 < u < image.valid.shape[1] - 0.5 and -0.5 < v < image.valid.shape[0] - 0.5
        if not inside or not image.valid[round(v), round(u)]:
            assert np.isnan(gaps[k])
            continue
        seen = float(image.range_mm[round(v), round(u)])
        left, top = int(np.clip(np.floor(u), 0, 118)), int(np.clip(np.floor(v), 0, 118))
        four = image.range_mm[top : top + 2, left : left + 2].astype(float)
        if image.valid[top : top + 2, left : left + 2].all() and np.ptp(four) < 5.0:
            du, dv = u - left, v - top
            seen = np.array([1 - dv, dv]) @ four @ np.array([1 - du, du])
        distance = np.linalg.norm(points[k] - image.camera.centre_world)
        assert gaps[k] == pytest.approx(seen - distance, abs=1e-9)


def test_trust_rises_from_the_edge_of_the_data():
    camera = camera_towards("a", (0, 0, 1))
    image = range_image(camera, np.full(camera.shape_hw, 400.0))
    trust = image.trust(10.0)
    assert trust[0].max() == pytest.approx(0.1)  # one pixel, 1 mm, from where there is nothing
    np.testing.assert_allclose(trust[60, :12], np.minimum((np.arange(12) + 1) / 10, 1.0), atol=1e-6)


def test_plausible_points_are_the_nearest_data():
    """Against a search through all data: the same distance from the surface, to the sagitta of the data's spacing."""
    image = seen_ellipsoid()
    view = view_data(image, spacing_mm=0.5, normal_mm=2.5, taper_mm=0.0)
    scale = np.array([40.0, 30.0, 25.0]) / 30.0
    mesh = sphere_mesh(30.0, rings=40)
    vertices = mesh.vertices * scale * 1.02
    normals = mesh.vertices / scale
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    gates = Gates(reach_mm=4.0, normal_angle_deg=45.8, tangential_mm=0.8, similarity_mm=2.0, blend=True)
    found = correspond(vertices, normals, [view], gates)
    known = np.isfinite(image.normals_world(2.5)[..., 0])
    points, normal = image.points_world()[known], image.normals_world(2.5)[known]
    distance, nearest = cKDTree(points).query(vertices)
    height = np.einsum("ij,ij->i", points[nearest] - vertices, normal[nearest])
    is_found = found.found
    assert is_found.sum() > 0.35 * len(vertices)
    assert distance[is_found].max() < 4.0
    towards = image.camera.centre_world - vertices
    squarely = np.einsum("ij,ij->i", normals, towards) / np.linalg.norm(towards, axis=1) > 0.5
    assert is_found[squarely & (distance < 1.0)].mean() > 0.95
    # neighbouring data are up to 2 mm apart there, on skin of at least 16 mm radius: their tangent planes differ by
    # up to 2²/(2·16) = .12 mm
    moved = np.linalg.norm(found.targets - vertices, axis=1)
    assert np.abs(moved - np.abs(height))[is_found & squarely].max() < 0.12


def test_values_are_carried_over_through_a_coarse_grid_of_places():
    rng = np.random.default_rng(5)
    picture = rng.uniform(size=(40, 50)).astype(np.float32)
    places = np.stack(np.meshgrid(np.linspace(-3, 42, 7), np.linspace(-4, 53, 9), indexing="ij"), axis=-1)
    places += rng.normal(scale=0.8, size=places.shape)
    carried = image_kernels.resampled(picture, places, 61, 83)
    whole = [ndimage.zoom(places[..., axis], (61 / 7, 83 / 9), order=1) for axis in (0, 1)]
    expected = ndimage.map_coordinates(picture, whole, order=1, mode="constant", cval=0.0)
    inside = (whole[0] >= 0) & (whole[0] <= 39) & (whole[1] >= 0) & (whole[1] <= 49)
    np.testing.assert_allclose(carried[inside], expected[inside], atol=1e-5)
    assert not carried[~inside].any()


def test_outline_distances_are_exact_near_it_and_almost_so_elsewhere():
    """A star of straight sides, cut in pieces of a pixel."""
    around = np.linspace(0, 2 * np.pi, 11)[:-1]
    corners = np.stack([30.3 + 22 * np.sin(around), 33.6 + 22 * np.cos(around)], axis=1)
    corners[1::2] = 0.8 * corners[1::2] + 0.2 * np.array([30.3, 33.6])
    share = np.linspace(0, 1, 23)[:-1, None]
    starts = np.concatenate([a + share * (b - a) for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)])
    steps = np.roll(starts, -1, axis=0) - starts
    pixels = np.stack(np.indices((61, 68)), axis=-1)
    inside = np.asarray(Path(corners).contains_points(pixels.reshape(-1, 2))).reshape(61, 68)
    found = image_kernels.outline_distances(inside, starts, steps, 5.0)
    offset = pixels[:, :, None] - starts
    along = np.clip((offset * steps).sum(axis=-1) / (steps**2).sum(axis=-1), 0, 1)
    exact = np.linalg.norm(offset - along[..., None] * steps, axis=-1).min(axis=-1)
    np.testing.assert_array_equal(found < 0, inside)
    near = exact < 5.0
    np.testing.assert_allclose(np.abs(found)[near], exact[near], atol=1e-5)
    assert (~near).any()
    # the outline lies within half a pixel's diagonal of the middle between two pixels
    assert np.abs(np.abs(found) - exact).max() < 0.75


def spans(image, valid, subject, slope_px, least_jump_mm, others_mm=None):
    """Without data of other views, unless they are given in blocks of four pixels."""
    if others_mm is None:
        others_mm = np.full((-(-image.shape[0] // 4), -(-image.shape[1] // 4)), np.inf, dtype=np.float32)
    arrays = (np.ascontiguousarray(each) for each in (image, valid, subject, others_mm))
    return image_kernels.spans(*arrays, 4, slope_px, least_jump_mm, 5.0)


def parabola(u, start_mm, slope, gap_px, rise_mm):
    """From a start with a slope to a rise at the gap's other end: the only parabola that does all three."""
    return start_mm + slope * u + (rise_mm - slope * gap_px) * (u / gap_px) ** 2


def test_near_skin_goes_on_with_its_slope_and_bends_to_meet_the_far_one():
    """A ramp of 1.5 mm a pixel, a gap of 20 pixels, and skin 60 mm farther: along and against both axes."""
    ramp = np.concatenate([300 + 1.5 * np.arange(31), np.zeros(19), np.full(30, 405.0)])
    valid = ramp > 0
    expected = parabola(np.arange(1, 20), 345.0, 1.5, 20, 60.0)
    for flipped in (False, True):
        line, known, wanted = (each[::-1] if flipped else each for each in (ramp, valid, expected))
        image, mask = np.tile(line, (5, 1)).astype(np.float32), np.tile(known, (5, 1))
        subject = np.ones_like(mask)
        for turned in (False, True):
            each = (image.T, mask.T, subject.T) if turned else (image, mask, subject)
            found = spans(*each, 4, 20.0)
            found = found.T if turned else found
            np.testing.assert_allclose(found[:, ~known], np.tile(wanted, (5, 1)), rtol=1e-6)
            assert not found[mask].any()


@pytest.mark.parametrize("least_jump_mm", [59.0, 61.0])
def test_gaps_with_less_of_a_jump_or_with_background_in_them_are_not_spanned(least_jump_mm):
    image = np.tile(np.concatenate([np.full(20, 300.0), np.zeros(10), np.full(20, 360.0)]), (3, 1)).astype(np.float32)
    subject = np.ones(image.shape, dtype=bool)
    subject[1, 25] = False
    found = spans(image, image > 0, subject, 3, least_jump_mm) > 0
    assert found[[0, 2], 20:30].all() == (least_jump_mm < 60)
    assert not found[1].any()


def test_the_shorter_of_two_ways_counts_more():
    """A gap 4 wide and 12 high, both ways from 100 to 160 mm without slope: the mean, weighted by 1/5 and 1/13."""
    image = np.full((40, 40), 100.0, dtype=np.float32)
    image[:, 24:] = image[26:] = 160.0
    valid = np.ones(image.shape, dtype=bool)
    valid[14:26, 20:24] = False
    found = spans(image, valid, np.ones_like(valid), 3, 20.0)
    across, down = parabola(2, 100.0, 0.0, 5, 60.0), parabola(3, 100.0, 0.0, 13, 60.0)
    assert found[16, 21] == pytest.approx((across / 5 + down / 13) / (1 / 5 + 1 / 13))


@pytest.mark.parametrize(("other_mm", "spanned"), [(340.0, False), (np.inf, True), (420.0, True)])
def test_a_gap_before_which_another_view_measured_skin_is_not_spanned(other_mm, spanned):
    """A rail hides a bulge from this view: near and far skin beside it say nothing of what lies between."""
    image = np.tile(np.concatenate([np.full(20, 350.0), np.zeros(20), np.full(20, 410.0)]), (8, 1)).astype(np.float32)
    others_mm = np.full((2, 15), np.inf, dtype=np.float32)
    others_mm[0, 7] = other_mm  # in rows 0 to 3, columns 28 to 31
    found = spans(image, image > 0, np.ones(image.shape, dtype=bool), 4, 20.0, others_mm) > 0
    assert found[:4, 20:40].all() == spanned
    assert found[4:, 20:40].all()
