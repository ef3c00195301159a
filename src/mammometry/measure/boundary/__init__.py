"""The boundary of a breast."""

from collections.abc import Iterable
from typing import Literal, TypeAlias

BoundaryRemark: TypeAlias = Literal["given", "head-not-shown", "to-be-confirmed", "confirmed"]
"""What a program must know of a boundary: it was drawn or imported (``given``); left and right depend on how the
cameras are mounted (``head-not-shown``); it was found automatically and nobody has confirmed it (``to-be-confirmed``);
somebody has (``confirmed``)."""
_WORDS = {"to-be-confirmed": "to be confirmed by eye", "confirmed": "confirmed by eye"}


def boundary_words(method: str, remarks: Iterable[BoundaryRemark]) -> str:
    """How a boundary was found and whether it is confirmed, one sentence."""
    return "; ".join((method, *(_WORDS[code] for code in remarks if code in _WORDS)))
