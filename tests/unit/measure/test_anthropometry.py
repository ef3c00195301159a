"""Shape, lengths, ptosis, symmetry and nipples on bodies that are known in closed form."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import gaussian_filter
from scipy.spatial.transform import Rotation
from solids import as_surface, ball
from trunks import LEFT, RADIUS_MM, RIGHT, edge_of, radius_mm, trunk_mesh

from mammometry.base.errors import MeasureError
from mammometry.geometry.mesh import TriangleMesh
from mammometry.geometry.transform import Transform
from mammometry.measure.landmarks.landmarks import Landmark, picked_landmarks
from mammometry.measure.landmarks.nipple import propose_nipple
from mammometry.measure.settings import NippleSettings
from mammometry.measure.shape.anthropometry import shape_of, volume_within_mm3
from mammometry.measure.shape.lengths import by_name, linear_measures, ptosis
from mammometry.measure.shape.symmetry import symmetry
from mammometry.measure.trunk.body import find_body
from mammometry.measure.trunk.mirror_plane import MirrorPlane, mirror, register
from mammometry.measure.volume import volumes
from mammometry.measure.volume.difference import difference
from mammometry.measure.volume.measurement import VolumeMeasurement
from mammometry.measure.wall import chest_wall
from mammometry.measure.wall.open_breast import OpenBreast
from mammometry.surface.repair.repair import RepairedSurface

FRAME = np.eye(3)
MIDDLE = MirrorPlane(point_world=np.zeros(3), normal_world=FRAME[0], sigma_mm=0.1, scatter_mm=0.5)
"""The trunk stands in its own frame: +x is the patient's left, +y the head, +z ahead."""
BALL = ball(50.0, subdivisions=4)


def on_trunk(theta: float, y: float) -> np.ndarray:
    r = float(radius_mm(np.array(theta), np.array(y)))
    return np.array([r * np.sin(theta), y, r * np.cos(theta)])


@cache
def trunk(step_mm: float = 3.0) -> RepairedSurface:
    return as_surface(trunk_mesh(step_mm))


@cache
def measured() -> tuple[VolumeMeasurement, ...]:
    edges = (edge_of(LEFT, "left"), edge_of(RIGHT, "right"))
    found = []
    for edge in edges:
        wall = chest_wall.fit(OpenBreast(boundary=edge, surface=trunk(), boundaries=edges), "membrane")
        found.append(volumes.measure(edge, wall))
    return tuple(found)


# --- volumes on one side of planes


def test_half_and_quarter_balls() -> None:
    whole = BALL.volume_mm3()
    up, left = np.array([0.0, 1.0, 0.0]), np.array([1.0, 0.0, 0.0])
    assert volume_within_mm3(BALL, np.zeros(3), [up]) == pytest.approx(whole / 2, rel=1e-9)
    assert volume_within_mm3(BALL, np.zeros(3), [up, left]) == pytest.approx(whole / 4, rel=1e-3)


@settings(max_examples=20, deadline=None)
@given(st.floats(-40, 40), st.floats(-1, 1), st.floats(-1, 1))
def test_caps_of_a_ball_have_archimedes_volume(height: float, a: float, b: float) -> None:
    normal = np.array([a, b, 1.2]) / np.linalg.norm([a, b, 1.2])
    cap = 50.0 - height
    wanted = np.pi * cap**2 * (3 * 50.0 - cap) / 3
    found = volume_within_mm3(BALL, normal * height, [normal])
    # The faceted ball is .45 % smaller than the round one, and its caps by as much of the whole.
    assert found == pytest.approx(wanted, abs=0.006 * BALL.volume_mm3())
    other = volume_within_mm3(BALL, normal * height, [-normal])
    assert found + other == pytest.approx(BALL.volume_mm3(), rel=1e-12)


@settings(max_examples=20, deadline=None)
@given(st.tuples(*[st.floats(-80, 80)] * 3))
def test_quadrants_add_up_wherever_the_planes_meet(place: tuple[float, ...]) -> None:
    up, left = np.array([0.0, 1.0, 0.0]), np.array([0.8, 0.0, 0.6])
    parts = [volume_within_mm3(BALL, np.array(place), [i * up, j * left]) for i in (1, -1) for j in (1, -1)]
    assert sum(parts) == pytest.approx(BALL.volume_mm3(), rel=1e-12)
    assert min(parts) > -1e-6


