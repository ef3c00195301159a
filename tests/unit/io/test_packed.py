"""Packed arrays come back with every bit, and lie smaller."""

import zlib
from pathlib import Path

import numpy as np
import pytest

from mammometry.geometry.arrays import Array
from mammometry.geometry.mesh import on_microns
from mammometry.io.results.codecs import packed, read_arrays, unpacked, write_arrays

RNG = np.random.default_rng(6)
N = 20_000
VERTICES = on_microns(np.cumsum(RNG.normal(0, 0.4, (N, 3)), axis=0))
FACES = (np.arange(N)[:, None] + RNG.integers(-40, 40, (N, 3))).clip(0, N - 1).astype(np.int32)


@pytest.mark.parametrize("array", [VERTICES, FACES, FACES[:, 0].copy(), np.zeros((5000, 0, 2), np.int32)])
def test_what_is_written_is_read(tmp_path: Path, array: Array) -> None:
    write_arrays(tmp_path / "a.npz", {"a": array, "b": np.arange(3)})
    read = read_arrays(tmp_path / "a.npz")["a"]
    assert (read.dtype, read.shape) == (array.dtype, array.shape)
    assert read.tobytes() == array.tobytes()


@pytest.mark.parametrize("array", [VERTICES, FACES])
def test_meshes_take_two_thirds_at_most(array: Array) -> None:
    found = packed(array)
    assert found is not None
    assert len(zlib.compress(found[0], 1)) < 2 / 3 * len(zlib.compress(array, 1))
    assert unpacked(*found).tobytes() == array.tobytes()


def other(change: str) -> Array:
    """An array that would not come back."""
    array = VERTICES.copy()
    array[77, 1] = {"between": 0.3, "signed zero": -0.0, "nan": np.nan, "infinite": np.inf, "far": 2.0**40}[change]
    return array


@pytest.mark.parametrize("change", ["between", "signed zero", "nan", "infinite", "far"])
def test_what_would_change_stays_as_it_is(tmp_path: Path, change: str) -> None:
    array = other(change)
    assert packed(array) is None
    write_arrays(tmp_path / "a.npz", {"a": array})
    assert read_arrays(tmp_path / "a.npz")["a"].tobytes() == array.tobytes()


def test_the_largest_whole_numbers_come_back() -> None:
    array = np.resize(np.array([2**30 - 1, -(2**30) + 1], np.int32), 5000)
    found = packed(array)
    assert found is not None
    np.testing.assert_array_equal(unpacked(*found), array)


def test_other_files_of_earlier_versions_are_read(tmp_path: Path) -> None:
    """Without the member ``packed``."""
    np.savez(tmp_path / "a.npz", tree=np.frombuffer(b'{"$array": "a0"}', np.uint8), a0=VERTICES)
    np.testing.assert_array_equal(read_arrays(tmp_path / "a.npz"), VERTICES)
