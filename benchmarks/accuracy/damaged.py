"""How many damaged photographs are found, by which program, and at what cost.

    python -m benchmarks.accuracy.damaged [--each 20] [--whole FOLDER]

Damages are those of tests/brought/photograph_damage.py: so many of each kind in each format. Of those that are not
found it prints how many pixels they change by more than 20 of 255 grey levels. ``--whole`` reads every photograph in a
folder, none of which may be refused. simplejpeg (strict) is compared where it is installed.
"""

from __future__ import annotations

import argparse
import importlib.util
import io
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from PIL import Image
from tests.brought.photograph_damage import DAMAGES, FORMS, damaged, written

from mammometry.base.errors import ImageError
from mammometry.io.photographs.images import EXTENSIONS, read_photograph
from mammometry.io.photographs.jpeg_stream import check_jpeg

_LEVELS = 20


def _refuses(path: Path, content: bytes, program: str) -> bool:
    try:
        if program == "mammometry":
            path.write_bytes(content)
            read_photograph(path, path.name)
        elif program == "OpenCV":
            return cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED) is None
        elif program == "Pillow":
            Image.open(io.BytesIO(content)).load()
        elif content.startswith(b"\xff\xd8"):
            importlib.import_module("simplejpeg").decode_jpeg(content, "RGB", strict=True)
    except (ImageError, OSError, ValueError, SyntaxError, cv2.error):
        return True
    return False


def _changed(path: Path, content: bytes, whole: bytes) -> float:
    """Share of the pixels that an unfound damage changes."""
    read = []
    for each in (content, whole):
        path.write_bytes(each)
        pixels = read_photograph(path, path.name).pixels
        read.append(pixels.astype(float) * 255 / np.iinfo(pixels.dtype).max)
    differs = np.abs(read[0] - read[1]) > _LEVELS
    return float(differs.reshape(*differs.shape[:2], -1).any(axis=2).mean())


def _damages(each: int, path: Path) -> None:
    programs = ["OpenCV", "Pillow", "mammometry"]
    if importlib.util.find_spec("simplejpeg"):
        programs.insert(2, "simplejpeg")
    totals: Counter[Any] = Counter()
    for form in FORMS:
        for damage in DAMAGES:
            found: Counter[str] = Counter()
            changed = []
            for number in range(each):
                content = damaged(form, damage, number)
                for program in programs:
                    found[program] += _refuses(path, content, program)
                if found.total() and not _refuses(path, content, "mammometry"):
                    changed.append(_changed(path, content, written(form, number % 3)))
            totals["tried"] += each
            totals += found
            rest = f"; unfound change at most {max(changed):.2%} of the pixels" if changed else ""
            print(f"{form}, {damage}: " + ", ".join(f"{name} {found[name]}/{each}" for name in programs) + rest)
    print("all: " + ", ".join(f"{name} {totals[name]}/{totals['tried']}" for name in programs))


def _whole(folder: Path) -> None:
    counts: Counter[str] = Counter()
    for path in sorted(path for path in folder.rglob("*") if path.suffix.lower() in EXTENSIONS):
        try:
            read_photograph(path, path.name)
            counts["read"] += 1
        except ImageError as error:
            counts["refused"] += 1
            print(error)
    print(f"undamaged: {counts['read']} read, {counts['refused']} refused")


def _cost(path: Path) -> None:
    """Seconds of a photograph of the reference rig, 4504 × 3000 pixels."""
    from tests.brought.photograph_damage import picture

    image = Image.fromarray(np.tile(picture(0), (10, 10, 1))[:3000, :4504])
    buffer = io.BytesIO()
    image.save(buffer, "JPEG", quality=92)
    content = buffer.getvalue()
    seconds = []
    for _ in range(5):
        begun = time.perf_counter()
        check_jpeg(content)
        walked = time.perf_counter()
        cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_COLOR_RGB)
        seconds.append((walked - begun, time.perf_counter() - walked))
    walk, decode = np.min(seconds, axis=0)
    print(f"4504 × 3000, {len(content) / 1e6:.1f} MB: checked in {walk:.3f} s, decoded in {decode:.3f} s")


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--each", type=int, default=20, help="damages of each kind in each format")
    parser.add_argument("--whole", type=Path, help="a folder of undamaged photographs")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.jpg"
        _damages(arguments.each, path)
        _cost(path)
    if arguments.whole is not None:
        _whole(arguments.whole)


if __name__ == "__main__":
    main()
