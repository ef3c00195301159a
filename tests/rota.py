"""Which tests run when, by the seconds they take: slow ones in turn, and long files first.

``seconds.txt`` beside this file says what was recorded: CPU seconds of each slow test (one case of it) and of the
longest files of the default run. What it does not name is taken as short.
"""

import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from zlib import crc32

RECORDED = Path(__file__).with_name("seconds.txt")
SHARES = 12
"""So many runs in a row take all slow tests: a share is four to five minutes of two cores (decision 35)."""


def turn(text: str) -> int:
    """Read the number of this run, any: the share that it takes, from 0."""
    if not text.isdecimal():
        raise ValueError(f"--rota: found {text!r}, expected the number of this run, as in 17")
    return int(text) % SHARES


def recorded(path: Path = RECORDED) -> dict[str, float]:
    """CPU seconds of tests (``file::function``) and files; lines that begin with # are words."""
    lines = (line.split(maxsplit=1) for line in path.read_text(encoding="utf-8").splitlines() if line[:1] not in "#")
    return {name: float(seconds) for seconds, name in lines}


def function_of(test: str) -> str:
    """A test's name without its case, and without the group that xdist puts behind it."""
    return re.split(r"[\[@]", test, maxsplit=1)[0]


def chosen(groups: Iterable[tuple[str, Sequence[str]]], number: int) -> set[str]:
    """The groups of slow tests whose turn it is.

    Longest first, each goes to the share that has least to do, so that all take alike. Short ones, and those of which
    nothing is recorded, are dealt by their names: a new test moves no other one to another share.

    Args:
        groups: name of each group, and its tests. Tests that share what is costly to make are one group.
        number: of the share, from 0.
    """
    seconds = recorded()
    known = {name: [seconds[function_of(test)] for test in tests if function_of(test) in seconds]
             for name, tests in groups}  # fmt: skip
    load = [0.0] * SHARES
    here = {name for name, found in known.items() if not found and crc32(name.encode()) % SHARES == number}
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
