"""JPEG files without their tags: the picture stays as it was coded."""

import io

import numpy as np
import pytest
from PIL import Image

from mammometry.io.photographs.tags import without_tags


def coded(mode: str = "RGB", **how: object) -> bytes:
    values = np.random.default_rng(1).integers(0, 255, (9, 14, 3), dtype=np.uint8)
    tags = Image.Exif()
    tags[0x010E] = "Zypernkatze"
    buffer = io.BytesIO()
    Image.fromarray(values).convert(mode).save(buffer, "JPEG", exif=tags, comment="Quirina", **how)  # type: ignore[arg-type]
    return buffer.getvalue()


@pytest.mark.parametrize("mode", ["RGB", "L"])
@pytest.mark.parametrize("progressive", [False, True])
def test_the_pixels_stay_and_the_tags_go(mode: str, progressive: bool) -> None:
    given = coded(mode, progressive=progressive)
    found = without_tags(given)
    assert found is not None
    assert (found.size_wh, found.components, found.baseline) == ((14, 9), 1 if mode == "L" else 3, not progressive)
    with Image.open(io.BytesIO(given)) as before, Image.open(io.BytesIO(found.content)) as after:
        assert before.getexif()
        assert not after.getexif()
        assert np.array_equal(np.asarray(before), np.asarray(after))
    assert b"Zypernkatze" not in found.content
    assert b"Quirina" not in found.content


def test_of_several_pictures_the_first_is_kept() -> None:
    given = coded()
    alone = without_tags(given)
    assert alone is not None
    assert without_tags(given + coded("L")) == alone


@pytest.mark.parametrize("cut", [0, 2, 3, 10, 200, -2])
def test_a_file_cut_short_is_none(cut: int) -> None:
    assert without_tags(coded()[:cut]) is None


def test_inks_and_other_files_are_none() -> None:
    assert without_tags(coded("CMYK")) is None
    assert without_tags(b"\x89PNG" + bytes(100)) is None
