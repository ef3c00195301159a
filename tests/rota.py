"""Which tests run when, by the seconds they take: slow ones in turn, and long files first.

``seconds.txt`` beside this file says what was recorded: CPU seconds of each slow test (one case of it) and of the
longest files of the default run. What it does not name is taken as short.
"""

import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from zlib import crc32

RECORDED = Path(__file__).with_name("seconds.txt")
UNRECORDED_S = 3.0
"""Of a slow test that the table does not name: the median of those that it names."""


MAY_SKIP = (
    "third-party captures are not beside",
    "the clinic was tested with SQLite alone",  # a slow test runs all of it with PostgreSQL
    "this is that run",
    "SQLite has no TRUNCATE",
    "mounting",  # needs rights that containers lack; the same is tested with injected errors
    "this gphoto2 has no simulated camera",
)
"""Beginnings of the reasons for which a test may be skipped although all is installed that .ci/run installs."""


def not_run(skipped: Iterable[tuple[str, str]]) -> list[str]:
    """Tests that were skipped for another reason, with it, from names and reasons."""
    return [
        f"{name}: {reason}" for name, reason in skipped if not reason.removeprefix("Skipped: ").startswith(MAY_SKIP)
    ]


def turn(text: str) -> tuple[int, int]:
    """Read "RUN/SHARES": the number of this run, any, and how many runs take all."""
    run, _, shares = text.partition("/")
    if not (run.isdecimal() and shares.isdecimal() and int(shares) > 0):
        raise ValueError(f"--rota: found {text!r}, expected RUN/SHARES, as in 17/5")
    return int(run) % int(shares), int(shares)


def recorded(path: Path = RECORDED) -> dict[str, float]:
    """CPU seconds of tests (``file::function``) and files; lines that begin with # are words."""
    lines = (line.split(maxsplit=1) for line in path.read_text(encoding="utf-8").splitlines() if line[:1] not in "#")
    return {name: float(seconds) for seconds, name in lines}


def function_of(test: str) -> str:
    """A test's name without its case, and without the group that xdist puts behind it."""
    return re.split(r"[\[@]", test, maxsplit=1)[0]


def chosen(groups: Iterable[tuple[str, Sequence[str]]], number: int, shares: int) -> set[str]:
    """The groups of slow tests whose turn it is.

    Longest first, each goes to the share that has least to do, so that all take alike. Short ones, and those of which
    nothing is recorded, are dealt by their names: a new test moves no other one to another share.

    Args:
        groups: name of each group, and its tests. Tests that share what is costly to make are one group.
        number: of the share, from 0.
        shares: how many there are.
    """
    seconds = recorded()
    known = {name: [seconds[function_of(test)] for test in tests if function_of(test) in seconds]
             for name, tests in groups}  # fmt: skip
    load = [0.0] * shares
    here = {name for name, found in known.items() if not found and crc32(name.encode()) % shares == number}
    for name in sorted((name for name in known if known[name]), key=lambda name: (-sum(known[name]), name)):
        least = load.index(min(load))
        load[least] += sum(known[name])
        if least == number:
            here.add(name)
    return here


def longest_first(names: Iterable[str]) -> dict[str, int]:
    """Place of each file or test, so that all cores end together: long ones begin, others keep their order."""
    seconds = recorded()
    order = sorted(dict.fromkeys(names), key=lambda name: -seconds.get(name, 0.0))
    return {name: place for place, name in enumerate(order)}
