import numpy as np
import pytest

from mammometry.matching.pyramid import BINOMIAL, HALF_BAND, build, coarser, finer_field, finer_mask


@pytest.mark.parametrize("shape", [(40, 52), (41, 53)], ids=["even", "odd"])
def test_levels_keep_positions(shape: tuple[int, int]) -> None:
    """A ramp keeps its value at every point: u lies at (u + .5)/2 − .5 on the next level."""
    v, u = np.mgrid[: shape[0], : shape[1]].astype(np.float32)
    levels = build((3 * u + 2 * v).astype(np.float32), np.ones(shape, dtype=bool), 0, 2)
    for index, level in enumerate(levels):
        rows, columns = np.mgrid[: level.image.shape[0], : level.image.shape[1]].astype(np.float64)
        for _ in range(index):
            rows, columns = 2 * rows + 0.5, 2 * columns + 0.5
        inner = (slice(4, -4), slice(4, -4)) if index < 2 else (slice(4, -5), slice(4, -5))
        np.testing.assert_allclose(level.image[inner], (3 * columns + 2 * rows)[inner], rtol=2e-5)
    assert coarser(np.array([0.5]))[0] == 0.0


def test_the_finest_step_keeps_a_tenth_of_a_cycle_and_drops_what_would_alias() -> None:
    frequency = np.fft.rfftfreq(1024)
    response = np.abs(np.fft.rfft(HALF_BAND, 1024))
    assert response[frequency < 0.1].min() > 0.99
    assert response[frequency > 0.4].max() < 0.02
    assert HALF_BAND.sum() == pytest.approx(1) == BINOMIAL.sum()


def test_the_backdrop_does_not_leak_into_the_subject() -> None:
    mask = np.hypot(*(np.mgrid[:64, :64] - 31.5)) < 20
    levels = build(np.where(mask, 0.6, 0.02).astype(np.float32), mask, 0, 2)
    for level in levels:
        np.testing.assert_allclose(level.image[level.mask], 0.6, atol=2e-3)


def test_fields_and_masks_on_the_finer_level() -> None:
    v, u = np.mgrid[:9, :12].astype(np.float32)
    fine = finer_field(2 * u - v, (17, 24))
    rows, columns = np.mgrid[:17, :24]
    expected = 2 * coarser(columns.astype(np.float64)) - coarser(rows.astype(np.float64))
    np.testing.assert_allclose(fine[1:-1, 1:-1], expected[1:-1, 1:-1], atol=1e-5)
    mask = np.zeros((9, 12), dtype=bool)
    mask[2, 3] = True
    assert set(zip(*np.nonzero(finer_mask(mask, (17, 24))), strict=True)) == {(4, 6), (4, 7), (5, 6), (5, 7)}
