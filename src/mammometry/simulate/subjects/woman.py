"""Virtual women whose muscle, layer over it, and breasts are known exactly.

Three surfaces have the same triangles: the skin, the flat chest (muscle and layer, like a chest without a breast), and
the muscle. The space between any two of them within the boundary is closed, and its volume is that of its triangles.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline, LinearNDInterpolator
from scipy.spatial import Delaunay, cKDTree

from mammometry.base.errors import UnknownWordError
from mammometry.geometry import Array, Bool, Float64, Int32, TriangleMesh
from mammometry.simulate.subjects.registry import SubjectRequest, add_subject
from mammometry.simulate.subjects.solid import Breast, SubjectSolid, rounded_mesh, smoothstep, waves
from mammometry.simulate.subjects.woman_shape import (
    MUSCLE_ASIDE_MM,
    SIDES,
    Pose,
    WomanBreast,
    WomanShape,
    outline_area_mm2,
    outline_mm,
    woman_shape,
)

_TALL_MM = 175.0  # distance of the trunk's ends above and below the breasts' centre
_PROFILE_MM = 115.0  # length of a breast's profile, which is divided into edges
_STEP_MM = 0.5  # step of the differences for a surface's normal
_SMOOTH_ANGLE_RAD = math.radians(110.0)  # direction in which a breast tapers most gradually: up and slightly inwards
_NIPPLE_MM, _AREOLA_MM = 4.0, 20.0  # height of the nipple above the breast, and radius of the areola, mm
_VOLUME_ROUNDS = 4  # rounds of scaling the height until the breast has its volume
_BEYOND_MM = 15.0  # least depth of an open front mesh behind the boundaries
_LAYER_BACK_MM = 15.0  # thickness of the layer at the flanks, beyond both breasts
_SHOW_MM = 2.5  # ratio of edge lengths away from the breasts to those on them


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Woman:
    """A solid and the anatomy behind its breasts."""

    solid: SubjectSolid
    """The closed body. Its walls are the flat chest."""
    muscle_vertices: Float64[Array, "n 3"]
    """Points on the muscle straight behind the solid's front vertices, mm."""
    shape: WomanShape
    """Her measures."""

    def muscle_cc(self, side: str) -> float:
        """Volume from the skin to the muscle within the boundary, cc."""
        breast = self.solid.breasts[side]
        faces, count = self.solid.mesh.faces[breast.skin_faces], len(self.muscle_vertices)
        rim, following = breast.boundary, np.roll(breast.boundary, -1)
        around = np.concatenate(
            [
                np.stack([rim, rim + count, following + count], axis=1),
                np.stack([rim, following + count, following], axis=1),
            ]
        )
        both = np.concatenate([self.solid.mesh.vertices, self.muscle_vertices])
        closed = TriangleMesh(vertices=both, faces=np.concatenate([faces, faces[:, ::-1] + count, around]))
        closed = closed.submesh(np.arange(len(closed.faces)))
        if not closed.is_watertight():
            raise ValueError(f"{self.solid.name}: the volume in front of the muscle is not closed")
        return closed.volume_mm3() / 1000

    def layer_mm(self, side: str) -> dict[str, float]:
        """Thickness of the layer normal to the muscle at the boundary, by quadrant, mm."""
        lateral, upper, medial, lower = self.shape.breasts[side].layer_mm
        return {"lateral": lateral, "upper": upper, "medial": medial, "lower": lower}

    def front(self) -> TriangleMesh:
        """The open mesh of a scanner that sees only the front."""
        return front_of(self.solid, self.shape.cut_mm)


def front_of(solid: SubjectSolid, cut_mm: float) -> TriangleMesh:
    """Front skin within `cut_mm` of the foremost point, and at least as far back as the boundaries."""
    vertices = solid.mesh.vertices
    behind = min(float(vertices[breast.boundary, 2].min()) for breast in solid.breasts.values()) - _BEYOND_MM
    limit = min(float(vertices[:, 2].max()) - cut_mm, behind)
    around = vertices[np.concatenate([breast.boundary for breast in solid.breasts.values()]), 1]
    tall = (vertices[:, 1] > around.min() - 60.0) & (vertices[:, 1] < around.max() + 60.0)
    keep = (vertices[:, 2] > limit) & tall
    mesh = solid.mesh.submesh(keep[solid.mesh.faces].all(axis=1))
    _, label = mesh.components()
    largest = np.argmax(np.bincount(label[mesh.faces[:, 0]]))
    return mesh.submesh(label[mesh.faces[:, 0]] == largest)


