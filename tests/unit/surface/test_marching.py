"""The level of a field, whatever the field."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from mammometry.geometry.mesh import TriangleMesh
from mammometry.surface.fusion.marching import march


def drawn_field(seed, smoothing, shape=(9, 8, 10)):
    """Noise, smoothed by so many steps, positive on the grid's outside and nowhere zero."""
    field = np.random.default_rng(seed).normal(size=shape)
    field = ndimage.gaussian_filter(field, smoothing) if smoothing else field
    outside = np.ones(shape, dtype=bool)
    outside[1:-1, 1:-1, 1:-1] = False
    field[outside] = np.abs(field).max()
    return np.where(np.abs(field) < 1e-6, 1e-6, field).astype(np.float32)


def level(field, cells=None):
    cells = np.ones(np.array(field.shape) - 1, dtype=bool) if cells is None else cells
    vertices, faces = march(field, cells)
    return TriangleMesh(vertices=vertices, faces=faces)


def crossed_edges(field):
    """Plain NumPy: where the linear interpolation along each edge between corners of different sign is zero."""
    found = []
    for axis in range(3):
        start, end = (np.moveaxis(field.astype(np.float64), axis, 0)[side] for side in (slice(-1), slice(1, None)))
        crossed = (start > 0) != (end > 0)
        at = np.argwhere(crossed).astype(float)
        at[:, 0] += start[crossed] / (start - end)[crossed]
        found.append(np.insert(at[:, 1:], axis, at[:, 0], axis=1))
    return np.concatenate(found)


@settings(deadline=None, max_examples=60)
@given(seed=st.integers(0, 10**6), smoothing=st.sampled_from([0.0, 0.4, 0.8, 1.5]))
def test_the_level_closes_and_crosses_every_edge_once(seed, smoothing):
    field = drawn_field(seed, smoothing)
    mesh = level(field)
    if (field > 0).all():
        assert len(mesh.faces) == 0
        return
    assert mesh.is_watertight()
    expected = crossed_edges(field)
    on_edge = mesh.vertices[((mesh.vertices % 1) == 0).sum(axis=1) == 2]
    np.testing.assert_allclose(on_edge[np.lexsort(on_edge.T)], expected[np.lexsort(expected.T)], atol=1e-9)
    # The others, in the middle of loops that pass a face twice, are few: 10.3 ± 1.5 % on pure noise (3,000 seeds).
    assert len(mesh.vertices) - len(on_edge) <= 0.2 * len(expected)


def test_faces_turn_outwards():
    steps = np.stack(np.meshgrid(*[np.arange(25.0)] * 3, indexing="ij"), axis=-1)
    field = (np.linalg.norm(steps - [12.1, 11.9, 12.3], axis=-1) - 9.0).astype(np.float32)
    # chords of a cube's diagonal at most: sagitta 3/(8 · 9) = .042 steps inwards, 3 · .042/9 of the volume
    assert level(field).volume_mm3() == pytest.approx(4 / 3 * np.pi * 9.0**3, rel=0.014)
    assert level(-field).volume_mm3() == pytest.approx(-4 / 3 * np.pi * 9.0**3, rel=0.014)


@settings(deadline=None, max_examples=20)
@given(seed=st.integers(0, 10**6))
def test_two_halves_make_the_whole(seed):
    field = drawn_field(seed, 0.4)
    cells = np.random.default_rng(seed).uniform(size=np.array(field.shape) - 1) < 0.5
    whole, one, other = (sorted(level(field, c).corners().sum(axis=(1, 2)).round(9)) for c in (None, cells, ~cells))
    assert whole == sorted(one + other)


def test_corners_of_a_face_belong_together_where_its_saddle_is_inside():
    """One face with alternating signs: the inner corners are connected across it where their product is greater."""
    field = np.ones((2, 2, 2), dtype=np.float32)
    field[0, 0, 0] = field[0, 1, 1] = -0.5  # product .25 against 1: apart
    assert level(field).components()[0] == 2
    field[0, 0, 0] = field[0, 1, 1] = -2.0
    assert level(field).components()[0] == 1
