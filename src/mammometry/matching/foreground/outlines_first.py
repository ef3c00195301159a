"""Name photographs without an outline before a disagreement is put down to moved cameras.

Where the outline of the subject is not known, everything near is matched, also what is not the subject. Pairs then
disagree, and a later check says that a camera has moved. The outline comes first: it can be drawn.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager

from mammometry.base.errors import MatchingError, SurfaceError

OF_PARTNER = "its partner's silhouette is not known"
"""Reason given for a camera whose partner has a wrong silhouette: both pictures of a pair are treated alike."""


def outline_advice(cameras: Sequence[str], doubts: Mapping[str, str]) -> str:
    """What to do before a disagreement is put down to moved cameras. Empty where all outlines are known.

    Args:
        cameras: those of the pair that disagrees.
        doubts: camera → why its silhouette is not known.
    """
    missing = [name for name in cameras if doubts.get(name, OF_PARTNER) != OF_PARTNER]
    if not missing:
        return ""
    return (
        f"The subject's outline in the photograph of {' and of '.join(missing)} is not known, so the background may "
        f"have been matched. Draw {' and '.join(f'masks/{name}.png' for name in missing)}, and run again before you "
        "calibrate again."
    )


@contextmanager
def outlines_first(doubts: Mapping[str, str]) -> Iterator[None]:
    """Turn a disagreement of the pairs into a demand for the missing outlines, if any are missing.

    Args:
        doubts: camera → why its silhouette is not known. With none, errors pass unchanged.

    Raises:
        MatchingError: the pairs disagree, and outlines are missing. Names the photographs.
    """
    try:
        yield
    except SurfaceError as error:
        missing = [camera for camera, reason in doubts.items() if reason != OF_PARTNER]
        if not missing:
            raise
        reasons = "; ".join(dict.fromkeys(doubts[camera] for camera in missing))
        files = " and ".join(f"masks/{camera}.png" for camera in missing)
        raise MatchingError(
            f"capture, {', '.join(missing)}",
            found=f"no usable outline of the subject ({reasons}), and {error.subject} with {error.found}",
            expected="the subject's outline in every photograph, before cameras can be said to have moved",
            remedy=f"Draw the subject as {files} (white where the subject is, black elsewhere, as large as the "
            "photograph), and run again",
        ) from error
