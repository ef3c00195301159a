"""Damaged photographs in every format are refused by name, whole ones are read.

A draw of the damages is tried in every run; the slow tests try 20 of each kind in each format, 2,400 in all.
MAMMOMETRY_MUTATIONS_SEED starts from another.
"""

import io
import os
import struct
from pathlib import Path
from random import Random

import numpy as np
import pytest
import tifffile
from PIL import Image
from scipy.fft import idctn
from tests.brought.photograph_damage import DAMAGES, FORMS, HIGH, WIDE, damaged, picture, written

from mammometry.base.errors import ImageError
from mammometry.io.photographs import jpeg_stream
from mammometry.io.photographs.images import read_header, read_photograph
from mammometry.io.photographs.jpeg_stream import check_jpeg
from mammometry.io.photographs.seams import has_seam

SEED = int(os.environ.get("MAMMOMETRY_MUTATIONS_SEED", "55"))
EACH = 20
DRAWN = 40
EVERY = [(form, damage) for form in FORMS for damage in DAMAGES if form not in DAMAGES[damage].unfound]
MOST_CHANGED, LEVELS = 0.05, 20
"""Share of the pixels that damage which is not found may change by so many of 255 grey levels: a row of blocks."""
MOST_UNFOUND = 0.02
"""Share of damages that may change more without being found: bits of brightness at either end of a row of blocks."""


def outcome(form: str, damage: str, number: int, folder: Path) -> str:
    """``found``, ``harmless``, ``changed`` where it may be, or what is wrong."""
    path = folder / "front_left.jpg"
    path.write_bytes(damaged(form, damage, number))
    try:
        pixels = read_photograph(path, "front_left.jpg").pixels
    except ImageError as error:
        said = str(error)
        fits = said.startswith("front_left.jpg: ") and "opy it again from the camera" in said and "\n" not in said
        return "found" if fits else f"{form}, {damage}, {number}: {said}"
    path.write_bytes(written(form, number % 3))
    whole = read_photograph(path, "whole").pixels
    changed = np.abs(pixels.astype(float) - whole) * 255 / np.iinfo(whole.dtype).max > LEVELS
    share = changed.reshape(HIGH, WIDE, -1).any(axis=2).mean()
    if DAMAGES[damage].sometimes:
        return "harmless" if share <= MOST_CHANGED else "changed"
    return f"{form}, {damage}, {number}: not found, {share:.1%} of the pixels changed"


def wrong(tried: list[tuple[str, str, int]], folder: Path) -> str:
    outcomes = [outcome(*each, folder) for each in tried]
    many = outcomes.count("changed") > MOST_UNFOUND * len(tried)
    return "\n".join(each for each in outcomes if each not in ("found", "harmless") and (many or each != "changed"))


@pytest.mark.requirement("R-IN-18")
def test_some_damaged_photographs_are_refused_by_name(tmp_path: Path) -> None:
    pairs = EVERY.copy()
    Random(SEED).shuffle(pairs)
    assert not (said := wrong([(*pair, SEED) for pair in pairs[:DRAWN]], tmp_path)), said


@pytest.mark.slow
@pytest.mark.parametrize("form", FORMS)
@pytest.mark.requirement("R-IN-18")
def test_every_damage_of_every_format_is_found_or_changes_little(tmp_path: Path, form: str) -> None:
    tried = [(form, damage, SEED + number) for kind, damage in EVERY if kind == form for number in range(EACH)]
    assert not (said := wrong(tried, tmp_path)), said


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.requirement("R-IN-18")
def test_what_cameras_add_to_a_file_is_no_damage(tmp_path: Path, form: str) -> None:
    content = written(form, 0)
    additions = [content, content + bytes(513), content + Random(1).randbytes(700)]
    if content.startswith(b"\xff\xd8"):
        scan = content.index(b"\xff\xda")
        thumbnail = b"\xff\xe1" + struct.pack(">H", 2 + 6 + len(written("JPEG", 1)[:9000])) + b"Exif\0\0"
        additions += [
            content[:2] + thumbnail + written("JPEG", 1)[:9000] + content[2:],
            content + written("JPEG", 2),  # a preview behind, as MPF has it
            content[:scan] + b"\xff\xff\xff" + content[scan:],  # bytes that may stand before a marker (T.81, B.1.1.2)
            content[:-2] + b"\xff\xff" + content[-2:],
            content[:-2] + bytes(11) + content[-2:],
        ]
    path = tmp_path / "a.jpg"
    path.write_bytes(content)
    expected = read_photograph(path, "a").pixels
    for number, addition in enumerate(additions):
        path.write_bytes(addition)
        np.testing.assert_array_equal(read_photograph(path, "a").pixels, expected, err_msg=str(number))


@pytest.mark.data
@pytest.mark.requirement("R-IN-18")
def test_no_photograph_of_a_real_camera_is_refused(shared_data: Path) -> None:
    paths = sorted((shared_data / "opencv_samples").rglob("*.jpg"))[::4]
    paths += sorted((shared_data / "multidic").rglob("*.jpg"))[::20]
    paths += sorted((shared_data / "rendered").rglob("capture/*.jpg"))[::10]
    assert len(paths) > 10
    for path in paths:
        assert read_photograph(path, path.name).pixels.size


