"""Two cameras before a sphere: what is true of their pixels follows from similar triangles."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from mammometry.geometry.camera import Camera, Rig, StereoPair
from mammometry.geometry.mesh import TriangleMesh
from mammometry.geometry.transform import Transform
from mammometry.io.truth import read_truth
from mammometry.matching.dense.match import DisparityMap
from mammometry.matching.foreground.foreground import Foreground
from mammometry.study.accuracy_matching import (
    judge_disparity,
    judge_range,
    judge_silhouette,
    silhouette_overlap,
    true_disparity,
)
from mammometry.study.rays import RayScene, pixel_grid, seen_by_pairs
from mammometry.surface.ranges.range_image import RangeImage, thinned_camera

RADIUS, DISTANCE, BASELINE, FOCAL = 50.0, 600.0, 150.0, 900.0
SIZE = (240, 180)


def camera(name: str, x_mm: float) -> Camera:
    """Looks along z from (x, 0, −600); its principal point is where the sphere about the origin is in the middle."""
    column = (SIZE[0] - 1) / 2 + FOCAL * x_mm / DISTANCE
    return Camera(
        name=name,
        size_wh=SIZE,
        matrix=np.array([[FOCAL, 0, column], [0, FOCAL, (SIZE[1] - 1) / 2], [0, 0, 1]]),
        distortion=np.zeros(5),
        camera_from_world=Transform(rotation=np.eye(3), translation_mm=np.array([-x_mm, 0, DISTANCE])),
    )


PAIR = StereoPair(name="front", left=camera("left", -BASELINE / 2), right=camera("right", BASELINE / 2))


@pytest.fixture(scope="module")
def scene() -> RayScene:
    ball = trimesh.creation.icosphere(subdivisions=6, radius=RADIUS)
    return RayScene(TriangleMesh(vertices=np.asarray(ball.vertices), faces=np.asarray(ball.faces).astype(np.int32)))


def disparity_map(d_h: np.ndarray, valid: np.ndarray, sigma: float = 0.1) -> DisparityMap:
    zero = np.zeros(d_h.shape, dtype=np.float32)
    return DisparityMap(
        name="front",
        left=PAIR.left,
        right=PAIR.right,
        d_h_px=np.where(valid, d_h, 0).astype(np.float32),
        d_v_px=zero,
        confidence=zero,
        sigma_px=zero + np.float32(sigma),
        valid=valid,
        weak=np.zeros_like(valid),
    )


def sphere_depth() -> np.ndarray:
    """Depth z of the sphere in the left picture by the quadratic formula; NaN beside it."""
    rays = PAIR.left.rays_world(pixel_grid(PAIR.left))
    origin = PAIR.left.centre_world
    b = rays @ origin
    with np.errstate(invalid="ignore"):
        along = -b - np.sqrt(b**2 - (origin @ origin - RADIUS**2))
    return along * rays[..., 2]


def test_true_disparity_is_that_of_similar_triangles(scene: RayScene) -> None:
    truth = true_disparity(scene, PAIR, PAIR, PAIR.left, PAIR.right)
    expected = FOCAL * BASELINE / sphere_depth() - FOCAL * BASELINE / DISTANCE
    assert truth.step == 1
    assert truth.judged.sum() > 8000
    # Facets of the sphere lie at most 0.02 mm inside: 900 · 150 / 550² · 0.02 = 0.01 px.
    assert truth.d_h_px[truth.judged] == pytest.approx(expected[truth.judged], abs=0.01)
    assert truth.edge_px[truth.judged].min() > 5


def test_true_disparity_does_not_depend_on_what_the_calibration_believes(scene: RayScene) -> None:
    """Cameras calibrated 2 px off in one principal point see the same photographs: the disparity shifts by that."""
    wrong = camera("right", BASELINE / 2)
    matrix = wrong.matrix.copy()
    matrix[0, 2] += 2.0
    calibrated = Camera(
        name="right", size_wh=SIZE, matrix=matrix, distortion=np.zeros(5), camera_from_world=wrong.camera_from_world
    )
    believed = StereoPair(name="front", left=PAIR.left, right=calibrated)
    # Rectified with the belief: the photograph's column c is the rectified column c − 2.
    right = true_disparity(scene, PAIR, PAIR, PAIR.left, PAIR.right)
    shifted = true_disparity(scene, PAIR, believed, PAIR.left, PAIR.right)
    both = right.judged & shifted.judged
    assert both.sum() > 8000
    assert (shifted.d_h_px - right.d_h_px)[both] == pytest.approx(2.0, abs=1e-6)
    assert shifted.range_mm[both] == pytest.approx(right.range_mm[both])


def test_errors_put_in_come_out(scene: RayScene) -> None:
    truth = true_disparity(scene, PAIR, PAIR, PAIR.left, PAIR.right)
    valid = np.isfinite(truth.d_h_px)
    valid[:, : SIZE[0] // 2] = False
    error = np.where(pixel_grid(PAIR.left)[..., 1] % 10 == 0, 1.5, 0.2)  # every tenth row far off
    found = judge_disparity(truth, disparity_map(np.nan_to_num(truth.d_h_px) + error, valid))
    assert found is not None
    assert found.median_px == pytest.approx(0.2, abs=1e-4)
    assert found.p95_px == pytest.approx(1.5, abs=1e-4)
    assert found.beyond_1_px_percent == pytest.approx(10, abs=1.5)
    assert found.complete_percent == pytest.approx(100 * truth.judged[:, SIZE[0] // 2 :].sum() / truth.judged.sum())
    assert found.error_over_sigma == pytest.approx(1.4826 * 2, rel=1e-3)
    assert found.beyond_3_sigma_percent == found.beyond_1_px_percent
    assert found.depth_bias_mm == pytest.approx(-0.2 * 555**2 / (FOCAL * BASELINE), rel=0.05)  # nearer
    # Depths at the outline: that of the tangent cone, and of what lies 8 px within it.
    assert found.rim_bias_mm == pytest.approx(-0.2 * 580**2 / (FOCAL * BASELINE), rel=0.05)
    halved = judge_disparity(truth, replace(disparity_map(np.nan_to_num(truth.d_h_px) + error, valid), halvings=1))
    assert halved is not None
    assert (halved.median_px, halved.p95_px) == (2 * found.median_px, 2 * found.p95_px)
    assert (halved.error_over_sigma, halved.depth_bias_mm) == (found.error_over_sigma, found.depth_bias_mm)
    nothing = disparity_map(np.nan_to_num(truth.d_h_px), np.zeros_like(valid))
    assert judge_disparity(truth, nothing) is None


def test_range_errors_put_in_come_out(scene: RayScene) -> None:
    truth = true_disparity(scene, PAIR, PAIR, PAIR.left, PAIR.right)
    valid = np.isfinite(truth.range_mm)
    ranges = np.where(valid, truth.range_mm + 0.3, 0).astype(np.float32)
    zero = np.zeros_like(ranges)
    image = RangeImage(name="front", camera=PAIR.left, range_mm=ranges, sigma_mm=zero, confidence=zero, valid=valid)
    found = judge_range(truth, image)
    assert found is not None
    assert (found.bias_mm, found.median_mm, found.p95_mm) == pytest.approx((0.3, 0.3, 0.3), abs=1e-4)
    assert judge_range(truth, image.keeping(np.zeros_like(valid))) is None


@pytest.mark.parametrize(("judged_every", "thinned"), [(2, 2), (2, 3), (1, 2), (3, 1)])
def test_range_images_and_truth_are_thinned_by_steps_of_their_own(
    scene: RayScene, judged_every: int, thinned: int
) -> None:
    # Full-size pictures are judged at every second pixel, and their range images keep every second one too.
    whole = true_disparity(scene, PAIR, PAIR, PAIR.left, PAIR.right)
    few = slice(None, None, judged_every)
    fields = {
        name: np.array(getattr(whole, name)[few, few])
        for name in ("d_h_px", "range_mm", "judged", "visible", "edge_px")
    }
    truth = replace(whole, step=judged_every, **fields)
    kept = slice(None, None, thinned)
    valid = np.isfinite(whole.range_mm)[kept, kept]
    ranges = np.where(valid, whole.range_mm[kept, kept] - 0.2, 0).astype(np.float32)
    zero = np.zeros_like(ranges)
    camera = thinned_camera(PAIR.left, thinned)
    image = RangeImage(name="front", camera=camera, range_mm=ranges, sigma_mm=zero, confidence=zero, valid=valid)
    found = judge_range(truth, image)
    assert found is not None
    assert (found.bias_mm, found.median_mm, found.p95_mm) == pytest.approx((-0.2, 0.2, 0.2), abs=1e-4)


@pytest.mark.parametrize("too_wide_px", [0.0, 1.5, -1.0])
def test_a_silhouette_of_another_size(scene: RayScene, too_wide_px: float) -> None:
    # The rays that touch a sphere make a circular cone about the direction of its centre.
    towards = -PAIR.left.centre_world
    distance = np.linalg.norm(towards)
    angle = np.arccos(PAIR.left.rays_world(pixel_grid(PAIR.left)) @ towards / distance)
    inwards_px = FOCAL * (np.arcsin(RADIUS / distance) - angle)  # within 2 %: the cone stands 7° off the axis
    coverage = np.clip(0.5 + (inwards_px + too_wide_px) / 4, 0, 1).astype(np.float32)
    found = Foreground(camera="left", coverage=coverage, contour_level=0.5, everything=False)
    judged = judge_silhouette(scene, PAIR.left, found)
    assert judged is not None
    assert judged.mean_px == pytest.approx(too_wide_px, abs=0.06)
    common, either = silhouette_overlap(scene, PAIR.left, found)
    assert common / either > 0.93


def test_no_silhouette_is_not_judged(scene: RayScene) -> None:
    nothing = Foreground(
        camera="left", coverage=np.zeros(SIZE[::-1], dtype=np.float32), contour_level=0.4, everything=False
    )
    assert judge_silhouette(scene, PAIR.left, nothing) is None


def test_a_pair_sees_what_faces_both_of_its_cameras(scene: RayScene) -> None:
    rig = Rig(name="r", cameras={"left": PAIR.left, "right": PAIR.right}, pair_names={"front": ("left", "right")})
    at, by_pair = seen_by_pairs(scene, rig, every=3)
    points = scene.mesh.vertices[at]
    facing = np.ones(len(at), dtype=bool)
    sharp = np.ones(len(at), dtype=bool)
    for each in (PAIR.left, PAIR.right):
        offsets = each.centre_world - points
        angle = np.degrees(np.arccos(np.einsum("ij,ij->i", offsets, points / RADIUS) / np.linalg.norm(offsets, axis=1)))
        facing &= angle < 75
        sharp &= np.abs(angle - 75) > 0.5  # vertex normals of facets are good to less than that
    assert (by_pair["front"] == facing)[sharp].all()
    assert 0.2 < facing.mean() < 0.5


def test_what_stands_before_a_point_hides_it(scene: RayScene) -> None:
    # A small plate before the sphere's pole, both in one mesh.
    plate = trimesh.creation.box(extents=(10, 10, 1)).apply_translation((0, 0, -70))
    both = trimesh.util.concatenate(trimesh.Trimesh(scene.mesh.vertices, scene.mesh.faces, process=False), plate)
    mixed = RayScene(TriangleMesh(vertices=np.asarray(both.vertices), faces=np.asarray(both.faces).astype(np.int32)))
    points = np.array([[0.0, 0, -RADIUS], [30.0, 0, -40.0]])
    assert mixed.hides(np.array([0.0, 0, -DISTANCE]), points).tolist() == [True, False]
    assert scene.hides(np.array([0.0, 0, -DISTANCE]), points).tolist() == [False, False]
    assert mixed.seen_from(np.array([0.0, 0, -DISTANCE]), points).hit.tolist() == [False, True]


@pytest.mark.slow
@pytest.mark.data
def test_visibility_agrees_with_an_independent_renderers(shared_data: Path) -> None:
    """Its truth says which vertices each pair sees by the same rule (75°); both cast rays at the same mesh."""
    captures = shared_data / "rendered"
    pairs = {
        name: tuple(cameras) for name, cameras in json.loads((captures / "session.json").read_text())["pairs"].items()
    }
    truth = read_truth(captures / "plaster_a" / "truth", pairs)
    at, by_pair = seen_by_pairs(RayScene(truth.mesh), truth.rig, every=9)
    with np.load(captures / "plaster_a" / "truth" / "visibility.npz") as theirs:
        for bit, name in enumerate(theirs["pairs"]):
            differs = ((theirs["pair_bits"][at] >> bit) & 1).astype(bool) != by_pair[str(name)]
            assert differs.mean() < 0.001
