"""What a report gives away, and how to give away less.

De-identified: no name of the session, no identifier of the subject, no date, no photograph; photographic colours only
below the sternal notch, so that no face shows. Geometry only: no photographic colours at all.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from mammometry.geometry.arrays import Array, Bool, Float64
from mammometry.report.figures.catalogue import shows_photographs
from mammometry.surface.texture import TexturedMesh

WHOLE = "photographs of the subject, but no name beyond those in its heading"
"""What a page holds that leaves nothing out, in words."""
_GREY = 176


@dataclass(frozen=True, slots=True, kw_only=True)
class Privacy:
    """How much of the subject a report shows."""

    deidentify: bool = False
    """Leave out names, the identifier, dates and photographs, and colours above the clavicle."""
    geometry_only: bool = False
    """Leave out all photographic colours."""

    @property
    def guarded(self) -> bool:
        """Whether anything is left out."""
        return self.deidentify or self.geometry_only


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Guarded:
    """A surface with what may be shown of its colours."""

    textured: TexturedMesh
    contains: str
    """What the report holds of the subject, in words for its reader."""


def guard(
    textured: TexturedMesh,
    privacy: Privacy,
    *,
    subject_kind: str,
    up_world: Float64[Array, 3],
    landmarks: Mapping[str, Float64[Array, "k 3"]],
) -> Guarded:
    """Grey out the colours that must not be shown.

    Args:
        textured: the surface in its photographic colours, world frame, mm.
        privacy: what is wanted.
        subject_kind: model, torso or surface; only a torso has a face above it.
        up_world: towards the patient's head, unit vector, world frame.
        landmarks: ``sternal_notch`` says where the clavicles are. Without it none of a torso's colours are shown.
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
            contains="the shape of the body's surface, but no photograph, no name and no date; its photographic "
            "colours are left out because no sternal notch was marked below which they could be shown",
        )
    above = (textured.mesh.vertices - notch[0]) @ up_world > 0
    return Guarded(
        textured=_greyed(textured, above),
        contains="the surface, in its photographic colours below the sternal notch only, but no whole photograph, no "
        "name and no date",
    )


def without_photographs(pictures: Mapping[str, Mapping[str, bytes]]) -> dict[str, dict[str, bytes]]:
    """Stage → name → picture, without those that show photographs and so whatever stood behind the subject."""
    return {
        stage: {name: png for name, png in drawn.items() if not shows_photographs(name)}
        for stage, drawn in pictures.items()
    }


def _greyed(textured: TexturedMesh, hidden: Bool[Array, " n"]) -> TexturedMesh:
    colours = np.where(hidden[:, None], np.uint8(_GREY), textured.colours)
    return TexturedMesh(mesh=textured.mesh, colours=colours)
