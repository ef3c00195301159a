"""Short warnings that stand beside a volume."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from mammometry.base.machine.cores import available_cores
from mammometry.geometry.arrays import bounds
from mammometry.geometry.nearest import point_tree
from mammometry.measure.trunk.head import HEAD_NOT_SHOWN
from mammometry.measure.volume.measurement import VolumeMeasurement
from mammometry.report.figures.drawing.sides import wall_faces
from mammometry.surface.repair.repair import Provenance, RepairedSurface

SKIN_MEASURED = 0.8
"""Share of a breast's skin that should be measured, not closed by the elastic repair. Chosen by eye."""
_AROUND_MM = 10.0  # around a breast: its skin is a part of the surface, a cube's edge from its vertices at most


def own_cautions(measured: VolumeMeasurement, shares: Mapping[Provenance, float] | None = None) -> Iterator[str]:
    """Warn of what changes the meaning of one volume.

    Args:
        measured: one breast.
        shares: of its skin, by origin. None if they are not known.
    """
    if not measured.watertight:
        yield "Do not use this volume: its solid is not watertight."
    if HEAD_NOT_SHOWN in measured.boundary_method:
        yield "Left and right may be exchanged: the body does not show where its head is. See the warnings."
    if shares is not None and shares[Provenance.MEASURED] < SKIN_MEASURED:
        yield f"Only {100 * shares[Provenance.MEASURED]:.0f} % of its skin was measured."


def skin_shares(measured: VolumeMeasurement, repaired: RepairedSurface) -> dict[Provenance, float]:
    """Share of a breast's skin of each origin.

    The origin is that of the nearest vertex of the whole surface.
    """
    skin = ~wall_faces(measured)
    middles = measured.closed.corners()[skin].mean(axis=1)
    areas = np.linalg.norm(measured.closed.face_vectors()[skin], axis=1)
    low, high = bounds(middles)
    near = repaired.mesh.vertices_between(low - _AROUND_MM, high + _AROUND_MM)
    near = near if len(near) else np.arange(len(repaired.mesh.vertices))
    nearest = point_tree(repaired.mesh.vertices[near]).query(middles, workers=available_cores())[1]
    sums = np.bincount(repaired.provenance[near[nearest]], areas, minlength=len(Provenance))
    return {kind: float(sums[kind] / max(areas.sum(), 1e-12)) for kind in Provenance}
