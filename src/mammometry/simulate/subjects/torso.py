"""Torsos: a leaning trunk with two breasts of exactly known volume.

The skin has the same triangles as the chest wall, with the vertices of the breasts moved outwards. The space between
the two surfaces is closed, and its volume is that of its triangles.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache

import numpy as np

from mammometry.geometry.arrays import Array, Bool, Float64, Int32
from mammometry.geometry.mesh import TriangleMesh, edge_table, split_edges
from mammometry.simulate.subjects.body import NOTCH_Y_MM, BodyShape, TrunkField
from mammometry.simulate.subjects.marks import mark
from mammometry.simulate.subjects.registry import SubjectRequest, add_subject, numbered
from mammometry.simulate.subjects.solid import Breast, SubjectSolid, rounded_mesh, sagged, smoothstep, waves
from mammometry.simulate.subjects.torso_shape import SIDES, BreastDesign, TorsoShape, torso_shape

_COARSE_MM = 7.0  # edges of the body before it is refined
_DEEPEST_MM, _HIGHEST_MM = 110.0, 45.0  # range of the chest wall's height relative to a breast's tangent plane
_SNAP = 0.2  # share of an edge: a vertex closer than this to the boundary is moved onto it
_VOLUME_ROUNDS = 3  # rounds of scaling a breast to its volume
_HANG_ROUNDS = 2  # rounds of pulling a breast down: the nipple's height is almost a linear function of the pull
_ARMPIT_MM = 25.0  # height above the lowest junction of arm and trunk in which the armpit's front is searched
# Made up:
_FORWARD = 0.6  # weight of straight ahead, relative to the chest's normal, in a breast's direction
_SLACK = 0.6  # pull down along the chest relative to gravity, because stretched skin yields


class _Mound:
    """One breast, as a mapping from the chest wall to the skin."""

    def __init__(self, body: TrunkField, shape: BreastDesign, side: str, lean_rad: float, seed: int) -> None:
        self.shape, self.sign, self._seed = shape, 1.0 if side == "left" else -1.0, seed
        aside, height = shape.apex_mm
        self.foot = body.on_front(np.array([self.sign * aside]), np.array([height]))[0]
        normal = body.gradient(self.foot[None])[0]
        # A direction between the chest's normal and straight ahead.
        ahead = normal / np.linalg.norm(normal) + np.array([0.0, 0.0, _FORWARD])
        self.ahead = ahead / np.linalg.norm(ahead)
        up = np.array([0.0, 1.0, 0.0]) - self.ahead[1] * self.ahead
        self.up = up / np.linalg.norm(up)
        self.aside = self.sign * np.cross(self.up, self.ahead)
        # Along gravity, and down the chest because stretched skin yields. When lying, the breast slides sideways on the
        # chest.
        pull = np.array([0.0, -math.cos(lean_rad) - _SLACK * (lean_rad >= 0), math.sin(lean_rad)])
        pull -= min(float(pull @ self.ahead), 0.0) * (lean_rad < 0) * self.ahead
        self._pull = pull / np.linalg.norm(pull)
        # The nipple's position and direction, on the mound without it.
        radii = np.array(shape.radii_mm)
        u, v = np.array(shape.nipple_place) * (radii[1], radii[2])
        around = self.foot + np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]) @ np.stack([self.aside, self.up])
        around = around + u * self.aside + v * self.up
        around = body.onto(around, np.repeat(normal[None], 3, axis=0), rounds=6)
        apex, a, b = self._dome(around)
        direction = self.sign * np.cross(a - apex, b - apex)
        self.nipple_wall, self.apex = around[0], apex
        self.direction = direction / np.linalg.norm(direction)

    def rho(self, wall: Float64[Array, "n 3"]) -> Float64[Array, " n"]:
        """Distance from the centre in base radii, or 9 elsewhere on the wall."""
        u, v, _ = self._local(wall)
        wall_mask = self._there(wall)
        return np.where(wall_mask, np.hypot(u, v), 9.0)

    def skin(self, wall: Float64[Array, "n 3"]) -> Float64[Array, "n 3"]:
        """Skin over points of the chest wall. Outside the boundary they do not move."""
        points = wall.copy()
        inside = np.flatnonzero(self.rho(wall) < 1.0)
        if not len(inside):
            return points
        dome = self._dome(wall[inside])
        if self.shape.bare:
            points[inside] = dome
            return points
        distance = np.linalg.norm(dome - self.apex, axis=1) / self.shape.areola_mm
        puff = 0.06 * self.shape.areola_mm * np.clip(1.0 - (distance / 1.2) ** 2, 0.0, None) ** 2
        bud = self.shape.nipple_mm * (1.0 - smoothstep(0.12, 1.0, distance / 0.36))
        blend = smoothstep(1.0, 0.9, self.rho(wall[inside]))
        points[inside] = dome + self.direction * ((puff + bud) * blend)[:, None]
        return points

    def areola(self, wall: Float64[Array, "n 3"]) -> Float64[Array, " n"]:
        """Share of areola colour over points of the chest wall."""
        inside = np.flatnonzero(self.rho(wall) < 1.0)
        share = np.zeros(len(wall))
        if self.shape.bare:
            return share
        dome = self._dome(wall[inside])
        wobble = 1.0 + 0.04 * waves(dome, np.random.default_rng([self._seed, 83]), shortest_mm=12, longest_mm=30)
        share[inside] = 1.0 - smoothstep(
            0.93, 1.07, np.linalg.norm(dome - self.apex, axis=1) * wobble / self.shape.areola_mm
        )
        return share

    def on_boundary(self, angle_rad: float, body: TrunkField) -> Float64[Array, 3]:
        """Point of the boundary in a direction: 0 lateral, π/2 up."""
        middle, outer, upper, lower = self.shape.radii_mm
        u, v = math.cos(angle_rad), math.sin(angle_rad)
        place = self.foot + u * (outer if u > 0 else middle) * self.aside + v * (upper if v > 0 else lower) * self.up
        return body.onto(place[None], np.repeat(self.ahead[None], 1, axis=0), rounds=60)[0]

    def place_mm(self, wall: Float64[Array, "n 3"]) -> Float64[Array, "n 2"]:
        """Position on the base, mm. Very far away for points outside the breast's own part of the chest."""
        offset = wall - self.foot
        place = np.stack([offset @ self.aside, offset @ self.up], axis=1)
        return np.where(self._there(wall)[:, None], place, 1e6)

    def _local(self, wall: Array) -> tuple[Array, Array, Array]:
        """Position on the base (radii, lateral and up), and height, mm."""
        inner, outer, upper, lower = self.shape.radii_mm
        offset = wall - self.foot
        u, v = offset @ self.aside, offset @ self.up
        return u / np.where(u > 0, outer, inner), v / np.where(v > 0, upper, lower), offset @ self.ahead

    def _there(self, wall: Array) -> Bool[Array, " n"]:
        """Whether points are on the front of the chest, on the side of the breast."""
        depth = (wall - self.foot) @ self.ahead
        return (self.sign * wall[:, 0] > 0.0) & (depth > -_DEEPEST_MM) & (depth < _HIGHEST_MM) & (wall[:, 2] > -45.0)

    def _dome(self, wall: Float64[Array, "n 3"]) -> Float64[Array, "n 3"]:
        """Skin without nipple over points inside the boundary.

        Two profiles are blended: above, a cap that tapers into the chest; below, a half ellipsoid that meets the chest
        in a fold. The mass then moves along gravity, more with increasing distance from the chest.
        """
        shape = self.shape
        u, v, _ = self._local(wall)
        rho = np.hypot(u, v)
        inwards = np.clip(1.0 - rho, 0.0, 1.0)
        delta = shape.fold_mm / float(np.mean(shape.radii_mm))
        eased = (np.sqrt(inwards**2 + delta**2) - delta) / (math.sqrt(1.0 + delta**2) - delta)
        angle = 0.5 * math.pi * (1.0 - eased)
        full = shape.fullness * smoothstep(0.35, -0.75, v)
        height = (1.0 - full) * np.clip(1.0 - rho**shape.cap, 0.0, None) ** 2 + full * np.cos(angle)
        spread = full * (np.sin(angle) / np.maximum(rho, 1e-9) - 1.0) * inwards**2 / (inwards**2 + delta**2)
        inner, outer, upper, lower = shape.radii_mm
        across = u * np.where(u > 0, outer, inner)
        along = v * np.where(v > 0, upper, lower)
        rng = np.random.default_rng([self._seed, 82])
        uneven = shape.unevenness_mm * waves(wall, rng, shortest_mm=35.0, longest_mm=110.0)
        return (
            wall
            + (spread * across)[:, None] * self.aside
            + (spread * along)[:, None] * self.up
            + (height * (shape.projection_mm + uneven))[:, None] * self.ahead
            + (sagged(height, shape.sag) * shape.hang_mm)[:, None] * self._pull
        )


