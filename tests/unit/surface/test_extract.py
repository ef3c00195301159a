"""The first surface on bodies of known shape; the kernel against a plain twin."""

import numpy as np
import pytest
from spheres import camera_towards, ellipsoid_range, range_image, rig_of, silhouette
from tests.first_cases import first

from mammometry.base.errors import SurfaceError
from mammometry.geometry.mesh import TriangleMesh
from mammometry.surface.fusion import field_kernels as kernels
from mammometry.surface.fusion.field import (
    EXTEND_MM,
    EXTEND_WEIGHT,
    JUMP_MM,
    build_field,
    closing_box,
    nearest_of_others_mm,
    silhouette_distance_px,
    view_elements,
)
from mammometry.surface.fusion.fuse import extract, extract_open, largest_part, tunnel_places
from mammometry.surface.fusion.isosurface import Isosurface
from mammometry.surface.fusion.voxels import sample_blocks
from mammometry.surface.ranges import image_kernels
from mammometry.surface.ranges.range_image import NORMAL_MM, SIGMA_FLOOR_MM
from mammometry.surface.settings import TAPER_MM, ExtractSettings

AROUND = [(1, 0, 0.1), (-1, 0, 0.1), (0, 1, 0.1), (0, -1, 0.1), (0.1, 0, 1), (0.1, 0, -1)]
FRONT = [(0, 0, 1), (0.6, 0, 1), (-0.6, 0, 1), (0, 0.8, 1)]


def scene(directions, radii, **camera):
    cameras = [camera_towards(f"c{k}", d, **camera) for k, d in enumerate(directions)]
    images = [range_image(c, ellipsoid_range(c, radii)) for c in cameras]
    return images, {c.name: silhouette(c, radii) for c in cameras}, rig_of(cameras)


def is_closed_ball(mesh):
    return mesh.is_watertight() and mesh.components()[0] == 1 and mesh.euler_number() == 2


def test_a_sphere_seen_from_all_sides():
    images, foregrounds, rig = scene(AROUND, (30.0,) * 3)
    mesh = extract(images, foregrounds, rig, ExtractSettings(cube_mm=1.0))
    assert is_closed_ball(mesh)
    error = np.linalg.norm(mesh.vertices, axis=1) - 30.0
    # Interpolating ranges between pixels of 1 mm cuts the sphere's sagitta, (1 mm)²/(8 · 30 mm) = .004 mm, and a
    # Gaussian of one cube σ moves a sphere inwards by σ²/R = .033 mm: the bias is inwards.
    assert -0.08 < error.mean() < 0.0
    assert np.abs(error).max() < 0.5
    # mean inward shift × area
    assert mesh.volume_mm3() == pytest.approx(4 / 3 * np.pi * 30.0**3, rel=0.01)
    assert mesh.volume_mm3() < 4 / 3 * np.pi * 30.0**3


@pytest.mark.slow
def test_an_ellipsoid_seen_from_all_sides():
    radii = (28.0, 20.0, 35.0)
    images, foregrounds, rig = scene(AROUND, radii)
    mesh = extract(images, foregrounds, rig, ExtractSettings(cube_mm=1.0))
    assert is_closed_ball(mesh)
    volume = 4 / 3 * np.pi * np.prod(radii)
    assert 0.985 * volume < mesh.volume_mm3() < volume


@pytest.mark.slow
def test_the_unseen_back_is_closed_plainly(monkeypatch):
    images, foregrounds, rig = scene(FRONT, (30.0,) * 3)
    monkeypatch.setattr("mammometry.surface.fusion.fuse.BACK_MM", 8.0)
    mesh = extract(images, foregrounds, rig, ExtractSettings(cube_mm=1.0))
    assert is_closed_ball(mesh)
    front = mesh.vertices[:, 2] > 10
    assert np.abs(np.linalg.norm(mesh.vertices[front], axis=1) - 30.0).max() < 0.6
    box = closing_box(images, back_mm=8.0, around_mm=20.0)
    assert box.distance_mm(mesh.vertices).max() < 1.0
    assert box.distance_mm(mesh.vertices).max() > -1.0  # it does reach the back


