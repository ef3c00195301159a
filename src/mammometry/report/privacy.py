"""How much of the subject a report shows.

De-identified reports contain no name from the session, no identifier, no date and no photograph, and show photographic
colours only below the sternal notch, so that no face is visible. With geometry only, there are no photographic colours.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from mammometry.geometry.arrays import Array, Bool, Float64
from mammometry.report.figures.catalogue import shows_photographs
from mammometry.surface.texture.texture import TexturedMesh

WHOLE = "photographs of the subject, and no name except those in its heading"
"""What a full report contains."""
_GREY = 176  # grey level (0–255) that replaces a colour; appearance only


@dataclass(frozen=True, slots=True, kw_only=True)
class Privacy:
    """How much of the subject a report shows."""

    deidentify: bool = False
    """Whether to leave out names, the identifier, dates, photographs, and colours above the sternal notch."""
    geometry_only: bool = False
    """Whether to leave out all photographic colours."""

    @property
    def guarded(self) -> bool:
        """Whether anything is left out."""
        return self.deidentify or self.geometry_only


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Guarded:
    """A surface in the colours that may be shown."""

    textured: TexturedMesh
    contains: str
    """What the report contains, as text for its reader."""


def guard(
    textured: TexturedMesh,
    privacy: Privacy,
    *,
    subject_kind: str,
    up_world: Float64[Array, 3],
    landmarks: Mapping[str, Float64[Array, "k 3"]],
) -> Guarded:
    """Replace the colours that must not be shown by grey.

    Args:
        textured: the surface in its photographic colours, world frame, mm.
        privacy: what to leave out.
        subject_kind: ``model``, ``torso`` or ``surface``. Only a torso has a face above it.
        up_world: direction towards the patient's head, unit vector, world frame.
        landmarks: a torso's colours are shown below its ``sternal_notch``. Without that landmark, none are.
    """
    if privacy.geometry_only:
        return Guarded(
            textured=_greyed(textured, np.ones(len(textured.colours), dtype=bool)),
            contains="the shape of the body's surface, but no photograph and no photographic colour"
            + (", no name and no date" if privacy.deidentify else ""),
        )
    if not privacy.deidentify:
        return Guarded(textured=textured, contains=WHOLE)
    if subject_kind != "torso":
        return Guarded(
            textured=textured,
            contains="the surface in its photographic colours, but no whole photograph, no name and no date",
        )
    notch = landmarks.get("sternal_notch")
    if notch is None:
        return Guarded(
            textured=_greyed(textured, np.ones(len(textured.colours), dtype=bool)),
            contains="the shape of the body's surface, but no photograph, no name and no date. Its colours are left "
            "out, because no sternal notch was marked",
        )
    above = (textured.mesh.vertices - notch[0]) @ up_world > 0
    return Guarded(
        textured=_greyed(textured, above),
        contains="the surface, with photographic colours only below the sternal notch, but no whole photograph, no "
        "name and no date",
    )


def without_photographs(pictures: Mapping[str, Mapping[str, bytes]]) -> dict[str, dict[str, bytes]]:
    """Stage → name → picture, without pictures that show photographs.

    Photographs also show the background.
    """
    return {
        stage: {name: png for name, png in drawn.items() if not shows_photographs(name)}
        for stage, drawn in pictures.items()
    }


def _greyed(textured: TexturedMesh, hidden: Bool[Array, " n"]) -> TexturedMesh:
    colours = np.where(hidden[:, None], np.uint8(_GREY), textured.colours)
    return TexturedMesh(mesh=textured.mesh, colours=colours)