@lru_cache(maxsize=8)
def _coarse_mesh(shape: BodyShape) -> TriangleMesh:
    return TrunkField(shape).coarse_mesh(_COARSE_MM)


def torso(shape: TorsoShape, *, name: str = "torso", seed: int = 0, edge_mm: float = 0.7) -> SubjectSolid:
    """Make a torso.

    Args:
        shape: measures of the torso.
        name: name of the torso.
        seed: seed of the skin's unevenness.
        edge_mm: approximate longest edge on the nipples and in the folds. Edges on the chest are up to twice, others up
            to five times as long.

    Raises:
        ValueError: the measures are inconsistent: a breast extends beyond the front of the chest.
    """
    body = TrunkField(shape.body)
    coarse = _coarse_mesh(shape.body)
    mounds: dict[str, _Mound] = {}
    for index, side in enumerate(SIDES):
        mounds[side] = _sized(body, coarse, shape.breasts[side], side, shape.lean_rad, 2 * seed + index)
    standing = {side: mound for side, mound in mounds.items() if not mound.shape.removed}
    wall, faces = _refined(body, coarse, mounds, edge_mm)
    for mound in standing.values():
        wall, faces = _cut_along_boundary(body, wall, faces, mound)
    skin = wall
    for mound in standing.values():
        skin = mound.skin(skin)
    bare = np.all(skin == wall, axis=1)
    marked = mark(shape.marks, {side: mound.place_mm(wall) for side, mound in mounds.items()})
    if marked is not None:
        for side, height in marked.height_mm.items():
            skin = skin + height[:, None] * mounds[side].ahead
    mesh = rounded_mesh(skin, faces)
    wall_vertices = rounded_mesh(wall, faces).vertices.copy()
    wall_vertices[bare] = mesh.vertices[bare]
    rho = {side: mound.rho(wall) for side, mound in standing.items()}
    breasts = {side: _breast(faces, rho[side], wall, mound) for side, mound in standing.items()}
    feet = [mounds[side].apex for side in SIDES]
    solid = SubjectSolid(
        name=name,
        subject_kind="torso",
        mesh=mesh,
        back_vertices=0,
        areola=np.clip(sum((mound.areola(wall) for mound in standing.values()), np.zeros(len(wall))), 0.0, 1.0).astype(
            np.float32
        ),
        base_boundary=None,
        wall_vertices=wall_vertices,
        breasts=breasts,
        landmarks=_landmarks(body, mounds, mesh, wall_vertices),
        tint=None if marked is None else marked.tint,
        lean_rad=shape.lean_rad,
        middle=np.mean(feet, axis=0) + np.array([0.0, 28.0, -38.0]),
        facts={
            "kind": "torso",
            "closed": True,
            "lean_deg": math.degrees(shape.lean_rad),
            "chest_width_mm": 2.0 * shape.body.half_width_mm,
            "chest_flatness": shape.body.flatness,
            "hang_mm": {side: mound.shape.hang_mm for side, mound in standing.items()},
            **({"removed": [side for side in SIDES if side not in standing]} if len(standing) < len(SIDES) else {}),
            "breast": "all between the skin and the skin that the same body has without it; the boundary is where they "
            "part, which lies outside the visible fold and slope",
        },
    )
    for side in standing:  # the truth needs an exact volume
        if not solid.closed_breast(side).is_watertight():
            raise ValueError(f"{name} of seed {seed} has a {side} breast that is not closed; choose another number")
    return solid


