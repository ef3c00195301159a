"""Turning a number of the surface stage does what its docstring says; other tests turn the ones not named here."""

from dataclasses import replace

import numpy as np
import pytest
from spheres import camera_towards, ellipsoid_range, range_image, rig_of, silhouette, sphere_mesh
from test_repair import AROUND, RADIUS, dented, radial_error, valid_views

from mammometry.base.errors import SurfaceError
from mammometry.base.photograph import Photograph
from mammometry.geometry.mesh import TriangleMesh, joined
from mammometry.matching.foreground.foreground import Foreground
from mammometry.surface.fusion.field import build_field, nearest_of_others_mm, view_elements
from mammometry.surface.fusion.fuse import closing_box_of, extract
from mammometry.surface.ranges.dents import remove_dents
from mammometry.surface.repair.correspond import view_data
from mammometry.surface.repair.repair import Provenance, repair
from mammometry.surface.settings import DentSettings, ExtractSettings, RepairSettings
from mammometry.surface.texture.texture import paint

FRONT = [(0, 0, 1), (0.6, 0, 1), (-0.6, 0, 1), (0, 0.8, 1)]


def ball_seen_from(*directions, radius=RADIUS):
    cameras = [camera_towards(f"c{k}", direction) for k, direction in enumerate(directions)]
    return [range_image(camera, ellipsoid_range(camera, (radius,) * 3)) for camera in cameras]


@pytest.fixture(scope="module")
def half_ball():
    """A ball seen from the front: range images, silhouettes, rig."""
    images = ball_seen_from(*FRONT)
    cameras = [image.camera for image in images]
    return images, {camera.name: silhouette(camera, (RADIUS,) * 3) for camera in cameras}, rig_of(cameras)


def test_dents_angle_is_the_largest_that_stays():
    images = ball_seen_from((0, 0, 1))
    for limit_deg in (40.0, 60.0):
        left = remove_dents(images, None, DentSettings(angle_deg=limit_deg))
        angles = np.degrees(left.angles_rad[0][left.range_images[0].valid])
        assert limit_deg - 3 < angles.max() <= limit_deg + 0.5  # they are kept in steps of 2^-6 rad, .9°


def test_dents_neighbourhood_gives_steadier_angles_when_wide():
    image = ball_seen_from((0, 0, 1))[0]
    noise = np.random.default_rng(2).normal(0.0, 0.2, image.range_mm.shape).astype(np.float32)
    noisy = replace(image, range_mm=np.where(image.valid, image.range_mm + noise, np.float32(0)))
    errors = []
    for width_mm in (1.0, 5.0):
        found = remove_dents([noisy], None, DentSettings(rule="none", neighbourhood_mm=width_mm)).angles_rad[0]
        middle = np.s_[50:70, 50:70]
        errors.append(np.abs(found[middle] - image.incidence_rad(2.5)[middle]).mean())
    assert errors[1] < 0.3 * errors[0]


def test_dents_drop_what_another_view_looks_through_by_more_than_the_distance(monkeypatch):
    image, other = ball_seen_from((0, 0, 1), (0.6, 0, 1))
    points = image.points_world()
    floating = image.valid & (np.abs(points[..., 0] - 14) < 4) & (np.abs(points[..., 1]) < 4)
    assert floating.sum() > 30
    lifted = replace(image, range_mm=np.where(floating, image.range_mm - np.float32(4.0), image.range_mm))

    def kept(**turned):
        left = remove_dents([lifted, other], None, DentSettings(angle_deg=89.0, **turned)).range_images[0]
        return left.valid[floating].mean()

    assert kept() < 0.1
    assert kept(drop_seen_through=False) > 0.8
    monkeypatch.setattr("mammometry.surface.ranges.dents.SEEN_THROUGH_MM", 6.0)
    assert kept() > 0.8


@pytest.mark.slow
def test_extract_cubes_twice_as_large_give_a_quarter_of_the_triangles(half_ball):
    fine, coarse = (len(extract(*half_ball, ExtractSettings(cube_mm=cube_mm)).faces) for cube_mm in (1.0, 2.0))
    assert coarse == pytest.approx(fine / 4, rel=0.15)


@pytest.mark.slow
def test_extract_smoothing_draws_a_ball_in(half_ball, monkeypatch):
    volumes = []
    for sigma in (0.5, 2.0):
        monkeypatch.setattr("mammometry.surface.fusion.fuse.SMOOTHING_CUBES", sigma)
        volumes.append(extract(*half_ball, ExtractSettings(cube_mm=1.0)).volume_mm3())
    assert volumes[1] < volumes[0]


