"""Photographs and masks that are none, or that would cost more than they show."""

import io
import os
import re
import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import tifffile
from PIL import EpsImagePlugin, Image

import mammometry as mm
from mammometry.base.errors import ImageError, SettingsError
from mammometry.base.parse import LimitSettings
from mammometry.io.photographs.images import read_header, read_mask, read_photograph
from mammometry.io.session import Session
from mammometry.settings import Settings

GREY = Image.fromarray(np.full((20, 30), 128, np.uint8))
EPS = b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 10 10\n%%EndComments\nshowpage\n%%EOF\n"


def encoded(form: str) -> bytes:
    buffer = io.BytesIO()
    GREY.save(buffer, form)
    return buffer.getvalue()


def bomb(width: int, height: int) -> bytes:
    """A PNG of nothing, a thousandth of its pixels' size."""

    def chunk(kind: bytes, content: bytes) -> bytes:
        return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))

    packer = zlib.compressobj(9)
    rows = b"".join(packer.compress(bytes(1 + width // 8)) for _ in range(height)) + packer.flush()
    header = struct.pack(">IIBBBBB", width, height, 1, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", rows) + chunk(b"IEND", b"")


@pytest.mark.parametrize("name", ["a.jpg", "a.png", "a.tif"])
@pytest.mark.parametrize(
    "content", [EPS, *map(encoded, ("GIF", "BMP", "WEBP", "PPM", "JPEG2000", "PCX", "TGA", "ICO"))]
)
@pytest.mark.requirement("R-IN-6")
def test_other_formats_are_not_even_tried(
    tmp_path: Path, name: str, content: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(EpsImagePlugin, "Ghostscript", lambda *_, **__: pytest.fail("Ghostscript was started"))
    (tmp_path / name).write_bytes(content)
    for read in (read_header, read_photograph, read_mask):
        with pytest.raises(ImageError, match=r"image|GIF|BMP|WebP"):
            read(tmp_path / name, name)


def test_the_content_tells_the_format_and_not_the_name(tmp_path: Path) -> None:
    (tmp_path / "a.jpg").write_bytes(encoded("PNG"))
    np.testing.assert_array_equal(read_photograph(tmp_path / "a.jpg", "a").pixels, np.asarray(GREY))


def test_of_a_camera_file_with_several_pictures_the_first_is_taken(tmp_path: Path) -> None:
    GREY.save(tmp_path / "a.jpg", "MPO", save_all=True, append_images=[Image.new("L", (15, 10))])
    with Image.open(tmp_path / "a.jpg") as opened:
        assert opened.format == "MPO"
    assert read_photograph(tmp_path / "a.jpg", "a").size_wh == (30, 20)


@pytest.mark.slow
@pytest.mark.requirement("R-IN-7")
def test_too_many_pixels_are_refused_by_the_header(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "a.png").write_bytes(bomb(30_000, 30_000))
    assert (tmp_path / "a.png").stat().st_size < 200_000
    monkeypatch.setattr(Image.Image, "load", lambda _: pytest.fail("pixels were decoded"))
    for read in (read_header, read_photograph, read_mask):
        with pytest.raises(ImageError, match=r"30000 × 30000 pixels, 900 megapixels, .*\b200\b"):
            read(tmp_path / "a.png", "a")


@pytest.mark.parametrize("behind", [False, True])
def test_a_pngs_orientation_is_found_before_and_behind_its_pixels(tmp_path: Path, behind: bool) -> None:
    exif = Image.Exif()
    exif[274] = 6
    tags = exif.tobytes().removeprefix(b"Exif\x00\x00")
    chunk = struct.pack(">I", len(tags)) + b"eXIf" + tags + struct.pack(">I", zlib.crc32(b"eXIf" + tags))
    start, end = encoded("PNG")[:33], encoded("PNG")[33:]
    content = start + end[:-12] + chunk + end[-12:] if behind else start + chunk + end
    (tmp_path / "a.png").write_bytes(content)
    assert read_header(tmp_path / "a.png", "a").orientation == 6


def test_the_limit_is_a_setting(tmp_path: Path) -> None:
    GREY.save(tmp_path / "a.png")
    settings = Settings().overridden(["limits.megapixels=0.0005"])
    with pytest.raises(ImageError, match=r"30 × 20 pixels, 0 megapixels, .*0\.0005"):
        read_header(tmp_path / "a.png", "a", settings.limits)
    assert Settings.from_toml(settings.to_toml()) == settings
    for unfit in ("0", "1001", "nan"):
        with pytest.raises(SettingsError, match=r"limits\.megapixels"):
            Settings().overridden([f"limits.megapixels={unfit}"])


MANIFEST = """\
format = 1
units = "mm"
rig = { name = "two", pairs = [{ name = "front", left = "l", right = "r" }] }
target = { kind = "chessboard", squares = [5, 4], square_mm = 25.0 }
subject = { kind = "model" }
"""


@pytest.fixture
def session(tmp_path: Path) -> Path:
    for place in ("capture", "masks", "calibration/00"):
        (tmp_path / place).mkdir(parents=True)
    for camera in ("l", "r"):
        GREY.save(tmp_path / "capture" / f"{camera}.png")
    (tmp_path / "session.toml").write_text(MANIFEST)
    return tmp_path


def test_a_job_hands_its_limit_on(session: Path) -> None:
    mm.open_session(session)
    with pytest.raises(ImageError, match=r"capture/l\.png: found 30 × 20 pixels"):
        mm.open_session(session, Settings(limits=LimitSettings(megapixels=1e-4)))


@pytest.mark.requirement("R-IN-7")
def test_a_masks_size_is_compared_before_it_is_decoded(session: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (session / "masks" / "l.png").write_bytes(bomb(8_000, 8_000))
    masks = Session.open(session).inputs().masks
    monkeypatch.setattr(Image.Image, "load", lambda _: pytest.fail("pixels were decoded"))
    with pytest.raises(ImageError, match=r"8000 × 8000 pixels, .*30 × 20 pixels"):
        masks["l"]


def test_pipes_and_folders_do_not_hang(session: Path) -> None:
    os.mkfifo(session / "pipe.jpg")
    (session / "folder.jpg").mkdir()
    for name, said in (("pipe.jpg", "a pipe or a device"), ("folder.jpg", "a folder"), ("none.jpg", "no file")):
        with pytest.raises(ImageError, match=said):
            read_photograph(session / name, name)


def tiff(change: Callable[[bytearray], None], bits: int) -> bytes:
    buffer = io.BytesIO()
    tifffile.imwrite(buffer, np.full((20, 30), 128, np.uint8 if bits == 8 else np.uint16), metadata=None)
    content = bytearray(buffer.getvalue())
    change(content)
    return bytes(content)


def tag(code: int, kind: int, count: int, value: int) -> Callable[[bytearray], None]:
    """Overwrite a tag of a little-endian TIFF."""

    def change(content: bytearray) -> None:
        (directory,) = struct.unpack_from("<I", content, 4)
        (entries,) = struct.unpack_from("<H", content, directory)
        for place in range(directory + 2, directory + 2 + 12 * entries, 12):
            if struct.unpack_from("<H", content, place)[0] == code:
                struct.pack_into("<HHII", content, place, code, kind, count, value)

    return change


@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize(
    "change",
    [
        tag(273, 2, 4, 0x41414141),  # offsets that are text
        tag(273, 12, 1, 8),  # that are a double
        tag(273, 5, 1, 8),  # a fraction
        tag(273, 4, 0, 0),  # none
        tag(273, 4, 50, 8),  # more than there are lengths
        tag(273, 4, 1, 0xFFFFFFFF),
        tag(279, 2, 4, 0x41414141),
        tag(279, 4, 1, 0xFFFFFFFF),
        tag(258, 2, 4, 0x41414141),
        tag(258, 5, 1, 8),
        tag(256, 4, 1, 0),
        tag(277, 3, 1, 60_000),
        tag(259, 3, 1, 65_000),
        tag(262, 3, 1, 65_000),
    ],
)
def test_damaged_tags_of_a_tiff_are_one_sentence(
    tmp_path: Path, change: Callable[[bytearray], None], bits: int, recwarn: pytest.WarningsRecorder
) -> None:
    (tmp_path / "a.tif").write_bytes(tiff(change, bits))
    with pytest.raises(ImageError, match=r"^a: found") as caught:
        read_photograph(tmp_path / "a.tif", "a")
    assert "\n" not in str(caught.value)


@pytest.mark.filterwarnings("ignore")  # as at the command line, where Pillow only warns of strange tags
@pytest.mark.parametrize("form", ["JPEG", "PNG", "TIFF", "16"])
def test_whatever_bytes_change_it_is_a_photograph_or_one_sentence(tmp_path: Path, form: str) -> None:
    whole = tiff(lambda _: None, 16) if form == "16" else encoded(form)
    random = np.random.default_rng(5)
    read = 0
    for _ in range(60):
        content = bytearray(whole)
        for place in random.integers(8, min(len(content), 400), random.integers(1, 6)):
            content[place] = random.integers(0, 256)
        (tmp_path / "a.jpg").write_bytes(content)
        try:
            assert read_photograph(tmp_path / "a.jpg", "a").pixels.size
            read += 1
        except ImageError as error:
            assert re.fullmatch(r"a: found [^\n]+", str(error))  # noqa: PT017
    assert read < 60
