"""Brown's lens model: derivatives, inverse, fold, and the form that compiled code uses.

OpenCV is the oracle of the model itself in tests/properties/test_camera_laws.py.
"""

import numpy as np
import pytest

from mammometry.geometry import lens, lens_kernels

LENSES = [np.array([-0.25, 0.3, 1e-3, -2e-3, 0.05]), np.array([-0.05, 0.1, 0.0, 0.0, 0.0]), np.zeros(5)]


@pytest.fixture
def xy() -> np.ndarray:
    return np.random.default_rng(3).uniform(-0.7, 0.7, (300, 2))


@pytest.mark.parametrize("coefficients", LENSES)
def test_jacobian_is_the_slope_of_the_model(xy, coefficients):
    """By complex steps, which are exact to rounding: the model is arithmetic alone."""
    tiny = 1e-20
    by_xx, by_xy, by_yy = lens.jacobian(*xy.T, coefficients)
    along_x = lens.distorted(xy[:, 0] + 1j * tiny, xy[:, 1] + 0j, coefficients)
    along_y = lens.distorted(xy[:, 0] + 0j, xy[:, 1] + 1j * tiny, coefficients)
    np.testing.assert_allclose(along_x[0].imag / tiny, by_xx, rtol=0, atol=1e-14)
    np.testing.assert_allclose(along_x[1].imag / tiny, by_xy, rtol=0, atol=1e-14)
    np.testing.assert_allclose(along_y[0].imag / tiny, by_xy, rtol=0, atol=1e-14)
    np.testing.assert_allclose(along_y[1].imag / tiny, by_yy, rtol=0, atol=1e-14)


def test_what_the_adjustment_takes_is_the_same_lens(xy):
    """Points to the last bit or one beside it, and the slope by each coefficient."""
    coefficients = np.tile(LENSES[0], (len(xy), 1)).T
    seen = lens.linearised(*xy.T, coefficients)
    x, y = lens.distorted(*xy.T, LENSES[0])
    np.testing.assert_array_max_ulp(seen.x, x, maxulp=4)
    np.testing.assert_array_max_ulp(seen.y, y, maxulp=4)
    for k in range(5):
        one = np.zeros(5)
        one[k] = 1.0
        x_more, y_more = lens.distorted(*xy.T, one)
        np.testing.assert_allclose(seen.x_by_coefficient[k], x_more - xy[:, 0], atol=1e-15)
        np.testing.assert_allclose(seen.y_by_coefficient[k], y_more - xy[:, 1], atol=1e-15)


@pytest.mark.parametrize("coefficients", LENSES)
def test_compiled_code_computes_the_same_bits(xy, coefficients):
    for x, y in xy[:50].tolist():
        assert lens_kernels.distorted(x, y, coefficients) == lens.distorted(x, y, coefficients)
        assert lens_kernels.distorted(x, y, tuple(coefficients)) == lens.distorted(x, y, coefficients)
        assert lens_kernels.jacobian(x, y, coefficients) == lens.jacobian(x, y, coefficients)


@pytest.mark.parametrize("coefficients", LENSES)
def test_both_forms_undo_the_lens(xy, coefficients):
    shown = lens.distort(xy, coefficients)
    np.testing.assert_allclose(lens.undistort(shown, coefficients), xy, atol=1e-13)
    for (xd, yd), (x, y) in zip(shown[:50].tolist(), xy[:50].tolist(), strict=True):
        undone = lens_kernels.undistorted(xd, yd, coefficients, xd, yd)
        assert undone[:2] == pytest.approx((x, y), abs=1e-13)
        assert undone[2:] == pytest.approx(lens.jacobian(x, y, coefficients), abs=1e-6)


def test_fold_is_where_the_distorted_radius_stops_growing():
    barrel = np.array([-1.0 / 3.0, 0.0, 0.0, 0.0, 0.0])  # r − r³/3 has its top at 1
    assert lens.fold_radius(barrel) == pytest.approx(1.0)
    assert lens.fold_xy(barrel) == pytest.approx(2.0 / 3.0)
    for never in (np.zeros(5), np.array([0.2, 0.0, 0.0, 0.0, 0.0])):
        assert lens.fold_radius(never) == lens.fold_xy(never) == np.inf
