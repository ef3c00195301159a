"""Silhouettes of discs and of a shaded ball whose outline is known."""

import numpy as np
import pytest
from alone import foreground as foreground_of
from scipy import ndimage
from skimage.measure import find_contours

from mammometry.base.errors import ImageError, MatchingError
from mammometry.base.photograph import Photograph, linear_of
from mammometry.matching.foreground import silhouette
from mammometry.matching.foreground.foreground import Foreground, estimate_foreground

SIZE = (240, 320)
V, U = np.mgrid[: SIZE[0], : SIZE[1]].astype(np.float64)
RADIUS = 80.3


def encode(linear: np.ndarray) -> np.ndarray:
    srgb = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 0) ** (1 / 2.4) - 0.055)
    return np.clip(np.rint(255 * srgb), 0, 255).astype(np.uint8)


def picture(
    subject: np.ndarray, backdrop: np.ndarray, *, centre: tuple[float, float] = (150.0, 120.0), grey: bool = False
) -> Photograph:
    """A disc of the subject's radiance before the backdrop, 8 × 8 samples a pixel, a lens blur of .7 px, noise."""
    steps = (np.arange(8) + 0.5) / 8 - 0.5
    inside = np.mean([np.hypot(U + a - centre[0], V + b - centre[1]) < RADIUS for a in steps for b in steps], axis=0)
    noise = np.random.default_rng(0).normal(0, 0.002, SIZE)
    channels = [
        ndimage.gaussian_filter(inside * tint * subject + (1 - inside) * backdrop, 0.7) + noise
        for tint in ((1.0,) if grey else (1.0, 0.6, 0.5))
    ]
    pixels = encode(channels[0] if grey else np.stack(channels, axis=-1))
    return Photograph(name="capture/front_left.jpg", pixels=pixels)


def radii(foreground: Foreground, centre: tuple[float, float] = (150.0, 120.0)) -> np.ndarray:
    contour = np.concatenate(find_contours(np.asarray(foreground.coverage), foreground.contour_level))
    inner = ((contour > 2) & (contour < np.array(SIZE) - 3)).all(axis=1)
    return np.hypot(contour[inner, 1] - centre[0], contour[inner, 0] - centre[1])


BOARD = 0.02 + 0.012 * ndimage.gaussian_filter(np.random.default_rng(1).normal(size=SIZE), 2) * 5


@pytest.mark.parametrize("grey", [False, True], ids=["colour", "grey"])
@pytest.mark.parametrize("backdrop", [np.full(SIZE, 0.004), BOARD], ids=["dark", "textured board"])
def test_the_outline_of_an_evenly_lit_disc(backdrop: np.ndarray, grey: bool) -> None:
    foreground = foreground_of(picture(np.full(SIZE, 0.4), np.abs(backdrop), grey=grey), "front_left")
    error = radii(foreground) - RADIUS
    # Level .4 of an evenly lit edge blurred by .7 and .5 px lies Φ⁻¹(.6)·.86 = .22 px outside.
    assert np.abs(error.mean() - 0.22) < 0.1
    assert np.percentile(np.abs(error - error.mean()), 95) < 0.3
    assert not foreground.everything


def test_a_shaded_flank_is_still_subject() -> None:
    """Brightness falls to a sixteenth towards one side: darker than Otsu's threshold, brighter than the backdrop."""
    shade = np.clip((U - 60) / 160, 0.06, 1)
    foreground = foreground_of(picture(0.4 * shade, np.full(SIZE, 0.004)), "front_left")
    error = radii(foreground) - RADIUS
    assert np.abs(error).max() < 1.5
    assert abs(error.mean()) < 0.5


def test_dark_spots_inside_are_subject() -> None:
    skin = np.where(np.hypot(U - 140, V - 110) < 15, 0.01, 0.4)
    assert foreground_of(picture(skin, np.full(SIZE, 0.004)), "a").mask[110, 140]


@pytest.mark.parametrize("radius_px", [26, 55])
def test_a_patch_of_another_colour_on_the_outline_is_subject(radius_px: float) -> None:
    """An areola that the outline cuts, of a red that is rare on the skin, and deep enough to be taken for backdrop.

    The larger one has 2.5 % of the subject's area, as that of a virtual cast from the side.
    """
    v, u = np.mgrid[:600, :800].astype(np.float64)
    disc = np.hypot(u - 400, v - 300) < 270
    areola = disc & (np.hypot(u - 400 - 255, v - 300) < radius_px)
    linear = np.where(disc[..., None], 0.4 * np.array([1.0, 0.6, 0.5]), 0.004)
    linear[areola] = 0.36 * np.array([1.0, 0.25, 0.3])
    blurred = ndimage.gaussian_filter(linear, (0.7, 0.7, 0.0))
    found = foreground_of(Photograph(name="capture/front_left.jpg", pixels=encode(blurred)), "front_left")
    assert found.mask[ndimage.binary_erosion(areola, iterations=2)].all()
    assert np.count_nonzero(found.mask ^ disc) < 0.005 * np.count_nonzero(disc)