@add_subject("torso", has=numbered("torso"), choices="torso, torso_1, torso_2 …", has_patients=True)
def _torso(wanted: SubjectRequest) -> SubjectSolid:
    shape = torso_shape(wanted.name, wanted.seed)
    if wanted.reshape is not None:
        shape = wanted.reshape(shape)
    solid = torso(shape, name=wanted.name, seed=wanted.seed, edge_mm=wanted.edge_mm)
    if wanted.reshape is not None and not solid.mesh.is_watertight():
        raise ValueError(f"{wanted.name} of seed {wanted.seed} is not closed as it is disturbed; choose another seed")
    return solid


def _sized(
    body: TrunkField, coarse: TriangleMesh, shape: BreastDesign, side: str, lean_rad: float, seed: int
) -> _Mound:
    """The breast scaled to its volume, to a few per cent."""
    mound = _hung(body, shape, side, lean_rad, seed)
    near = (mound.rho(coarse.vertices) < 1.2)[coarse.faces].any(axis=1)
    patch = coarse.submesh(near)
    vertices, faces = patch.vertices, patch.faces
    for _ in range(2):
        vertices, faces = _halved(body, vertices, faces)
    for _ in range(_VOLUME_ROUNDS):
        skin = mound.skin(vertices)
        # Both have the same open rim, so the breast is the difference between the volumes that they enclose with any
        # point.
        middle = vertices.mean(axis=0)
        swept = _cone_mm3(skin - middle, faces) - _cone_mm3(vertices - middle, faces)
        shape = replace(mound.shape, projection_mm=mound.shape.projection_mm * shape.volume_cc * 1000.0 / swept)
        mound = _hung(body, shape, side, lean_rad, seed)
    return mound


