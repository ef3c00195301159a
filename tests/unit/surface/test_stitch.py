"""Fine and coarse cubes meet without a gap."""

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from mammometry.geometry.mesh import TriangleMesh
from mammometry.surface.fusion.isosurface import Isosurface, OpenMesh, stitched
from mammometry.surface.fusion.marching import without_saddles
from mammometry.surface.fusion.voxels import sample_blocks


def ellipsoid(radii, centre):
    def sample(origins, side, spacing):
        steps = np.stack(np.meshgrid(*[np.arange(side)] * 3, indexing="ij"), axis=-1) * spacing
        points = (origins[:, None, None, None] + steps - centre) / radii
        length = np.linalg.norm(points, axis=-1)
        return np.clip((length - 1.0) * np.min(radii), -2, 2).astype(np.float32)

    return sample


@pytest.mark.slow
@settings(max_examples=6, deadline=None, phases=(Phase.explicit, Phase.generate))
@given(
    radii=st.tuples(*[st.floats(11.0, 15.0)] * 3),
    centre=st.tuples(*[st.floats(-3.0, 3.0)] * 3),
    seed=st.integers(0, 1000),
)
def test_a_body_with_data_on_one_side_closes_with_fewer_triangles(radii, centre, seed):
    radii, centre = np.array(radii), np.array(centre)
    direction = np.random.default_rng(seed).normal(size=3)
    data = (centre + radii * direction / np.linalg.norm(direction))[None]
    arguments = ellipsoid(radii, centre), np.array([centre - radii - 1, centre + radii + 1]), data
    fine, mixed = (
        Isosurface(sample_blocks(*arguments, cube_mm=0.5, truncation_mm=2.0, near_mm=near), smoothing=0.0).mesh()
        for near in (np.inf, 2.0)
    )
    assert mixed.is_watertight()
    assert mixed.components()[0] == 1
    assert mixed.euler_number() == 2
    assert len(mixed.faces) < 0.9 * len(fine.faces)
    # the coarse cubes' chords, (2 mm)²/(8 · 11 mm) = .045 mm inwards on both sides: 1.2 %
    assert abs(mixed.volume_mm3() / fine.volume_mm3() - 1) < 0.02
    # near the datum nothing changes
    near = np.linalg.norm(fine.vertices - data, axis=1) < 2.0
    kept = np.linalg.norm(mixed.vertices - data, axis=1) < 2.0
    np.testing.assert_allclose(np.sort(mixed.vertices[kept], axis=0), np.sort(fine.vertices[near], axis=0), atol=1e-6)


def test_borders_that_do_not_correspond_are_refused():
    """Two pyramids without a base, point down and point up, whose bases' corners lie on the same coarse edges."""
    sides = np.array([[0, 1, 3], [1, 2, 3], [2, 0, 3]], dtype=np.int32)
    below = np.array([[2.0, 4.0, 8.0], [4.0, 2.0, 8.0], [6.0, 4.0, 8.0], [4.0, 3.0, 6.0]])
    above = np.array([[3.0, 4.0, 8.0], [4.0, 3.0, 8.0], [5.0, 4.0, 8.0], [4.0, 3.0, 10.0]])
    fine = OpenMesh(vertices=below, faces=sides)
    coarse = OpenMesh(vertices=above, faces=sides[:, ::-1].copy())
    joined = stitched(fine, coarse, 4)
    assert joined is not None
    assert TriangleMesh(vertices=joined.vertices, faces=joined.faces).is_watertight()
    np.testing.assert_array_equal(joined.vertices, [*below, above[3]])  # the corners are the fine mesh's
    other_edge = OpenMesh(vertices=above + np.array([8.0, 0.0, 0.0]), faces=coarse.faces)
    assert stitched(fine, other_edge, 4) is None
    turned = OpenMesh(vertices=above, faces=sides)
    assert stitched(fine, turned, 4) is None  # the same way round on both sides: no closed surface


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_no_border_face_is_cut_twice(seed):
    rng = np.random.default_rng(seed)
    field = rng.normal(size=(9, 8, 7)).astype(np.float32)
    far = rng.uniform(size=(8, 7, 6)) < 0.2
    mended = without_saddles(field, far, 0.02)
    count = 0
    for axis in range(3):
        cells, positive, changed = (np.moveaxis(a, axis, 0) for a in (far, mended > 0, mended != field))
        for plane, row, column in np.argwhere(cells[1:] != cells[:-1]):
            face = positive[plane + 1, row : row + 2, column : column + 2]
            assert not (face[0, 0] == face[1, 1] != face[0, 1] == face[1, 0])
            count += int(changed[plane + 1, row : row + 2, column : column + 2].any())
    assert count > 0  # a random field has saddles; corners that touch no such face stay as they were
    touched = np.zeros(field.shape, dtype=bool)
    for axis in range(3):
        cells, corners = np.moveaxis(far, axis, 0), np.moveaxis(touched, axis, 0)
        for plane, row, column in np.argwhere(cells[1:] != cells[:-1]):
            corners[plane + 1, row : row + 2, column : column + 2] = True
    np.testing.assert_array_equal(mended[~touched], field[~touched])