def test_extract_back_and_around_are_the_boxs_distances(half_ball, monkeypatch):
    images = half_ball[0]
    small = closing_box_of(images).planes[:, 3]
    monkeypatch.setattr("mammometry.surface.fusion.fuse.BACK_MM", 15.0)
    deep = closing_box_of(images).planes[:, 3]
    monkeypatch.setattr("mammometry.surface.fusion.fuse.BACK_MM", 10.0)
    monkeypatch.setattr("mammometry.surface.fusion.fuse.AROUND_MM", 27.0)
    wide = closing_box_of(images).planes[:, 3]
    assert deep - small == pytest.approx([5.0, 0, 0, 0, 0, 0])
    assert wide - small == pytest.approx([0.0, 7, 7, 7, 7, 7])


@pytest.mark.slow
def test_field_truncation_cuts_the_signed_distance(half_ball, monkeypatch):
    box = closing_box_of(half_ball[0])
    for truncation_mm in (1.0, 3.0):
        monkeypatch.setattr("mammometry.surface.fusion.field.TRUNCATION_MM", truncation_mm)
        field = build_field(*half_ball, box, "default")
        values = field.sample(np.array([[-4.0, -4.0, RADIUS - 4.0]]), 8, 1.0)
        assert np.abs(values).max() == truncation_mm


def test_field_extends_data_so_far(half_ball, monkeypatch):
    image, silhouettes, rig = half_ball[0][0], half_ball[1], half_ball[2]
    half = image.keeping(np.broadcast_to(np.arange(120) < 60, image.valid.shape))
    left = rig.pair(image.name).left
    for extend_mm in (4.0, 12.0):
        monkeypatch.setattr("mammometry.surface.fusion.field.EXTEND_MM", extend_mm)
        weights = view_elements(half, left, silhouettes[left.name], nearest_of_others_mm(half, ()))[..., 2]
        columns = np.flatnonzero(weights[60, 35:85] < 0)  # away from the ball's rim
        assert len(columns) * half.pixel_mm() == pytest.approx(extend_mm, abs=1.0)  # whole pixels


@pytest.mark.parametrize(("jump_mm", "hollow"), [(20.0, True), (80.0, False)])
def test_nothing_unmeasured_stands_before_what_spans_a_gap(jump_mm, hollow, monkeypatch):
    """A step of 60 mm behind a gap of 24 mm, seen from ahead and, half hidden, from aside.

    Ahead sees no floor in the gap, and aside only that the edge stands before it: both may be full.
    """
    cameras = [camera_towards(name, direction) for name, direction in (("ahead", (0, 0, 1)), ("aside", (-1, 0, 1)))]
    middle = np.arange(120) - 59.5
    step = np.where(middle < -12, 370.0, np.where(middle > 12, 430.0, np.nan))
    rays = cameras[1].rays_world(np.stack(np.meshgrid(*[np.arange(120.0)] * 2), axis=-1))
    along = (30.0 - cameras[1].centre_world[2]) / rays[..., 2]  # to the near skin, at x < −12 and z = 30
    edge = np.where(cameras[1].centre_world[0] + along * rays[..., 0] < -12, along, np.nan)
    images = [range_image(cameras[0], np.tile(step, (120, 1))), range_image(cameras[1], edge)]
    rig, box = rig_of(cameras), closing_box_of(images)
    full = np.ones((120, 120), dtype=np.float32)
    masks = {c.name: Foreground(camera=c.name, coverage=full, contour_level=0.5, everything=False) for c in cameras}
    monkeypatch.setattr("mammometry.surface.fusion.field.SPAN_JUMP_MM", jump_mm)
    monkeypatch.setattr("mammometry.surface.fusion.field.EXTEND_MM", 0.0)
    field = build_field(images, masks, rig, box, "default")
    # Half-way across, the span has fallen by a quarter of the step, 15 mm: 385 of 400 mm from the camera.
    before, behind = (field.sample(np.array([[0.0, 0.0, depth]]), 1, 1.0).item() for depth in (17.0, 11.0))
    assert (before > 0) == hollow
    assert behind < 0


@pytest.mark.slow
def test_repair_rounds_are_the_most():
    for rounds in (1, 2):
        assert len(repair(dented(), valid_views(AROUND), RepairSettings(rounds=rounds)).convergence) <= rounds
    assert len(repair(dented(), valid_views(AROUND), RepairSettings(rounds=1)).convergence) == 1


@pytest.mark.slow
def test_repair_false_weight_holds_vertices_without_data(monkeypatch):
    """Displacements fade at once here: the heavier a vertex without data, the less its neighbours carry it along."""
    first = TriangleMesh(vertices=1.05 * sphere_mesh(RADIUS, 60).vertices, faces=sphere_mesh(RADIUS, 60).faces)
    valid = valid_views(AROUND, lambda points: ~(points[..., 2] > 0.97 * RADIUS))
    moved = []
    for weight in (0.02, 5.0):
        monkeypatch.setattr("mammometry.surface.repair.repair.FALSE_WEIGHT", weight)
        result = repair(first, valid, RepairSettings(fade_mm=0.1))
        bare = (result.provenance != Provenance.MEASURED) & (first.vertices[:, 2] > 0.9 * RADIUS)
        assert bare.sum() > 20
        moved.append(np.linalg.norm((result.mesh.vertices - first.vertices)[bare], axis=1).mean())
    assert moved[1] < 0.5 * moved[0]