def _hung(body: TrunkField, shape: BreastDesign, side: str, lean_rad: float, seed: int) -> _Mound:
    """The breast pulled down until its nipple has the required distance below the fold."""
    mound = _Mound(body, shape, side, lean_rad, seed)
    for _ in range(_HANG_ROUNDS if shape.below_fold_mm is not None else 0):
        fold_y = mound.on_boundary(-0.5 * math.pi, body)[1]
        further = _Mound(body, replace(mound.shape, hang_mm=mound.shape.hang_mm + 1.0), side, lean_rad, seed)
        missing_mm = shape.below_fold_mm - (fold_y - mound.apex[1])
        hang_mm = mound.shape.hang_mm + missing_mm / (mound.apex[1] - further.apex[1])
        mound = _Mound(body, replace(mound.shape, hang_mm=hang_mm), side, lean_rad, seed)
    return mound


def _cone_mm3(vertices: Array, faces: Array) -> float:
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0)


def _halved(body: TrunkField, vertices: Array, faces: Array) -> tuple[Float64[Array, "n 3"], Int32[Array, "m 3"]]:
    edges, of_face = edge_table(faces)
    middle = vertices[edges].mean(axis=1)
    middle = body.onto(middle, body.gradient(middle))
    every = np.ones(len(edges), dtype=bool)
    return np.concatenate([vertices, middle]), split_edges(faces, of_face, every, len(vertices))