@pytest.mark.slow
def test_silhouettes_bound_what_ranges_do_not_show(monkeypatch):
    images, foregrounds, rig = scene(FRONT, (30.0,) * 3)
    half_blind = [image.keeping(image.points_world()[..., 1] > -5.0) for image in images]
    monkeypatch.setattr("mammometry.surface.fusion.fuse.BACK_MM", 5.0)
    monkeypatch.setattr("mammometry.surface.fusion.field.EXTEND_MM", 0.0)
    mesh = extract(half_blind, foregrounds, rig, ExtractSettings(cube_mm=1.0))
    assert is_closed_ball(mesh)
    # Below the data only silhouettes speak: the visual hull of four views contains the sphere, by little near contours
    below = (mesh.vertices[:, 1] < -25) & (np.abs(mesh.vertices[:, 2]) < 8) & (np.abs(mesh.vertices[:, 0]) < 10)
    radius = np.linalg.norm(mesh.vertices[below], axis=1)
    assert below.sum() > 20
    assert radius.min() > 29.0
    assert radius.max() < 34.0


@pytest.mark.slow
def test_nearest_swells_and_furthest_shrinks():
    images, foregrounds, rig = scene(AROUND, (25.0,) * 3)
    rng = np.random.default_rng(3)
    noisy = [
        range_image(image.camera, np.where(image.valid, image.range_mm + rng.normal(0, 0.5, image.valid.shape), np.nan))
        for image in images
    ]
    volume = {
        rule: extract(noisy, foregrounds, rig, ExtractSettings(cube_mm=1.0, rule=rule)).volume_mm3()
        for rule in ("nearest", "default", "furthest")
    }
    assert volume["furthest"] < 0.995 * volume["default"]
    # The silhouettes bound what `nearest` may add.
    assert volume["default"] < volume["nearest"]


def test_no_data_contradicting_masks_and_contradicting_views_are_errors():
    images, foregrounds, rig = scene(FRONT[:2], (30.0,) * 3)
    empty = [image.keeping(np.zeros(image.valid.shape, dtype=bool)) for image in images]
    with pytest.raises(SurfaceError, match=r"pairs c0, c1: .*range data"):
        extract(empty, foregrounds, rig)
    one_empty = extract([images[0], empty[1]], foregrounds, rig, ExtractSettings(cube_mm=2.0))
    assert is_closed_ball(one_empty)
    elsewhere = {name: silhouette(rig.cameras[name], (3.0, 3.0, 3.0)) for name in foregrounds}
    tiny = {
        name: type(value)(
            camera=name, coverage=np.roll(value.coverage, 50, axis=k), contour_level=0.5, everything=False
        )
        for k, (name, value) in enumerate(elsewhere.items())
    }
    with pytest.raises(SurfaceError, match="silhouettes"):
        extract(images, tiny, rig, ExtractSettings(cube_mm=2.0))


def test_an_open_surface_is_the_data_and_nothing_else():
    camera = camera_towards("a", (0, 0, 1))
    image = range_image(camera, ellipsoid_range(camera, (40.0,) * 3))
    mesh = extract_open([image])
    assert not mesh.is_watertight()
    np.testing.assert_allclose(np.linalg.norm(mesh.vertices, axis=1), 40.0, atol=1e-3)
    assert (mesh.face_vectors()[:, 2] > 0).all()  # counter-clockwise seen from the camera
    sides = mesh.corners() - np.roll(mesh.corners(), 1, axis=1)
    assert np.linalg.norm(sides, axis=2).max() <= 4.0 * image.pixel_mm()
    # nearly every datum that faces the camera is used
    assert len(mesh.vertices) > 0.9 * image.valid.sum()


def test_silhouette_distance_of_a_disc_is_sub_pixel():
    u, v = np.meshgrid(np.arange(101.0), np.arange(101.0))
    true = np.hypot(u - 50.3, v - 49.6) - 30.25
    from mammometry.matching.foreground.foreground import Foreground

    disc = Foreground(
        camera="a", coverage=np.clip(0.5 - true / 4, 0, 1).astype(np.float32), contour_level=0.5, everything=False
    )
    distance = silhouette_distance_px(disc)
    near = np.abs(true) < 10
    # pieces of up to √2 px on a circle of 30 px: sagitta of a hundredth of a pixel
    assert np.abs(distance - true)[near].max() < 0.05
    assert np.abs(distance - true).max() < 1.0