def test_manifold_cuts_the_same_volume() -> None:
    """Independent: Manifold's own trimming, with a cap."""
    import manifold3d

    mesh = manifold3d.Mesh64(vert_properties=np.array(BALL.vertices), tri_verts=BALL.faces.astype(np.uint64))
    solid = manifold3d.Manifold(mesh)
    normal = np.array([0.36, 0.48, 0.8])
    assert volume_within_mm3(BALL, normal * 17.0, [normal]) == pytest.approx(
        solid.trim_by_plane(tuple(normal), 17.0).volume(), rel=1e-9
    )


def test_shape_of_a_bump() -> None:
    left, _ = measured()
    tip = Landmark(name="nipple_left", points_world=on_trunk(LEFT[0], LEFT[1])[None], method="known", sigma_mm=2.0)
    # In the bump's own frame it is symmetric: all four quadrants are equal.
    turn = Rotation.from_rotvec([0, LEFT[0], 0]).as_matrix().T
    shape = shape_of(left, turn, tip, boundary_sigma_mm=3.0)
    assert shape.base_height_mm == pytest.approx(2 * LEFT[2], abs=0.5)  # the edge is drawn with 160 corners
    assert shape.base_width_mm == pytest.approx(2 * RADIUS_MM * np.sin(LEFT[2] / RADIUS_MM), abs=0.5)
    assert sum(shape.quadrants_cc.values()) == pytest.approx(left.volume_cc, rel=1e-12)
    assert shape.above_nipple_cc == pytest.approx(shape.below_nipple_cc, rel=0.03)  # 3 mm edges along the boundary
    assert shape.quadrants_cc["upper lateral"] == pytest.approx(shape.quadrants_cc["upper medial"], rel=0.03)
    higher = shape_of(
        left, turn, replace(tip, points_world=tip.points_world + np.array([0, 2, 0])), boundary_sigma_mm=3.0
    )
    assert shape.above_nipple_cc is not None
    assert higher.above_nipple_cc is not None
    assert shape.pole_sigma_cc == pytest.approx(shape.above_nipple_cc - higher.above_nipple_cc, rel=0.03)


def test_the_projection_changes_with_the_boundary_as_its_uncertainty_says() -> None:
    """Independent: the boundary drawn wider and narrower on the flank of the bump, and measured again."""
    drawn = {}
    for further in (-3.0, 0.0, 3.0):
        edge = edge_of(LEFT, "left", wider=0.6 + further / LEFT[2])
        wall = chest_wall.fit(OpenBreast(boundary=edge, surface=trunk(), boundaries=(edge,)), "membrane")
        drawn[further] = volumes.measure(edge, wall)
    wider, narrower = drawn[3.0], drawn[-3.0]
    moved = np.linalg.norm(wider.boundary_world - narrower.boundary_world, axis=1).mean() / 2
    sigma = shape_of(drawn[0.0], FRAME, None, boundary_sigma_mm=moved).projection_sigma_mm
    assert sigma > 1.0  # the flank is steep
    assert sigma == pytest.approx((wider.projection_mm - narrower.projection_mm) / 2, rel=0.1)


# --- lengths


def test_lengths_on_the_trunk() -> None:
    mesh = trunk().mesh
    places = {
        "sternal_notch": on_trunk(0.0, 150.0)[None],
        "midline": np.stack([on_trunk(0.0, y) for y in (150.0, 0.0, -150.0)]),
        "nipple_left": on_trunk(LEFT[0], LEFT[1])[None],
        "nipple_right": on_trunk(RIGHT[0], RIGHT[1])[None],
        "medial_left": on_trunk(np.pi - 0.4, -100.0)[None],
        "lateral_left": on_trunk(np.pi + 0.4, -40.0)[None],
    }
    marks = picked_landmarks({k: v for k, v in places.items() if "al_left" not in k}, mesh, FRAME, sigma_mm=2.0)
    ends = picked_landmarks({k: places[k] for k in ("medial_left", "lateral_left")}, mesh, None, sigma_mm=2.0)
    found = {measure.name: measure for measure in linear_measures(by_name([*marks, *ends]), mesh)}
    assert set(found) == {"SN-N left", "SN-N right", "N-N", "N-midline left", "N-midline right", "base width left"}
    straight = np.linalg.norm(places["nipple_left"] - places["nipple_right"])
    assert found["N-N"].straight_mm == pytest.approx(straight, abs=0.1)
    nearest = np.hypot(*places["nipple_left"][0, [0]], places["nipple_left"][0, 2] - RADIUS_MM)
    assert found["N-midline left"].straight_mm == pytest.approx(nearest, abs=0.2)
    around = found["base width left"]  # on the round back: straight when rolled out
    assert around.geodesic_mm == pytest.approx(np.hypot(0.8 * RADIUS_MM, 60.0), rel=0.005)
    assert around.geodesic_sigma_mm == pytest.approx(np.hypot(2.0, 2.0))
    assert all(each.geodesic_mm >= each.straight_mm - 1e-6 for each in found.values() if each.geodesic_mm)


