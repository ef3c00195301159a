"""Report photographs without an outline before moved cameras.

If the outline of the subject is unknown, everything near is matched, including other objects. Pairs then disagree as if
a camera had moved. The missing outline is reported first, since it can be drawn.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager

from mammometry.base.errors import MatchingError, SurfaceError
from mammometry.base.notices import Notice


def without_outline(cameras: Sequence[str], doubts: Mapping[str, str]) -> tuple[str, ...]:
    """Cameras whose outlines must be drawn before a disagreement shows that cameras moved.

    Args:
        cameras: cameras of the pair that disagrees.
        doubts: camera → reason why its silhouette is unknown. Empty: because its partner's is.
    """
    return tuple(name for name in cameras if doubts.get(name))


def outline_first(missing: Sequence[str]) -> Notice:
    """Advice to draw these cameras' outlines before anything else."""
    return Notice(
        code="outline-first",
        about=tuple(missing),
        photographs=tuple(f"capture/{name}" for name in missing),
        values={"masks": " and ".join(f"masks/{name}.png" for name in missing)},
    )


@contextmanager
def outlines_first(doubts: Mapping[str, str]) -> Iterator[None]:
    """Convert an error about disagreeing pairs to one about missing outlines, if any are missing.

    Args:
        doubts: camera → reason why its silhouette is unknown. With none, errors pass unchanged.

    Raises:
        MatchingError: the pairs disagree, and outlines are missing. The message lists the photographs.
    """
    try:
        yield
    except SurfaceError as error:
        missing = [camera for camera, reason in doubts.items() if reason]
        if not missing:
            raise
        reasons = "; ".join(dict.fromkeys(doubts[camera] for camera in missing))
        files = " and ".join(f"masks/{camera}.png" for camera in missing)
        raise MatchingError(
            f"capture, {', '.join(missing)}",
            found=f"no usable outline of the subject ({reasons}), and {error.subject} with {error.found}",
            expected="the subject's outline in every photograph, before motion of cameras can be tested",
            remedy=f"Draw the subject as {files} (white where the subject is, black elsewhere, as large as the "
            "photograph), and run again",
        ) from error
