"""Small pictures of the telephone's board, for pages on which nothing is measured."""

import base64
import io
import json
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType

import cv2
import numpy as np
from PIL import Image
from playwright.sync_api import Page

from mammometry.api.photos import WALK
from mammometry.walk.inputs import LeftOut
from mammometry.walk.region import TELEPHONE_BOARD

SIZE_WH = (640, 480)


@lru_cache
def picture(seed: int, *, board: bool = True, size_wh: tuple[int, int] = SIZE_WH, form: str = "JPEG") -> bytes:
    """A photograph of the board before noise, or of noise alone."""
    width, height = size_wh
    noise = np.random.default_rng(seed).integers(60, 90, (height, width), dtype=np.uint8)
    if board:
        columns, rows = TELEPHONE_BOARD["squares"]
        dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, TELEPHONE_BOARD["dictionary"]))
        sizes = TELEPHONE_BOARD["square_mm"], TELEPHONE_BOARD["marker_mm"]
        drawn = cv2.aruco.CharucoBoard((columns, rows), *sizes, dictionary)
        side = width // (columns + 4)
        image = drawn.generateImage((columns * side, rows * side))
        noise[side // 2 : image.shape[0] + 3 * side // 2, side // 2 : image.shape[1] + 3 * side // 2] = 255
        noise[side : side + image.shape[0], side : side + image.shape[1]] = image
        noise = cv2.GaussianBlur(noise, (0, 0), 0.7)  # an edge as sharp as drawn is no photograph's
    buffer = io.BytesIO()
    Image.fromarray(noise).convert("RGB").save(buffer, format=form)
    return buffer.getvalue()


@lru_cache
def video(seed: int = 1, *, frames: int = 12, board: bool = True) -> bytes:
    """An MP4 of 10 frames a second that shows the board."""
    shown = [cv2.imdecode(np.frombuffer(picture(seed + k % 3, board=board), np.uint8), 1) for k in range(frames)]
    with tempfile.TemporaryDirectory() as folder:
        return write_video(Path(folder) / "video.mp4", shown).read_bytes()


def write_video(path: Path, frames: Sequence[np.ndarray], rate: float = 10.0, codec: str = "mp4v") -> Path:
    """Write BGR pictures of one size as a video. The codec "png " is lossless, in a MOV."""
    height, width = frames[0].shape[:2]
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*codec), rate, (width, height))
    assert writer.isOpened()
    for frame in frames:
        writer.write(frame)
    writer.release()
    return path


def boxes(content: bytes) -> dict[bytes, tuple[int, int]]:
    """Outermost boxes of an MP4 (ISO/IEC 14496-12, 4.2): type → start and end."""
    found, start = {}, 0
    while start < len(content):
        size = int.from_bytes(content[start : start + 4], "big")
        found[content[start + 4 : start + 8]] = (start, start + size)
        start += size
    return found


def drop(page: Page, files: Sequence[Path]) -> None:
    """Drop files on the page's place for photographs, as from a folder's window."""
    sent = [{"name": path.name, "data": base64.b64encode(path.read_bytes()).decode()} for path in files]
    transfer = page.evaluate_handle(
        """files => {
            const transfer = new DataTransfer();
            for (const { name, data } of files)
                transfer.items.add(new File([Uint8Array.from(atob(data), (byte) => byte.charCodeAt(0))], name));
            return transfer;
        }""",
        sent,
    )
    page.dispatch_event("[data-drop]", "drop", {"dataTransfer": transfer})


def write_prepared(
    folder: Path,
    *,
    left_out: Mapping[str, LeftOut],
    pictures: int,
    card_scale: float | None = None,
    times: Mapping[str, str] = MappingProxyType({}),
) -> None:
    """A session's folder as the preparation of a walk leaves it, without anything to measure."""
    folder.mkdir(parents=True, exist_ok=True)
    numbers = [f"{number:02d}" for number in range(1, pictures + 1)]
    table = {
        "source": "x", "pictures": pictures, "used": [number for number in numbers if number not in left_out],
        "left_out": {number: asdict(why) for number, why in left_out.items()},
        "board_rms_px": 0.05, "board_bow_mm": 0.1, "focal_px": 900.0, "scale_std": 0.01,
        "point_std_mm": 0.1, "card_scale": card_scale, "times": dict(times),
    }  # fmt: skip
    (folder / WALK).write_text(json.dumps(table))