def test_a_box_as_bright_as_a_dark_subject_but_of_another_colour_is_none() -> None:
    """It touches the subject and lies above the threshold that finds the subject's core: only its colour tells."""
    v, u = np.mgrid[:600, :800].astype(np.float64)
    disc = np.hypot(u - 300, v - 300) < 200
    box = (np.abs(u - 560) < 70) & (np.abs(v - 300) < 60) & ~disc
    linear = np.where(disc[..., None], 0.17 * np.array([1.0, 0.6, 0.45]), 0.004)
    linear[box] = 0.13 * np.array([0.9, 1.0, 0.95])
    noisy = ndimage.gaussian_filter(linear, (0.7, 0.7, 0.0)) + np.random.default_rng(3).normal(0, 0.002, linear.shape)
    found = foreground_of(Photograph(name="capture/front_left.jpg", pixels=encode(noisy)), "front_left")
    assert not found.mask[ndimage.binary_erosion(box, iterations=4)].any()
    assert found.mask[ndimage.binary_erosion(disc, iterations=4)].all()


def test_a_subject_that_the_frame_crops_has_no_outline_along_the_frame() -> None:
    centre = (150.0, 20.0)
    foreground = foreground_of(picture(np.full(SIZE, 0.4), np.full(SIZE, 0.004), centre=centre), "a")
    assert foreground.mask[0, 120:180].all()
    assert np.abs(radii(foreground, centre) - RADIUS).max() < 0.8


def test_the_coverage_is_fit_for_sub_pixel_contours() -> None:
    foreground = foreground_of(picture(np.full(SIZE, 0.4), np.full(SIZE, 0.004)), "a")
    assert 0 <= foreground.coverage.min() <= foreground.coverage.max() <= 1
    assert not foreground.coverage.flags.writeable
    steps = np.abs(np.diff(np.asarray(foreground.coverage), axis=1))
    assert steps.max() < 0.6


def test_everything_and_given_masks() -> None:
    photograph = picture(np.full(SIZE, 0.4), np.full(SIZE, 0.004))
    whole = estimate_foreground(photograph, "a")
    assert whole.everything
    assert whole.mask.all()
    given = np.hypot(U - 100, V - 100) < 40
    drawn = estimate_foreground(photograph, "a", given=given)
    assert not drawn.everything
    assert (drawn.mask != given).mean() < 0.002
    with pytest.raises(ImageError, match="320 × 240"):
        estimate_foreground(photograph, "a", given=given[:-1])


def test_in_an_even_picture_no_silhouette_is_known() -> None:
    even = np.random.default_rng(0).integers(100, 110, (*SIZE, 3)).astype(np.uint8)
    assert foreground_of(Photograph(name="capture/x.jpg", pixels=even), "x").everything


def test_a_black_picture_is_refused_by_name() -> None:
    with pytest.raises(MatchingError, match=r"^capture/x\.jpg: .*black"):
        foreground_of(Photograph(name="capture/x.jpg", pixels=np.full((*SIZE, 3), 9, dtype=np.uint8)), "x")


def test_a_dark_subject_on_a_board_that_is_paler_than_the_dark_around_it() -> None:
    """The board's edge is the picture's larger step in light, but the subject is what lies on the board."""
    board = np.where((np.abs(U - 150) < 112) & (np.abs(V - 120) < 98), 0.03, 0.001)
    foreground = foreground_of(picture(np.full(SIZE, 0.115), board), "front_left")
    assert np.abs(radii(foreground) - RADIUS).max() < 1.0


@pytest.mark.parametrize("centre", [(150.0, 120.0), (60.0, 30.0)], ids=["inside", "cropped by the frame"])
@pytest.mark.parametrize("step", [2, 3])
def test_only_the_subjects_surroundings_need_be_looked_at(
    centre: tuple[float, float], step: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The coverage is that of work on the whole picture, whose far corner holds something brighter."""
    radius = 0.7 * RADIUS
    share = np.clip(radius + 0.5 - np.hypot(U - centre[0], V - centre[1]), 0, 1)
    light = 0.02 + 0.4 * share + 0.9 * ((U > 290) & (V > 210))
    pixels = encode((light + np.random.default_rng(4).normal(0, 0.003, SIZE))[..., None] * [1.0, 0.6, 0.5])
    blocks = share[step // 2 :: step, step // 2 :: step] > 0.5
    rows, columns = -(-SIZE[0] // step), -(-SIZE[1] // step)
    subject = np.pad(blocks, ((0, rows - blocks.shape[0]), (0, columns - blocks.shape[1])))
    asked = (pixels, linear_of(pixels.dtype), subject, step, 1.0, 0.4)
    found = silhouette.sub_pixel_coverage(*asked)
    held = np.zeros_like(subject)
    held[silhouette._around(subject, 8)] = True
    assert held.mean() < 0.7
    monkeypatch.setattr(silhouette, "_around", lambda subject, margin: (slice(0, rows), slice(0, columns)))
    np.testing.assert_allclose(found, silhouette.sub_pixel_coverage(*asked), atol=1e-4)  # places round otherwise
    assert 0.9 * np.count_nonzero(share > 0.5) < np.count_nonzero(found > 0.5)
