"""Photographs from files, against arrays written by other hands (OpenCV, Pillow)."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from mammometry.base.errors import ImageError
from mammometry.io.photographs.images import ImageHeader, check_sizes, read_header, read_mask, read_photograph

RGB8 = np.random.default_rng(1).integers(0, 256, (40, 60, 3), dtype=np.uint8)
RGB16 = np.random.default_rng(2).integers(0, 65536, (40, 60, 3), dtype=np.uint16)


@pytest.mark.parametrize("ending", ["png", "tif", "tiff", "PNG"])
@pytest.mark.parametrize("pixels", [RGB8, RGB16, RGB8[..., 0], RGB16[..., 0]], ids=["rgb8", "rgb16", "grey8", "grey16"])
def test_lossless_files_give_the_very_pixels(tmp_path: Path, ending: str, pixels: np.ndarray) -> None:
    path = tmp_path / f"a.{ending}"
    assert cv2.imwrite(str(path), pixels[..., ::-1] if pixels.ndim == 3 else pixels)
    read = read_photograph(path, "a").pixels
    assert read.dtype == pixels.dtype
    np.testing.assert_array_equal(read, pixels)


def test_jpeg_is_read_in_rgb_order(tmp_path: Path) -> None:
    red = np.zeros((32, 32, 3), np.uint8)
    red[..., 0] = 200
    Image.fromarray(red).save(tmp_path / "a.jpg", quality=95)
    mean = read_photograph(tmp_path / "a.jpg", "a").pixels.mean(axis=(0, 1))
    np.testing.assert_allclose(mean, [200, 0, 0], atol=3)  # JPEG's own rounding


@pytest.mark.parametrize("mode", ["RGBA", "LA", "P", "CMYK"])
def test_other_modes_become_grey_or_rgb(tmp_path: Path, mode: str) -> None:
    flat = Image.fromarray(np.full((16, 16, 3), 102, np.uint8)).convert("L" if mode == "LA" else "RGB").convert(mode)
    flat.save(tmp_path / ("a.tif" if mode == "CMYK" else "a.png"))
    (path,) = tmp_path.iterdir()
    pixels = read_photograph(path, "a").pixels
    assert pixels.shape == ((16, 16) if mode == "LA" else (16, 16, 3))
    np.testing.assert_allclose(pixels, 102, atol=2)  # CMYK rounds twice; 102 is in the palette


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_orientation_is_applied_as_pillow_does(tmp_path: Path, orientation: int, dtype: type) -> None:
    pixels = RGB8[..., 0].astype(dtype)
    exif = Image.Exif()
    exif[274] = orientation
    image = Image.fromarray(pixels)
    path = tmp_path / "a.png"
    image.save(path, exif=exif)
    image.getexif()[274] = orientation
    from PIL import ImageOps

    with Image.open(path) as stored:
        upright = np.array(ImageOps.exif_transpose(stored))
    np.testing.assert_array_equal(read_photograph(path, "a").pixels, upright)
    header = read_header(path, "a")
    assert header.orientation == orientation
    assert header.size_wh == upright.shape[::-1]
    assert header.stored_wh == (60, 40)


@pytest.mark.parametrize(("ending", "bits"), [("jpg", 8), ("png", 8), ("png", 16), ("tif", 8), ("tif", 16)])
@pytest.mark.parametrize("keep", [0.0, 0.02, 0.5, 0.9, 0.999])
def test_truncated_files_are_refused(
    tmp_path: Path, ending: str, bits: int, keep: float, capfd: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / f"a.{ending}"
    if ending == "tif":
        import tifffile

        tifffile.imwrite(path, RGB16 if bits == 16 else RGB8)  # directory before the pixels
    else:
        cv2.imwrite(str(path), RGB16 if bits == 16 else RGB8)
    whole = path.read_bytes()
    path.write_bytes(whole[: int(keep * len(whole))])
    with pytest.raises(ImageError, match="capture/front_left") as caught:
        read_photograph(path, "capture/front_left")
    assert "\n" not in str(caught.value)
    assert capfd.readouterr().err == ""  # libpng and libjpeg would talk


@pytest.mark.parametrize("ending", ["jpg", "png", "tif"])
def test_what_is_wrong_with_a_file_is_seen_in_its_bytes_and_not_in_its_name(tmp_path: Path, ending: str) -> None:
    """A decoder's message holds the file's name."""
    path = tmp_path / f"truncated.{ending}"
    path.write_text("not a picture at all")
    with pytest.raises(ImageError) as caught:
        read_photograph(path, "a")
    assert "image" in caught.value.found
    if ending == "tif":
        import tifffile

        tifffile.imwrite(path, RGB8)
    else:
        cv2.imwrite(str(path), RGB8)
    whole = path.read_bytes()
    for keep in (0.5, 0.9):
        path.write_bytes(whole[: int(keep * len(whole))])
        with pytest.raises(ImageError) as caught:
            read_photograph(path, "a")
        assert "truncated" in caught.value.found
    if ending != "tif":  # whose pixels have no checksum
        path.write_bytes(whole[: len(whole) // 2] + bytes(40) + whole[len(whole) // 2 + 40 :])
        with pytest.raises(ImageError) as caught:
            read_photograph(path, "a")
        assert "damaged" in caught.value.found


def test_no_image_and_no_file_are_told_apart(tmp_path: Path) -> None:
    (tmp_path / "a.jpg").write_text("not a picture at all")
    with pytest.raises(ImageError, match=r"^a: .*image"):
        read_photograph(tmp_path / "a.jpg", "a")
    with pytest.raises(ImageError, match=r"^b: (?!.*image)"):
        read_photograph(tmp_path / "b.jpg", "b")


def test_32_bit_images_are_refused(tmp_path: Path) -> None:
    Image.fromarray(np.ones((8, 8), np.float32)).save(tmp_path / "a.tif")
    with pytest.raises(ImageError, match="32 bits"):
        read_photograph(tmp_path / "a.tif", "a")


def header(width: int, height: int, orientation: int = 1) -> ImageHeader:
    return ImageHeader(stored_wh=(width, height), orientation=orientation, bits=8)


@pytest.mark.parametrize(
    "headers",
    [
        [header(60, 40), header(60, 40)],
        [header(60, 40, 6), header(60, 40, 6)],  # a camera that hangs on its side
        [header(60, 40), header(40, 60, 6)],  # turned by software, tagged so that it looks the same
    ],
)
def test_consistent_photographs_pass(headers: list[ImageHeader]) -> None:
    check_sizes({f"{index}.jpg": each for index, each in enumerate(headers)}, "left")


@pytest.mark.parametrize(
    ("headers", "said"),
    [
        ([header(60, 40), header(30, 20)], r"30 × 20 pixels, .*60 × 40 pixels, .*0\.jpg .*left"),
        ([header(60, 40), header(40, 60)], "turned"),
        ([header(60, 40), header(60, 40, 6)], "EXIF orientation 6"),
        ([header(60, 40), header(60, 40, 3)], "EXIF orientation 3, expected 1"),  # upside down: size cannot tell
        ([header(50, 50), header(50, 50, 8)], "EXIF orientation 8, expected 1"),
    ],
)
def test_inconsistent_photographs_are_refused(headers: list[ImageHeader], said: str) -> None:
    with pytest.raises(ImageError, match=said):
        check_sizes({f"{index}.jpg": each for index, each in enumerate(headers)}, "left")


def test_ready_made_cameras_fix_the_size() -> None:
    with pytest.raises(ImageError, match=r"60 × 40 pixels, .*120 × 80 pixels, .*cameras\.json"):
        check_sizes({"0.jpg": header(60, 40)}, "left", (120, 80))


def test_mask_is_the_brighter_half(tmp_path: Path) -> None:
    grey = np.array([[0, 127, 128, 255]], np.uint8)
    Image.fromarray(grey).save(tmp_path / "m.png")
    np.testing.assert_array_equal(read_mask(tmp_path / "m.png", "m"), [[False, False, True, True]])
