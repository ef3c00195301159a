"""The matcher under what photographs do to it; every truth in closed form.

Tolerances of the noise: as in test_match. A quantised picture (8 bit) adds noise of 1/√12 of a step, .0011.
"""

from collections.abc import Callable

import numpy as np
import pytest
from scipy import ndimage
from tests.first_cases import first
from textured_pair import Texture, camera, make_pair

from mammometry.matching.dense.match import match
from mammometry.matching.rectify import RectifiedPair

SIZE_WH = (240, 180)
V, U = np.mgrid[: SIZE_WH[1], : SIZE_WH[0]].astype(np.float64)


def pair_of(left: np.ndarray, right: np.ndarray, left_mask: np.ndarray, right_mask: np.ndarray) -> RectifiedPair:
    return RectifiedPair(
        name="synthetic",
        left=camera("left", SIZE_WH, 0.0),
        right=camera("right", SIZE_WH, 100.0),
        left_image=left.astype(np.float32),
        right_image=right.astype(np.float32),
        left_mask=left_mask,
        right_mask=right_mask,
    )


def seen(pair: RectifiedPair, change: Callable[[np.ndarray], np.ndarray], *, left_too: bool = False) -> RectifiedPair:
    left = change(pair.left_image) if left_too else pair.left_image
    return RectifiedPair(
        name=pair.name,
        left=pair.left,
        right=pair.right,
        left_image=left.astype(np.float32),
        right_image=change(pair.right_image).astype(np.float32),
        left_mask=pair.left_mask,
        right_mask=pair.right_mask,
    )


def vignetted(image: np.ndarray) -> np.ndarray:
    height, width = image.shape
    v, u = np.mgrid[:height, :width]
    return image * (1 - 0.4 * np.hypot(u - width / 2, v - height / 2) ** 2 / np.hypot(width / 2, height / 2) ** 2)


def in_8_bit(image: np.ndarray) -> np.ndarray:
    return np.rint(255 * image) / 255


@pytest.mark.slow
@pytest.mark.parametrize("change", [vignetted, in_8_bit, lambda image: 0.4 * image + 0.05], ids=["v", "8 bit", "dark"])
def test_exposure_vignetting_and_bit_depth_do_no_harm(change: Callable[[np.ndarray], np.ndarray]) -> None:
    pair, truth = make_pair(np.random.default_rng(1))
    found = match(seen(pair, change))
    inner = ndimage.binary_erosion(pair.left_mask & pair.right_mask, iterations=8)
    error = (found.d_h_px - truth)[inner & found.valid]
    assert (found.valid & inner).sum() / inner.sum() > 0.99
    assert (
        np.median(np.abs(error)) < 0.03
    )  # .02 as it is; the dark picture keeps its noise/texture, the others add a little
    assert np.percentile(np.abs(error), 95) < 0.12


@pytest.mark.slow
def test_half_the_contrast_at_the_same_noise_is_still_matched() -> None:
    pair, truth = make_pair(np.random.default_rng(2), contrast=0.025, noise=0.006)
    found = match(pair)
    inner = ndimage.binary_erosion(pair.left_mask & pair.right_mask, iterations=8)
    assert (found.valid & inner).sum() / inner.sum() > 0.95
    assert np.median(np.abs(found.d_h_px - truth)[inner & found.valid]) < 0.1


@pytest.mark.parametrize("slope", first(1, [-0.3, 0.3]))
def test_skin_that_slants_as_a_baseline_of_30_degrees_makes_it(slope: float) -> None:
    """A plane at 30° before a baseline that converges by 30° shifts by about .3 px a pixel."""
    rng = np.random.default_rng(3)
    texture = Texture.random(rng, shortest_px=5.0, longest_px=40.0, contrast=0.05)
    right_u = (U + slope * SIZE_WH[0] / 2) / (1 + slope)  # u = right_u + slope (right_u − middle)
    left = 0.5 + texture.at(right_u, V) + rng.normal(0, 0.004, U.shape)
    right = 0.5 + texture.at(U, V) + rng.normal(0, 0.004, U.shape)
    disc = np.hypot((right_u - 120) / 75, (V - 90) / 75) < 1
    right_disc = np.hypot((U - 120) / 75, (V - 90) / 75) < 1
    found = match(pair_of(left, right, disc, right_disc))
    inner = ndimage.binary_erosion(disc, iterations=8)
    error = (found.d_h_px - (U - right_u))[inner & found.valid]
    assert (found.valid & inner).sum() / inner.sum() > 0.97
    assert np.median(np.abs(error)) < 0.04