def test_a_dark_spot_inside_the_subject_does_not_pierce_it():
    u, v = np.meshgrid(np.arange(101.0), np.arange(101.0))
    from mammometry.matching.foreground.foreground import Foreground

    coverage = (np.hypot(u - 50, v - 50) < 40).astype(np.float32)
    coverage[50:52, 50:52] = 0.0
    distance = silhouette_distance_px(Foreground(camera="a", coverage=coverage, contour_level=0.5, everything=False))
    assert distance[51, 51] < -30


def test_a_silhouette_reaches_outside_where_its_edge_is_lost():
    """A disc of 60 px whose light fades over 20 px within 40° of straight below: there the line lies 10 px inside."""
    from scipy.ndimage import gaussian_filter

    from mammometry.matching.foreground.foreground import Foreground

    v, u = np.mgrid[-80.0:81, -80.0:81]
    inside = 60 - np.hypot(u, v)
    below = np.abs(np.arctan2(u, v)) < np.deg2rad(40)
    coverage = gaussian_filter(np.where(below, inside / 20, inside + 0.5).clip(0, 1), 0.7).astype(np.float32)
    disc = Foreground(camera="a", coverage=coverage, contour_level=0.5, everything=False)
    strict, let_out = silhouette_distance_px(disc), silhouette_distance_px(disc, lost_slope=0.25)
    away = np.hypot(60 * np.sin(np.deg2rad(40)), 60 * np.cos(np.deg2rad(40)) - 50)
    assert strict[140, 80] == pytest.approx(10, abs=0.5)
    assert let_out[140, 80] == pytest.approx(10 - 0.25 * away, abs=1.5)
    assert (let_out <= strict).all()
    sure = np.abs(np.arctan2(u, v)) > np.deg2rad(70)
    assert np.array_equal(let_out[sure & (np.abs(inside) < 10)], strict[sure & (np.abs(inside) < 10)])


def twin(field, points):
    """Plain NumPy form of kernels.sample_field at single points."""
    cut = field.truncation_mm
    out = np.full(len(points), -cut)
    out = np.maximum(out, (points @ field.box.planes[:, :3].T - field.box.planes[:, 3]).max(axis=1))
    for table in field.contours:
        for n, point in enumerate(points):
            x, y, z = table[:9].reshape(3, 3) @ point + table[9:12]
            u, v = table[12] * x / z + table[14], table[13] * y / z + table[15]
            w, h, start = int(table[21]), int(table[22]), int(table[23])
            if not (0 <= u < w - 1 and 0 <= v < h - 1):
                continue
            image = field.distances[start : start + w * h].reshape(h, w)
            c, r = int(u), int(v)
            du, dv = u - c, v - r
            pixels = (1 - dv) * ((1 - du) * image[r, c] + du * image[r, c + 1]) + dv * (
                (1 - du) * image[r + 1, c] + du * image[r + 1, c + 1]
            )
            out[n] = max(out[n], pixels * z / table[12])
    result = np.empty(len(points))
    for n, point in enumerate(points):
        total = weights = 0.0
        free = supported = False
        gaps = []
        for table in field.views:
            local = table[:9].reshape(3, 3) @ point + table[9:12]
            u, v = table[12] * local[0] / local[2] + table[14], table[13] * local[1] / local[2] + table[15]
            w, h, start = int(table[21]), int(table[22]), int(table[23])
            if not (0 <= u < w - 1 and 0 <= v < h - 1):
                continue
            image = field.elements[start : start + w * h].reshape(h, w, 3)
            c, r = int(u), int(v)
            du, dv = u - c, v - r
            square = image[r : r + 2, c : c + 2, 0].astype(float)
            nearest = image[r + (dv >= 0.5), c + (du >= 0.5)]
            seen = nearest[0]
            if square.min() > 0 and np.ptp(square) < JUMP_MM:
                seen = np.array([1 - dv, dv]) @ square @ np.array([1 - du, du])
            if seen <= 0:
                continue
            gap = (seen - np.linalg.norm(local)) * nearest[1]
            supported |= gap < cut
            if nearest[2] == 0:
                continue
            if nearest[2] == kernels.SPANNED:
                free |= gap > 0
                continue
            gaps.append(gap)
            if field.rule == "tsdf":
                if gap > -cut:
                    total += abs(nearest[2]) * min(gap, cut)
                    weights += abs(nearest[2])
            elif abs(gap) < cut:
                total += abs(nearest[2]) * gap
                weights += abs(nearest[2])
            elif gap > 0 and nearest[2] > 0:
                free = True
        if field.rule == "default":
            measured = total / weights if weights else (cut if free or not supported else -cut)
        elif field.rule == "tsdf":
            measured = total / weights if weights else (-cut if supported else cut)
        else:
            measured = {"nearest": min, "furthest": max}[field.rule](gaps) if gaps else (-cut if supported else cut)
        result[n] = np.clip(max(out[n], measured), -cut, cut)
    return result