def _refined(
    body: TrunkField, coarse: TriangleMesh, mounds: Mapping[str, _Mound], edge_mm: float
) -> tuple[Float64[Array, "n 3"], Int32[Array, "m 3"]]:
    """The chest wall, refined until the edges of the skin are short."""
    wall, faces = coarse.vertices, coarse.faces
    gradient = body.gradient(wall)
    skin = _skin(wall, mounds)
    limit = _edge_limit(wall, skin, mounds, edge_mm)
    for _ in range(12):
        edges, of_face = edge_table(faces)
        first, second = edges.T
        length = np.linalg.norm(skin[first] - skin[second], axis=1)
        split = length > np.minimum(limit[first], limit[second])
        if not split.any():
            break
        a, b = first[split], second[split]
        slope = 0.5 * (gradient[a] + gradient[b])
        middle = body.onto(0.5 * (wall[a] + wall[b]), slope)
        over = _skin(middle, mounds)
        faces = split_edges(faces, of_face, split, len(wall))
        wall, gradient = np.concatenate([wall, middle]), np.concatenate([gradient, slope])
        skin = np.concatenate([skin, over])
        limit = np.concatenate([limit, _edge_limit(middle, over, mounds, edge_mm)])
    return wall, faces


def _skin(wall: Float64[Array, "n 3"], mounds: Mapping[str, _Mound]) -> Float64[Array, "n 3"]:
    for mound in mounds.values():  # each moves only vertices on its own side
        wall = mound.skin(wall)
    return wall


def _edge_limit(wall: Array, skin: Array, mounds: Mapping[str, _Mound], edge_mm: float) -> Float64[Array, " n"]:
    """Longest allowed edge at each vertex: short on nipples and in folds."""
    limit = np.full(len(wall), np.inf)
    for mound in mounds.values():
        rho = mound.rho(wall)
        nipple = np.linalg.norm(skin - mound.apex, axis=1) < 0.6 * mound.shape.areola_mm
        near = np.clip(2.0 + 8.0 * (rho - 1.2), 2.0, 5.0) * edge_mm
        near = np.where((np.abs(rho - 0.98) < 0.08) | nipple, 1.2 * edge_mm, near)
        limit = np.minimum(limit, near)
    front = np.clip(3.0 + (20.0 - wall[:, 2]) / 25.0 + np.maximum(np.abs(wall[:, 1]) - 190.0, 0.0) / 20.0, 3.0, 9.0)
    return np.minimum(np.maximum(limit, 1.2 * edge_mm), front * edge_mm)


def _cut_along_boundary(
    body: TrunkField, wall: Float64[Array, "n 3"], faces: Int32[Array, "m 3"], mound: _Mound
) -> tuple[Float64[Array, "n 3"], Int32[Array, "m 3"]]:
    """Make edges along the boundary ρ = 1 by moving vertices and splitting edges."""
    wall = wall.copy()
    edges, of_face = edge_table(faces)
    first, second = edges.T
    rho = mound.rho(wall)
    crossing = ((rho[first] - 1.0) * (rho[second] - 1.0) < 0.0) & (np.maximum(rho[first], rho[second]) < 2.0)
    share = np.full(len(edges), 0.5)
    share[crossing] = (1.0 - rho[first[crossing]]) / (rho[second[crossing]] - rho[first[crossing]])
    # A vertex near the crossing of one of its edges is moved to the nearest such crossing.
    near, far = np.concatenate([first, second]), np.concatenate([second, first])
    share = np.concatenate([share, 1.0 - share])
    few = np.flatnonzero(np.tile(crossing, 2) & (share < _SNAP))
    few = few[np.argsort(share[few], kind="stable")]
    few = few[np.unique(near[few], return_index=True)[1]]
    wall[near[few]] = _onto_boundary(body, wall[near[few]], wall[far[few]], mound)
    rho = mound.rho(wall)
    rho[np.abs(rho - 1.0) < 1e-7] = 1.0
    split = ((rho[first] - 1.0) * (rho[second] - 1.0) < 0.0) & (np.maximum(rho[first], rho[second]) < 2.0)
    middle = _onto_boundary(body, wall[first[split]], wall[second[split]], mound)
    return np.concatenate([wall, middle]), split_edges(faces, of_face, split, len(wall))


