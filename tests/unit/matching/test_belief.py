"""What makes a match believed, against NumPy twins."""

import numpy as np
import pytest
from scipy import ndimage

from mammometry.matching.dense.least_squares_step import agreeing, compete, smoothing_weights

RNG = np.random.default_rng(5)


def test_agreement_interpolates_the_way_back() -> None:
    ours, theirs = (RNG.uniform(-6, 6, (9, 30)).astype(np.float32) for _ in range(2))
    target = np.arange(30) + ours.astype(np.float64)
    rows = np.broadcast_to(np.arange(9.0)[:, None], target.shape)
    back = ndimage.map_coordinates(theirs.astype(np.float64), [rows, target], order=1, mode="nearest")
    inside = (target >= 0) & (target <= 29)
    np.testing.assert_array_equal(agreeing(ours, theirs, 3.0), inside & (np.abs(ours + back) < 3.0))
    assert agreeing(np.full((2, 30), 2, np.float32), np.full((2, 30), -2, np.float32), 0.1)[:, :-2].all()


@pytest.mark.parametrize("halved", [0, 1])
def test_a_known_match_replaces_what_failed_or_is_far_less_certain(halved: int) -> None:
    shape, coarse = (8, 11), (8 >> halved, (11 + halved) >> halved)
    fine = [RNG.normal(size=shape).astype(np.float32) for _ in range(3)]
    fine.append(RNG.uniform(0, 1, shape).astype(np.float32))
    plausible = RNG.uniform(size=shape) > 0.4
    shift = RNG.normal(size=shape).astype(np.float32)
    known = [RNG.normal(size=coarse).astype(np.float32), RNG.uniform(0, 0.1, coarse).astype(np.float32)]
    accepted = RNG.uniform(size=coarse) > 0.4
    where = np.ix_(np.arange(8) >> halved, np.arange(11) >> halved)
    v, u = np.meshgrid(*((np.arange(n) + 0.5) / (1 + halved) - 0.5 for n in shape), indexing="ij")
    between = [ndimage.map_coordinates(each.astype(np.float64), [v, u], order=1, mode="nearest") for each in known]
    yields = accepted[where] & (~plausible | (16 * between[1] < fine[3]))
    expected = [
        np.where(yields, other, own) for own, other in zip(fine, (shift, np.zeros(shape), *between), strict=True)
    ]
    assert 10 < yields.sum() < 80
    believed = plausible | yields
    compete((*fine, plausible), shift, *known, accepted, halved, 4.0)
    for found, wanted in zip(fine, expected, strict=True):
        np.testing.assert_allclose(found, wanted, atol=1e-6)
    np.testing.assert_array_equal(plausible, believed)


def test_weights_are_inverse_variances_of_what_is_believed() -> None:
    variance = RNG.uniform(0, 3, (6, 7)).astype(np.float32)
    plausible, mask = (RNG.uniform(size=(6, 7)) > 0.3 for _ in range(2))
    expected = mask * (0.02 + plausible) / (np.minimum(variance, 1) + 1e-4)
    np.testing.assert_allclose(smoothing_weights(variance, plausible, mask), expected, rtol=1e-5)