class _Chest:
    """Muscle and flat skin as functions of (arc around the trunk, height), mm."""

    def __init__(self, shape: WomanShape) -> None:
        self.shape = shape
        half = {}
        for side, sign in (("left", 1.0), ("right", -1.0)):
            heights = shape.muscle_mm[side]
            lateral = heights[-1]
            far = shape.side_mm
            half[side] = np.array(
                [
                    *([sign * x, z] for x, z in zip(MUSCLE_ASIDE_MM, heights, strict=True)),
                    [sign * (far - 5.0), 0.5 * lateral - 62.0],
                    [sign * far, -0.53 * shape.thick_mm],
                    [sign * (far - 22.0), -0.76 * shape.thick_mm],
                    [sign * 0.6 * far, -0.95 * shape.thick_mm],
                ]
            )
        back = np.array([[0.0, -shape.thick_mm]])
        front = np.array([[0.0, 0.0]])
        loop = np.concatenate([back, half["right"][::-1], front, half["left"], back])
        along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(loop, axis=0), axis=1))])
        along -= along[1 + len(half["right"])]
        self.low, self.high = float(along[0]), float(along[-1])
        self._section = CubicSpline(along, loop, bc_type="periodic")
        self._rough = np.random.default_rng([shape.seed, 5]).integers(1 << 31)
        fine = np.linspace(0.0, self.high, 400)
        self._middles = {}
        for side, sign in (("left", 1.0), ("right", -1.0)):
            x = np.abs(self._section(sign * fine)[:, 0])
            rising = np.argmax(x) + 1
            self._middles[side] = float(np.interp(shape.breasts[side].middle_mm[0], x[:rising], fine[:rising]))

    def muscle(self, flat: Float64[Array, "n 2"]) -> Float64[Array, "n 3"]:
        """Points on the muscle."""
        arc, y = flat.T
        x, z = self._section(arc).T
        shape = self.shape
        front = smoothstep(-0.85 * shape.thick_mm, -60.0, z)
        beside = np.clip(np.abs(x), 0.0, 140.0) - 75.0
        z = z + front * (-shape.slope * y - shape.along_per_mm * y**2 / 2 + shape.twist_per_mm * beside * y)
        points = np.stack([x, y, z], axis=1)
        rough = waves(points, np.random.default_rng(self._rough), shortest_mm=60.0, longest_mm=200.0)
        points[:, 2] += front * shape.rough_mm * rough
        return points

    def layer_mm(self, flat: Float64[Array, "n 2"]) -> Float64[Array, " n"]:
        """Thickness of the layer over the muscle."""
        found = {}
        for side, sign in (("left", 1.0), ("right", -1.0)):
            breast = self.shape.breasts[side]
            lateral, upper, medial, lower = breast.layer_mm
            across = (sign * flat[:, 0] - self._middles[side]) / (0.54 * breast.width_mm)
            up = (flat[:, 1] - breast.middle_mm[1]) / (0.5 * breast.height_mm)
            rho = np.hypot(across, up)
            inside = np.minimum(rho, 1.0) / np.maximum(rho, 1e-9)
            across, up = across * inside, up * inside
            mean = (lateral + upper + medial + lower) / 4
            oblong = (lateral + medial - upper - lower) / 4
            found[side] = (
                mean + (lateral - medial) / 2 * across + (upper - lower) / 2 * up + oblong * (across**2 - up**2)
            )
        share = smoothstep(-18.0, 18.0, flat[:, 0])
        layer = share * found["left"] + (1 - share) * found["right"]
        back = smoothstep(0.55 * self.high, 0.75 * self.high, np.abs(flat[:, 0]))
        return np.asarray((1 - back) * layer + back * _LAYER_BACK_MM)

    def skin(self, flat: Float64[Array, "n 2"]) -> tuple[Float64[Array, "n 3"], Float64[Array, "n 3"]]:
        """Points on the flat chest's skin, and on the muscle under them."""
        muscle, aside, up = self.muscle(flat), *(_STEP_MM * np.eye(2))
        around = self.muscle(flat + aside) - self.muscle(flat - aside)
        along = self.muscle(flat + up) - self.muscle(flat - up)
        normal = np.cross(around, along)
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        return muscle + self.layer_mm(flat)[:, None] * normal, muscle

    def beneath(self, places: Float64[Array, "n 2"], side: str) -> Float64[Array, "n 2"]:
        """Arc and height of the flat skin's points at front coordinates, mm (Newton's method)."""
        sign = 1.0 if side == "left" else -1.0
        flat = np.stack(
            [places[:, 0] / self.shape.breasts[side].middle_mm[0] * self._middles[side], places[:, 1]], axis=1
        )
        flat[:, 0] = np.where(flat[:, 0] * sign > 0, flat[:, 0], 0.0)
        step = np.array([1.0, 0.0])
        for _ in range(30):
            here = self.skin(flat)[0][:, :2]
            wider, narrower = (self.skin(flat + sign * step)[0][:, 0] for sign in (1, -1))
            ahead = (wider - narrower) / 2
            missing = places - here
            flat = flat + np.clip(
                np.stack([missing[:, 0] / np.maximum(ahead, 0.3), missing[:, 1]], axis=1), -15.0, 15.0
            )
        return flat


