"""What a rigid motion, a scale and a mirror do to area and volume."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from strategies import transforms

from mammometry.geometry.mesh import TriangleMesh
from mammometry.geometry.transform import Transform

TETRAHEDRON = np.array([(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)], dtype=np.int32)
"""Outward for corners in a right-handed arrangement."""


@st.composite
def tetrahedra(draw: st.DrawFn) -> TriangleMesh:
    """Any four corners within 100 mm, oriented outwards; flat ones too."""
    vertices = draw(hnp.arrays(np.float64, (4, 3), elements=st.floats(-100, 100, allow_subnormal=False)))
    if np.linalg.det(vertices[1:] - vertices[0]) < 0:
        vertices = vertices[[0, 2, 1, 3]]
    return TriangleMesh(vertices=vertices, faces=TETRAHEDRON)


@pytest.mark.slow
@given(tetrahedra())
def test_a_tetrahedron_has_a_sixth_of_the_spat(mesh: TriangleMesh) -> None:
    spat_mm3 = np.linalg.det(mesh.vertices[1:] - mesh.vertices[0])
    assert mesh.volume_mm3() == pytest.approx(spat_mm3 / 6, abs=1e-7)


@pytest.mark.slow
@given(tetrahedra(), transforms())
def test_volume_and_area_survive_a_rigid_motion(mesh: TriangleMesh, b_from_a: Transform) -> None:
    moved = mesh.transformed(b_from_a)
    # 100 mm body, coordinates up to 1 m: 1e-13 mm × face area of 1e4 mm² × a few
    assert moved.volume_mm3() == pytest.approx(mesh.volume_mm3(), abs=1e-6)
    assert moved.area_mm2() == pytest.approx(mesh.area_mm2(), abs=1e-6)


@given(tetrahedra(), st.floats(0.1, 10.0))
def test_volume_scales_with_the_cube_and_area_with_the_square(mesh: TriangleMesh, scale: float) -> None:
    scaled = TriangleMesh(vertices=mesh.vertices * scale, faces=mesh.faces)
    assert scaled.volume_mm3() == pytest.approx(mesh.volume_mm3() * scale**3, rel=1e-9, abs=1e-4)
    assert scaled.area_mm2() == pytest.approx(mesh.area_mm2() * scale**2, rel=1e-9, abs=1e-6)


@given(tetrahedra())
def test_turning_the_faces_turns_the_sign(mesh: TriangleMesh) -> None:
    inside_out = TriangleMesh(vertices=mesh.vertices, faces=mesh.faces[:, ::-1].copy())
    assert inside_out.volume_mm3() == pytest.approx(-mesh.volume_mm3(), abs=1e-9)
    assert inside_out.is_watertight()


@given(tetrahedra())
def test_the_face_vectors_of_a_closed_mesh_cancel(mesh: TriangleMesh) -> None:
    np.testing.assert_allclose(mesh.face_vectors().sum(axis=0), 0.0, atol=1e-9)
