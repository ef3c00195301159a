"""Messages from the page (lengths in mm, world frame), checked as far as possible without the session."""

from typing import Annotated, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from mammometry.base.letters import name_fault

Breast = Literal["model", "left", "right"]
Point = tuple[float, float, float]
Base = Annotated[str, Field(max_length=64)] | None
"""Digest of the item before the change, if there was one."""


def _is_name(name: str) -> str:
    name = " ".join(name.split())
    if not name or name_fault(name) is not None:
        raise ValueError("enter your name")
    return name


Author = Annotated[str, Field(max_length=80), AfterValidator(_is_name)]


class EditorMessage(BaseModel):
    """A message, which must not contain other fields."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)


class SentHandle(EditorMessage):
    """A handle of a boundary."""

    point: Point
    at: Annotated[int, Field(ge=0)] | None = None


class Sketch(EditorMessage):
    """A boundary on the page: its original curve, and the positions of its handles."""

    of: Annotated[str, Field(max_length=64)] | None = None
    handles: Annotated[list[SentHandle], Field(min_length=3, max_length=5000)]


class Measure(EditorMessage):
    """Boundaries to measure."""

    boundaries: dict[Breast, Sketch]


class SketchChange(EditorMessage):
    """A changed boundary. Without a sketch it will be found automatically."""

    base: Base
    sketch: Sketch | None


class PlaceChange(EditorMessage):
    """A changed landmark. Without points it is removed."""

    base: Base
    points: Annotated[list[Point], Field(min_length=1, max_length=5000)] | None


class Save(EditorMessage):
    """All changed items."""

    author: Author
    boundaries: dict[Breast, SketchChange] = {}
    landmarks: dict[str, PlaceChange] = {}


class Finish(EditorMessage):
    """Confirmation that all boundaries were checked and are right."""

    author: Author
    curves: dict[Breast, Annotated[str, Field(max_length=64)]]
    """Breast → digest of the curve that was checked."""