class _Breast:
    """One breast on the chest: mapping to skin, flat chest and muscle."""

    def __init__(self, chest: _Chest, shape: WomanBreast, side: str) -> None:
        self.chest, self.shape, self.sign = chest, shape, 1.0 if side == "left" else -1.0
        curve = outline_mm(shape) + np.array(shape.middle_mm)
        self.rim = chest.beneath(curve * [self.sign, 1.0], side)
        self.middle = self.rim.mean(axis=0)
        self._turn = np.linspace(0.0, 2 * math.pi, len(curve) + 1)
        self._rim = CubicSpline(self._turn, np.concatenate([self.rim, self.rim[:1]]), bc_type="periodic")
        self.area_mm2 = outline_area_mm2(curve)
        self.top_mm = shape.volume_cc * 1000 / (self.area_mm2 * shape.fill)
        self._power = self._powers()

    def _powers(self) -> float:
        """Exponent q of the profile. Its mean 1/(1 + q) is the fill."""
        radius2 = ((self.rim - self.middle) ** 2).sum(axis=1)
        low, high = 0.05, 8.0
        for _ in range(50):
            power = (low + high) / 2
            q = power * np.exp(self.shape.run_out * np.cos(self._turn[:-1] - _SMOOTH_ANGLE_RAD))
            low, high = (power, high) if (radius2 / (1 + q)).sum() / radius2.sum() > self.shape.fill else (low, power)
        return power

    def flat(self, share: Array, turn: Array) -> Float64[Array, "n 2"]:
        """Position on the flattened chest."""
        return np.asarray(self.middle + share[:, None] * (self._rim(np.mod(turn, 2 * math.pi)) - self.middle))

    def turns(self, along: Array) -> Float64[Array, " n"]:
        """Directions of points along the boundary, given as fractions of its length."""
        closed = np.concatenate([self.rim, self.rim[:1]])
        length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(closed, axis=0), axis=1))])
        return np.interp(along * length[-1], length, self._turn)

    def skin(self, share: Array, turn: Array) -> tuple[Float64[Array, "n 3"], Float64[Array, "n 3"]]:
        """Skin over the flat chest at `share`, and the skin's own share."""
        q = self._power * np.exp(self.shape.run_out * np.cos(turn - _SMOOTH_ANGLE_RAD))
        out = 1.0 - np.clip(1.0 - share, 0.0, 1.0) ** np.maximum(1.0, 1.0 / q)
        height = np.clip(1.0 - out**2, 0.0, 1.0) ** q
        foot = self.chest.skin(self.flat(out, turn))[0]
        nipple = _NIPPLE_MM * smoothstep(0.1, 0.05, out)
        aside, up = self.shape.fall_mm
        fall = np.array([self.sign * aside, up, 0.0])
        return foot + (height * self.top_mm + nipple)[:, None] * [0.0, 0.0, 1.0] + height[:, None] * fall, out


