"""Catalogue of figures: previews of stages, and figures of the paper.

To add one, write a function in a module of this package and decorate it. The stage then writes the picture, and the
page and the PDF show it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeAlias, TypeVar

from mammometry.base.errors import SettingsError
from mammometry.base.registry import Registry
from mammometry.job.graph import Plan
from mammometry.job.inputs import Inputs
from mammometry.settings import Settings

if TYPE_CHECKING:
    from mammometry.job.products import Stage
    from mammometry.report.figures.canvas import PanelSheet


Draw: TypeAlias = Callable[..., "bytes | None"]
"""Draws a PNG from its stage's result (`stage_results`). A figure of each breast also gets that breast's measurement.

Returns None if there is nothing to show, such as residuals of given cameras.
"""
DrawPaper: TypeAlias = "Callable[[Source], PanelSheet]"
_Figure = TypeVar("_Figure", bound=Callable[..., Any])


@dataclass(frozen=True, slots=True, kw_only=True)
class Preview:
    """One picture of a stage's result, or one picture per breast."""

    name: str
    """File name in ``results/<stage>/``. If there is one per breast, the names are ``<name>-<breast>``."""
    stage: Stage
    draw: Draw
    place: int
    """Order among its stage's pictures, lowest first."""
    photographs: bool
    """Whether it shows photographs, including the background. Reports for other people omit such figures."""
    on_paper: bool = False
    """Whether the PDF's technical pages show it. The web page shows all."""
    per_breast: bool = False

    def is_called(self, name: str) -> bool:
        """Whether a picture with that name is this preview."""
        return name.startswith(f"{self.name}-") if self.per_breast else name == self.name


PREVIEWS: Registry[Preview] = Registry("preview", package=__package__)
PAPER_FIGURES: Registry[DrawPaper] = Registry("figure of the paper", package=__package__)
"""Number in the paper, as text → function."""


def preview(
    name: str, *, stage: Stage, place: int, photographs: bool, on_paper: bool = False, per_breast: bool = False
) -> Callable[[_Figure], _Figure]:
    """Decorate a function to register it as a preview. The parameters are those of `Preview`."""

    def enter(draw: _Figure) -> _Figure:
        entry = Preview(
            name=name,
            stage=stage,
            draw=draw,
            place=place,
            photographs=photographs,
            on_paper=on_paper,
            per_breast=per_breast,
        )
        PREVIEWS.add(name)(entry)
        return draw

    return enter


def paper_figure(number: int) -> Callable[[_Figure], _Figure]:
    """Register a function as the paper's figure with that number."""

    def enter(draw: _Figure) -> _Figure:
        PAPER_FIGURES.add(str(number))(draw)
        return draw

    return enter


def find_paper_figure(number: int) -> DrawPaper:
    """Return the function that draws a figure of the paper.

    Raises:
        SettingsError: the paper has no such figure; the message lists the existing ones.
    """
    return PAPER_FIGURES.find(str(number), "figure", error=SettingsError)


def previews_of(stage: Stage) -> list[Preview]:
    """Previews of a stage, in reading order."""
    return sorted(
        (preview for preview in PREVIEWS.values() if preview.stage == stage),
        key=lambda preview: (preview.place, preview.name),
    )


def in_order(stage: str, names: Iterable[str]) -> list[str]:
    """Names of a stage's pictures in their order. Unknown ones come last."""
    known = [preview for preview in PREVIEWS.values() if preview.stage == stage]

    def place(name: str) -> tuple[int, str]:
        places = [preview.place for preview in known if preview.is_called(name)]
        return (min(places) if places else max((preview.place for preview in known), default=0) + 1), name

    return sorted(names, key=place)


def shows_photographs(name: str) -> bool:
    """Whether a picture shows photographs. Unknown pictures are assumed to show them."""
    known = [preview for preview in PREVIEWS.values() if preview.is_called(name)]
    return not known or any(preview.photographs for preview in known)


def is_on_paper(name: str) -> bool:
    """Whether the PDF's pages for the technician show a picture."""
    return any(preview.on_paper for preview in PREVIEWS.values() if preview.is_called(name))


Source: TypeAlias = tuple[Plan, Inputs, Settings]
"""A session's plan, its inputs, and the settings."""