def _onto_boundary(body: TrunkField, start: Array, end: Array, mound: _Mound) -> Float64[Array, "n 3"]:
    """Where a segment crosses the boundary (bisection in ρ)."""
    if not len(start):
        return start
    low, high = np.zeros(len(start)), np.ones(len(start))
    outside = mound.rho(start) > 1.0
    slope = body.gradient(0.5 * (start + end))
    point = start
    for _ in range(36):
        share = 0.5 * (low + high)
        point = body.onto(start + share[:, None] * (end - start), slope)
        before = (mound.rho(point) > 1.0) == outside
        low, high = np.where(before, share, low), np.where(before, high, share)
    return point


def _breast(faces: Array, rho: Float64[Array, " n"], wall: Array, mound: _Mound) -> Breast:
    """Faces inside the boundary, and the boundary's vertices in order of direction."""
    inside = rho < 1.0 - 1e-7
    skin_faces = np.flatnonzero(inside[faces].any(axis=1))
    around = np.unique(faces[skin_faces][~inside[faces[skin_faces]]])
    offset = wall[around] - mound.foot
    order = np.argsort(np.arctan2(offset @ mound.up, offset @ mound.aside))
    return Breast(skin_faces=skin_faces.astype(np.int32), boundary=around[order].astype(np.int32))


def _landmarks(
    body: TrunkField, mounds: Mapping[str, _Mound], mesh: TriangleMesh, wall: Float64[Array, "n 3"]
) -> dict[str, Float64[Array, "k 3"]]:
    """Points on the skin, named as in an anthropometric protocol."""
    zero = np.zeros(1)
    found = {"sternal_notch": body.on_front(zero, np.array([NOTCH_Y_MM - 4.0]))}
    heights = np.arange(NOTCH_Y_MM - 4.0, -131.0, -5.0)
    found["midline"] = body.on_front(np.zeros(len(heights)), heights)
    in_arm = body.in_arm(wall)
    for side, mound in mounds.items():
        if not (mound.shape.removed or mound.shape.bare):
            found[f"nipple_{side}"] = mound.skin(mound.nipple_wall[None])
        if not mound.shape.removed:
            found[f"inframammary_fold_{side}"] = mound.on_boundary(-0.5 * math.pi, body)[None]
            found[f"lateral_{side}"] = mound.on_boundary(0.0, body)[None]
            found[f"medial_{side}"] = mound.on_boundary(math.pi, body)[None]
        # The armpit's front: where arm and trunk meet, facing ahead, just above the lowest such point. From there a
        # line straight down the trunk.
        edge = in_arm[mesh.faces].any(axis=1) & ~in_arm[mesh.faces].all(axis=1)
        crease = wall[np.unique(mesh.faces[edge])]
        crease = crease[crease[:, 0] * mound.sign > 0]
        crease = crease[crease[:, 1] < crease[:, 1].min() + _ARMPIT_MM]
        fold = crease[np.argmax(crease[:, 2])]
        heights = fold[1] - np.arange(0.0, 121.0, 5.0)
        ahead = np.array([fold[0], 0.0, fold[2]]) / math.hypot(fold[0], fold[2])
        axis = np.stack([np.zeros_like(heights), heights, np.zeros_like(heights)], axis=1)
        line = body.outwards(axis, ahead, 1.15 * body.shape.half_width_mm)
        standing = {name: other for name, other in mounds.items() if not other.shape.removed}
        found[f"anterior_axillary_line_{side}"] = _skin(line, standing)
    return found
