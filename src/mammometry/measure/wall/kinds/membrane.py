"""A wall as a film of soap would hang in the boundary."""

from __future__ import annotations

import numpy as np
from scipy.sparse.linalg import splu

from mammometry.geometry.arrays import Array, Float64
from mammometry.measure.solid.patch import Patch, cotangent_laplacian, harmonic
from mammometry.measure.solid.sew import Closed, sew
from mammometry.measure.wall.heights import SPACING_MM, best_plane
from mammometry.measure.wall.open_breast import OpenBreast
from mammometry.measure.wall.registry import CAST_WALLS, TORSO_WALLS, add_wall

_ROUNDS = 6  # of harmonic over itself; Scherk's surface is met after them (tests/unit/measure/test_walls.py)


@add_wall(
    TORSO_WALLS,
    CAST_WALLS,
    name="membrane",
    place=5,
    flat_u95_mm=9.2,
    sees_the_chest=False,
    definition="the surface of least area through the boundary, as a film of soap would hang in it",
)
def membrane(breast: OpenBreast) -> Closed:
    """Surface of least area: harmonic height, then harmonic over itself (Pinkall, Polthier)."""
    part = breast.part
    chart = best_plane(part)
    loops = tuple(chart.flatten(part.mesh.vertices[loop]) for loop in part.loops)

    def lift(patch: Patch) -> Float64[Array, "k 3"]:
        rim, b = np.concatenate(loops), patch.n_loop
        places = np.concatenate([patch.points, harmonic(patch, rim[:, 2:])], axis=1)
        for _ in range(_ROUNDS):
            laplacian = cotangent_laplacian(places, patch.faces)
            places[b:] = splu(laplacian[b:, b:].tocsc()).solve(-(laplacian[b:, :b] @ rim))
        return chart.world(places[b:])

    return sew(part, tuple(loop[:, :2] for loop in loops), lift, spacing_mm=SPACING_MM, subject="membrane wall")
