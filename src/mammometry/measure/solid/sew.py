"""Sew a wall onto a skin's opening, into a closed solid."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mammometry.base.errors import CrossingError, MeasureError
from mammometry.geometry.arrays import Array, Float64
from mammometry.geometry.mesh import TriangleMesh
from mammometry.measure.solid.cut import OpenPart
from mammometry.measure.solid.patch import Patch, fill
from mammometry.measure.solid.untangle import signed_area_mm2

Lift = Callable[[Patch], Float64[Array, "k 3"]]
"""World positions, mm, of a patch's inner points."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Closed:
    """A skin and the wall that closes it, world frame, mm."""

    wall: TriangleMesh
    """The wall alone, open, its normals pointing away from the skin."""
    skin: TriangleMesh
    """The skin alone, open."""
    solid: TriangleMesh
    """Both, sewn together without a gap. The skin's faces come first."""
    kind: str | None = None
    """Name of the resulting wall, if not the requested one: a cylinder may turn out flat."""
    definition: str | None = None
    """Definition of the wall, one sentence, if it depends on the breast: the radius of a cylinder."""


def sew(
    part: OpenPart, flat_loops: tuple[Float64[Array, "_ 2"], ...], lift: Lift, *, spacing_mm: float | None, subject: str
) -> Closed:
    """Close an open skin.

    Args:
        part: the skin; its loops run counter-clockwise around it for a viewer outside.
        flat_loops: each loop laid flat as that viewer sees it, mm.
        lift: where the wall's inner points go.
        spacing_mm: distance of the wall's inner points; None for a flat wall, which needs none.
        subject: whose skin, for messages.

    Raises:
        MeasureError: the skin has no opening, or the opening laid flat runs the wrong way.
    """
    if not part.loops:
        raise MeasureError(
            subject,
            found="a surface without an opening where the wall should meet it",
            expected="a wall that cuts the surface",
            remedy="Check the boundary: it must run around the breast, on the surface",
        )
    turning = sum(signed_area_mm2(loop) for loop in flat_loops)
    if turning <= 0:
        raise CrossingError(
            subject,
            found="a boundary that runs the wrong way round when laid flat",
            expected="a simple closed curve around the breast",
            remedy="Redraw the boundary, or choose another wall with --set measure.wall=plane",
        )
    patch = fill(flat_loops, spacing_mm)
    loop = np.concatenate(part.loops)
    inner = lift(patch) if len(patch.points) > patch.n_loop else np.empty((0, 3))
    faces = patch.faces[:, ::-1]
    wall = TriangleMesh(
        vertices=np.concatenate([part.mesh.vertices[loop], inner]), faces=np.ascontiguousarray(faces, dtype=np.int32)
    )
    number = np.concatenate([loop, len(part.mesh.vertices) + np.arange(len(inner))])
    closed = TriangleMesh(
        vertices=np.concatenate([part.mesh.vertices, inner]),
        faces=np.concatenate([part.mesh.faces, number[faces].astype(np.int32)]),
    )
    return Closed(wall=wall, skin=part.mesh, solid=closed)
