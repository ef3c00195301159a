"""Closed solids whose volume is known exactly: that of their own triangles, by the divergence theorem.

Frame of a solid: x right as the front camera sees it, y up, z forward out of the back; mm.
Vertices are rounded to float32 before the volume is taken, so that the solid rendered, the mesh on disk and the volume
in the truth are one and the same.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from mammometry.geometry.arrays import Array, Float32, Float64, Int32, read_only
from mammometry.geometry.mesh import TriangleMesh
from mammometry.geometry.transform import Transform

TABLE_1_WATER_CC = (364.6, 434.7, 579.0, 231.1, 433.4, 591.6, 596.6, 100.4, 863.1)
"""Volumes of the paper's nine plaster models by water displacement (Table 1), cc."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Solid:
    """A closed body, what to paint on it, and what is known about it."""

    name: str
    subject_kind: str
    """As in the session's manifest: "model" has a base, "surface" has none."""
    mesh: TriangleMesh
    """Closed; solid's frame, mm; coordinates are float32 numbers."""
    back_vertices: int
    """This many vertices, the last ones, are the back's own (the rim is not)."""
    areola: Float32[Array, " n"]
    """Share of areola colour at each vertex, 0…1."""
    base_boundary: Float64[Array, "b 3"] | None
    """Closed curve between front and back in order, solid's frame, mm; None where there is no base."""
    facts: Mapping[str, object]
    """What the truth file says about it beside the volume."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "areola", read_only(self.areola))

    @property
    def volume_cc(self) -> float:
        """Volume of the closed mesh, cc."""
        return self.mesh.volume_mm3() / 1000.0


@dataclass(frozen=True, slots=True, kw_only=True)
class PlasterShape:
    """Measures of a plaster breast; all but the volume are proportions that the scaling to the volume keeps."""

    volume_cc: float = 400.0
    """Of the finished solid, cc."""
    projection: float = 0.85
    """Height over the back, in radii of the base."""
    width: float = 1.05
    """Width of the base over its height."""
    sag: float = 0.45
    """How far the mass hangs down, in projections: 0 is a hemisphere, 0.8 ptotic with a deep undercut."""
    fold: float = 0.10
    """Depth of the groove under the breast, in radii of the base."""
    lateral: float = 0.10
    """How far the nipple points to the side, in projections."""
    upper_slope: float = 0.15
    """Flattening of the upper half."""
    outline: tuple[float, float, float, float] = (0.02, 0.5, 0.015, 1.0)
    """Second and third harmonic of the base's outline: amplitude in radii and phase in rad, twice."""
    back_radius_mm: float | None = None
    """Radius of the cylinder (axis along y) that the back is bent over; None for a flat back."""
    irregularity_mm: float = 0.5
    """Amplitude of the hand-made unevenness, mm."""
    nipple_mm: float = 4.0
    """Height of the nipple over the areola, mm."""
    areola_mm: float = 17.0
    """Radius of the areola, mm."""


def plaster_shape(name: str, seed: int) -> PlasterShape:
    """Draw the shape of a plaster model by seed.

    Args:
        name: ``plaster`` for any of the family, or ``plaster_1`` … ``plaster_9`` for one with a volume within 3 % of
            the paper's Table 1; even ones have a back bent over a cylinder.
        seed: of everything drawn.

    Raises:
        ValueError: the name is none of these.
    """
    number = 0
    if name != "plaster":
        try:
            number = int(name.removeprefix("plaster_"))
        except ValueError:
            number = -1
        if not 1 <= number <= len(TABLE_1_WATER_CC):
            raise ValueError(f"plaster models are plaster and plaster_1 … plaster_9, found {name!r}")
    rng = np.random.default_rng([seed, number, 71])
    if number:
        volume_cc = TABLE_1_WATER_CC[number - 1] * rng.uniform(0.97, 1.03)
        curved = number % 2 == 0
    else:
        volume_cc = float(np.exp(rng.uniform(math.log(80.0), math.log(1000.0))))
        curved = bool(rng.random() < 0.5)
    # Larger breasts hang more.
    heaviness = np.clip(math.log(volume_cc / 100.0) / math.log(9.0), 0.0, 1.0)
    return PlasterShape(
        volume_cc=float(volume_cc),
        projection=rng.uniform(0.72, 0.95),
        width=rng.uniform(0.97, 1.12),
        sag=float(0.15 + 0.35 * heaviness + rng.uniform(-0.1, 0.2)),
        fold=rng.uniform(0.03, 0.15),
        lateral=rng.uniform(-0.18, 0.18),
        upper_slope=rng.uniform(0.0, 0.25),
        outline=(
            rng.uniform(0.0, 0.03),
            rng.uniform(0.0, 2 * math.pi),
            rng.uniform(0.0, 0.025),
            rng.uniform(0.0, 2 * math.pi),
        ),
        back_radius_mm=rng.uniform(180.0, 280.0) if curved else None,
        irregularity_mm=rng.uniform(0.3, 0.8),
        nipple_mm=rng.uniform(2.5, 6.0),
        areola_mm=rng.uniform(14.0, 20.0),
    )


