"""Cutting meshes: against closed forms and against Manifold."""

import manifold3d
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from solids import ball

from mammometry.geometry.mesh import TriangleMesh
from mammometry.measure.boundary.cast_base import Base, frame_towards
from mammometry.measure.solid.cut import above, inside_curve, opening_loops
from mammometry.measure.solid.patch import sew

unit_vectors = st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda v: np.linalg.norm(v) > 0.1)


def plane(normal: np.ndarray, offset_mm: float) -> Base:
    frame = frame_towards(np.asarray(normal, dtype=float))
    return Base(origin=frame[2] * offset_mm, frame=frame, curvature_per_mm=0.0)


def closed_above(mesh: TriangleMesh, base: Base) -> TriangleMesh:
    part = above(mesh, base.height)
    loops = tuple(base.flatten(part.mesh.vertices[loop]) for loop in part.loops)
    closed = sew(
        part, loops, lambda patch: base.lift(patch.points[patch.n_loop :]), spacing_mm=None, subject="test"
    ).solid
    return closed


def manifold_volume_above(mesh: TriangleMesh, base: Base) -> float:
    solid = manifold3d.Manifold(manifold3d.Mesh64(mesh.vertices.copy(), mesh.faces.astype(np.uint64)))
    return float(solid.trim_by_plane(base.frame[2], float(base.frame[2] @ base.origin)).volume())


@pytest.mark.parametrize("offset_mm", [-30.0, 0.0, 13.0, 45.0])
def test_a_sphere_cut_by_a_plane_leaves_a_spherical_cap(offset_mm: float) -> None:
    closed = closed_above(ball(), plane(np.array([0.2, -0.3, 1.0]), offset_mm))
    height = 50.0 - offset_mm
    exact = np.pi * height**2 * (150.0 - height) / 3
    assert closed.is_watertight()
    assert closed.volume_mm3() < exact  # facets lie inside the sphere
    assert closed.volume_mm3() == pytest.approx(exact, rel=5e-3)


@settings(max_examples=15, deadline=None)
@given(normal=unit_vectors, offset_mm=st.floats(-45, 45))
def test_the_cut_agrees_with_manifold(normal: tuple[float, float, float], offset_mm: float) -> None:
    mesh, base = ball(subdivisions=3), plane(np.array(normal), offset_mm)
    closed = closed_above(mesh, base)
    assert closed.is_watertight()
    assert closed.volume_mm3() == pytest.approx(manifold_volume_above(mesh, base), rel=1e-6)


@settings(max_examples=15, deadline=None)
@given(rotation=st.tuples(*[st.floats(-3, 3)] * 3), shift_mm=st.tuples(*[st.floats(-1e5, 1e5)] * 3))
def test_volume_does_not_depend_on_place_and_attitude(
    rotation: tuple[float, float, float], shift_mm: tuple[float, float, float]
) -> None:
    mesh, base = ball(subdivisions=3), plane(np.array([0.3, 0.1, 1.0]), 11.0)
    turn = Rotation.from_rotvec(rotation).as_matrix()
    moved = TriangleMesh(vertices=mesh.vertices @ turn.T + shift_mm, faces=mesh.faces)
    carried = Base(origin=turn @ base.origin + shift_mm, frame=base.frame @ turn.T, curvature_per_mm=0.0)
    # At 100 m from the origin a coordinate has 1e-11 mm of rounding, and heights 1e-10.
    assert closed_above(moved, carried).volume_mm3() == pytest.approx(closed_above(mesh, base).volume_mm3(), rel=1e-8)


def test_a_cylinder_cuts_where_its_height_vanishes() -> None:
    base = Base(origin=np.array([0.0, 0.0, 10.0]), frame=np.eye(3), curvature_per_mm=1 / 80)
    part = above(ball(), base.height)
    on_wall = part.mesh.vertices[part.loops[0]]
    assert np.abs(np.hypot(on_wall[:, 0], on_wall[:, 2] + 70.0) - 80.0).max() < 1e-9
    assert (base.height(part.mesh.vertices) > -1e-9).all()


def test_only_the_largest_part_above_stays() -> None:
    small = ball(radius_mm=5.0, subdivisions=3)
    mesh = ball()
    both = TriangleMesh(
        vertices=np.concatenate([mesh.vertices, small.vertices + np.array([200.0, 0.0, 0.0])]),
        faces=np.concatenate([mesh.faces, small.faces + len(mesh.vertices)]).astype(np.int32),
    )
    assert np.ptp(above(both, lambda points: points[:, 2]).mesh.vertices[:, 0]) < 101


def test_nothing_above_is_an_empty_part() -> None:
    part = above(ball(), lambda points: points[:, 2] - 100.0)
    assert len(part.mesh.faces) == 0
    assert part.loops == ()


def test_loops_that_touch_in_a_corner_are_told_apart() -> None:
    faces = np.array([[0, 1, 2], [2, 3, 4]], dtype=np.int64)  # two triangles that share vertex 2
    loops = opening_loops(faces, 5)
    assert sorted(sorted(loop.tolist()) for loop in loops) == [[0, 1, 2], [2, 3, 4]]


def test_a_curve_of_edges_divides_a_sphere_into_its_smaller_part() -> None:
    mesh = ball(subdivisions=4)
    part = above(mesh, lambda points: points[:, 2] - 20.0)
    # Walk along the mesh: the lowest whole faces above z = 20 have a loop of mesh edges as their opening.
    whole = mesh.faces[(mesh.vertices[mesh.faces][:, :, 2] > 20.0).all(axis=1)].astype(np.int64)
    loop = opening_loops(whole, len(mesh.vertices))[0]
    cut = inside_curve(mesh, loop)
    assert cut.mesh.area_mm2() == pytest.approx(
        TriangleMesh(vertices=mesh.vertices, faces=whole.astype(np.int32)).area_mm2(), rel=1e-9
    )
    assert cut.mesh.area_mm2() < part.mesh.area_mm2()


def test_a_wall_may_use_every_chord_of_the_opening() -> None:
    """A face with two edges on the opening leaves a chord that a flat wall would use a second time."""
    mesh = ball(subdivisions=2)
    corner = int(np.argmax(mesh.vertices[:, 2]))
    ring = mesh.faces[(mesh.faces == corner).any(axis=1)].astype(np.int64)
    loop = opening_loops(ring, len(mesh.vertices))[0]
    part = inside_curve(mesh, loop[: len(loop)])
    frame = np.eye(3)
    base = Base(origin=part.mesh.vertices[part.loops[0]].mean(axis=0), frame=frame, curvature_per_mm=0.0)
    flat = (base.flatten(part.mesh.vertices[part.loops[0]]),)
    closed = sew(part, flat, lambda patch: patch.points[:0], spacing_mm=None, subject="test").solid
    assert closed.is_watertight()
