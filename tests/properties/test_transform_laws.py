"""A rigid transform is an element of a group; the laws, swept.

Tolerance: coordinates up to 1 m and a handful of products of float64 leave errors near 1 m × 1e-15 × 10 ≈ 1e-11 mm.
"""

import numpy as np
import pytest
from hypothesis import given
from scipy.spatial.transform import Rotation
from strategies import points, transforms, vectors

from mammometry.geometry.transform import Transform

TOLERANCE_MM = 1e-9


def assert_same(first: Transform, second: Transform) -> None:
    np.testing.assert_allclose(first.matrix, second.matrix, atol=TOLERANCE_MM, rtol=0)


@given(transforms(), transforms(), transforms())
def test_composition_is_associative(d_from_c: Transform, c_from_b: Transform, b_from_a: Transform) -> None:
    assert_same((d_from_c @ c_from_b) @ b_from_a, d_from_c @ (c_from_b @ b_from_a))


@given(transforms())
def test_identity_changes_nothing_on_either_side(b_from_a: Transform) -> None:
    assert_same(b_from_a @ Transform.identity(), b_from_a)
    assert_same(Transform.identity() @ b_from_a, b_from_a)


@given(transforms())
def test_inverse_undoes_on_either_side(b_from_a: Transform) -> None:
    assert_same(b_from_a.inverse() @ b_from_a, Transform.identity())
    assert_same(b_from_a @ b_from_a.inverse(), Transform.identity())


@given(transforms(), transforms(), points())
def test_applying_the_composition_is_applying_one_after_the_other(
    c_from_b: Transform, b_from_a: Transform, points_a: np.ndarray
) -> None:
    np.testing.assert_allclose(
        (c_from_b @ b_from_a).apply(points_a), c_from_b.apply(b_from_a.apply(points_a)), atol=TOLERANCE_MM, rtol=0
    )


@given(transforms(), points())
def test_apply_is_the_homogeneous_matrix_product(b_from_a: Transform, points_a: np.ndarray) -> None:
    homogeneous = np.c_[points_a, np.ones(len(points_a))] @ b_from_a.matrix.T
    np.testing.assert_allclose(b_from_a.apply(points_a), homogeneous[:, :3], atol=TOLERANCE_MM, rtol=0)
    np.testing.assert_allclose(homogeneous[:, 3], 1.0, atol=1e-15)


@given(transforms(), points())
def test_distances_and_handedness_are_kept(b_from_a: Transform, points_a: np.ndarray) -> None:
    points_b = b_from_a.apply(points_a)
    np.testing.assert_allclose(
        np.linalg.norm(np.diff(points_b, axis=0), axis=1),
        np.linalg.norm(np.diff(points_a, axis=0), axis=1),
        atol=TOLERANCE_MM,
    )
    rotated = b_from_a.rotate(np.eye(3))
    np.testing.assert_allclose(np.cross(rotated[0], rotated[1]), rotated[2], atol=1e-12)


@given(transforms(), vectors(1.0), points())
def test_directions_have_no_origin(b_from_a: Transform, direction_a: np.ndarray, points_a: np.ndarray) -> None:
    difference = b_from_a.apply(points_a + direction_a) - b_from_a.apply(points_a)
    np.testing.assert_allclose(difference - b_from_a.rotate(direction_a), 0.0, atol=TOLERANCE_MM)


@given(transforms())
def test_matrix_and_rotation_vector_are_read_back(b_from_a: Transform) -> None:
    assert_same(Transform.from_matrix(b_from_a.matrix), b_from_a)
    assert_same(Transform.from_rotation_vector(b_from_a.rotation_vector_rad, b_from_a.translation_mm), b_from_a)


@given(vectors(3.0))
def test_rotation_vector_is_rodrigues(rotation_rad: np.ndarray) -> None:
    import cv2  # the oracle: OpenCV's own Rodrigues

    built = Transform.from_rotation_vector(rotation_rad, np.zeros(3)).rotation
    np.testing.assert_allclose(built, cv2.Rodrigues(rotation_rad.reshape(3, 1))[0], atol=1e-12)


@pytest.mark.parametrize(
    ("rotation", "says"),
    [
        (np.diag([1.0, 1.0, -1.0]), "rotation"),
        (np.eye(3) * 1.001, "rotation"),
        (np.full((3, 3), np.nan), "finite"),
    ],
    ids=["mirror", "scale", "nan"],
)
def test_what_is_no_rotation_is_refused(rotation: np.ndarray, says: str) -> None:
    with pytest.raises(ValueError, match=says):
        Transform(rotation=rotation, translation_mm=np.zeros(3))


def test_a_projective_matrix_is_refused() -> None:
    matrix = np.eye(4)
    matrix[3, 0] = 0.1
    with pytest.raises(ValueError, match="0 0 0 1"):
        Transform.from_matrix(matrix)


def test_values_cannot_be_written() -> None:
    transform = Transform.from_rotation_vector(np.array([0.1, 0.2, 0.3]), np.array([1.0, 2.0, 3.0]))
    with pytest.raises(ValueError, match="read-only"):
        transform.rotation[0, 0] = 2.0
    with pytest.raises(ValueError, match="read-only"):
        transform.translation_mm[0] = 2.0


def test_names_compose() -> None:
    quarter_turn_about_z = Rotation.from_euler("z", 90, degrees=True).as_matrix()
    b_from_a = Transform(rotation=quarter_turn_about_z, translation_mm=np.array([1.0, 0.0, 0.0]))
    np.testing.assert_allclose(b_from_a.apply(np.array([1.0, 0.0, 5.0])), [1.0, 1.0, 5.0], atol=1e-12)
