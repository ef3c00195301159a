"""Pages from templates: shared parts, placement of a report's pictures, and the page of a refused run."""

import base64
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from typing import Any

from mammometry.base.errors import MammometryError, StorageError
from mammometry.base.identity import Identity
from mammometry.report.content import Fact, ReportContent, ReportPicture, sentence
from mammometry.report.figures.catalogue import in_order, is_on_paper
from mammometry.report.first_page import FIRST_PICTURES
from mammometry.report.pictures import encoded

STYLE = "report.css"
_TORN = re.compile(r"(?<=[\d±<>]) (?=%|± ?\d|\d|(?:cc|cm²|mm|px|ppm|s|CPU s)\b)")
"""Spaces within a quantity, at which lines must not break."""
_COMMAND = re.compile("`([^`]+)`")


@dataclass(frozen=True, slots=True, kw_only=True)
class EmbeddedPicture:
    """A picture embedded in a page."""

    source: str
    """A data URI."""
    width: int
    height: int
    title: str
    text: str


def resource(name: str) -> str:
    """Text of a file in the templates' folder."""
    return files("mammometry.report").joinpath("templates", name).read_text(encoding="utf-8")


def render(template: str, *, styles: tuple[str, ...] = (STYLE,), **values: Any) -> str:
    """HTML of a page from its template.

    The template may import macros from other templates. Its style is available as ``style``. The filter ``commands``
    formats text between `backticks` as code.
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
    """Replace spaces between numbers, signs and units by no-break spaces. Only text is changed."""
    if type(value) is not str or value.startswith("data:"):
        return value
    return _TORN.sub("\u00a0", value)


def embed(png: bytes) -> EmbeddedPicture:
    """A picture as a WebP data URI."""
    return shown(encoded(png, on_paper=False))


def shown(picture: ReportPicture) -> EmbeddedPicture:
    """A picture of a report as a WebP data URI."""
    return EmbeddedPicture(
        source=f"data:image/webp;base64,{base64.b64encode(picture.webp).decode('ascii')}",
        width=picture.width,
        height=picture.height,
        title=picture.title,
        text=picture.text,
    )


def viewer_program() -> str:
    """The viewer's program, in a form that is safe inside a script element.

    Raises:
        StorageError: the package was copied instead of installed. The program is built during installation.
    """
    try:
        return resource("viewer.js").replace("</", "<\\/")
    except FileNotFoundError:
        remedy = "Install mammometry again: pip install ."
        expected = "the 3D viewer, which is bundled when the package is installed"
        raise StorageError(
            "mammometry/report/templates/viewer.js", found="no such file", expected=expected, remedy=remedy
        ) from None


_MEASURE = "measure"


def whole_pictures(content: ReportContent) -> list[ReportPicture]:
    """Pictures of the whole measurement, except those on the first page."""
    of_breasts = {name for breast in content.breasts for name in _of_breast(content, breast.name)}
    measure = _drawn(content, _MEASURE)
    left_out = {*of_breasts, *FIRST_PICTURES}
    return [measure[name] for name in in_order(_MEASURE, measure) if name not in left_out]


def breast_pictures(content: ReportContent, breast: str) -> list[ReportPicture]:
    """Pictures of one breast."""
    return [_drawn(content, _MEASURE)[name] for name in _of_breast(content, breast)]


def stage_pictures(content: ReportContent, stage: str) -> list[ReportPicture]:
    """Pictures of one stage for the technician. Those of the measurement are shown with the breasts."""
    return [picture for _, picture in _of_stage(content, stage)]


def paper_pictures(content: ReportContent, stages: Sequence[str]) -> list[ReportPicture]:
    """Pictures of these stages for the PDF."""
    return [picture for stage in stages for name, picture in _of_stage(content, stage) if is_on_paper(name)]


def _of_stage(content: ReportContent, stage: str) -> list[tuple[str, ReportPicture]]:
    drawn = {} if stage == _MEASURE else _drawn(content, stage)
    return [(name, drawn[name]) for name in in_order(stage, drawn)]


def _of_breast(content: ReportContent, breast: str) -> list[str]:
    return in_order(_MEASURE, (name for name in _drawn(content, _MEASURE) if name.endswith(f"-{breast}")))


def _drawn(content: ReportContent, stage: str) -> dict[str, ReportPicture]:
    return dict(content.pictures.get(stage, {}))


def refusal_page(identity: Identity, error: MammometryError, pictures: Mapping[str, bytes]) -> str:
    """Page of a refused run: the error, and the pictures made before it.

    Args:
        identity: identity of the subject.
        error: the error.
        pictures: name → PNG with its caption, most useful first.
    """
    return render(
        "refused.html.j2",
        identity=identity,
        subject=_heading(error.subject),
        details=(Fact("Found", error.found), Fact("Expected", error.expected)),
        remedy=sentence(error.remedy),
        lines=[sentence(line) for line in error.details],
        pictures=[embed(png) for png in pictures.values()],
    )


def _heading(subject: str) -> str:
    """The subject with an initial capital, unless it is a file name."""
    return subject if {"/", "."} & set(subject) else f"{subject[:1].upper()}{subject[1:]}"
