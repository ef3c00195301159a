"""Find a fold that a scanner did not see: a breast hangs over it, and a hole there was closed.

A scan's program or ours bridges the skin below a hanging breast. The border then runs along the bridge, and the breast
goes on behind it. See docs/decisions/0051.
"""

from __future__ import annotations

import numpy as np

from mammometry.geometry import Array, Float64
from mammometry.geometry.nearest import point_tree
from mammometry.surface.repair.repair import Provenance, RepairedSurface

_BESIDE_MM = 12.0  # from invented skin within which a border is its edge: the widest bands along which meshes are cut
_LEAST_SHARE = 0.25  # of the lower border that lies there; six breasts with hidden folds have .26 to .77
_AROUND_MM = 80.0  # of the lower border's middle, where invented skin is the fold's; half a base's width
_LEAST_CM2 = 18.0
"""Invented skin there from which a fold is hidden, cm². Telephone scans of hanging breasts have 20 to 47, of standing
women with folds that are seen in part up to 15."""


def hidden_fold_cm2(lower_world: Float64[Array, "n 3"], surface: RepairedSurface) -> float:
    """Area of the invented skin along the lower part of a border, cm². 0 where the fold is seen.

    Args:
        lower_world: the lower quarter of a breast's border, mm, world frame.
        surface: a scan. Of photographed surfaces silhouettes bound what is hidden: 0.
    """
    invented = surface.provenance == Provenance.INVENTED
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