def woman(shape: WomanShape, *, name: str = "woman", edge_mm: float = 2.0) -> Woman:
    """Make a woman.

    Args:
        shape: her measures.
        name: her name.
        edge_mm: approximate edge length on the breasts. Other edges are longer.

    Raises:
        ValueError: the measures are inconsistent.
    """
    chest = _Chest(shape)
    breasts = {side: _Breast(chest, shape.breasts[side], side) for side in SIDES}
    rings = max(24, math.ceil(_PROFILE_MM / edge_mm))
    flat, share, turn, owner = _places(chest, breasts, rings, edge_mm)
    faces = Delaunay(flat).simplices
    corners = flat[faces]
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    doubled = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    faces = np.where((doubled > 0)[:, None], faces, faces[:, ::-1])[np.abs(doubled) > 1e-9]
    wall, muscle = chest.skin(flat)
    for _ in range(_VOLUME_ROUNDS):
        skin = wall.copy()
        for number, breast in enumerate(breasts.values()):
            own = owner == number
            skin[own] = breast.skin(share[own], turn[own])[0]
            inside = (own & (share < 1.0))[faces].any(axis=1)
            swept = _swept_mm3(skin, wall, faces[inside])
            breast.top_mm *= breast.shape.volume_cc * 1000 / swept
    flat, faces, (skin, wall, muscle), share, owner = _closed(chest, flat, faces, (skin, wall, muscle), share, owner)
    mesh, flat_chest = rounded_mesh(skin, faces), rounded_mesh(wall, faces).vertices.copy()
    bare = (owner < 0) | (share >= 1.0)
    flat_chest[bare] = mesh.vertices[bare]
    solid_breasts, areola = {}, np.zeros(len(skin))
    landmarks: dict[str, Float64[Array, "k 3"]] = {}
    for number, (side, breast) in enumerate(breasts.items()):
        rim = np.flatnonzero((owner == number) & (share >= 1.0))
        inside = np.flatnonzero(((owner == number) & (share < 1.0))[faces].any(axis=1))
        if not np.isin(faces[inside], np.flatnonzero(owner == number)).all():
            raise ValueError(f"{name}: triangles cross the {side} boundary; choose another number")
        solid_breasts[side] = Breast(skin_faces=inside.astype(np.int32), boundary=_in_order(faces[inside], rim))
        top = breast.skin(np.zeros(1), np.zeros(1))[0]
        areola += 1.0 - smoothstep(0.9, 1.1, np.linalg.norm(skin - top, axis=1) / _AREOLA_MM)
        landmarks[f"nipple_{side}"] = top
        for place, angle in (("lateral", 0.0), ("medial", math.pi), ("inframammary_fold", 1.5 * math.pi)):
            landmarks[f"{place}_{side}"] = chest.skin(breast.flat(np.ones(1), np.array([angle])))[0]
    heights = np.arange(130.0, -131.0, -5.0)
    landmarks["midline"] = chest.skin(np.stack([np.zeros_like(heights), heights], axis=1))[0]
    landmarks["sternal_notch"] = landmarks["midline"][:1]
    solid = SubjectSolid(
        name=name,
        subject_kind="torso",
        mesh=mesh,
        back_vertices=0,
        areola=np.clip(areola, 0.0, 1.0).astype(np.float32),
        base_boundary=None,
        wall_vertices=flat_chest,
        breasts=solid_breasts,
        landmarks=landmarks,
        lean_rad=shape.lean_rad,
        middle=np.mean([landmarks[f"nipple_{side}"][0] for side in SIDES], axis=0) - np.array([0.0, -20.0, 75.0]),
        facts={},
    )
    made = Woman(solid=solid, muscle_vertices=_straight_behind(wall, muscle, faces), shape=shape)
    for side in SIDES:
        if not solid.closed_breast(side).is_watertight():
            raise ValueError(f"{name} has a {side} breast that is not closed; choose another number")
    return _with_facts(made)


def _straight_behind(wall: Array, muscle: Array, faces: Array) -> Float64[Array, "n 3"]:
    """Points on the muscle straight behind the flat chest, or below it if there are none straight behind."""
    front = muscle[:, 2] > muscle[:, 2].max() - 90.0
    found = LinearNDInterpolator(muscle[front, :2], muscle[front, 2])(wall[:, :2])
    seen = front & np.isfinite(found)
    behind = np.where(seen[:, None], np.stack([wall[:, 0], wall[:, 1], found], axis=1), muscle)
    return np.asarray(rounded_mesh(behind, faces).vertices)


