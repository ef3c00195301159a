"""HEIC photographs of telephones.

`tests/data/colours.heic` has 75 × 47 pixels: red = 3 × column, green = 5 × row, blue = 128; compressed at quality 90.
"""

from pathlib import Path

import numpy as np
import pytest

from mammometry.api.walk_pictures import walk_files
from mammometry.base.errors import ImageError
from mammometry.base.parse import LimitSettings
from mammometry.io.photographs.heic import is_heic, read_heic

COLOURS = Path(__file__).parents[2] / "data" / "colours.heic"


def test_pixels_are_where_they_were() -> None:
    pixels = read_heic(COLOURS, "colours").pixels
    row, column = np.mgrid[:47, :75]
    expected = np.stack([3 * column, 5 * row, np.full_like(row, 128)], axis=-1)
    assert pixels.dtype == np.uint8
    assert pixels.shape == expected.shape
    assert np.abs(pixels - expected.astype(np.float64)).mean() < 2
    others = [read_heic(COLOURS, "again").pixels for _ in range(20)]  # the decoder's memory is used again
    assert all(np.array_equal(pixels, other) for other in others)


def test_a_walk_has_them_and_a_file_is_known_by_its_content(tmp_path: Path) -> None:
    (tmp_path / "IMG_1.HEIC").write_bytes(COLOURS.read_bytes())
    (tmp_path / "IMG_2.heic").write_bytes(b"\xff\xd8\xff\xe0" + bytes(20))
    assert [path.name for path in walk_files(tmp_path).values()] == ["IMG_1.HEIC", "IMG_2.heic"]
    assert [is_heic(path) for path in walk_files(tmp_path).values()] == [True, False]


@pytest.mark.parametrize("kept", [0.3, 0.6, 0.95])
def test_a_truncated_one_is_refused(tmp_path: Path, kept: float) -> None:
    content = COLOURS.read_bytes()
    (tmp_path / "cut.heic").write_bytes(content[: int(kept * len(content))])
    with pytest.raises(ImageError):
        read_heic(tmp_path / "cut.heic", "cut")


def test_one_that_is_too_large_is_refused() -> None:
    with pytest.raises(ImageError):
        read_heic(COLOURS, "colours", LimitSettings(megapixels=0.001))
