"""What the page sends, checked as far as that is possible without the session; mm, world frame."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

Breast = Literal["model", "left", "right"]
Point = tuple[float, float, float]
Base = Annotated[str, Field(max_length=64)] | None
"""Digest of the item that a change was made on; None where there was none."""


def _printable(name: str) -> str:
    name = " ".join(name.split())
    if not name or not name.isprintable():
        raise ValueError("a name is needed: who draws?")
    return name


Author = Annotated[str, Field(max_length=80), AfterValidator(_printable)]


class _Message(BaseModel):
    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)


class SentHandle(_Message):
    """A point of a boundary to take hold of."""

    point: Point
    at: Annotated[int, Field(ge=0)] | None = None


class Sketch(_Message):
    """A boundary as it is on the page: the curve it began from, and where its handles are now."""

    of: Annotated[str, Field(max_length=64)] | None = None
    handles: Annotated[list[SentHandle], Field(min_length=3, max_length=5000)]


class Measure(_Message):
    """Boundaries to be measured."""

    boundaries: dict[Breast, Sketch]


class SketchChange(_Message):
    """A boundary that somebody changed; without a sketch it is to be found automatically."""

    base: Base
    sketch: Sketch | None


class PlaceChange(_Message):
    """A landmark that somebody changed; without points it is taken away."""

    base: Base
    points: Annotated[list[Point], Field(min_length=1, max_length=5000)] | None


class Save(_Message):
    """What somebody changed, and nothing else."""

    author: Author
    boundaries: dict[Breast, SketchChange] = {}
    landmarks: dict[str, PlaceChange] = {}


class Confirm(_Message):
    """Somebody has looked at a boundary and found it right."""

    author: Author
    name: Breast
    base: Base
    curve: Annotated[str, Field(max_length=64)]
    """Digest of the curve that was looked at."""


def sentence(errors: list[dict[str, Any]]) -> str:
    """What is wrong with a message, in words, without repeating what was sent."""
    first = errors[0]
    where = ".".join(str(part) for part in first.get("loc", ()) if part != "body")
    return f"{where or 'The request'}: {first.get('msg', 'not as expected')}."
