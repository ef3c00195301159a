"""What a camera does to its picture, against plain NumPy."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from mammometry.simulate.rendering.develop import (
    arriving,
    demosaicked,
    develop,
    magnified,
    mosaicked,
    processed,
    srgb_encoded,
)
from mammometry.simulate.rendering.film import Film

_QUIET = Film(blur_px=0.0, vignetting=0.0).with_noise(0.0)


def test_mosaic_takes_one_colour_a_pixel():
    light = np.random.default_rng(1).random((6, 8, 3))
    raw = mosaicked(light)
    for row in range(6):
        for column in range(8):
            channel = (row % 2) + (column % 2)  # R G / G B
            assert raw[row, column] == light[row, column, channel]


def test_demosaicking_keeps_ramps_and_what_was_counted():
    row, column = np.mgrid[0:20, 0:24]
    ramp = np.repeat((0.1 + 0.02 * row + 0.01 * column)[:, :, None], 3, axis=2)
    assert demosaicked(mosaicked(ramp))[2:-2, 2:-2] == pytest.approx(ramp[2:-2, 2:-2], abs=1e-12)
    light = np.random.default_rng(2).random((10, 10, 3))
    raw = mosaicked(light)
    assert np.array_equal(mosaicked(demosaicked(raw)), raw)
    flat = np.broadcast_to(np.array([0.7, 0.4, 0.2]), (12, 12, 3))
    assert demosaicked(mosaicked(flat))[2:-2, 2:-2] == pytest.approx(flat[2:-2, 2:-2], abs=1e-12)


def test_demosaicking_is_malvars_at_a_red_pixel():
    raw = np.random.default_rng(3).random((9, 9))
    y, x = 4, 4  # red
    green = (4 * raw[y, x] + 2 * (raw[y - 1, x] + raw[y + 1, x] + raw[y, x - 1] + raw[y, x + 1])) / 8 - (
        raw[y - 2, x] + raw[y + 2, x] + raw[y, x - 2] + raw[y, x + 2]
    ) / 8
    corners = raw[y - 1, x - 1] + raw[y - 1, x + 1] + raw[y + 1, x - 1] + raw[y + 1, x + 1]
    far = raw[y - 2, x] + raw[y + 2, x] + raw[y, x - 2] + raw[y, x + 2]
    blue = (6 * raw[y, x] + 2 * corners - 1.5 * far) / 8
    assert demosaicked(raw)[y, x] == pytest.approx([raw[y, x], green, blue], abs=1e-12)


def test_aberration_magnifies_about_the_middle():
    row, column = np.mgrid[0:121, 0:161]
    places = {}
    for larger in (0.0, 0.01):
        blob = np.exp(-0.5 * ((row - 95.0) ** 2 + (column - 130.0) ** 2) / 9.0).astype(np.float32)
        seen = magnified(blob, larger) if larger else blob
        places[larger] = np.array([(seen * row).sum(), (seen * column).sum()]) / seen.sum()
    assert places[0.01] - places[0.0] == pytest.approx([0.35, 0.50], abs=2e-3)  # 1 % of 35 and 50 px


def test_only_red_and_blue_are_magnified():
    image = np.random.default_rng(4).random((40, 50, 3)).astype(np.float32)
    fringed = arriving(image, replace(_QUIET, aberration=(2e-3, -1e-3)))
    assert np.array_equal(fringed[:, :, 1], image[:, :, 1])
    for channel, larger in ((0, 2e-3), (2, -1e-3)):
        assert np.array_equal(fringed[:, :, channel], magnified(image[:, :, channel], larger))


def test_gain_is_the_exposure_and_the_white_balance():
    image = np.full((8, 8, 3), 0.2, dtype=np.float32)
    picture = develop(image, replace(_QUIET, gain_rgb=(1.5, 1.0, 0.5)), name="p", seed=1).pixels
    expected = np.round(255 * srgb_encoded(np.array([0.3, 0.2, 0.1])))
    assert np.abs(picture - expected).max() <= 1  # hardly any noise
    grey = develop(image[:, :, :1], replace(_QUIET, gain_rgb=(2.0, 2.0, 2.0)), name="p", seed=1).pixels
    assert np.abs(grey - np.round(255 * srgb_encoded(np.array(0.4)))).max() <= 1


def test_sharpening_adds_the_difference_to_the_blurred_picture():
    counted = (np.random.default_rng(5).random((30, 30, 3)) * 40000 + 8000).astype(np.uint16)
    encoded = srgb_encoded(counted / 65535.0)
    soft = np.stack([gaussian_filter(encoded[:, :, k], 1.0, mode="nearest") for k in range(3)], axis=2)
    expected = np.clip(1.5 * encoded - 0.5 * soft, 0.0, 1.0)
    found = processed(counted, replace(_QUIET, sharpening=0.5), 16)
    assert found == pytest.approx(np.round(expected * 65535), abs=1)


def test_a_camera_that_processes_nothing_counts_as_before():
    image = np.random.default_rng(6).random((20, 20, 3)).astype(np.float32)
    film = Film()
    assert not film.is_processed
    plain = develop(image, film, name="p", seed=3).pixels.astype(int)
    # The same light through the longer way, which rounds to 16 bits in between.
    nearly = develop(image, replace(film, gain_rgb=(1.0, 1.0, 1.0 + 1e-9)), name="p", seed=3).pixels.astype(int)
    assert np.abs(plain - nearly).max() <= 1


def test_a_grey_sensor_writes_one_channel_of_all_light():
    rng = np.random.default_rng(3)
    light = rng.uniform(0.1, 0.8, (12, 16, 3)).astype(np.float32)
    film = replace(Film(blur_px=0.0, vignetting=0.0).with_noise(0.0), grey=True)
    for one in (film, replace(film, sharpening=0.5)):
        assert develop(light, one, name="a", seed=1).pixels.shape == (12, 16)
    luma = light @ np.array([0.2126, 0.7152, 0.0722], dtype=np.float32)
    found = develop(light, film, name="a", seed=1).pixels
    assert np.abs(found - 255 * srgb_encoded(luma)).max() < 1.5
