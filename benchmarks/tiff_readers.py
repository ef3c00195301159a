"""Which programs read the results' TIFFs right, bit by bit.

    pip install imageio scikit-image rasterio jpype1
    apt install gdal-bin imagej
    python -m benchmarks.tiff_readers SESSION

Every page of every TIFF in SESSION/results is read by our own reader and by each program that is there, and compared.
ImageJ is looked for in /usr/share/java/ij.jar. It gets a page by itself, as float32 pages and masks stand
in one file and its reader takes all pages for what the first one is.
"""

from __future__ import annotations

import argparse
import importlib
import importlib.util
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from mammometry.io.results.codecs import to_tree
from mammometry.io.results.formats import read_raster

_IMAGEJ = Path("/usr/share/java/ij.jar")
Pages = list[np.ndarray[Any, Any]]


def ours(path: Path) -> Pages:
    """All pages as `write_raster` was given them."""
    arrays: dict[str, np.ndarray[Any, Any]] = {}
    to_tree(read_raster(path), arrays)
    return [array for array in arrays.values() if array.ndim == 2 and array.dtype in (np.float32, np.bool_)]


def with_tifffile(path: Path, count: int) -> Iterator[Any]:
    """Tifffile."""
    import tifffile

    with tifffile.TiffFile(path) as tiff:
        yield from (page.asarray() for page in tiff.pages)


def with_opencv(path: Path, count: int) -> Iterator[Any]:
    """OpenCV."""
    import cv2

    yield from cv2.imreadmulti(str(path), flags=cv2.IMREAD_UNCHANGED)[1]


def with_pillow(path: Path, count: int) -> Iterator[Any]:
    """Pillow."""
    from PIL import Image

    with Image.open(path) as image:
        for number in range(count):
            image.seek(number)
            yield np.array(image)


def with_imageio(path: Path, count: int) -> Iterator[Any]:
    """Imageio, by the reader that it chooses."""
    read = importlib.import_module("imageio.v3").imread
    yield from (read(path, page=number) for number in range(count))


def with_skimage(path: Path, count: int) -> Iterator[Any]:
    """scikit-image."""
    read = importlib.import_module("skimage.io").imread
    yield from (read(path, key=number) for number in range(count))


def with_rasterio(path: Path, count: int) -> Iterator[Any]:
    """GDAL, by rasterio."""
    rasterio = importlib.import_module("rasterio")
    for number in range(count):
        with rasterio.open(f"GTIFF_DIR:{number + 1}:{path}") as page:
            yield page.read(1)


def with_gdal(path: Path, count: int) -> Iterator[Any]:
    """GDAL's own command."""
    with tempfile.TemporaryDirectory() as scratch:
        for number in range(count):
            out = Path(scratch) / f"{number}.raw"
            subprocess.run(
                ["gdal_translate", "-q", "-of", "ENVI", f"GTIFF_DIR:{number + 1}:{path}", str(out)],
                check=True,
                capture_output=True,
            )
            told = dict(
                line.split(" = ", 1) for line in out.with_suffix(".hdr").read_text().splitlines() if " = " in line
            )
            told = {name.strip(): value.strip() for name, value in told.items()}
            kind = {"1": np.uint8, "4": np.float32}[told["data type"]]
            yield np.fromfile(out, dtype=kind).reshape(int(told["lines"]), int(told["samples"]))


def with_imagej(path: Path, count: int) -> Iterator[Any]:
    """ImageJ's reader of TIFF."""
    jpype = importlib.import_module("jpype")
    if not jpype.isJVMStarted():
        jpype.startJVM("-Djava.awt.headless=true", classpath=[str(_IMAGEJ)])
    opener, decoder = jpype.JClass("ij.io.FileOpener"), jpype.JClass("ij.io.TiffDecoder")
    for each in decoder(f"{path.parent}/", path.name).getTiffInfo():
        image = opener(each).openImage()
        found = np.array(image.getProcessor().getPixels()).reshape(image.getHeight(), image.getWidth())
        yield found.view(np.uint8) if found.dtype == np.int8 else found


READERS: dict[str, Callable[[Path, int], Iterator[Any]]] = {
    "tifffile": with_tifffile,
    "OpenCV": with_opencv,
    "Pillow": with_pillow,
    "imageio": with_imageio,
    "scikit-image": with_skimage,
    "rasterio": with_rasterio,
    "gdal_translate": with_gdal,
    "ImageJ": with_imagej,
}
_NEEDS = {"imageio": "imageio", "scikit-image": "skimage", "rasterio": "rasterio", "ImageJ": "jpype"}


def is_there(reader: str) -> bool:
    """Whether a program is installed."""
    if reader == "gdal_translate":
        return shutil.which(reader) is not None
    if reader == "ImageJ" and not _IMAGEJ.is_file():
        return False
    return reader not in _NEEDS or importlib.util.find_spec(_NEEDS[reader]) is not None


def judged(read: Callable[[Path, int], Iterator[Any]], files: list[Path]) -> dict[str, list[int]]:
    """Pages with values, and masks: how many are right, how many were refused, how many there are."""
    found = {"float32": [0, 0, 0], "masks": [0, 0, 0]}
    for path in files:
        wanted = ours(path)
        pages = read(path, len(wanted))
        for want in wanted:
            row = found["masks" if want.dtype == np.bool_ else "float32"]
            row[2] += 1
            try:
                got = next(pages)
            except Exception:  # whatever another program raises
                row[1] += 1
                continue
            row[0] += got.shape == want.shape and np.array_equal(got, want, equal_nan=want.dtype == np.float32)
    return found


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("session", type=Path, help="with results up to the surface")
    arguments = parser.parse_args()
    files = sorted((arguments.session / "results").rglob("*.tif"))
    print("| program | pages of float32: right, refused, of all | masks: right, refused, of all |\n| --- | --- | --- |")
    for name, read in READERS.items():
        if not is_there(name):
            print(f"| {name} | not installed | |", flush=True)
            continue
        cells = [", ".join(map(str, row)) for row in judged(read, files).values()]
        print(f"| {name} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
