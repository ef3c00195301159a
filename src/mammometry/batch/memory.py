"""Memory that a session needs, learned from sessions measured before."""

from __future__ import annotations

from collections.abc import Sequence

_MARGIN = 1.15
"""Sessions of one size differ in memory: casts of the reference rig by ± 10 %."""


def need_mb(megapixels: float | None, known: Sequence[tuple[float, float]]) -> float | None:
    """Memory to keep free for a session, MB.

    None where no session is known. Memory grows with the pixels at most in proportion, so a session needs no more than
    the next larger one, or the largest one times its own size over that one's.

    Args:
        megapixels: of its photographs of the subject; None where that is not known: it may be as large as any.
        known: (megapixels, peak memory in MB) of others.
    """
    if not known:
        return None
    if megapixels is None:
        return _MARGIN * max(peak for _, peak in known)
    larger = [(size, peak) for size, peak in known if size >= megapixels]
    if larger:
        nearest = min(size for size, _ in larger)
        return _MARGIN * max(peak for size, peak in larger if size <= 1.05 * nearest)
    size = max(size for size, _ in known)
    return _MARGIN * max(peak for other, peak in known if other == size) * megapixels / size
