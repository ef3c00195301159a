"""The boundary of a breast: found automatically, from landmarks, or drawn."""

from collections.abc import Iterable
from typing import Literal, TypeAlias

BoundaryRemark: TypeAlias = Literal["given", "head-not-shown", "to-be-confirmed", "confirmed"]
"""Codes of facts about a boundary. ``given``: drawn or imported. ``head-not-shown``: left and right depend on the
cameras' mounting. ``to-be-confirmed``: found automatically, not confirmed yet. ``confirmed``: confirmed by a person."""
_WORDS = {"to-be-confirmed": "to be confirmed by eye", "confirmed": "confirmed by eye"}


def boundary_words(method: str, remarks: Iterable[BoundaryRemark]) -> str:
    """One sentence on how a boundary was found and whether it is confirmed."""
    return "; ".join((method, *(_WORDS[code] for code in remarks if code in _WORDS)))