def test_sigma_of_a_straight_length_is_that_of_repeated_picks() -> None:
    """Monte Carlo on a cylinder's back: picks scattered within the tangent planes."""
    mesh = trunk().mesh
    angles, heights = np.array([np.pi - 0.5, np.pi + 0.5]), np.array([-90.0, -20.0])
    marks = [
        Landmark(name=name, points_world=on_trunk(t, y)[None], method="known", sigma_mm=2.0)
        for name, t, y in zip(("medial_left", "lateral_left"), angles, heights, strict=True)
    ]
    (length,) = linear_measures(by_name(marks), mesh)
    rng = np.random.default_rng(3)
    t = angles[:, None] + rng.normal(0, 2.0 / RADIUS_MM, (2, 20000))
    y = heights[:, None] + rng.normal(0, 2.0, (2, 20000))
    points = np.stack([RADIUS_MM * np.sin(t), y, RADIUS_MM * np.cos(t)], axis=-1)
    spread = np.linalg.norm(points[0] - points[1], axis=1).std()
    assert length.straight_sigma_mm == pytest.approx(spread, rel=0.04)  # facets turn the normals by up to 1°


@pytest.mark.parametrize(
    ("below_mm", "grade", "certain"),
    [(-25.0, "none", True), (5.0, "I", False), (20.0, "II", True), (45.0, "III", True)],
)
def test_regnault(below_mm: float, grade: str, certain: bool) -> None:
    """A bump whose fold is put where it gives the wanted height; the contour lies 58 mm below the nipple."""
    left, _ = measured()
    nipple = Landmark(name="nipple_left", points_world=on_trunk(LEFT[0], LEFT[1])[None], method="known", sigma_mm=2.0)
    fold = on_trunk(LEFT[0], LEFT[1]) + np.array([0, below_mm, 0])
    mark = Landmark(name="inframammary_fold_left", points_world=fold[None], method="known", sigma_mm=3.0)
    found = ptosis(left, FRAME[1], nipple, mark, boundary_sigma_mm=3.0)
    assert found.nipple_below_fold_mm == pytest.approx(below_mm)
    assert found.sigma_mm == pytest.approx(np.hypot(2.0, 3.0))
    assert (found.grade if below_mm > -20 else "none") == grade
    assert (len(found.likely) == 1) == certain
    assert found.nipple_above_lowest_mm == pytest.approx(LEFT[2], abs=3.0)  # 3 mm edges along the boundary


def test_a_nipple_about_5_mm_over_the_contour_may_be_of_either_grade() -> None:
    left, _ = measured()
    up = FRAME[1]
    lowest = left.skin.vertices[np.argmin(left.skin.vertices @ up)]
    nipple = Landmark(name="nipple_left", points_world=(lowest + 6.0 * up)[None], method="known", sigma_mm=2.0)
    fold = (lowest + 26.0 * up)[None]
    mark = Landmark(name="inframammary_fold_left", points_world=fold, method="known", sigma_mm=1.0)
    found = ptosis(left, up, nipple, mark, boundary_sigma_mm=3.0)
    assert (found.grade, set(found.likely)) == ("II", {"II", "III"})


def test_landmarks_of_the_wrong_side_and_off_the_surface_are_named() -> None:
    mesh = trunk().mesh
    notch = {"sternal_notch": on_trunk(0.0, 150.0)[None]}
    with pytest.raises(MeasureError, match=r"^landmark 'nipple_left': .*middle"):
        picked_landmarks({**notch, "nipple_left": on_trunk(RIGHT[0], RIGHT[1])[None]}, mesh, FRAME, sigma_mm=2.0)
    swapped = {"nipple_left": on_trunk(RIGHT[0], 0.0)[None], "nipple_right": on_trunk(LEFT[0], 0.0)[None]}
    with pytest.raises(MeasureError, match="Swap"):
        picked_landmarks(swapped, mesh, FRAME, sigma_mm=2.0)
    lonely = {"nipple_right": on_trunk(LEFT[0], 0.0)[None]}
    with pytest.raises(MeasureError, match="nipple_right"):
        picked_landmarks(lonely, mesh, FRAME, sigma_mm=2.0, middle_world=np.zeros(3))
    with pytest.raises(MeasureError, match=r"^landmark 'sternal_notch': .*surface"):
        picked_landmarks({"sternal_notch": notch["sternal_notch"] + (0, 0, 30.0)}, mesh, FRAME, sigma_mm=2.0)


