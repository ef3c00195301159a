"""The boundary's best plane as a wall."""

from __future__ import annotations

import numpy as np

from mammometry.geometry.mesh import TriangleMesh
from mammometry.measure.solid.patch import fill
from mammometry.measure.solid.sew import Closed
from mammometry.measure.wall.heights import best_plane
from mammometry.measure.wall.open_breast import OpenBreast
from mammometry.measure.wall.registry import TORSO_WALLS, add_wall


@add_wall(
    TORSO_WALLS,
    name="plane",
    place=8,
    flat_u95_mm=9.5,
    sees_the_chest=False,
    definition="the boundary's best-fitting plane, joined to it by a skirt along the plane's normal",
)
def plane(breast: OpenBreast) -> Closed:
    """The boundary's best plane, joined to it by a skirt. The skirt runs along the plane's normal."""
    part = breast.part
    chart = best_plane(part)
    patch = fill(tuple(chart.flatten(part.mesh.vertices[loop])[:, :2] for loop in part.loops))
    loop = np.concatenate(part.loops)
    n, n_skin = len(loop), len(part.mesh.vertices)
    sunk = chart.world(np.concatenate([patch.points, np.zeros((n, 1))], axis=1))
    upper, follower = [], []
    start = 0
    for ring in part.loops:
        index = np.arange(start, start + len(ring))
        upper.append(index)
        follower.append(np.roll(index, -1))
        start += len(ring)
    a, b = np.concatenate(upper), np.concatenate(follower)
    skirt = np.concatenate([np.stack([b, a, a + n], axis=1), np.stack([b, a + n, b + n], axis=1)])
    faces = np.concatenate([skirt, patch.faces[:, ::-1] + n])
    wall = TriangleMesh(vertices=np.concatenate([part.mesh.vertices[loop], sunk]), faces=faces.astype(np.int32))
    number = np.concatenate([loop, n_skin + np.arange(n)])
    closed = TriangleMesh(
        vertices=np.concatenate([part.mesh.vertices, sunk]),
        faces=np.concatenate([part.mesh.faces, number[faces].astype(np.int32)]),
    )
    return Closed(wall=wall, skin=part.mesh, solid=closed)
