"""Plain solids (ball, bar, plate, head), and the triangulated disc used for them and for casts."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from mammometry.geometry.arrays import Array, Int32
from mammometry.simulate.subjects.registry import SubjectRequest, add_subject
from mammometry.simulate.subjects.solid import SubjectSolid, rounded_mesh

_FIGURE_MM, _FIGURE_EDGE_MM = 52.0, 0.4  # height of the small head on a table, and its longest edge, mm


def sphere(radius_mm: float = 60.0, edge_mm: float = 0.7) -> SubjectSolid:
    """A ball."""
    rings = max(8, math.ceil(0.5 * math.pi * radius_mm * 1.1 / edge_mm))
    rho, theta, faces, _ = disc(rings)
    angle = 0.5 * math.pi * rho
    front = radius_mm * np.stack([np.sin(angle) * np.cos(theta), np.sin(angle) * np.sin(theta), np.cos(angle)], axis=1)
    front[rho == 1.0, 2] = 0.0
    back = front[rho < 1.0] * np.array([1.0, 1.0, -1.0])
    return _plain_solid("sphere", front, back, faces, rho, {"radius_mm": radius_mm})


def cylinder(radius_mm: float = 57.15, length_mm: float = 150.0, edge_mm: float = 0.7) -> SubjectSolid:
    """A round bar with its axis along y."""
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


def head(seed: int, height_mm: float = 265.0, edge_mm: float = 0.7) -> SubjectSolid:
    """A head with neck, nose, brows, eyes and chin, random by seed, that looks along z."""
    rng = np.random.default_rng([seed, 74])
    ball = sphere(100.0, edge_mm=edge_mm * 265.0 / height_mm)
    out = ball.mesh.vertices / np.linalg.norm(ball.mesh.vertices, axis=1, keepdims=True)
    half = np.array([76.0, 112.0, 96.0]) * rng.uniform(0.94, 1.06, 3)
    radius = 1.0 / np.linalg.norm(out / half, axis=1)
    below = np.maximum(-out[:, 1], 1e-6)
    neck = np.minimum(54.0 / np.maximum(np.hypot(out[:, 0], out[:, 2]), 1e-6), 150.0 / below)
    blend = np.clip((below - 0.72) / 0.2, 0.0, 1.0)
    radius += blend**2 * (3.0 - 2.0 * blend) * np.maximum(neck - radius, 0.0)
    for x, y, width, lift in (
        (0.0, -0.12, 0.13, 20.0),  # nose
        (0.0, 0.08, 0.10, 7.0),
        (-0.33, 0.10, 0.14, -7.0),  # eyes
        (0.33, 0.10, 0.14, -7.0),
        (-0.28, 0.32, 0.16, 5.0),  # brows
        (0.28, 0.32, 0.16, 5.0),
        (0.0, -0.42, 0.10, 4.0),  # mouth
        (0.0, -0.68, 0.16, 9.0),  # chin
        (-0.52, -0.22, 0.2, 4.0),  # cheeks
        (0.52, -0.22, 0.2, 4.0),
    ):
        away = np.hypot(out[:, 0] - x, out[:, 1] - y)
        radius += lift * rng.uniform(0.7, 1.3) * np.exp(-((away / width) ** 2)) * np.clip(2.0 * out[:, 2], 0.0, 1.0)
    vertices = out * radius[:, None]
    vertices *= height_mm / float(np.ptp(vertices[:, 1]))
    facts: dict[str, object] = {"kind": "head", "height_mm": height_mm}
    return replace(_whole_solid("head", vertices, ball.mesh.faces, facts), lean_rad=0.0)


def plate(
    width_mm: float = 220.0, height_mm: float = 160.0, thickness_mm: float = 6.0, edge_mm: float = 2.0
) -> SubjectSolid:
    """A flat plate for the paper's depth check, with its front at z = thickness / 2."""
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


@add_subject("sphere")
def _sphere(wanted: SubjectRequest) -> SubjectSolid:
    return sphere(edge_mm=wanted.edge_mm)


@add_subject("cylinder")
def _cylinder(wanted: SubjectRequest) -> SubjectSolid:
    return cylinder(edge_mm=wanted.edge_mm)


@add_subject("head")
def _head(wanted: SubjectRequest) -> SubjectSolid:
    return head(wanted.seed, edge_mm=wanted.edge_mm)


@add_subject("figure")
def _figure(wanted: SubjectRequest) -> SubjectSolid:
    return head(wanted.seed, height_mm=_FIGURE_MM, edge_mm=min(wanted.edge_mm, _FIGURE_EDGE_MM))


@add_subject("plate")
def _plate(wanted: SubjectRequest) -> SubjectSolid:
    return plate()


def disc(rings: int) -> tuple[Array, Array, Int32[Array, "m 3"], int]:
    """Polar coordinates, faces and number of rings of a unit disc in concentric hexagons."""
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


def back_faces(faces: Int32[Array, "m 3"], front: int, rim: int) -> Int32[Array, "m 3"]:
    """Faces of the back: those of the front, reversed, with their own interior vertices."""
    interior = front - rim
    index = np.concatenate([front + np.arange(interior), interior + np.arange(rim)])
    return index[faces[:, ::-1]].astype(np.int32)


def _plain_solid(
    name: str, front: Array, back: Array, faces: Array, rho: Array, facts: dict[str, object]
) -> SubjectSolid:
    rim = int((rho == 1.0).sum())
    every = np.concatenate([faces, back_faces(faces, len(front), rim)])
    return _whole_solid(name, np.concatenate([front, back]), every, {"kind": name, **facts})


def _whole_solid(name: str, vertices: Array, faces: Array, facts: dict[str, object]) -> SubjectSolid:
    return SubjectSolid(
        name=name,
        subject_kind="surface",
        mesh=rounded_mesh(vertices, faces),
        back_vertices=0,
        areola=np.zeros(len(vertices), dtype=np.float32),
        base_boundary=None,
        facts=facts,
    )