# --- nipples


def _breast_with_nipple(
    tip_mm: float, red: float, *, off_mm: tuple[float, float] = (0.0, 0.0), noise_mm: float = 0.0, seed: int = 1
) -> tuple[TriangleMesh, np.ndarray, np.ndarray, np.ndarray]:
    """A cap on a plane, a nipple beside its highest point, an areola around that; colours under slanting light.

    `off_mm`: of the areola's middle from the nipple. `noise_mm`: of the skin, smoothed as a telephone's scan is.
    """
    x, y = np.meshgrid(np.arange(-70.0, 70.1, 1.75), np.arange(-70.0, 70.1, 1.75))
    nipple = np.array([12.0, -9.0])
    away = np.hypot(x - nipple[0], y - nipple[1])
    z = 32.0 * np.clip(1 - (x**2 + y**2) / 65.0**2, 0, None) ** 2 + tip_mm * np.exp(-((away / 5.0) ** 2))
    rng = np.random.default_rng(seed)
    if noise_mm:
        rough = gaussian_filter(rng.normal(size=z.shape), 2.0)
        z += noise_mm * rough / rough.std()
    n = len(x)
    a = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    faces = np.concatenate([np.stack([a, a + 1, a + n + 1], axis=1), np.stack([a, a + n + 1, a + n], axis=1)])
    mesh = TriangleMesh(vertices=np.stack([x, y, z], axis=-1).reshape(-1, 3), faces=faces.astype(np.int32))
    light = np.clip(mesh.vertex_normals() @ (0.6, 0.3, 0.74), 0.15, None) * rng.normal(1, 0.03, len(mesh.vertices))
    linear = light[:, None] * np.array([0.55, 0.35, 0.27]) * rng.normal(1, 0.01, (len(mesh.vertices), 3))
    centre = nipple + off_mm
    height = 32.0 * (1 - (centre**2).sum() / 65.0**2) ** 2
    coloured = np.linalg.norm(mesh.vertices - [*centre, height], axis=1) < 18.0
    linear[coloured, 1:] *= 1 - red
    colours = np.clip(255 * np.clip(linear, 0, 1) ** (1 / 2.2), 0, 255).astype(np.uint8)
    angle = np.linspace(0, 2 * np.pi, 120, endpoint=False)
    boundary = np.stack([65 * np.cos(angle), 65 * np.sin(angle), 0 * angle], axis=1)
    return mesh, colours, boundary, nipple


@pytest.mark.parametrize(
    ("tip_mm", "red", "how", "within_mm"),
    [(5.0, 0.15, "and the tip within", 2.0), (0.0, 0.15, "no tip stands out", 3.0), (5.0, 0.0, "tip near", 3.0)],
)
def test_nipples_are_proposed_by_colour_and_shape(tip_mm: float, red: float, how: str, within_mm: float) -> None:
    mesh, colours, boundary, nipple = _breast_with_nipple(tip_mm, red)
    found = propose_nipple("nipple_left", mesh, colours, boundary)
    assert found is not None
    assert how in found.method
    assert found.probability >= NippleSettings().least_probability
    assert np.linalg.norm(found.points_world[0, :2] - nipple) < within_mm  # samples are 2.5 mm apart
    assert found.sigma_mm >= 1.5


@pytest.mark.slow
def test_a_clear_tip_decides_within_an_areola_that_is_not_centred_on_it() -> None:
    for off_mm in ((4.0, 0.0), (0.0, -4.0)):
        mesh, colours, boundary, nipple = _breast_with_nipple(5.0, 0.15, off_mm=off_mm)
        found = propose_nipple("nipple_left", mesh, colours, boundary)
        assert found is not None
        assert np.linalg.norm(found.points_world[0, :2] - nipple) < 1.0


@pytest.mark.slow
def test_the_areola_decides_where_a_scan_flattened_the_tip() -> None:
    """Noise alike over 4 mm, a quarter as high as the tip that is left."""
    away = []
    for seed in range(6):
        mesh, colours, boundary, nipple = _breast_with_nipple(2.2, 0.15, noise_mm=0.5, seed=seed)
        found = propose_nipple("nipple_left", mesh, colours, boundary)
        assert found is not None
        away.append(np.linalg.norm(found.points_world[0, :2] - nipple))
    assert np.mean(away) < 1.0