def _with_facts(made: Woman) -> Woman:
    from dataclasses import replace

    facts = {
        "kind": "woman",
        "closed": True,
        "pose": made.shape.pose,
        "lean_deg": math.degrees(made.shape.lean_rad),
        "muscle_volumes_cc": {side: made.muscle_cc(side) for side in SIDES},
        "layer_mm": {side: made.layer_mm(side) for side in SIDES},
        "breast": "volumes_cc: all before a flat chest, muscle and the layer found at the boundary; "
        "muscle_volumes_cc: all before the muscle",
    }
    return replace(made, solid=replace(made.solid, facts=facts))


def _places(
    chest: _Chest, breasts: dict[str, _Breast], rings: int, edge_mm: float
) -> tuple[Float64[Array, "n 2"], Array, Array, Array]:
    """Points on the flattened chest, with relative distance from a breast's centre, direction and breast."""
    flat, share, turn, owner = [], [], [], []
    for number, breast in enumerate(breasts.values()):
        length = float(np.linalg.norm(breast.rim - np.roll(breast.rim, 1, axis=0), axis=1).sum())
        narrow = float(np.linalg.norm(breast.rim - breast.middle, axis=1).min())
        around = math.ceil(length / (0.75 * narrow / rings))
        for ring in range(rings + 1):
            count = around if ring >= rings - 1 else max(6, math.ceil(around * ring / rings))
            angles = breast.turns((np.arange(count) + 0.5 * (ring % 2)) / count) if ring else np.zeros(1)
            shares = np.full(len(angles), ring / rings)
            flat.append(breast.flat(shares, angles))
            share.append(shares)
            turn.append(angles)
            owner.append(np.full(len(angles), number))
    within = [(breast.middle, breast.rim) for breast in breasts.values()]
    beside = []
    for breast in breasts.values():  # rows of points outside each boundary, so that no triangle crosses it
        angles = breast.turns(np.linspace(0.0, 1.0, max(60, math.ceil(450 / edge_mm)), endpoint=False))
        for off in (0.7, 1.6, 3.0):
            rim = breast.flat(np.ones(len(angles)), angles)
            out = rim - breast.middle
            beside.append(rim + off * edge_mm * out / np.linalg.norm(out, axis=1, keepdims=True))
    spacing = _SHOW_MM * edge_mm
    columns = np.linspace(chest.low, chest.high, math.ceil((chest.high - chest.low) / spacing) + 1)
    rows = np.linspace(-_TALL_MM, _TALL_MM, math.ceil(2 * _TALL_MM / spacing) + 1)
    grid = np.stack([axis.ravel() for axis in np.meshgrid(columns, rows)], axis=1)
    grid_kept = ~_near_any(grid, within, 4.0 * edge_mm)
    rest = np.concatenate(beside)
    rest = rest[~_near_any(rest, within, 0.55 * edge_mm)]
    rest = rest[_spaced(rest, 0.5 * edge_mm)]
    rest = np.concatenate([grid[grid_kept], rest])
    flat.append(rest)
    none = np.full(len(rest), 9.0)
    return (
        np.concatenate(flat),
        np.concatenate([*share, none]),
        np.concatenate([*turn, none]),
        np.concatenate([*owner, np.full(len(rest), -1)]),
    )


def _near_any(points: Array, outlines: list[tuple[Array, Array]], reach_mm: float) -> Bool[Array, " n"]:
    """Whether points are inside or within `reach_mm` of a star-shaped outline."""
    near = np.zeros(len(points), dtype=bool)
    for middle, rim in outlines:
        around = np.arctan2(*(rim - middle).T[::-1])
        order = np.argsort(around)
        offset = points - middle
        reach = np.interp(
            np.arctan2(offset[:, 1], offset[:, 0]), around[order], np.linalg.norm(rim - middle, axis=1)[order],
            period=2 * math.pi,
        )  # fmt: skip
        near |= np.linalg.norm(offset, axis=1) < reach
        near |= np.asarray(cKDTree(rim).query(points)[0]) < reach_mm
    return near


