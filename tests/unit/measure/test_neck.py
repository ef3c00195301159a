"""A breast that another one touches is cut off at the neck between them."""

import numpy as np
import pytest
from skimage.measure import marching_cubes

from mammometry.geometry.mesh import TriangleMesh
from mammometry.measure.boundary.trace import edge_loop
from mammometry.measure.solid.cut import inside_curve, neck_sides

STEP_MM = 2.0
RADIUS_MM, APART_MM = 30.0, 40.0  # of each breast, and of their middles from the plane between them
THIN_MM = 6.0


def two_that_touch(*, bridge_mm: float = THIN_MM, high_mm: float = 45.0) -> TriangleMesh:
    """Two columns with round ends on a slab, joined by a rod between their upper ends."""
    x, y, z = np.meshgrid(
        np.arange(-90, 91, STEP_MM), np.arange(-50, 51, STEP_MM), np.arange(-20, 91, STEP_MM), indexing="ij"
    )
    slab = np.maximum.reduce([np.abs(x) - 84, np.abs(y) - 44, np.abs(z + 7) - 7])
    body = slab
    for sign in (-1, 1):
        along = np.clip(z, 0.0, high_mm)
        column = np.sqrt((x - sign * APART_MM) ** 2 + y**2 + (z - along) ** 2) - RADIUS_MM
        body = np.minimum(body, np.maximum(column, -7 - z))
    if bridge_mm:
        body = np.minimum(body, np.maximum(np.hypot(y, z - high_mm) - bridge_mm, np.abs(x) - APART_MM))
    vertices, faces, _, _ = marching_cubes(body, 0.01, spacing=(STEP_MM,) * 3)
    mesh = TriangleMesh(vertices=vertices + np.array([-90.0, -50.0, -20.0]), faces=faces[:, ::-1].astype(np.int32))
    return mesh if mesh.volume_mm3() > 0 else mesh.turned_over()


def foot(mesh: TriangleMesh, sign: int, z_mm: float = 8.0) -> np.ndarray:
    """The curve of edges around one column, right above the slab."""
    turn = np.linspace(0, 2 * np.pi, 90, endpoint=False)
    ring = np.stack([sign * APART_MM + RADIUS_MM * np.cos(turn), RADIUS_MM * np.sin(turn), np.full(90, z_mm)], axis=1)
    return edge_loop("left", ring, mesh)


@pytest.mark.parametrize("sign", [-1, 1])
def test_each_breast_ends_half_way_at_the_neck(sign: int) -> None:
    mesh, alone = two_that_touch(), two_that_touch(bridge_mm=0.0)
    assert (mesh.euler_number(), alone.euler_number()) == (0, 2)
    part, expected = inside_curve(mesh, foot(mesh, sign)), inside_curve(alone, foot(alone, sign))
    assert len(part.loops) == 1
    tip = part.mesh.vertices[:, 0] * sign
    assert tip.min() > -3.0  # never over to the other side, but for a face or two
    # Closed by the same flat foot, both hold the column; the rod's own half is at most π · 6² · 10 mm³.
    rod = np.pi * THIN_MM**2 * (APART_MM - RADIUS_MM)
    assert volume(part) - volume(expected) == pytest.approx(rod / 2, abs=rod)
    assert len(np.unique(np.sort(part.mesh.faces, axis=1), axis=0)) == len(part.mesh.faces)


def volume(part) -> float:
    """Between the part and the fan over its opening, mm³."""
    loop = part.loops[0]
    middle = part.mesh.vertices[loop].mean(axis=0, keepdims=True)
    fan = np.stack([np.roll(loop, -1), loop, np.full(len(loop), len(part.mesh.vertices))], axis=1)
    closed = TriangleMesh(
        vertices=np.concatenate([part.mesh.vertices, middle]),
        faces=np.concatenate([part.mesh.faces, fan]).astype(np.int32),
    )
    assert closed.is_watertight()
    return closed.volume_mm3()


def test_the_neck_is_the_shortest_second_cut() -> None:
    mesh = two_that_touch()
    sides = neck_sides(mesh, foot(mesh, 1))
    starts, stops = mesh.faces.ravel()[sides], mesh.faces[:, [1, 2, 0]].ravel()[sides]
    length_mm = np.linalg.norm(mesh.vertices[starts] - mesh.vertices[stops], axis=1).sum() / 2  # both faces of an edge
    # Around the rod; along the mesh's edges a circle takes up to 4/π as long.
    assert 2 * np.pi * THIN_MM * 0.95 < length_mm < 8 * THIN_MM * 1.1
    assert np.abs(mesh.vertices[starts][:, 0]).max() < APART_MM - RADIUS_MM + 2 * STEP_MM


def test_a_join_as_wide_as_the_breast_is_no_neck() -> None:
    """A bar that is wider around than the curve: then nothing parts them, and nothing is cut."""
    mesh = two_that_touch(bridge_mm=36.0, high_mm=50.0)
    curve = foot(mesh, 1)
    if mesh.euler_number() == 0:
        assert not neck_sides(mesh, curve).any()
        assert len(inside_curve(mesh, curve).mesh.faces) == 0
    else:
        pytest.fail("the bar leaves no way through under it")