@pytest.mark.parametrize("progressive", [False, True])
@pytest.mark.parametrize("restarts", [0, 5])
def test_the_walk_reads_the_brightness_that_the_picture_has(progressive: bool, restarts: int) -> None:
    """Against the pixels that libjpeg makes: a block's mean is its DC. One bit further, all that follow are wrong."""
    buffer = io.BytesIO()
    image = Image.fromarray(picture(0)).convert("L")
    image.save(buffer, "JPEG", quality=90, progressive=progressive, restart_marker_blocks=restarts)
    decoder = jpeg_stream._Decoder()
    jpeg_stream._read(np.frombuffer(buffer.getvalue(), dtype=np.uint8), decoder)
    with Image.open(buffer) as decoded:
        step = decoded.quantization[0][0]
        pixels = np.asarray(decoded).astype(float)
    means = pixels.reshape(HIGH // 8, 8, WIDE // 8, 8).mean(axis=(1, 3))
    unit = idctn(np.eye(1, 64).reshape(8, 8), norm="ortho")[0, 0]  # what a DC of 1 adds to each pixel
    dc = decoder.dc.reshape(HIGH // 8, WIDE // 8)
    np.testing.assert_allclose(dc * step * unit + 128, means, atol=0.6)  # rounding of 64 pixels, and clipping


@pytest.mark.parametrize("mode", ["RGB", "L"])
def test_brightness_that_jumps_along_the_blocks_is_a_seam_and_an_edge_is_not(mode: str) -> None:
    image = Image.fromarray(picture(0)).convert(mode)
    buffer = io.BytesIO()
    image.save(buffer, "JPEG", quality=92)
    layout = check_jpeg(buffer.getvalue())
    pixels = np.asarray(image).astype(int)
    wide, high = layout.unit_wh
    row, column = 5 * high, 11 * wide
    shifted = pixels.copy()
    shifted[row : row + high, column:] += 12
    shifted[row + high :] += 12
    edge = pixels.copy()
    edge[row:] += 40
    beside = np.roll(shifted, 3, axis=0)
    assert has_seam(shifted.clip(0, 255).astype(np.uint8), layout)
    for whole in (pixels, edge, beside):
        assert not has_seam(whole.clip(0, 255).astype(np.uint8), layout)


SMALL = picture(1)[::8, ::8].copy()


def pages(path: Path, *each: tuple[np.ndarray, int], subifds: int = 0) -> Path:
    with tifffile.TiffWriter(path) as tiff:
        for number, (pixels, kind) in enumerate(each):
            tiff.write(pixels, photometric="rgb", subfiletype=kind, metadata=None, subifds=0 if number else subifds)
    return path


@pytest.mark.parametrize(
    "order", ["thumbnail first", "thumbnail last", "unmarked", "photograph in a sub-page", "pyramid"]
)
@pytest.mark.requirement("R-IN-18")
def test_of_a_tiff_the_page_at_full_size_is_read(tmp_path: Path, order: str) -> None:
    full, half = picture(0), picture(0)[::2, ::2].copy()
    arranged = {
        "thumbnail first": ([(SMALL, 1), (full, 0)], 0),
        "thumbnail last": ([(full, 0), (SMALL, 1)], 0),
        "unmarked": ([(SMALL, 0), (full, 0)], 0),
        "photograph in a sub-page": ([(SMALL, 1), (full, 0)], 1),
        "pyramid": ([(full, 0), (half, 1), (SMALL, 1)], 2),
    }[order]
    path = pages(tmp_path / "a.tif", *arranged[0], subifds=arranged[1])
    assert read_header(path, "a").stored_wh == (WIDE, HIGH)
    np.testing.assert_array_equal(read_photograph(path, "a").pixels, full)


@pytest.mark.requirement("R-IN-19")
def test_a_raw_picture_is_named_by_its_content(tmp_path: Path) -> None:
    """As DNG and NEF lay them out: a thumbnail, and the sensor's pixels in a sub-page. By the name of a photograph."""
    with tifffile.TiffWriter(tmp_path / "a.tif") as tiff:
        tiff.write(SMALL, photometric="rgb", subfiletype=1, metadata=None, subifds=1)
        tiff.write(picture(0)[..., 0].astype(np.uint16), photometric="cfa", metadata=None)
    with pytest.raises(ImageError, match="DNG"):
        read_header(tmp_path / "a.tif", "a")


@pytest.mark.requirement("R-IN-18")
def test_a_tiff_of_several_photographs_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ImageError, match=r"^a: .*\b2 pages"):
        read_header(pages(tmp_path / "a.tif", (picture(0), 0), (picture(1), 0)), "a")
    with pytest.raises(ImageError, match=r"^b: .*copies"):
        read_header(pages(tmp_path / "b.tif", (SMALL, 1), (SMALL, 1)), "b")
