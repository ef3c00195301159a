"""Thinned meshes: as many triangles as wanted, the same shape, and no memory kept."""

import numpy as np
import pytest
import trimesh

from mammometry.geometry.mesh import TriangleMesh
from mammometry.surface.texture import simplify as thinning
from mammometry.surface.texture.simplify import thinned


def ball(rows: int, radius_mm: float = 50.0) -> TriangleMesh:
    """A closed ball far from the origin, of 2 · rows · (2 · rows − 1) or so triangles."""
    theta = np.linspace(0, np.pi, rows + 1)[1:-1]
    phi = np.linspace(0, 2 * np.pi, 2 * rows, endpoint=False)
    t, p = (each.ravel() for each in np.meshgrid(theta, phi, indexing="ij"))
    ring = radius_mm * np.column_stack([np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), np.cos(t)])
    poles = np.array([[0, 0, radius_mm], [0, 0, -radius_mm]])
    points = np.concatenate([ring, poles]) + np.array([900.0, -400.0, 1500.0])
    n, north, south = 2 * rows, len(ring), len(ring) + 1
    number = np.arange(len(ring)).reshape(rows - 1, n)
    after = np.roll(number, -1, axis=1)
    quads = [(number[:-1], number[1:], after[1:]), (number[:-1], after[1:], after[:-1])]
    faces = [np.stack(each, axis=-1).reshape(-1, 3) for each in quads]
    faces += [np.column_stack([np.full(n, north), number[0], after[0]])]
    faces += [np.column_stack([np.full(n, south), after[-1], number[-1]])]
    return TriangleMesh(vertices=points, faces=np.concatenate(faces).astype(np.int32))


def test_a_mesh_small_enough_stays_itself() -> None:
    mesh = ball(20)
    assert thinned(mesh, len(mesh.faces)) is mesh


def test_a_process_of_its_own_gives_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    mesh = ball(60)
    here = thinned(mesh, 2000)
    monkeypatch.setattr(thinning, "_LARGE", 1000)
    apart = thinned(mesh, 2000)
    np.testing.assert_array_equal(apart.vertices, here.vertices)
    np.testing.assert_array_equal(apart.faces, here.faces)
    assert len(here.faces) <= 2000
    assert here.is_watertight()
    # Chords of 2000 triangles: 4 π r² / 2000 each, so a volume some tenths of a per cent below the ball's.
    assert here.volume_mm3() == pytest.approx(4 / 3 * np.pi * 50.0**3, rel=0.01)


@pytest.mark.slow
def test_a_large_mesh_leaves_no_memory_behind() -> None:
    """A million triangles: in this process the library would keep some 270 MB."""
    import resource

    mesh = ball(500)
    assert len(mesh.faces) > 900_000
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    thinned(mesh, 20_000)
    grown_mb = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024
    assert grown_mb < 150  # the arrays that are handed over, twice: 2 × (6 + 12) MB, and their float64 originals


@pytest.mark.parametrize("large", [10**6, 100])
def test_the_order_of_a_meshs_arrays_in_memory_does_not_matter(large: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(thinning, "_LARGE", large)  # from which a process of its own does it
    ball = trimesh.creation.icosphere(subdivisions=3, radius=50)
    mesh = TriangleMesh(vertices=np.asfortranarray(ball.vertices), faces=np.asfortranarray(ball.faces.astype(np.int32)))
    assert len(thinned(mesh, 500).faces) == 500
