"""MAT-files as SciPy writes and reads them, which is not what reads them here."""

import contextlib
import io
import struct
import zlib
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from scipy.io import loadmat, savemat

from mammometry.io.cameras import matlab
from mammometry.io.cameras.matlab import read_variables

NUMBERS = arrays.arrays(
    st.sampled_from([np.float64, np.float32, np.int8, np.uint8, np.int16, np.uint16, np.int32, np.uint32]),
    arrays.array_shapes(max_dims=3, max_side=4),
)
TEXTS = st.text(st.characters(min_codepoint=32, max_codepoint=0x2FFF, exclude_categories=("Cs",)), min_size=1)
NAMES = st.text(st.sampled_from("abcdefgKRT"), min_size=1, max_size=20)
VALUES = st.recursive(
    NUMBERS | TEXTS, lambda inner: st.dictionaries(NAMES, inner, min_size=1, max_size=3), max_leaves=6
)


def saved(variables: dict[str, Any], *, packed: bool = False) -> bytes:
    buffer = io.BytesIO()
    savemat(buffer, variables, do_compression=packed, long_field_names=True)
    return buffer.getvalue()


def require_same(ours: Any, theirs: Any) -> None:
    if isinstance(theirs, dict):
        assert list(ours) == list(theirs)
        for name in theirs:
            require_same(ours[name], theirs[name])
    elif isinstance(theirs, str):
        assert ours.rstrip(" ") == theirs.rstrip(" ")
    else:
        np.testing.assert_array_equal(np.squeeze(ours), np.squeeze(theirs))


@pytest.mark.slow
@given(st.dictionaries(NAMES, VALUES, min_size=1, max_size=3), st.booleans())
@settings(max_examples=40, deadline=None)
def test_what_scipy_writes_is_read_as_scipy_reads_it(variables: dict[str, Any], packed: bool) -> None:
    content = saved(variables, packed=packed)
    theirs = loadmat(io.BytesIO(content), simplify_cells=True)
    ours = read_variables(content)
    assert set(ours) == {name for name in theirs if not name.startswith("__")}
    for name, value in ours.items():
        require_same(value, theirs[name])


@pytest.mark.slow
@given(st.data())
@settings(max_examples=300, deadline=None)
def test_a_damaged_file_is_refused_or_read(data: st.DataObject) -> None:
    """SciPy's reader ends the process at some of these."""
    content = bytearray(saved({"s": {"K": np.eye(3), "unit": "mm", "size": [3, 4], "n": {"a": 1}}}))
    for _ in range(data.draw(st.integers(1, 3))):
        place = data.draw(st.integers(0, len(content) - 1))
        content[place : place + 4] = data.draw(st.binary(min_size=0, max_size=8))
    with contextlib.suppress(ValueError):  # nothing else
        read_variables(bytes(content))


def test_a_variable_that_unpacks_to_more_than_is_allowed_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(matlab, "_MOST_BYTES", 2 << 20)
    packed = zlib.compress(bytes(3 << 20))
    head = b"MATLAB 5.0 MAT-file".ljust(124) + struct.pack("<HH", 0x0100, 0x4D49)
    with pytest.raises(ValueError, match=r"\b2 MiB"):
        read_variables(head + struct.pack("<II", 15, len(packed)) + packed)


def test_variables_that_lie_within_one_another_without_end_are_refused() -> None:
    value: Any = 1.0
    for _ in range(40):
        value = {"a": value}
    with pytest.raises(ValueError, match=r"\b32\b"):
        read_variables(saved({"s": value}))
