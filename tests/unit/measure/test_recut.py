"""A part cut out again within a band equals the cut through the whole mesh, bit by bit."""

import numpy as np
import pytest
from tests.first_cases import first
from tests.unit.measure.trunks import LEFT, edge_of, trunk_mesh

from mammometry.geometry.mesh import TriangleMesh
from mammometry.measure.boundary.trace import REACH_MM, edge_loop
from mammometry.measure.solid.cut import OpenPart, inside_curve
from mammometry.measure.volume import boundary_jitter
from mammometry.measure.volume.boundary_jitter import Band


@pytest.fixture(scope="module")
def mesh() -> TriangleMesh:
    return trunk_mesh(2.0)


def same(one: OpenPart, other: OpenPart) -> None:
    np.testing.assert_array_equal(one.mesh.vertices, other.mesh.vertices)
    np.testing.assert_array_equal(one.mesh.faces, other.mesh.faces)
    assert [loop.tolist() for loop in one.loops] == [loop.tolist() for loop in other.loops]


@pytest.mark.parametrize("wider", first(2, [0.9, 1.06, 0.97, 1.0, 1.12]))
def test_the_part_is_that_of_the_whole_mesh(mesh: TriangleMesh, wider: float, monkeypatch: pytest.MonkeyPatch) -> None:
    first, again = (edge_of(LEFT, "left", each).points_world for each in (1.0, wider))
    band = Band(mesh, edge_loop("left", first, mesh), REACH_MM + 10.0)
    assert len(band.mesh.faces) < len(mesh.faces)
    whole = inside_curve(mesh, edge_loop("left", again, mesh))
    monkeypatch.setattr(boundary_jitter, "inside_curve", None)  # the band alone is enough
    same(band.inside(edge_loop("left", again, band.mesh)), whole)


def test_a_band_that_does_not_tell_asks_the_whole_mesh(mesh: TriangleMesh) -> None:
    """So wide a band that nothing of the breast is left outside it, and nothing of the trunk."""
    points = edge_of(LEFT, "left").points_world
    curve = edge_loop("left", points, mesh)
    band = Band(mesh, curve, 2000.0)
    assert len(band.mesh.faces) == len(mesh.faces)
    same(band.inside(edge_loop("left", points, band.mesh)), inside_curve(mesh, curve))
