import numpy as np
import pytest
from spheres import camera_towards, ellipsoid_range, range_image

from mammometry.geometry.camera import Camera
from mammometry.geometry.transform import Transform
from mammometry.matching.dense.match import DisparityMap
from mammometry.surface.ranges import ray_kernels
from mammometry.surface.ranges.range_image import RangeImage, triangulate
from mammometry.surface.settings import TriangulateSettings

BASELINE, FOCAL, SIZE = 120.0, 400.0, 81


def parallel_pair() -> tuple[Camera, Camera]:
    left = camera_towards("left", (0, 0, 1), size=SIZE, focal=FOCAL)
    shifted = Transform(
        rotation=left.camera_from_world.rotation,
        translation_mm=left.camera_from_world.translation_mm - [BASELINE, 0, 0],
    )
    matrix = left.matrix.copy()
    matrix[0, 2] += 100.0  # a principal column of its own, as rectification gives
    return left, Camera(
        name="right", size_wh=(SIZE, SIZE), matrix=matrix, distortion=np.zeros(5), camera_from_world=shifted
    )


def exact_disparity(radius: float, vertical: float = 0.0) -> tuple[DisparityMap, np.ndarray]:
    left, right = parallel_pair()
    truth = ellipsoid_range(left, (radius,) * 3)
    valid = np.isfinite(truth)
    points = range_image(left, truth).points_world()
    points[valid] = left.centre_world + (points[valid] - left.centre_world)
    exact = left.centre_world + (left.rays_world(pixel_grid()) * np.where(valid, truth, 400.0)[..., None])
    shift = pixel_grid() - right.project(exact)
    zero = np.zeros((SIZE, SIZE), dtype=np.float32)
    return (
        DisparityMap(
            name="pair",
            left=left,
            right=right,
            d_h_px=np.where(valid, shift[..., 0], 0).astype(np.float32),
            d_v_px=(np.where(valid, shift[..., 1], 0) + vertical).astype(np.float32),
            confidence=valid.astype(np.float32),
            sigma_px=zero + np.float32(0.05),
            valid=valid,
            weak=np.zeros_like(valid),
        ),
        truth,
    )


def pixel_grid() -> np.ndarray:
    return np.stack(np.meshgrid(np.arange(SIZE, dtype=float), np.arange(SIZE, dtype=float)), axis=-1)


def test_exact_disparities_give_the_sphere_back():
    disparity, truth = exact_disparity(35.0)
    image = triangulate(disparity)
    assert (image.valid == np.isfinite(truth)).all()
    # float32 disparities of ~20 px resolve 2e-6 px, times z²/(fB) = 3 mm/px; ranges are multiples of 1/512 mm
    assert np.abs(image.range_mm - truth)[image.valid].max() < 1e-3
    distance = np.linalg.norm(image.points_world()[image.valid], axis=1)
    np.testing.assert_allclose(distance, 35.0, atol=1e-3)
    np.testing.assert_allclose(image.valid_points_world(), image.points_world()[image.valid])
    assert np.isnan(image.points_world()[~image.valid]).all()
    assert not np.any(np.mod(image.range_mm * 512, 1))


def test_sigma_is_that_of_the_disparity_through_the_geometry():
    disparity, _ = exact_disparity(35.0)
    image = triangulate(disparity)
    left = image.camera
    depth = left.camera_from_world.apply(image.valid_points_world())[:, 2]
    expected = 0.05 * depth**2 / (FOCAL * BASELINE) * image.range_mm[image.valid] / depth
    np.testing.assert_allclose(image.sigma_mm[image.valid], expected, rtol=1 / 63)  # six binary digits


def test_a_vertical_residual_hardly_moves_the_range():
    moved = triangulate(exact_disparity(35.0, vertical=0.3)[0])
    still = triangulate(exact_disparity(35.0)[0])
    # second order: range · (0.3 px / 400 px) · tan(ray's elevation ≤ 6°) / tan(convergence 17°)-like terms
    assert np.abs(moved.range_mm - still.range_mm)[still.valid].max() < 0.05


def test_uncertain_and_impossible_disparities_are_dropped(monkeypatch):
    disparity, _ = exact_disparity(35.0)
    with monkeypatch.context() as stricter:
        stricter.setattr("mammometry.surface.ranges.range_image.MAX_SIGMA_MM", 0.01)
        assert not triangulate(disparity).valid.any()
    # The right principal column lies 100 px further right: rays meet only if u_left − u_right > −100.
    behind = disparity.d_h_px - np.float32(400.0)
    flipped = DisparityMap(
        name="pair",
        left=disparity.left,
        right=disparity.right,
        d_h_px=behind,
        d_v_px=disparity.d_v_px,
        confidence=disparity.confidence,
        sigma_px=disparity.sigma_px,
        valid=disparity.valid,
        weak=disparity.weak,
    )
    assert not triangulate(flipped).valid.any()


