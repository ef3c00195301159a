"""A run decodes each photograph of the subject once, and does nothing costly twice."""

import shutil
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from mammometry.api.job import open_session
from mammometry.calibration.judge import quality
from mammometry.io import session as session_file
from mammometry.measure.wall import open_breast
from mammometry.settings import Settings
from mammometry.surface.motion.motion_detection import MotionEstimate


@pytest.mark.slow
def test_a_run_does_nothing_twice(tiny_finished: Path, tiny_settings: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shutil.rmtree(tiny_finished / "results")
    decoded, done = Counter[str](), Counter[str]()

    def counted(owner: object, name: str, label: Callable[..., str], into: Counter[str]) -> None:
        function = getattr(owner, name)

        def counting(*args: Any, **named: Any) -> Any:
            into[label(*args)] += 1
            return function(*args, **named)

        monkeypatch.setattr(owner, name, counting)

    counted(session_file, "read_photograph", lambda path, *_: "/".join(path.parts[-3:]), decoded)
    counted(quality, "view_qualities", lambda *_: "judged", done)
    counted(open_breast, "open_breasts", lambda *_: "cut out", done)
    counted(MotionEstimate, "apply_motion", lambda _, image, *__: f"moved {image.name}", done)
    quality._assessed.cache_clear()
    job = open_session(tiny_finished, Settings.load(tiny_settings))
    job.run()
    captured = {name: count for name, count in decoded.items() if "/capture/" in name}
    assert captured == dict.fromkeys(captured, 1)
    assert len(captured) == len(job.inputs.photographs) > 0
    assert (done["judged"], done["cut out"]) == (1, 1)
    moved = {name: count for name, count in done.items() if name.startswith("moved")}
    assert len(moved) == len(job.inputs.pair_names)
    # The surface, its picture and a cast's free space each make the range data: between them they leave the memory.
    assert max(moved.values()) <= 3
