"""Pages from templates: what all of them share."""

from __future__ import annotations

import base64
import re
from dataclasses import dataclass
from importlib.resources import files
from typing import Any

from mammometry.base.errors import StorageError
from mammometry.report.content import Picture
from mammometry.report.pictures import encoded

STYLE = "report.css"
_TORN = re.compile(r"(?<=[\d±<>]) (?=%|± ?\d|\d|(?:cc|cm²|mm|px|ppm|s|CPU s)\b)")
"""Spaces within a quantity, at which no line may end."""
_COMMAND = re.compile("`([^`]+)`")


@dataclass(frozen=True, slots=True, kw_only=True)
class Shown:
    """A picture as the page embeds it."""

    source: str
    """A data URI."""
    width: int
    height: int
    title: str
    text: str


def resource(name: str) -> str:
    """Text of a file beside the templates."""
    return files("mammometry.report").joinpath("templates", name).read_text(encoding="utf-8")


def render(template: str, *, styles: tuple[str, ...] = (STYLE,), **values: Any) -> str:
    """A page's text.

    It may import macros from other templates, and finds its style under ``style``. Its filter ``commands`` sets what
    stands between `backticks` as code.
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
    """Words whose numbers keep to their signs and units. Everything else as it is."""
    if type(value) is not str or value.startswith("data:"):
        return value
    return _TORN.sub("\u00a0", value)


def embed(png: bytes) -> Shown:
    """A picture as a WebP data URI."""
    return shown(encoded(png, on_paper=False))


def shown(picture: Picture) -> Shown:
    """A picture of a report as a WebP data URI."""
    return Shown(
        source=f"data:image/webp;base64,{base64.b64encode(picture.webp).decode('ascii')}",
        width=picture.width,
        height=picture.height,
        title=picture.title,
        text=picture.text,
    )


def viewer_program() -> str:
    """The viewer's program, safe inside a script element.

    Raises:
        StorageError: the package was copied and not installed: the program is made when it is installed.
    """
    try:
        return resource("viewer.js").replace("</", "<\\/")
    except FileNotFoundError:
        raise StorageError(
            "mammometry/report/templates/viewer.js",
            found="no such file",
            expected="the 3D viewer, which is bundled when the package is installed",
            remedy="Install mammometry again: pip install .",
        ) from None