def plaster(shape: PlasterShape, *, name: str = "plaster", seed: int = 0, edge_mm: float = 0.7) -> Solid:
    """Make a plaster breast: a half ellipsoid that sags into an undercut fold, uneven, with nipple and areola.

    Args:
        shape: its measures.
        name: what to call it.
        seed: of the unevenness.
        edge_mm: 95 % of the edges of the breast's side are shorter; the others lie in the fold and on the nipple.
    """
    rho, theta, faces, rings = _disc(48)
    coarse = _dome(rho, theta, shape)
    rings = max(8, math.ceil(48 * _long_edge(coarse, faces) / edge_mm))
    rho, theta, faces, rings = _disc(rings)
    front = _dome(rho, theta, shape)

    base_radius = _base_radius(shape)
    normals = TriangleMesh(vertices=front, faces=faces).vertex_normals()
    rng = np.random.default_rng([seed, 72])
    unevenness = _waves(front, rng, shortest_mm=0.4 * base_radius, longest_mm=1.2 * base_radius)
    front += normals * (shape.irregularity_mm * unevenness * (1.0 - rho**6))[:, None]

    normals = TriangleMesh(vertices=front, faces=faces).vertex_normals()
    apex = int(np.argmin(np.hypot(rho * np.cos(theta) - 0.02, rho * np.sin(theta) + rng.uniform(0.02, 0.14))))
    nipple, direction = front[apex].copy(), normals[apex].copy()
    distance = np.linalg.norm(front - nipple, axis=1)
    wobble = 1.0 + 0.04 * _waves(front, rng, shortest_mm=12.0, longest_mm=30.0)
    areola = 1.0 - _smoothstep(0.93, 1.07, distance * wobble / shape.areola_mm)
    puff = 0.08 * shape.areola_mm * np.clip(1.0 - (distance / (1.2 * shape.areola_mm)) ** 2, 0.0, None) ** 2
    bud = shape.nipple_mm * (1.0 - _smoothstep(0.15, 1.0, distance / (0.38 * shape.areola_mm)))
    front += direction * (puff + bud)[:, None]
    facing = _smoothstep(-0.2, 0.2, normals @ direction)
    areola = np.clip(areola * facing, 0.0, 1.0)

    rim = front[rho == 1.0]
    back = _flat_back(rim, rho, theta)
    vertices = np.concatenate([front, back])
    all_faces = np.concatenate([faces, _back_faces(faces, len(front), len(rim))])
    vertices *= (shape.volume_cc * 1000.0 / _volume(vertices, all_faces)) ** (1.0 / 3.0)
    if shape.back_radius_mm is not None:
        vertices = _bent(vertices, shape.back_radius_mm)
        # Straight edges on a bent surface: a last scaling by a millionth or so.
        vertices *= (shape.volume_cc * 1000.0 / _volume(vertices, all_faces)) ** (1.0 / 3.0)
    mesh = _rounded(vertices, all_faces)
    vertices = mesh.vertices
    boundary = vertices[: len(front)][rho == 1.0]
    overhang_mm = boundary[:, 1].min() - vertices[: len(front), 1].min()
    return Solid(
        name=name,
        subject_kind="model",
        mesh=mesh,
        back_vertices=len(back),
        areola=np.concatenate([areola, np.zeros(len(back))]).astype(np.float32),
        base_boundary=boundary.copy(),
        facts={
            "kind": "plaster",
            "back": "flat" if shape.back_radius_mm is None else "curved: bent over a cylinder along y",
            "back_radius_mm": shape.back_radius_mm,
            "areola_mm": shape.areola_mm,
            "overhang_mm": float(overhang_mm),
            "nipple_solid": [float(value) for value in vertices[apex]],
        },
    )


