"""One picture in every coding that cameras and programs write, read back as the same pixels."""

import os
import subprocess
import sys
from itertools import product
from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile
from PIL import Image, ImageOps

from mammometry.base.errors import ImageError
from mammometry.io.photographs.images import read_header, read_photograph

WIDE, HIGH = 37, 21
"""Odd and unlike, so that no turn or plane is taken for another."""


def scene(bits: int, samples: int) -> np.ndarray:
    """Smooth pixels (h, w) or (h, w, samples), so that a JPEG keeps them; each corner and channel differs."""
    row, column = np.mgrid[0:HIGH, 0:WIDE] / (HIGH, WIDE)[0]
    channels = [0.1 + 0.3 * row + 0.35 * column / 1.8 + 0.05 * channel for channel in range(samples)]
    pixels = np.rint(np.stack(channels, axis=-1) * (2**bits - 1)).astype(np.uint8 if bits == 8 else np.uint16)
    return pixels[..., 0] if samples == 1 else pixels


def upright(pixels: np.ndarray, orientation: int) -> np.ndarray:
    """The pixels turned by Pillow, which is not what reads them: by the place of each pixel."""
    place = Image.fromarray(np.arange(HIGH * WIDE, dtype=np.int32).reshape(HIGH, WIDE))
    place.getexif()[274] = orientation
    turned = np.asarray(ImageOps.exif_transpose(place))
    return pixels.reshape(HIGH * WIDE, -1)[turned].reshape(*turned.shape, *pixels.shape[2:])


def oriented(orientation: int) -> list[tuple[int, str, int, int, bool]]:
    return [(274, "H", 1, orientation, True)]


TIFF_WAYS = {
    "plain": {},
    "planar": {"planarconfig": "separate"},
    "tiled": {"tile": (16, 16)},
    "planar tiled": {"planarconfig": "separate", "tile": (16, 16)},
    "deflate": {"compression": "zlib", "predictor": True},
    "lzw": {"compression": "lzw"},
    "packbits": {"compression": "packbits"},
    "big-endian": {"byteorder": ">"},
    "bigtiff": {"bigtiff": True},
    "one strip a row": {"rowsperstrip": 1},
}
TIFF_KINDS = {
    "grey": (1, "minisblack", ()),
    "min-is-white": (1, "miniswhite", ()),
    "rgb": (3, "rgb", ()),
    "rgba": (4, "rgb", ("unassalpha",)),
    "cmyk": (4, "separated", ()),
}


def expected_of(kind: str, pixels: np.ndarray) -> np.ndarray:
    """What the coded pixels show."""
    white = np.iinfo(pixels.dtype).max
    if kind == "min-is-white":
        return white - pixels
    if kind == "cmyk":  # light that the inks leave: each of three, then black
        left = 1.0 - pixels / white
        return np.rint(left[..., :3] * left[..., 3:] * white).astype(pixels.dtype)
    return pixels[..., :3] if kind == "rgba" else pixels


EVERY_TIFF = [
    *((*each, 1 + number % 8) for number, each in enumerate(product(TIFF_KINDS, (8, 16)))),
    *(("rgb", 16, orientation) for orientation in range(1, 9) if orientation != 6),  # that is among them
]
"""Each kind and depth, each orientation."""


@pytest.mark.parametrize(("kind", "bits", "orientation"), EVERY_TIFF)
def test_every_tiff_shows_the_same_picture(tmp_path: Path, kind: str, bits: int, orientation: int) -> None:
    samples, photometric, extra = TIFF_KINDS[kind]
    pixels = scene(bits, samples)
    expected = upright(expected_of(kind, pixels), orientation)
    for way, options in TIFF_WAYS.items():
        if samples == 1 and "planar" in way:
            continue
        kept = dict(options)
        coded = np.moveaxis(pixels, -1, 0) if "planar" in way else pixels
        file = {name: kept.pop(name) for name in ("byteorder", "bigtiff") if name in kept}
        with tifffile.TiffWriter(tmp_path / "a.tif", **file) as tiff:
            tiff.write(coded, photometric=photometric, extrasamples=extra or None, metadata=None,
                       extratags=oriented(orientation), **kept)  # fmt: skip
        header = read_header(tmp_path / "a.tif", "a")
        assert header.stored_wh == (WIDE, HIGH), way
        assert header.orientation == orientation, way
        assert header.bits == bits, way
        read = read_photograph(tmp_path / "a.tif", "a").pixels
        assert read.dtype == pixels.dtype, way
        np.testing.assert_allclose(read.astype(int), expected, atol=1 if kind == "cmyk" else 0, err_msg=way)


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("mode", ["L", "RGB", "RGBA", "LA", "P"])
def test_every_8_bit_png_shows_the_same_picture(tmp_path: Path, mode: str, orientation: int) -> None:
    image = Image.fromarray(scene(8, 1 if mode in ("L", "LA") else 3)).convert(mode)
    exif = Image.Exif()
    exif[274] = orientation
    image.save(tmp_path / "a.png", exif=exif)
    shown = np.asarray(image.convert("L" if mode in ("L", "LA") else "RGB"))
    np.testing.assert_array_equal(read_photograph(tmp_path / "a.png", "a").pixels, upright(shown, orientation))


