"""Pictures of the stages, read back for a report."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from mammometry.api.job import open_session
from mammometry.base.errors import StorageError
from mammometry.base.progress import Progress
from mammometry.cli import main
from mammometry.job.stages.report import previews_key
from mammometry.report.figures.canvas import Caption, encode


def test_a_picture_that_is_none_is_one_sentence_although_its_record_agrees(tmp_path: Path) -> None:
    assert main.run(["new", str(tmp_path / "session"), "--quiet"]) == 0
    job = open_session(tmp_path / "session")
    whole = encode(np.zeros((40, 60, 3), np.uint8), Caption(title="Rig", text="Where its cameras stand."))
    noise = whole[:-40] + b"\xff" * 28 + whole[-12:]  # before the part that ends a PNG

    def holding(png: bytes) -> Callable[[], Callable[[Path, Progress], None]]:
        def write(folder: Path, progress: Progress) -> None:
            (folder / "rig.png").write_bytes(png)

        return lambda: write

    job.store.write_folder(previews_key("calibrate", job.plan), holding(whole))
    assert job.previews("calibrate") == {"rig": whole}
    job.store.write_folder(previews_key("match", job.plan), holding(noise))
    with pytest.raises(StorageError, match=r"^match/rig\.png: "):
        job.previews("match")
