"""Pages from templates: what all of them share."""

from __future__ import annotations

import re
from importlib.resources import files
from typing import Any

STYLE = "report.css"
_TORN = re.compile(r"(?<=[\d±<>]) (?=%|± ?\d|\d|(?:cc|cm²|mm|px|ppm|s|CPU s)\b)")
"""Spaces within a quantity, at which no line may end."""
_COMMAND = re.compile("`([^`]+)`")


def resource(name: str) -> str:
    """Text of a file beside the templates."""
    return files("mammometry.report").joinpath("templates", name).read_text(encoding="utf-8")


def render(template: str, *, styles: tuple[str, ...] = (STYLE,), **values: Any) -> str:
    """A page's text; it may import macros from other templates, and finds its style under ``style``.

    Its filter ``commands`` sets what stands between `backticks` as code.
    """
    from jinja2 import Environment, FunctionLoader, StrictUndefined
    from markupsafe import Markup, escape

    def commands(words: str) -> Markup:
        return Markup(_COMMAND.sub(r"<code>\1</code>", str(escape(tied(words)))))

    environment = Environment(
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        finalize=tied,
        loader=FunctionLoader(resource),
    )
    environment.filters["commands"] = commands
    style = Markup("".join(resource(name) for name in styles))
    return environment.get_template(template).render(style=style, **values)


def tied(value: object) -> object:
    """Words whose numbers keep to their signs and units; everything else as it is."""
    if type(value) is not str or value.startswith("data:"):
        return value
    return _TORN.sub("\u00a0", value)
