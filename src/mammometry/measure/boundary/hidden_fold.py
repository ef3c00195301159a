"""Detection of a fold that is hidden from a scanner by a hanging breast.

The hole below the breast is closed by a bridge of invented skin, along which the border runs (docs/decisions/0051).
"""

from __future__ import annotations

import numpy as np

from mammometry.geometry import Array, Float64
from mammometry.geometry.nearest import point_tree
from mammometry.surface.repair.repair import Provenance, RepairedSurface

_BESIDE_MM = 12.0  # largest distance of the border from invented skin: half width of the band along which it is cut
_LEAST_SHARE = 0.25  # least share of the lower border near invented skin; six hidden folds have 0.26 to 0.77
_AROUND_MM = 80.0  # largest distance of the invented skin from the lower border's middle: half a base's width
_LEAST_CM2 = 18.0
"""Least area of invented skin there, cm². Telephone scans of hanging breasts have 20 to 47, of standing women with
partly visible folds up to 15."""


def hidden_fold_cm2(lower_world: Float64[Array, "n 3"], surface: RepairedSurface) -> float:
    """Area of the invented skin along the lower part of a border, cm². 0 if the fold is visible.

    Args:
        lower_world: the lower quarter of a breast's border, mm, world frame.
        surface: a scan. The result is 0 for photographed surfaces, whose hidden skin is bounded by silhouettes.
    """
    invented = np.isin(surface.provenance, (Provenance.INVENTED, Provenance.BRIDGED))
    if surface.pair_names or not invented.any():
        return 0.0
    mesh = surface.mesh
    away_mm = np.asarray(point_tree(mesh.vertices[invented]).query(lower_world)[0])
    if (away_mm < _BESIDE_MM).mean() < _LEAST_SHARE:
        return 0.0
    bridged = mesh.submesh(np.flatnonzero(invented[mesh.faces].any(axis=1)))
    near = np.linalg.norm(bridged.corners().mean(axis=1) - lower_world.mean(axis=0), axis=1) < _AROUND_MM
    area_cm2 = float(np.linalg.norm(bridged.face_vectors()[near], axis=1).sum()) / 100
    return area_cm2 if area_cm2 >= _LEAST_CM2 else 0.0
