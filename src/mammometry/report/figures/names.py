"""What readers call a measured side."""

from collections.abc import Mapping
from types import MappingProxyType

NAMES: Mapping[str, str] = MappingProxyType(
    {"model": "cast", "left": "patient's left breast", "right": "patient's right breast"}
)
"""``model``, ``left`` or ``right`` → its name in a sentence."""
