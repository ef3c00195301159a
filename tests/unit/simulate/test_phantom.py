"""Volumes against closed forms, shapes against what they are said to be."""

import math

import manifold3d
import numpy as np
import pytest

from mammometry.simulate.subjects.plaster import TABLE_1_WATER_CC, PlasterShape, plaster, plaster_shape
from mammometry.simulate.subjects.registry import make_subject
from mammometry.simulate.subjects.shapes import cylinder, plate, sphere
from mammometry.simulate.subjects.solid import rig_from_solid

_HALF_ELLIPSOID = PlasterShape(
    volume_cc=400.0,
    projection=0.8,
    width=1.1,
    sag=0.4,
    fold=0.0,
    lateral=0.2,
    upper_slope=0.0,
    outline=(0.0, 0.0, 0.0, 0.0),
    irregularity_mm=0.0,
    nipple_mm=0.0,
    areola_mm=1e-3,
)


@pytest.mark.parametrize("edge_mm", [3.0, 6.0])
def test_sphere_volume_tends_to_the_closed_form_from_below(edge_mm):
    exact = 4.0 / 3.0 * math.pi * 60.0**3 / 1000.0
    coarse, fine = sphere(60.0, edge_mm).volume_cc, sphere(60.0, edge_mm / 2).volume_cc
    # Chords lie inside, and the deficit falls with the square of the edge.
    assert coarse < fine < exact
    assert (exact - coarse) / (exact - fine) == pytest.approx(4.0, rel=0.15)


def test_sphere_volume_extrapolates_to_a_millionth():
    exact = 4.0 / 3.0 * math.pi * 60.0**3 / 1000.0
    errors = []
    for rings_per_radius in (0.02, 0.01):
        solid = sphere(60.0, 60.0 * rings_per_radius)
        rings = round(0.5 * math.pi * 1.1 / rings_per_radius + 0.5)
        errors.append((solid.volume_cc, 1.0 / rings**2))
    (v1, h1), (v2, h2) = errors
    assert (v2 * h1 - v1 * h2) / (h1 - h2) == pytest.approx(exact, rel=1e-6)


def test_sheared_half_ellipsoid_keeps_its_volume():
    # Sag and a nipple that points sideways are shears: they move volume, and neither add nor take any. The scale that
    # the solid needed to reach its volume is therefore that of an inscribed polyhedron alone.
    solid = plaster(_HALF_ELLIPSOID, edge_mm=1.0)
    vertices = solid.mesh.vertices
    height = vertices[:, 2].max()
    base = solid.base_boundary
    a = 0.5 * (base[:, 0].max() - base[:, 0].min())
    b = 0.5 * (base[:, 1].max() - base[:, 1].min())
    assert 2.0 / 3.0 * math.pi * a * b * height / 1000.0 == pytest.approx(400.0, rel=3e-4)
    assert a / b == pytest.approx(1.1, rel=1e-4)


def test_cylinder_and_plate_are_exact_prisms():
    solid = cylinder(50.0, 120.0, 2.0)
    n = math.ceil(2 * math.pi * 50.0 / 2.0)
    prism = 0.5 * n * 50.0**2 * math.sin(2 * math.pi / n) * 120.0 / 1000.0
    assert solid.volume_cc == pytest.approx(prism, rel=1e-6)
    assert plate(220.0, 160.0, 6.0).volume_cc == pytest.approx(211.2, rel=1e-6)


@pytest.mark.parametrize("name", ["plaster_1", "plaster_4", "plaster", "sphere", "cylinder", "plate", "head", "figure"])
def test_solids_are_closed_and_of_one_piece(name):
    mesh = make_subject(name, 3, edge_mm=3.0).mesh
    assert mesh.is_watertight()
    assert mesh.euler_number() == 2
    assert mesh.components()[0] == 1
    assert mesh.volume_mm3() > 0


@pytest.mark.parametrize("number", range(1, 10))
def test_the_nine_have_volumes_near_the_table_and_exactly_as_asked(number):
    shape = plaster_shape(f"plaster_{number}", 11)
    assert abs(shape.volume_cc / TABLE_1_WATER_CC[number - 1] - 1.0) <= 0.03
    # Vertices are float32 numbers: relative error of a coordinate 6e-8, of a volume a millionth at most.
    assert plaster(shape, edge_mm=4.0).volume_cc == pytest.approx(shape.volume_cc, rel=1e-6)


