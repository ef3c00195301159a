"""Names on the command line of a benchmark."""

from __future__ import annotations

from collections.abc import Collection, Iterable


def known(what: str, chosen: Iterable[str], names: Collection[str]) -> list[str]:
    """Return the chosen names.

    Args:
        what: kind of the names, in the plural, for the message.
        chosen: names as written on the command line.
        names: all known names.

    Raises:
        SystemExit: a name is unknown. Its message lists the known ones.
    """
    found = list(chosen)
    if unknown := [name for name in found if name not in names]:
        raise SystemExit(f"{what} are {', '.join(names)}; found {', '.join(unknown)}")
    return found