def sphere(radius_mm: float = 60.0, edge_mm: float = 0.7) -> Solid:
    """Make a ball."""
    rings = max(8, math.ceil(0.5 * math.pi * radius_mm * 1.1 / edge_mm))
    rho, theta, faces, _ = _disc(rings)
    angle = 0.5 * math.pi * rho
    front = radius_mm * np.stack([np.sin(angle) * np.cos(theta), np.sin(angle) * np.sin(theta), np.cos(angle)], axis=1)
    front[rho == 1.0, 2] = 0.0
    back = front[rho < 1.0] * np.array([1.0, 1.0, -1.0])
    return _plain_solid("sphere", front, back, faces, rho, {"radius_mm": radius_mm})


def cylinder(radius_mm: float = 57.15, length_mm: float = 150.0, edge_mm: float = 0.7) -> Solid:
    """Make a round bar, its axis along y."""
    around = math.ceil(2 * math.pi * radius_mm / edge_mm)
    along = math.ceil(length_mm / edge_mm)
    angle = np.arange(around) * (2 * math.pi / around)
    y = np.linspace(-0.5 * length_mm, 0.5 * length_mm, along + 1)
    ring = np.stack([radius_mm * np.sin(angle), np.zeros(around), radius_mm * np.cos(angle)], axis=1)
    side = (ring[None] + np.stack([np.zeros_like(y), y, np.zeros_like(y)], axis=1)[:, None]).reshape(-1, 3)
    vertices = np.concatenate([side, [[0.0, y[0], 0.0], [0.0, y[-1], 0.0]]])
    row, column = (grid.ravel() for grid in np.meshgrid(np.arange(along), np.arange(around), indexing="ij"))
    a, b = row * around + column, row * around + (column + 1) % around
    c, d = a + around, b + around
    low, high = len(side), len(side) + 1
    first, last = np.arange(around), along * around + np.arange(around)
    faces = np.concatenate(
        [
            np.stack([a, b, d], axis=1),
            np.stack([a, d, c], axis=1),
            np.stack([np.full(around, low), np.roll(first, -1), first], axis=1),
            np.stack([np.full(around, high), last, np.roll(last, -1)], axis=1),
        ]
    )
    facts = {"kind": "cylinder", "radius_mm": radius_mm, "length_mm": length_mm}
    return _whole_solid("cylinder", vertices, faces, facts)