def test_a_cast_of_any_volume_can_be_asked_for():
    solid = make_subject("plaster_60cc", 11, edge_mm=3.0)
    assert solid.volume_cc == pytest.approx(60.0, rel=1e-6)
    assert solid.facts["back"] == "flat"
    for name in ("plaster_5cc", "plaster_9999cc", "plaster_60 cc"):
        with pytest.raises(ValueError, match="plaster"):
            plaster_shape(name, 11)


def test_back_is_flat_or_on_its_cylinder():
    flat = plaster(PlasterShape(), edge_mm=3.0)
    assert np.abs(flat.mesh.vertices[-flat.back_vertices :, 2]).max() < 1e-4
    assert np.abs(flat.base_boundary[:, 2]).max() < 1e-4
    bent = plaster(PlasterShape(back_radius_mm=200.0), edge_mm=3.0)
    x, _, z = bent.mesh.vertices[-bent.back_vertices :].T
    assert np.hypot(x, z + 200.0) == pytest.approx(np.full(len(x), 200.0), abs=1e-3)
    assert z.min() < -5.0


def test_sag_makes_an_undercut():
    overhang = [float(plaster(PlasterShape(sag=sag), edge_mm=3.0).facts["overhang_mm"]) for sag in (0.0, 0.4, 0.8)]
    assert overhang[0] < 3.0  # the fold's groove alone
    assert overhang[0] < overhang[1] < overhang[2]
    assert overhang[2] > 12.0


def test_areola_is_a_spot_of_its_size_on_the_front():
    solid = plaster(PlasterShape(areola_mm=16.0), edge_mm=1.0)
    spot = solid.mesh.vertices[solid.areola > 0.5]
    assert np.linalg.norm(spot - spot.mean(axis=0), axis=1).max() == pytest.approx(16.0, rel=0.3)
    assert solid.areola[-solid.back_vertices :].max() == 0.0
    # The nipple stands up by 4 mm from a spot that curves away below it.
    assert np.linalg.norm(spot.mean(axis=0) - np.array(solid.facts["nipple_solid"])) < 8.0


def test_edges_are_as_fine_as_asked():
    solid = plaster(plaster_shape("plaster_5", 7), edge_mm=1.5)
    corners = solid.mesh.corners()[: len(solid.mesh.faces) // 2]
    edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    assert np.percentile(edges, 95) == pytest.approx(1.5, rel=0.05)


def test_seed_decides_everything():
    first, again, other = (make_subject("plaster_3", seed, edge_mm=4.0) for seed in (5, 5, 6))
    assert np.array_equal(first.mesh.vertices, again.mesh.vertices)
    assert abs(first.volume_cc - other.volume_cc) > 0.1


def test_placed_in_the_middle_of_the_rig_leaning_forward():
    solid = make_subject("plaster_3", 5, edge_mm=4.0)
    placed = rig_from_solid(solid, 5)
    points = placed.apply(solid.mesh.vertices)
    assert np.abs(0.5 * (points.min(axis=0) + points.max(axis=0))).max() <= 6.0
    forward = placed.rotate(np.array([0.0, 0.0, 1.0]))
    assert forward @ np.array([0.0, -math.sqrt(0.5), math.sqrt(0.5)]) > math.cos(math.radians(10.0))


@pytest.mark.parametrize("name", ["plaster_0", "plaster_10", "plaster_x", "teapot"])
def test_unknown_subject_is_refused_by_name(name):
    with pytest.raises(ValueError, match=name):
        make_subject(name, 1)


def test_plaster_family_has_the_range_it_is_said_to_have():
    shapes = [plaster_shape("plaster", seed) for seed in range(300)]
    volumes = np.array([shape.volume_cc for shape in shapes])
    assert 80.0 <= volumes.min() < 90.0
    assert 900.0 < volumes.max() <= 1000.0
    sag = np.array([shape.sag for shape in shapes])
    assert sag.min() < 0.1  # a hemisphere, nearly
    assert sag.max() > 0.6  # ptotic
    bent = [shape.back_radius_mm is not None for shape in shapes]
    assert 0.3 < np.mean(bent) < 0.7
    assert np.std([shape.lateral for shape in shapes]) > 0.05  # asymmetric, to both sides


@pytest.mark.parametrize("name", ["plaster_2", "plaster_7", "sphere", "cylinder", "plate"])
def test_volume_is_the_independent_librarys(name):
    solid = make_subject(name, 3, edge_mm=3.0)
    body = manifold3d.Manifold(
        manifold3d.Mesh64(
            vert_properties=np.array(solid.mesh.vertices),
            tri_verts=np.array(solid.mesh.faces, dtype=np.uint64),
            tolerance=0.0,
        )
    )
    assert solid.volume_cc == pytest.approx(float(body.volume()) / 1000.0, rel=1e-6)