def test_repair_target_is_the_closest_view_or_their_mean():
    inner, outer = ball_seen_from(*AROUND), ball_seen_from(*AROUND, radius=RADIUS + 1.0)
    outer = [replace(image, name=f"outer {image.name}") for image in outer]
    valid = remove_dents([*inner, *outer], None, DentSettings(drop_seen_through=False))
    first = sphere_mesh(RADIUS + 0.2, rings=40)
    closest, blend = (
        radial_error(repair(first, valid, RepairSettings(target=target)).mesh).mean() for target in ("closest", "blend")
    )
    assert abs(closest) < 0.1
    assert blend == pytest.approx(0.5, abs=0.1)


def test_repair_reach_is_how_far_data_are_plausible(monkeypatch):
    first, valid = sphere_mesh(RADIUS + 3.0, rings=40), valid_views(AROUND)
    assert np.abs(radial_error(repair(first, valid).mesh)).mean() < 0.1
    monkeypatch.setattr("mammometry.surface.repair.repair.REACH_MM", 2.0)
    with pytest.raises(SurfaceError, match="range data"):
        repair(first, valid)


@pytest.mark.slow
def test_repair_tangential_reaches_beyond_the_edge_of_the_data(monkeypatch):
    first, valid = sphere_mesh(RADIUS, rings=60), valid_views(AROUND, lambda points: points[..., 2] < 20.0)
    measured = []
    for limit in (0.1, 3.0):
        monkeypatch.setattr("mammometry.surface.repair.repair.TANGENTIAL_MM", limit)
        measured.append((repair(first, valid).provenance == Provenance.MEASURED).sum())
    assert measured[1] > measured[0]


@pytest.mark.slow
def test_repair_similarity_is_the_distance_at_which_data_lose_weight(monkeypatch):
    first, valid = dented(), valid_views(AROUND)
    errors = []
    for limit in (0.7, 5.0):
        monkeypatch.setattr("mammometry.surface.repair.repair.SIMILARITY_MM", limit)
        errors.append(np.abs(radial_error(repair(first, valid, RepairSettings(rounds=1)).mesh)).max())
    assert errors[1] < errors[0]


def test_repair_taper_weighs_data_at_the_edge_of_a_view_less():
    image = valid_views(AROUND, lambda points: points[..., 2] < 20.0).range_images[0]
    plain, tapered = (view_data(image, 1.0, taper_mm=taper_mm).trust for taper_mm in (0.0, 10.0))
    believed = plain > 0.05  # elsewhere there is no datum
    assert np.all(plain[believed] == 1.0)
    assert tapered[believed].min() < 0.2


def grey(name):
    return Photograph(name=name, pixels=np.full((120, 120), 90, dtype=np.uint8))


def test_texture_clearance_ignores_what_lies_closer(monkeypatch):
    ball = sphere_mesh(RADIUS)
    lid = TriangleMesh(
        vertices=np.array([[-5.0, -5, RADIUS + 2], [5, -5, RADIUS + 2], [0, 6, RADIUS + 2]]),
        faces=np.array([[0, 1, 2]], dtype=np.int32),
    )
    camera = camera_towards("a", (0, 0, 1))
    rig = rig_of([camera, camera_towards("b", (0, 0, -1))])
    pole = int(np.argmax(ball.vertices[:, 2]))
    assert paint(joined([ball, lid]), {"a": grey("a")}, rig).colours[pole, 0] == 128
    monkeypatch.setattr("mammometry.surface.texture.texture.CLEARANCE_MM", 3.0)
    assert paint(joined([ball, lid]), {"a": grey("a")}, rig).colours[pole, 0] == 90


def test_texture_triangles_are_the_most_of_the_viewing_mesh():
    from mammometry.surface.texture.simplify import thinned

    mesh = sphere_mesh(RADIUS)
    assert len(mesh.faces) > 2000
    assert 1000 < len(thinned(mesh, 2000).faces) <= 2000


def test_cubes_suit_the_subject_unless_their_edge_is_chosen():
    assert [ExtractSettings().of(kind).cube_mm for kind in ("torso", "cast", "surface")] == [0.7, 0.5, 0.5]
    assert ExtractSettings(cube_mm=1.2).of("torso").cube_mm == 1.2


@pytest.mark.slow
def test_cubes_of_no_edge_are_the_papers(half_ball):
    by_default, chosen = (extract(*half_ball, ExtractSettings(cube_mm=cube_mm)) for cube_mm in (0.0, 0.5))
    assert len(by_default.faces) == len(chosen.faces)