@pytest.mark.parametrize("rule", first(2, ["default", "tsdf", "nearest", "furthest"]))
def test_kernel_equals_its_plain_twin(rule):
    images, foregrounds, rig = scene(FRONT, (30.0, 25.0, 20.0), size=90)
    images = [image.keeping(image.points_world()[..., 0] > -15) for image in images]
    box = closing_box(images, back_mm=5.0, around_mm=5.0)
    field = build_field(images, foregrounds, rig, box, rule)
    rng = np.random.default_rng(1)
    origins = rng.normal(size=(24, 3))
    origins *= (rng.uniform(0.75, 1.15, 24) / np.linalg.norm(origins, axis=1))[:, None] * [30.0, 25.0, 20.0]
    steps = np.stack(np.meshgrid(*[np.arange(3)] * 3, indexing="ij"), axis=-1).reshape(-1, 3) * 0.7
    points = (origins[:, None] + steps).reshape(-1, 3)
    sampled = field.sample(origins, 3, 0.7).ravel()
    np.testing.assert_allclose(sampled, twin(field, points), atol=1e-4)
    assert len(np.unique(np.round(sampled, 3))) > 100  # not all cut to ±2


@pytest.mark.parametrize("whose", ["silhouette", "outline"])
def test_elements_equal_their_plain_twin(whose):
    """Normals, tangent planes and weights of one view, written with whole arrays in the world frame."""
    images, foregrounds, rig = scene(FRONT, (30.0, 25.0, 20.0), size=90)
    points = images[0].points_world()
    image = images[0].keeping((points[..., 0] > -15) & (np.hypot(points[..., 0], points[..., 1]) > 4))  # with a hole
    left = rig.pair(image.name).left
    foreground = foregrounds[left.name] if whose == "silhouette" else None
    found = view_elements(image, left, foreground, nearest_of_others_mm(image, images))
    rays, normals = image.ray_directions(), image.normals_world(NORMAL_MM)
    cosine = -np.einsum("ijk,ijk->ij", normals, rays)
    known = image.valid & np.isfinite(cosine)
    cosine = np.where(known, np.clip(cosine, 0.1, 1.0), 0.5)
    trust = image.trust(TAPER_MM)
    weight = np.where(image.valid, cosine**2 * trust / (image.sigma_mm**2 + SIGMA_FLOOR_MM**2), 0.0)
    subject = found[..., 0] > 0
    assert (subject[image.valid]).all()
    assert (subject & ~image.valid).sum() > (300 if whose == "silhouette" else 20)
    at = image_kernels.nearest_true(known)
    beside = np.hypot(*(found_at - index for found_at, index in zip(at, np.indices(known.shape), strict=True)))
    nearest = image.range_mm[at].astype(float)
    with np.errstate(divide="ignore", invalid="ignore"):
        plane = nearest * np.einsum("ijk,ijk->ij", normals[at], rays[at]) / np.einsum("ijk,ijk->ij", normals[at], rays)
    reach = 6.0 * image.pixel_mm() * beside
    plane = np.clip(np.where(plane > 0, plane, nearest), nearest - reach, nearest + reach)
    extended = subject & ~image.valid & (beside * image.pixel_mm() <= EXTEND_MM)
    ranges = np.where(image.valid, image.range_mm, np.where(extended, plane, nearest))
    weights = np.where(image.valid, weight, np.where(extended, -EXTEND_WEIGHT * weight[at], 0.0))
    expected = np.stack([ranges, np.where(image.valid, cosine, cosine[at]), weights], axis=-1)
    np.testing.assert_allclose(found[subject], expected[subject], rtol=2e-5)
    assert not found[~subject].any()


