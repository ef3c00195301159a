"""One function on many things, in sequence here or in parallel elsewhere."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, TypeAlias

Tell: TypeAlias = Callable[[str, float], None]
"""Called with the current stage and its fraction done."""
Each: TypeAlias = Callable[[Callable[..., Any], Mapping[str, tuple[Any, ...]]], dict[str, Any]]
"""Call a function with ``(tell, *arguments)`` for each name. Return name → result.

The function is defined in a module, its arguments can be pickled, and its result is plain JSON data: it may run in
another process or on another machine.
"""


def one_after_another(function: Callable[..., Any], arguments: Mapping[str, tuple[Any, ...]]) -> dict[str, Any]:
    """Call the function here, for each name in turn."""
    return {name: function(lambda stage, fraction: None, *each) for name, each in arguments.items()}
