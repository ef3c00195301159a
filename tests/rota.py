"""The slow tests in turn: each run takes a share of them, and as many runs in a row take all."""

from collections.abc import Sequence


def turn(text: str) -> tuple[int, int]:
    """Read "RUN/SHARES": the number of this run, any, and how many runs take all."""
    run, _, shares = text.partition("/")
    if not (run.isdecimal() and shares.isdecimal() and int(shares) > 0):
        raise ValueError(f"--rota: found {text!r}, expected RUN/SHARES, as in 17/5")
    return int(run) % int(shares), int(shares)


def chosen(groups: Sequence[str], number: int, shares: int) -> set[str]:
    """The groups of tests whose turn it is: dealt out like cards, so that neighbours, alike in cost, are spread."""
    return set(sorted(set(groups))[number::shares])