def test_cells_are_empty_where_no_point_lies():
    points = np.random.default_rng(3).uniform(-2, 12, (60, 3))
    empty = kernels.empty_cells(points, np.array([0.0, 1.0, 0.5]), 1.5, (5, 6, 4))
    cell = np.floor((points - [0.0, 1.0, 0.5]) / 1.5).astype(int)
    expected = np.ones((5, 6, 4), dtype=bool)
    expected[tuple(cell[((cell >= 0) & (cell < (5, 6, 4))).all(axis=1)].T)] = False
    np.testing.assert_array_equal(empty, expected)


def ball(radius, centre=(0, 0, 0)):
    def sample(origins, side, spacing):
        steps = np.stack(np.meshgrid(*[np.arange(side)] * 3, indexing="ij"), axis=-1) * spacing
        points = origins[:, None, None, None] + steps
        return np.clip(np.linalg.norm(points - centre, axis=-1) - radius, -2, 2).astype(np.float32)

    return sample


def test_only_blocks_near_the_surface_are_evaluated():
    low, high = np.full(3, -40.0), np.full(3, 40.0)
    grid = sample_blocks(ball(30.0), np.array([low, high]), np.zeros((0, 3)), cube_mm=0.5, truncation_mm=2.0)
    crossed = 4 * np.pi * 30.0**2 / (8 * 0.5) ** 2
    assert crossed < len(grid.values) < 4 * crossed
    mesh = Isosurface(grid, smoothing=0.0).mesh()
    assert is_closed_ball(mesh)
    # linear interpolation of the distance over a 0.5 mm edge: h²/(8R) = .001 mm inwards
    error = np.linalg.norm(mesh.vertices, axis=1) - 30.0
    assert error.min() > -0.006
    assert error.max() < 0.006  # both: values within .005 mm of the level are moved off it
    assert mesh.volume_mm3() == pytest.approx(4 / 3 * np.pi * 27000, rel=1e-3)


def test_the_surface_is_followed_where_no_block_centre_shows_it():
    """A ball that hides between block centres is still found from a measured point on it."""
    low, high = np.full(3, -20.0), np.full(3, 20.0)
    args = dict(cube_mm=0.5, truncation_mm=2.0)
    centre = (2.0, 2.0, 2.0)
    grid = sample_blocks(ball(1.6, centre), np.array([low, high]), np.array([[3.6, 2.0, 2.0]]), **args)
    assert is_closed_ball(Isosurface(grid, smoothing=0.0).mesh())


def test_the_largest_part_drops_crumbs_and_cavities():
    def hollow_and_crumb(origins, side, spacing):
        shell = np.maximum(ball(15.0)(origins, side, spacing), -ball(6.0)(origins, side, spacing))
        return np.minimum(shell, ball(4.0, (0, 0, 25.0))(origins, side, spacing))

    low, high = np.full(3, -20.0), np.full(3, 32.0)
    on_each = np.array([[15.0, 0, 0], [6.0, 0, 0], [4.0, 0, 25.0]])
    mesh = Isosurface(
        sample_blocks(hollow_and_crumb, np.array([low, high]), on_each, cube_mm=1.0, truncation_mm=2.0), smoothing=0.0
    ).mesh()
    assert mesh.components()[0] == 3
    part = largest_part(mesh)
    assert is_closed_ball(part)
    assert part.volume_mm3() == pytest.approx(4 / 3 * np.pi * 15.0**3, rel=0.01)


def pierced(origins, side, spacing):
    """A ball of 15 mm with a bore of 0.7 mm radius beside its axis."""
    steps = np.stack(np.meshgrid(*[np.arange(side)] * 3, indexing="ij"), axis=-1) * spacing
    points = origins[:, None, None, None] + steps
    bore = 0.7 - np.hypot(points[..., 0] - 11.0, points[..., 1])
    return np.maximum(ball(15.0)(origins, side, spacing), bore).astype(np.float32)


