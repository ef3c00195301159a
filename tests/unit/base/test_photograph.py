"""Photographs: accepted pixels, luma and linear light against their closed forms."""

import numpy as np
import pytest

from mammometry.base.errors import ImageError, MammometryError
from mammometry.base.photograph import Photograph


def photograph(pixels: np.ndarray) -> Photograph:
    return Photograph(name="capture/front_left.png", pixels=pixels)


def srgb_encode(linear: np.ndarray) -> np.ndarray:
    """IEC 61966-2-1, the direction that the code does not use."""
    return np.where(linear <= 0.0031308, linear * 12.92, 1.055 * linear ** (1 / 2.4) - 0.055)


@pytest.mark.parametrize(("dtype", "top"), [(np.uint8, 255), (np.uint16, 65535)])
def test_encoded_values_run_from_0_to_1(dtype: type, top: int) -> None:
    encoded = photograph(np.array([[0, top]], dtype=dtype)).encoded()
    assert encoded.dtype == np.float32
    np.testing.assert_array_equal(encoded, [[0.0, 1.0]])


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_linear_light_is_undone_by_the_encoding(dtype: type) -> None:
    top = np.iinfo(dtype).max
    levels = np.arange(0, top + 1, max(1, top // 255)).astype(dtype).reshape(1, -1)
    linear = photograph(levels).linear()
    # IEC's rounded constants leave a jump of 3e-8 at the toe; float32 carries 6e-8 at 1
    np.testing.assert_allclose(srgb_encode(linear.astype(np.float64)), levels / top, atol=3e-7)


def test_linear_light_of_middle_grey() -> None:
    assert photograph(np.array([[188]], dtype=np.uint8)).linear()[0, 0] == pytest.approx(0.5, abs=0.003)


def test_pixels_cannot_be_written() -> None:
    pixels = np.zeros((2, 3), dtype=np.uint8)
    taken = photograph(pixels)
    with pytest.raises(ValueError, match="read-only"):
        taken.pixels[0, 0] = 1
    assert taken.size_wh == (3, 2)


@pytest.mark.parametrize(
    "pixels",
    [np.zeros((2, 3)), np.zeros((2, 3, 4), dtype=np.uint8), np.zeros((2, 3, 1), dtype=np.uint8)],
    ids=["float", "rgba", "single channel"],
)
def test_other_pixels_are_refused_with_a_remedy(pixels: np.ndarray) -> None:
    with pytest.raises(ImageError) as caught:
        photograph(pixels)
    assert caught.value.subject == "capture/front_left.png"
    assert str(pixels.shape) in caught.value.found
    assert isinstance(caught.value, MammometryError)
    assert str(caught.value).count(".") >= 2
    assert "Export" in caught.value.remedy
