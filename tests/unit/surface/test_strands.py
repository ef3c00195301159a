"""Hair before the skin: dark, long, narrow, and nearer than what is around it."""

from dataclasses import replace

import numpy as np
import pytest
from spheres import camera_towards, ellipsoid_range, range_image

from mammometry.base.photograph import Photograph
from mammometry.surface.ranges.strands import strands_in

CAMERA = camera_towards("left", (0, 0, 1))  # pixels of 1 mm
WIDE = slice(40, 80)
STRAND = slice(55, 60)
EDGE = 7  # px: half a window of 6, in blocks of 2


def seen(*, columns=STRAND, rows=slice(None), luma=40, before_mm=3.0, skin=200, dtype=np.uint8):
    """A chest of 200 mm, and a stripe of another colour that stands so far before it."""
    range_mm = ellipsoid_range(CAMERA, (200.0,) * 3, (0, 0, -200.0))
    range_mm[rows, columns] -= before_mm
    pixels = np.full((120, 120), skin, dtype=np.uint8)
    pixels[rows, columns] = luma
    photograph = Photograph(name="capture/left.png", pixels=pixels.astype(dtype) * (np.iinfo(dtype).max // 255))
    return range_image(CAMERA, range_mm), photograph


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("skin", [200, 100])
def test_a_dark_strand_before_the_skin_is_found_with_what_lies_beside_it(skin, dtype):
    mask = strands_in(*seen(skin=skin, luma=skin // 5, dtype=dtype), CAMERA)
    assert mask[:, STRAND].all()
    assert not mask[:, : STRAND.start - EDGE].any()
    assert not mask[:, STRAND.stop + EDGE :].any()


def test_colours_count_as_their_luma():
    image, grey = seen()
    colour = replace(grey, pixels=np.repeat(grey.pixels[..., None], 3, axis=2))
    np.testing.assert_array_equal(strands_in(image, colour, CAMERA), strands_in(image, grey, CAMERA))


@pytest.mark.parametrize(
    "what",
    [
        {"before_mm": 0.0},  # a tattoo
        {"before_mm": -4.0},  # a fold in its shadow
        {"luma": 120},  # an areola, a scar, a strap of the skin's colour
        {"columns": WIDE},  # a shirt
        {"rows": slice(50, 65)},  # a nipple
    ],
)
def test_what_is_not_dark_long_narrow_and_before_the_skin_is_kept(what):
    assert not strands_in(*seen(**what), CAMERA).any()


def test_a_strand_that_its_own_error_explains_is_kept():
    image, photograph = seen(before_mm=3.0)
    assert not strands_in(replace(image, sigma_mm=np.full_like(image.sigma_mm, 1.5)), photograph, CAMERA).any()


def test_a_view_without_data_has_no_strands():
    image, photograph = seen()
    assert not strands_in(image.keeping(np.zeros_like(image.valid)), photograph, CAMERA).any()