def plate(width_mm: float = 220.0, height_mm: float = 160.0, thickness_mm: float = 6.0, edge_mm: float = 2.0) -> Solid:
    """Make a flat plate whose front is the plane z = thickness / 2 (the paper's depth check)."""
    columns, rows = math.ceil(width_mm / edge_mm), math.ceil(height_mm / edge_mm)
    x, y = np.meshgrid(
        np.linspace(-0.5 * width_mm, 0.5 * width_mm, columns + 1),
        np.linspace(-0.5 * height_mm, 0.5 * height_mm, rows + 1),
    )
    top = np.stack([x.ravel(), y.ravel(), np.full(x.size, 0.5 * thickness_mm)], axis=1)
    bottom = top * np.array([1.0, 1.0, -1.0])
    row, column = (grid.ravel() for grid in np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij"))
    a = row * (columns + 1) + column
    b, c, d = a + 1, a + columns + 1, a + columns + 2
    upper = np.concatenate([np.stack([a, b, d], axis=1), np.stack([a, d, c], axis=1)])
    index = np.arange(x.size).reshape(x.shape)
    loop = np.concatenate([index[0, :-1], index[:-1, -1], index[-1, :0:-1], index[:0:-1, 0]])
    following = np.roll(loop, -1)
    walls = np.concatenate(
        [
            np.stack([loop + x.size, following + x.size, following], axis=1),
            np.stack([loop + x.size, following, loop], axis=1),
        ]
    )
    faces = np.concatenate([upper, upper[:, ::-1] + x.size, walls])
    facts = {"kind": "plate", "width_mm": width_mm, "height_mm": height_mm, "thickness_mm": thickness_mm}
    return _whole_solid("plate", np.concatenate([top, bottom]), faces, facts)


def make_subject(name: str, seed: int, *, edge_mm: float = 0.7) -> Solid:
    """Make a subject by name: ``plaster``, ``plaster_1`` … ``plaster_9``, ``sphere``, ``cylinder`` or ``plate``.

    Raises:
        ValueError: there is no subject of that name.
    """
    if name == "sphere":
        return sphere(edge_mm=edge_mm)
    if name == "cylinder":
        return cylinder(edge_mm=edge_mm)
    if name == "plate":
        return plate()
    if name.split("_")[0] != "plaster":
        raise ValueError(f"subjects are plaster, plaster_1 … plaster_9, sphere, cylinder and plate, found {name!r}")
    return plaster(plaster_shape(name, seed), name=name, seed=seed, edge_mm=edge_mm)


def rig_from_solid(solid: Solid, seed: int, *, lean_rad: float = math.radians(45.0)) -> Transform:
    """Place a solid in the middle of the rig, leaning forward over the floor pair, with small errors by seed."""
    rng = np.random.default_rng([seed, 73])
    turn = Transform.from_rotation_vector(
        np.array([lean_rad, 0.0, 0.0]) + np.radians(rng.normal(0.0, 2.0, 3)), np.zeros(3)
    )
    turned = turn.rotate(solid.mesh.vertices)
    middle = 0.5 * (turned.min(axis=0) + turned.max(axis=0))
    return Transform(rotation=turn.rotation.copy(), translation_mm=rng.uniform(-6.0, 6.0, 3) - middle)


def _dome(rho: Array, theta: Array, shape: PlasterShape) -> Float64[Array, "n 3"]:
    """Breast side over the unit disc (rho, theta), at about its final size; its rim lies in z = 0."""
    radius = _base_radius(shape)
    height = shape.projection * radius
    angle = 0.5 * math.pi * rho
    level = np.cos(angle)
    level[rho == 1.0] = 0.0
    a2, phase2, a3, phase3 = shape.outline
    ring = np.sin(angle) * (
        1.0 + (1.0 - level) * (a2 * np.cos(2 * (theta - phase2)) + a3 * np.cos(3 * (theta - phase3)))
    )
    downward = (0.5 * (1.0 - np.sin(theta))) ** 3
    ring *= 1.0 - shape.fold * downward * np.exp(-((level / 0.25) ** 2))
    x = radius * shape.width * ring * np.cos(theta)
    y = radius * ring * np.sin(theta)
    z = height * level * (1.0 - shape.upper_slope * _smoothstep(0.0, 1.0, ring * np.sin(theta)))
    x = x + shape.lateral * height * level
    y = y - shape.sag * height * level
    return np.stack([x, y, z], axis=1)


def _base_radius(shape: PlasterShape) -> float:
    """Radius at which a half ellipsoid of these proportions has the volume, mm."""
    return float((shape.volume_cc * 1000.0 / (2.0 / 3.0 * math.pi * shape.projection * shape.width)) ** (1.0 / 3.0))


def _disc(rings: int) -> tuple[Array, Array, Int32[Array, "m 3"], int]:
    """Triangulate the unit disc in concentric hexagons: polar coordinates, faces counter-clockwise, number of rings."""
    rho: list[Array] = [np.zeros(1)]
    theta: list[Array] = [np.zeros(1)]
    faces: list[Array] = []
    for ring in range(1, rings + 1):
        count = 6 * ring
        rho.append(np.full(count, ring / rings))
        theta.append(np.arange(count) * (2 * math.pi / count))
        start, inner_start, inner_count = 1 + 3 * ring * (ring - 1), 1 + 3 * (ring - 1) * (ring - 2), 6 * (ring - 1)
        sector, step = (grid.ravel() for grid in np.meshgrid(np.arange(6), np.arange(ring), indexing="ij"))
        outer = start + sector * ring + step
        outer_next = start + (sector * ring + step + 1) % count
        if ring == 1:
            faces.append(np.stack([np.zeros(6, dtype=np.int64), outer, outer_next], axis=1))
            continue
        inner = inner_start + (sector * (ring - 1) + step) % inner_count
        inner_next = inner_start + (sector * (ring - 1) + step + 1) % inner_count
        faces.append(np.stack([inner, outer, outer_next], axis=1))
        between = step < ring - 1
        faces.append(np.stack([inner, outer_next, inner_next], axis=1)[between])
    return np.concatenate(rho), np.concatenate(theta), np.concatenate(faces).astype(np.int32), rings


def _flat_back(rim: Float64[Array, "r 3"], rho: Array, theta: Array) -> Float64[Array, "b 3"]:
    """Interior points of the plane piece that the rim encloses: the rim drawn together towards its mean."""
    inside = rho < 1.0
    angle = np.arange(len(rim)) * (2 * math.pi / len(rim))
    outline = np.stack([np.interp(theta[inside], angle, rim[:, k], period=2 * math.pi) for k in range(3)], axis=1)
    middle = rim.mean(axis=0)
    return middle + (outline - middle) * rho[inside, None]


def _back_faces(faces: Int32[Array, "m 3"], front: int, rim: int) -> Int32[Array, "m 3"]:
    """Faces of the back: those of the front turned over, on its own interior vertices and the shared rim."""
    interior = front - rim
    index = np.concatenate([front + np.arange(interior), interior + np.arange(rim)])
    return index[faces[:, ::-1]].astype(np.int32)


def _bent(vertices: Float64[Array, "n 3"], radius_mm: float) -> Float64[Array, "n 3"]:
    """Lower every point by the sagitta of a cylinder along y, so that the plane z = 0 becomes that cylinder.

    A shear: volume is kept, and the sides do not flare, so that the rim stays the widest place where it was.
    """
    sagitta = radius_mm - np.sqrt(radius_mm**2 - vertices[:, 0] ** 2)
    return np.stack([vertices[:, 0], vertices[:, 1], vertices[:, 2] - sagitta], axis=1)


def _waves(points: Array, rng: np.random.Generator, *, shortest_mm: float, longest_mm: float) -> Float64[Array, " n"]:
    """Sum of a few plane waves in random directions, about unit amplitude."""
    total = np.zeros(len(points))
    count = 10
    for _ in range(count):
        direction = rng.normal(size=3)
        direction /= np.linalg.norm(direction)
        length = math.exp(rng.uniform(math.log(shortest_mm), math.log(longest_mm)))
        total += np.sin(points @ direction * (2 * math.pi / length) + rng.uniform(0.0, 2 * math.pi))
    return total * math.sqrt(2.0 / count)


def _smoothstep(low: float, high: float, value: Array) -> Array:
    t = np.clip((value - low) / (high - low), 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


def _long_edge(vertices: Array, faces: Array) -> float:
    """Return the length that 95 % of the edges keep below, mm."""
    corners = vertices[faces]
    return float(np.percentile(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2), 95.0))


def _volume(vertices: Array, faces: Array) -> float:
    return TriangleMesh(vertices=vertices, faces=faces).volume_mm3()


def _rounded(vertices: Array, faces: Array) -> TriangleMesh:
    return TriangleMesh(vertices=vertices.astype(np.float32).astype(np.float64), faces=faces.astype(np.int32))


def _plain_solid(name: str, front: Array, back: Array, faces: Array, rho: Array, facts: dict[str, object]) -> Solid:
    rim = int((rho == 1.0).sum())
    every = np.concatenate([faces, _back_faces(faces, len(front), rim)])
    return _whole_solid(name, np.concatenate([front, back]), every, {"kind": name, **facts})


def _whole_solid(name: str, vertices: Array, faces: Array, facts: dict[str, object]) -> Solid:
    return Solid(
        name=name,
        subject_kind="surface",
        mesh=_rounded(vertices, faces),
        back_vertices=0,
        areola=np.zeros(len(vertices), dtype=np.float32),
        base_boundary=None,
        facts=facts,
    )
