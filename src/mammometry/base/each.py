"""The same work on many things: one after another here, or side by side by whatever the caller brings."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, TypeAlias

Tell: TypeAlias = Callable[[str, float], None]
"""Called with the stage that is at work and the fraction of it that is done."""
Each: TypeAlias = Callable[[Callable[..., Any], Mapping[str, tuple[Any, ...]]], dict[str, Any]]
"""Call a function with ``(tell, *arguments)`` once for each name. Return name → result.

The function stands in a module, its arguments can be pickled, and its result is plain JSON data: it may be called in
another process or on another machine.
"""


def one_after_another(function: Callable[..., Any], arguments: Mapping[str, tuple[Any, ...]]) -> dict[str, Any]:
    """Call the function here, for each name in turn."""
    return {name: function(lambda stage, fraction: None, *each) for name, each in arguments.items()}