@pytest.mark.parametrize("samples", [1, 3, 4])
def test_every_16_bit_png_shows_the_same_picture(tmp_path: Path, samples: int) -> None:
    pixels = scene(16, samples)
    order = [2, 1, 0, 3][:samples]  # OpenCV's
    cv2.imwrite(str(tmp_path / "a.png"), pixels if samples == 1 else pixels[..., order])
    shown = pixels[..., :3] if samples == 4 else pixels
    np.testing.assert_array_equal(read_photograph(tmp_path / "a.png", "a").pixels, shown)


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("mode", ["L", "RGB", "CMYK"])
@pytest.mark.parametrize("progressive", [False, True])
def test_every_jpeg_shows_the_same_picture(tmp_path: Path, mode: str, orientation: int, progressive: bool) -> None:
    image = Image.fromarray(scene(8, 1 if mode == "L" else 3)).convert(mode)
    exif = Image.Exif()
    exif[274] = orientation
    image.save(tmp_path / "a.jpg", quality=98, subsampling=0, exif=exif, progressive=progressive)
    shown = np.asarray(image.convert("L" if mode == "L" else "RGB"))
    read = read_photograph(tmp_path / "a.jpg", "a").pixels
    np.testing.assert_allclose(read.astype(int), upright(shown, orientation), atol=4)  # JPEG's own rounding


@pytest.mark.parametrize("photometric", ["rgb", "ycbcr"])
def test_a_jpeg_within_a_tiff_is_read_as_rgb(tmp_path: Path, photometric: str) -> None:
    pixels = scene(8, 3)
    quality = {"compression": "jpeg", "compressionargs": {"level": 98}}
    tifffile.imwrite(tmp_path / "a.tif", pixels, photometric=photometric, **quality)
    read = read_photograph(tmp_path / "a.tif", "a").pixels
    with Image.open(tmp_path / "a.tif") as image:
        np.testing.assert_allclose(read.astype(int), np.asarray(image), atol=1)  # of two JPEG libraries


def test_a_palette_within_a_tiff_is_read_as_rgb(tmp_path: Path) -> None:
    image = Image.fromarray(scene(8, 3)).convert("P", palette=Image.Palette.ADAPTIVE)
    image.save(tmp_path / "a.tif")
    np.testing.assert_array_equal(read_photograph(tmp_path / "a.tif", "a").pixels, np.asarray(image.convert("RGB")))


@pytest.mark.parametrize(
    ("pixels", "options", "said"),
    [
        (scene(8, 3), {"photometric": "cielab"}, "CIELAB"),
        (scene(16, 1).astype(np.int16), {}, "integers"),
        (scene(16, 1).astype(np.float16), {}, "integers"),
        (scene(8, 1)[None].repeat(3, axis=0), {"volumetric": True, "photometric": "minisblack"}, "3 layers"),
    ],
)
def test_a_tiff_that_is_no_photograph_is_refused_by_its_cause(
    tmp_path: Path, pixels: np.ndarray, options: dict[str, object], said: str, capfd: pytest.CaptureFixture[str]
) -> None:
    tifffile.imwrite(tmp_path / "a.tif", pixels, **options)
    with pytest.raises(ImageError, match=said):
        read_photograph(tmp_path / "a.tif", "a")
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize("ending", ["png", "tif"])
@pytest.mark.parametrize(("bits", "factor"), [(10, 64), (12, 16), (14, None), (16, None)])
def test_a_sensors_bits_in_the_lower_part_of_sixteen_are_named(
    tmp_path: Path, ending: str, bits: int, factor: int | None
) -> None:
    cv2.imwrite(str(tmp_path / f"a.{ending}"), scene(16, 1) >> (16 - bits))
    if factor is None:
        assert read_photograph(tmp_path / f"a.{ending}", "a").pixels.dtype == np.uint16
        return
    with pytest.raises(ImageError, match=rf"{bits} bits .*\b{factor}\b"):
        read_photograph(tmp_path / f"a.{ending}", "a")


@pytest.mark.slow
@pytest.mark.parametrize("folder", [b"caf\xe9", b"\xff\xfe", "七乳".encode(), b"a b\nc"], ids=ascii)
@pytest.mark.parametrize(("bits", "ending"), list(product((8, 16), ("png", "tif", "jpg"))))
def test_a_folder_may_have_any_name(tmp_path: Path, folder: bytes, bits: int, ending: str) -> None:
    if (bits, ending) == (16, "jpg"):
        return
    place = Path(os.fsdecode(os.path.join(os.fsencode(tmp_path), folder)))
    place.mkdir()
    cv2.imwrite(str(tmp_path / f"a.{ending}"), scene(bits, 1))
    (tmp_path / f"a.{ending}").rename(place / f"a.{ending}")
    read = subprocess.run(  # a segmentation fault would end the tests
        [sys.executable, "-c", "import sys, pathlib; from mammometry.io.photographs.images import read_photograph;"
         "print(read_photograph(pathlib.Path(sys.argv[1]), 'a').pixels.shape)", place / f"a.{ending}"],
        capture_output=True, text=True, check=False,
    ) if bits == 16 and ending == "png" else None  # fmt: skip
    if read is not None:
        assert read.stdout.strip() == f"({HIGH}, {WIDE})", read.stderr
    else:
        assert read_photograph(place / f"a.{ending}", "a").pixels.shape == (HIGH, WIDE)