def test_a_tunnel_is_found_and_healed_in_its_place():
    grid = sample_blocks(pierced, np.array([[-18.0] * 3, [18.0] * 3]), np.zeros((0, 3)), cube_mm=0.5, truncation_mm=2.0)
    surface = Isosurface(grid, smoothing=0.0)
    torus = surface.mesh()
    assert torus.euler_number() == 0
    places = tunnel_places(torus, 6.0)
    assert len(places) >= 1
    # the bore leaves the ball at (11, 0, ±√(15² − 11²)); cells are 6 mm wide
    mouths = np.array([[11.0, 0.0, 10.2], [11.0, 0.0, -10.2]])
    assert np.linalg.norm(places[:, None] - mouths, axis=2).min(axis=1).max() < 6.0
    surface.heal(places, reach_mm=6.0, sigma_mm=2.0)
    healed = surface.mesh()
    assert is_closed_ball(largest_part(healed))
    far = (
        np.linalg.norm(torus.vertices[:, None] - places, axis=2).min(axis=1) > 15.5
    )  # twice the reach, and a coarse cube
    kept = (
        np.linalg.norm(healed.vertices[:, None] - places, axis=2).min(axis=1) > 15.5
    )  # twice the reach, and a coarse cube
    # untouched elsewhere
    np.testing.assert_allclose(np.sort(torus.vertices[far], axis=0), np.sort(healed.vertices[kept], axis=0))
    surface.heal(np.array([[-15.0, 0.0, 0.0]]), reach_mm=6.0, sigma_mm=2.0)  # elsewhere: what was healed stays so
    assert is_closed_ball(largest_part(surface.mesh()))
    assert not len(tunnel_places(Isosurface(grid_of_ball(), smoothing=0.0).mesh(), 6.0))


def grid_of_ball():
    return sample_blocks(
        ball(15.0), np.array([[-18.0] * 3, [18.0] * 3]), np.zeros((0, 3)), cube_mm=0.5, truncation_mm=2.0
    )


def test_an_empty_field_gives_an_empty_mesh():
    grid = sample_blocks(
        lambda o, s, h: np.full((len(o), s, s, s), 2.0, dtype=np.float32),
        np.array([[0.0] * 3, [10.0] * 3]),
        np.zeros((0, 3)),
        cube_mm=1.0,
        truncation_mm=2.0,
    )
    mesh = Isosurface(grid, smoothing=1.0).mesh()
    assert isinstance(mesh, TriangleMesh)
    assert len(mesh.faces) == 0


def test_the_box_holds_what_little_is_seen_of_an_arm():
    """One datum in three thousand lies 150 mm beside the rest; one in a hundred thousand is an outlier."""
    camera = camera_towards("a", (0, 0, 1), size=460, distance=500.0, focal=500.0)
    valid = np.zeros(camera.shape_hw, dtype=bool)
    valid[80:380, 60:300] = True  # 72,000 data
    valid[200:205, 445:450] = True
    ranges = np.where(valid, 500.0, np.nan)
    image = range_image(camera, ranges)
    box = closing_box([image], back_mm=10.0, around_mm=20.0)
    assert (box.distance_mm(image.valid_points_world()) < 0).all()


@pytest.mark.slow
def test_the_nearest_datum_of_other_views_in_each_block():
    """By a loop over all points of the other views, one by one."""
    images, _, _ = scene(FRONT, (30.0, 25.0, 20.0), size=61)
    found = nearest_of_others_mm(images[0], images)
    expected = np.full((16, 16), np.inf)
    for other in images[1:]:
        for point in other.valid_points_world():
            u, v = np.rint(images[0].camera.project(point[None])[0]).astype(int)
            if 0 <= u < 61 and 0 <= v < 61:
                away = np.linalg.norm(point - images[0].camera.centre_world)
                expected[v // 4, u // 4] = min(expected[v // 4, u // 4], away)
    assert np.isfinite(expected).any()
    np.testing.assert_allclose(found, expected, rtol=1e-6)