@pytest.mark.slow
def test_at_a_depth_jump_nothing_is_stretched_and_the_hidden_is_not_invented() -> None:
    """A near band before a far plane, nine pixels of disparity apart: a strip is hidden from the right eye."""
    rng = np.random.default_rng(4)
    near_texture, far_texture = (Texture.random(rng, shortest_px=5.0, longest_px=30.0, contrast=0.05) for _ in range(2))
    near_d, far_d = 7.0, -2.0
    left_near = np.abs(U - 120) < 32
    right_near = np.abs(U + near_d - 120) < 32
    left = 0.5 + np.where(left_near, near_texture.at(U, V), far_texture.at(U, V)) + rng.normal(0, 0.004, U.shape)
    right = np.where(right_near, near_texture.at(U + near_d, V), far_texture.at(U + far_d, V))
    right = 0.5 + right + rng.normal(0, 0.004, U.shape)
    mask = (np.abs(U - 120) < 100) & (np.abs(V - 90) < 70)
    right_mask = (np.abs(U - 118) < 100) & (np.abs(V - 90) < 70)
    found = match(pair_of(left, right, mask, right_mask))
    truth = np.where(left_near, near_d, far_d)
    # Left of the near band: far points that the right picture hides behind it.
    hidden = (U - far_d > 88 - near_d) & (U <= 88)
    edge = ndimage.distance_transform_edt(~(left_near ^ ndimage.binary_dilation(left_near)))
    judged = mask & ~hidden & (edge > 5) & ndimage.binary_erosion(mask, iterations=6)
    judged &= (U < 80) | (U > 88)
    error = np.abs(found.d_h_px - truth)
    assert (found.valid & judged).sum() / judged.sum() > 0.97
    assert np.median(error[judged & found.valid & (edge < 20)]) < 0.1
    assert (error[judged & found.valid] > 1).mean() < 0.002
    between = found.valid & (found.d_h_px > far_d + 1.5) & (found.d_h_px < near_d - 1.5)
    assert between.sum() / mask.sum() < 0.004  # a membrane over the jump would be 9 of 200 columns: 4 %
    strip = hidden & (edge > 2) & (np.abs(V - 90) < 60)
    assert found.valid[strip].mean() < 0.4


@pytest.mark.slow
def test_a_repeating_pattern_is_told_apart_by_what_does_not_repeat() -> None:
    rng = np.random.default_rng(5)
    weak = Texture.random(rng, shortest_px=8.0, longest_px=60.0, contrast=0.02)

    def picture(u: np.ndarray) -> np.ndarray:
        return 0.5 + 0.06 * np.sin(2 * np.pi * u / 11) + 0.04 * np.sin(2 * np.pi * V / 13) + weak.at(u, V)

    disparity = 6.0 * np.cos((V - 90) / 60)
    left = picture(U - disparity) + rng.normal(0, 0.004, U.shape)
    right = picture(U) + rng.normal(0, 0.004, U.shape)
    disc = np.hypot(U - 120, V - 90) < 75
    right_disc = np.hypot(U + disparity - 120, V - 90) < 75
    found = match(pair_of(left, right, disc, right_disc))
    inner = ndimage.binary_erosion(disc, iterations=8)
    error = np.abs(found.d_h_px - disparity)[inner & found.valid]
    assert (found.valid & inner).sum() / inner.sum() > 0.95
    assert (error > 3).mean() < 0.01  # a slip to the next period would be 11 px
    assert np.median(error) < 0.05


@pytest.mark.slow
@pytest.mark.parametrize("polished", [False, True], ids=["dull", "with a gleam"])
def test_jewellery_does_not_become_skin(polished: bool) -> None:
    """A flat pendant 4 px nearer than the skin, plain but for a gleam that each camera sees elsewhere on it.

    What is accepted is the skin or the pendant, but for a ring along its edge: no membrane spans its radius of skin
    around it, and nothing follows the gleam to where neither is.
    """
    rng = np.random.default_rng(6)
    pair, truth = make_pair(rng, size_wh=SIZE_WH)
    radius, lift, middle = 11.0, 4.0, (118.0, 90.0)
    own = float(truth[int(middle[1]), int(middle[0])]) + lift  # the pendant's disparity
    images, masks = [], []
    for image, mask, column, gleam in (
        (pair.left_image, pair.left_mask, middle[0], -4.0),
        (pair.right_image, pair.right_mask, middle[0] - own, 4.0),
    ):
        pendant = np.hypot(U - column, V - middle[1]) < radius
        seen_image = np.where(pendant, 0.62 + rng.normal(0, 0.004, U.shape), image)
        blown = np.zeros_like(mask)
        if polished:
            glow = np.exp(-0.5 * (np.hypot(U - column - gleam, V - middle[1]) / 2.5) ** 2)
            seen_image = np.minimum(seen_image + 0.8 * glow, 1.0)
            blown = ndimage.binary_dilation(seen_image > 0.985, iterations=2)  # as rectification leaves them out
        images.append(seen_image)
        masks.append(mask & ~blown)
    found = match(pair_of(*images, *masks))
    on_it = np.hypot(U - middle[0], V - middle[1]) < radius
    near = np.hypot(U - middle[0], V - middle[1]) < radius + 12
    error = np.minimum(np.abs(found.d_h_px - truth), np.where(near, np.abs(found.d_h_px - own), np.inf))
    assert (error > 1)[found.valid & near].mean() < 0.1  # the ring; a membrane around it would be half
    assert found.valid[on_it].mean() < 0.4  # it has no texture: most of it says nothing
    rise = (found.d_h_px - truth)[found.valid & near]
    assert np.percentile(rise, 1) > -1.0
    assert np.percentile(rise, 99) < lift + 1.0
    far = ndimage.binary_erosion(pair.left_mask & pair.right_mask, iterations=8) & ~near
    assert (found.valid & far).sum() / far.sum() > 0.99
    assert np.median(error[found.valid & far]) < 0.03
    assert not found.valid[~masks[0]].any()