def test_no_nipple_is_proposed_where_neither_areola_nor_tip_is_seen() -> None:
    mesh, colours, boundary, _ = _breast_with_nipple(0.0, 0.0)
    assert propose_nipple("nipple_left", mesh, colours, boundary) is None


# --- registration and symmetry


def test_a_moved_surface_is_brought_back() -> None:
    mesh = trunk().mesh
    normals = mesh.vertex_normals()
    motion = Transform.from_rotation_vector(np.array([0.05, -0.08, 0.04]), np.array([6.0, -4.0, 8.0]))
    found = register((motion.apply(mesh.vertices), motion.rotate(normals)), (mesh.vertices, normals))
    back = found.fixed_from_moving @ motion
    bumps = mesh.vertices[mesh.vertices[:, 2] > RADIUS_MM]
    assert np.abs(back.apply(bumps) - bumps).max() < 0.1


@pytest.mark.slow
def test_the_mid_sagittal_plane_of_a_trunk() -> None:
    """Mirror symmetric without its bumps, and turned, shifted and put into a rough frame."""
    motion = Transform.from_rotation_vector(np.array([0.1, 0.3, -0.2]), np.array([30.0, -20.0, 10.0]))
    mesh = trunk().mesh
    # Flattened as a body is: a round trunk has many planes.
    flat = TriangleMesh(vertices=mesh.vertices * (1, 1, 0.7), faces=mesh.faces)
    moved = as_surface(flat.transformed(motion))
    squeezed = [replace(m, boundary_world=motion.apply(m.boundary_world * (1, 1, 0.7))) for m in measured()]
    rough = Rotation.from_rotvec([0.0, 0.1, 0.05]).as_matrix() @ motion.rotation.T
    body = find_body(moved, rough, boundaries=[each.boundary_world for each in squeezed])
    assert body.plane is not None
    point, normal, scatter = body.point_world, body.left, body.plane.scatter_mm
    assert np.rad2deg(np.arccos(min(1.0, normal @ motion.rotation[:, 0]))) < 0.2
    assert abs((point - motion.translation_mm) @ motion.rotation[:, 0]) < 0.3
    assert scatter < 0.3


def test_a_breast_and_its_mirror_image_do_not_differ() -> None:
    left, _ = measured()
    twin = replace(
        left,
        name="right",
        closed=TriangleMesh(
            vertices=mirror(left.closed.vertices, np.zeros(3), FRAME[0]),
            faces=np.ascontiguousarray(left.closed.faces[:, ::-1]),
        ),
        boundary_world=mirror(left.boundary_world, np.zeros(3), FRAME[0]),
        volume_cc=left.volume_cc,
    )
    found = symmetry((left, twin), FRAME, MIDDLE)
    assert found is not None
    assert found.rms_mm < 0.15
    assert (found.difference_cc, found.ratio) == (0.0, 1.0)
    assert found.difference_interval_cc is not None
    assert found.difference_interval_cc[0] == -found.difference_interval_cc[1]
    assert found.difference_interval_cc == difference(left, twin, "sides").difference_interval_cc
    out = np.hypot(twin.closed.vertices[:, 0], twin.closed.vertices[:, 2])
    stretched = twin.closed.vertices * np.stack([k := 1 + 0.2 * (out - RADIUS_MM) / out, np.ones_like(k), k], axis=1)
    solid = TriangleMesh(vertices=stretched, faces=twin.closed.faces)
    grown = replace(twin, volume_cc=twin.volume_cc * 1.2, closed=solid)
    bigger = symmetry((left, grown), FRAME, MIDDLE)
    assert bigger is not None
    assert bigger.ratio == pytest.approx(1 / 1.2)
    assert bigger.difference_cc < 0
    # The right tip stands out 9 mm further; the rigid motion takes up the mean of a 20 % difference, a third of it.
    assert np.nanmin(bigger.left_mm) == pytest.approx(-6.0, abs=1.5)
    assert np.nanmax(bigger.right_mm) == pytest.approx(6.0, abs=1.5)
    assert bigger.rms_mm < bigger.rms_mirrored_mm


def test_one_breast_alone_has_no_symmetry() -> None:
    assert symmetry(measured()[:1], FRAME, MIDDLE) is None