def test_rays_meet_where_those_of_the_cameras_do():
    # Plain NumPy twin, in the world frame, of cameras turned against each other.
    left, right = camera_towards("left", (0.3, -0.2, 1)), camera_towards("right", (-0.2, 0.1, 1))
    random = np.random.default_rng(5)
    rows, columns = random.integers(0, SIZE, (2, 300))
    d_h, d_v = random.normal(0, 30, 300), random.normal(0, 5, 300)
    rotations = left.camera_from_world.rotation, right.camera_from_world.rotation
    baseline = right.centre_world - left.centre_world
    turned = rotations[0] @ rotations[1].T
    found = ray_kernels.meetings(
        rows, columns, d_h, d_v, left.intrinsics, right.intrinsics, turned, rotations[0] @ baseline
    )

    def along(shift: float) -> np.ndarray:
        a = left.rays_world(np.stack([columns, rows], axis=-1).astype(float))
        b = right.rays_world(np.stack([columns - d_h - shift, rows - d_v], axis=-1))
        # Least squares of |s a − t b − baseline|, ray by ray.
        return np.array(
            [np.linalg.lstsq(np.stack([p, -q], axis=1), baseline, rcond=None)[0] for p, q in zip(a, b, strict=True)]
        )

    np.testing.assert_allclose(np.stack(found[:2], axis=1), along(0.0), rtol=1e-7)
    slope = np.abs(along(0.05)[:, 0] - along(-0.05)[:, 0]) / 0.1
    np.testing.assert_allclose(found[2], slope, rtol=1e-4)


def test_normals_of_a_sphere_point_to_its_outside():
    camera = camera_towards("a", (0.3, -0.2, 1), size=140)
    image = range_image(camera, ellipsoid_range(camera, (50.0,) * 3))
    normals = image.normals_world(2.5)
    true = image.points_world() / 50.0
    inner = image.incidence_rad(2.5) < np.radians(60)
    angle = np.degrees(np.arccos(np.clip(np.einsum("ijk,ijk->ij", normals, true), -1, 1)))
    assert inner.sum() > 4000
    assert np.nanmax(angle[inner]) < 1.5
    # incidence in closed form: the angle between outward normal and direction to the camera
    towards = camera.centre_world - image.points_world()
    towards /= np.linalg.norm(towards, axis=-1, keepdims=True)
    expected = np.arccos(np.einsum("ijk,ijk->ij", true, towards))
    assert np.nanmax(np.abs(image.incidence_rad(2.5) - expected)[inner]) < np.radians(1.5)


def test_a_tilted_plane_has_its_normal_exactly():
    camera = camera_towards("a", (0, 0, 1))
    normal = np.array([0.6, 0.0, 0.8])
    rays = camera.rays_world(np.stack(np.meshgrid(np.arange(120.0), np.arange(120.0)), axis=-1))
    image = range_image(camera, -(camera.centre_world @ normal) / (rays @ normal))
    np.testing.assert_allclose(image.normals_world(3.0)[40:80, 40:80], np.broadcast_to(normal, (40, 40, 3)), atol=2e-4)


def test_too_few_neighbours_have_no_normal():
    camera = camera_towards("a", (0, 0, 1))
    truth = np.full((120, 120), np.nan)
    truth[60, 60:63] = 400.0
    assert np.isnan(range_image(camera, truth).normals_world(2.5)).all()
    assert np.isnan(range_image(camera, np.full((120, 120), np.nan)).normals_world()).all()


def test_keeping_drops_data():
    camera = camera_towards("a", (0, 0, 1))
    image = range_image(camera, ellipsoid_range(camera, (30.0,) * 3))
    left_half = np.broadcast_to(np.arange(120) < 60, (120, 120))
    kept = image.keeping(left_half)
    assert (kept.valid == (image.valid & left_half)).all()
    assert not kept.range_mm[~kept.valid].any()


def test_wrong_shapes_ranges_and_cameras_are_refused():
    camera = camera_towards("a", (0, 0, 1))
    good = ellipsoid_range(camera, (30.0,) * 3)
    image = range_image(camera, good)
    with pytest.raises(ValueError, match="finite"):
        range_image(camera, -good)
    with pytest.raises(ValueError, match="range_mm is"):
        RangeImage(
            name="a",
            camera=camera,
            range_mm=image.range_mm[1:],
            sigma_mm=image.sigma_mm[1:],
            confidence=image.confidence[1:],
            valid=image.valid[1:],
        )
    bent = Camera(
        name="a",
        size_wh=camera.size_wh,
        matrix=camera.matrix,
        distortion=np.array([0.1, 0, 0, 0, 0]),
        camera_from_world=camera.camera_from_world,
    )
    with pytest.raises(ValueError, match="distortion"):
        range_image(bent, good)


def test_elements_denser_than_wanted_are_left_out():
    whole = triangulate(exact_disparity(35.0)[0], TriangulateSettings(spacing_mm=0.0))
    every_third = triangulate(exact_disparity(35.0)[0], TriangulateSettings(spacing_mm=3.2 * whole.pixel_mm()))
    assert every_third.valid.shape == tuple(-(-side // 3) for side in whole.valid.shape)
    np.testing.assert_array_equal(every_third.range_mm, whole.range_mm[::3, ::3])
    np.testing.assert_array_equal(every_third.valid, whole.valid[::3, ::3])
    # and stay where they were
    np.testing.assert_allclose(
        every_third.points_world()[every_third.valid], whole.points_world()[::3, ::3][every_third.valid], atol=1e-9
    )
