"""Each stage says how far it is at least each two seconds, whatever it does meanwhile."""

import os
import shutil
import time
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path

import pytest

from mammometry.api.job import open_session
from mammometry.base.machine.cores import available_cores
from mammometry.base.progress import Progress, ticking
from mammometry.job.products import Key
from mammometry.settings import Settings

_LONGEST_S = 2.0


@pytest.mark.slow
def test_every_stage_reports_each_two_seconds(tiny_finished: Path, tiny_settings: Path) -> None:
    """As the command line's bars hear it, in a run of all stages."""
    shutil.rmtree(tiny_finished / "results")
    told, shares = defaultdict[str, list[float]](list), defaultdict[str, list[float]](list)

    @contextmanager
    def watch(key: Key) -> Iterator[Progress]:
        name = f"{key.stage}/{key.product}"

        def heard(fraction: float) -> None:
            told[name].append(time.monotonic())
            shares[name].append(fraction)

        heard(0.0)
        with ticking(heard) as report:
            yield report
        heard(1.0)

    open_session(tiny_finished, Settings.load(tiny_settings), watch=watch).run()
    longest = {name: max(b - a for a, b in pairwise(times)) for name, times in told.items()}
    worst = sorted(longest.items(), key=lambda item: -item[1])[:4]
    shared = max(1.0, os.getloadavg()[0] / available_cores())  # with others at work, a thread waits for its turn
    waits = ", ".join(f"{name} {seconds:.2f} s" for name, seconds in worst)
    print(f"longest waits for a report: {waits}, on a machine shared {shared:.1f} times")  # noqa: T201
    assert all(values == sorted(values) for values in shares.values())
    assert {name.partition("/")[0] for name in told} == {"calibrate", "match", "surface", "measure", "report"}
    assert worst[0][1] < _LONGEST_S * shared, worst