def _spaced(points: Array, least_mm: float) -> Bool[Array, " n"]:
    """The points, without those that are closer to an earlier one than a given distance."""
    keep = np.ones(len(points), dtype=bool)
    for first, second in cKDTree(points).query_pairs(least_mm):
        if keep[first]:
            keep[second] = False
    return keep


def _closed(
    chest: _Chest, flat: Array, faces: Array, surfaces: tuple[Array, ...], share: Array, owner: Array
) -> tuple[Array, Array, tuple[Array, ...], Array, Array]:
    """Join the trunk's seam at the back, and close both ends with fans."""
    first = np.flatnonzero(flat[:, 0] == chest.low)
    last = np.flatnonzero(flat[:, 0] == chest.high)
    first, last = (corners[np.argsort(flat[corners, 1])] for corners in (first, last))
    same = np.arange(len(flat))
    same[last] = first
    faces = same[faces]
    ends = []
    for row, turned in ((flat[:, 1].min(), False), (flat[:, 1].max(), True)):
        rim = np.flatnonzero((flat[:, 1] == row) & (flat[:, 0] < chest.high))
        rim = rim[np.argsort(flat[rim, 0])]
        ends.append((rim, turned))
    count = len(flat)
    fans, hubs = [], []
    for number, (rim, turned) in enumerate(ends):
        hub = np.full(len(rim), count + number)
        following = np.roll(rim, -1)
        fans.append(np.stack([rim, following, hub] if turned else [following, rim, hub], axis=1))
        hubs.append(surfaces[0][rim].mean(axis=0))
    surfaces = tuple(np.concatenate([surface, np.array(hubs)]) for surface in surfaces)
    faces = np.concatenate([faces, *fans])
    used, compact = np.unique(faces, return_inverse=True)
    flat = np.concatenate([flat, np.zeros((2, 2))])[used]
    share = np.concatenate([share, [9.0, 9.0]])[used]
    owner = np.concatenate([owner, [-1, -1]])[used]
    return flat, compact.reshape(-1, 3).astype(np.int32), tuple(surface[used] for surface in surfaces), share, owner


def _in_order(faces: Array, rim: Array) -> Int32[Array, " n"]:
    """Boundary of some faces as a loop, in their direction."""
    a, b = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    on_rim = np.isin(a, rim) & np.isin(b, rim)
    forward = {(int(p), int(q)) for p, q in zip(a[on_rim], b[on_rim], strict=True)}
    follow = {p: q for p, q in forward if (q, p) not in forward}
    start = next(iter(follow))
    loop = [start]
    while follow[loop[-1]] != start:
        loop.append(follow[loop[-1]])
    return np.array(loop, dtype=np.int32)


def _swept_mm3(skin: Array, wall: Array, faces: Array) -> float:
    """Volume between two surfaces that have the same triangles and rim."""
    middle = wall[faces].mean(axis=(0, 1))

    def cone(points: Array) -> float:
        a, b, c = np.moveaxis(points[faces] - middle, 1, 0)
        return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)

    return cone(skin) - cone(wall)


def woman_named(name: str, seed: int, *, edge_mm: float = 2.0) -> Woman:
    """Make a woman by name.

    Args:
        name: ``woman`` or ``leaning-woman``, with ``-wide`` for 100 to 1500 cc, and ``_1``, ``_2`` … for others.
        seed: seed of all random values.
        edge_mm: approximate edge length on the breasts.

    Raises:
        ValueError: the name is unknown.
    """
    family, _, number = name.partition("_")
    pose: Pose = "leaning" if family.startswith("leaning-") else "prone"
    if family not in _FAMILIES or not (number.isdecimal() or name == family):
        raise UnknownWordError(f"women are {', '.join(_FAMILIES)}, each with _1, _2 …", f"{name!r}")
    shape = woman_shape(int(number or 0), seed, pose, wide=family.endswith("-wide"))
    return woman(shape, name=name, edge_mm=edge_mm)


_FAMILIES = ("woman", "leaning-woman", "woman-wide", "leaning-woman-wide")


@add_subject(
    "woman",
    has=lambda name: name.partition("_")[0] in _FAMILIES,
    choices="woman, woman_1 … (leaning-woman, woman-wide, leaning-woman-wide alike)",
)
def _woman(wanted: SubjectRequest) -> SubjectSolid:
    return woman_named(wanted.name, wanted.seed, edge_mm=max(wanted.edge_mm, 1.0)).solid
