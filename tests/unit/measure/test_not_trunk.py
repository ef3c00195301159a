"""What is no trunk does not count as one: arms, a belly, what is worn."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from trunks import LEFT, LENGTH_MM, RADIUS_MM, bump_mm, trunk_mesh

from mammometry.geometry.mesh import TriangleMesh
from mammometry.measure.boundary.boundary import TorsoSides, outline_torso
from mammometry.measure.trunk.thorax import Trunk, find_trunk, seen_skin
from mammometry.surface.repair.repair import Provenance, RepairedSurface

TWIN = (-LEFT[0], *LEFT[1:])
FLAT = 0.72  # depth over width of a body's trunk
BELLY = (0.0, -165.0, 85.0, 40.0)  # as a breast is described
WAIST_MM = -120.0  # height up to which trousers reach


def joined(*parts: TriangleMesh) -> TriangleMesh:
    first = np.cumsum([0, *(len(part.vertices) for part in parts[:-1])])
    return TriangleMesh(
        vertices=np.concatenate([part.vertices for part in parts]),
        faces=np.concatenate([part.faces + np.int32(at) for part, at in zip(parts, first, strict=True)]),
    )


def bare() -> TriangleMesh:
    """A body's trunk with two breasts alike."""
    mesh = trunk_mesh(5.0)
    x, y, z = mesh.vertices.T
    theta, out = np.arctan2(x, z), np.hypot(x, z)
    side = (np.abs(y) < LENGTH_MM / 2 - 1e-9) & (out > 1)
    wanted = RADIUS_MM + bump_mm(theta, y, LEFT) + bump_mm(theta, y, TWIN)
    scale = np.where(side, wanted / np.where(side, out, 1), np.where(out > 1, RADIUS_MM / np.where(out > 1, out, 1), 0))
    return TriangleMesh(vertices=np.stack([x * scale, y, z * scale * FLAT], axis=1), faces=mesh.faces)


def with_belly() -> TriangleMesh:
    mesh = bare()
    x, y, z = mesh.vertices.T
    out = bump_mm(np.arctan2(x, z), y, BELLY) * (np.hypot(x, z) > 1)
    return replace(mesh, vertices=mesh.vertices + np.stack([0 * x, 0 * y, out], axis=1))


def with_trousers() -> TriangleMesh:
    """Cloth 12 mm thick, up to the waist."""
    mesh = bare()
    x, y, z = mesh.vertices.T
    out = np.hypot(x, z)
    grown = 1 + 12.0 * (y < WAIST_MM) / np.where(out > 1, out, np.inf)
    return replace(mesh, vertices=mesh.vertices * np.stack([grown, np.ones_like(y), grown], axis=1))


def arm(side: float, low_mm: float = -190.0) -> TriangleMesh:
    """An upper arm that hangs beside the trunk, as a rod with two ends."""
    around, along = 40, 60
    angle, height = np.meshgrid(np.arange(around) * 2 * np.pi / around, np.linspace(low_mm, 190.0, along))
    ring = np.stack([side * (RADIUS_MM + 62.0) + 45 * np.sin(angle), height, 45 * np.cos(angle) - 10], axis=-1)
    ends = np.array([[side * (RADIUS_MM + 62.0), y, -10.0] for y in (low_mm, 190.0)])
    grid = np.arange(around * along).reshape(along, around)
    a, b, c, d = grid[:-1], np.roll(grid, -1, axis=1)[:-1], grid[1:], np.roll(grid, -1, axis=1)[1:]
    faces = [np.stack([a, b, d], axis=-1).reshape(-1, 3), np.stack([a, d, c], axis=-1).reshape(-1, 3)]
    low, high = around * along, around * along + 1
    faces += [
        np.stack([np.full(around, low), np.roll(grid[0], -1), grid[0]], axis=1),
        np.stack([np.full(around, high), grid[-1], np.roll(grid[-1], -1)], axis=1),
    ]
    vertices = np.concatenate([ring.reshape(-1, 3), ends])
    return TriangleMesh(vertices=vertices, faces=np.concatenate(faces).astype(np.int32))


def with_arms() -> TriangleMesh:
    return joined(bare(), arm(1.0), arm(-1.0))


def with_one_arm() -> TriangleMesh:
    """As pictures end before the elbow on one side, and beyond the arm on the other."""
    return joined(bare(), arm(1.0, low_mm=20.0))


def seen(mesh: TriangleMesh) -> RepairedSurface:
    """From ahead and from both sides."""
    n = len(mesh.vertices)
    front = mesh.vertex_normals()[:, 2] > -0.3
    return RepairedSurface(
        mesh=mesh,
        provenance=np.where(front, Provenance.MEASURED, Provenance.INVENTED).astype(np.uint8),
        sigma_mm=np.full(n, 0.1, dtype=np.float32),
        pair_bits=np.ones(n, dtype=np.int32),
        pair_names=("front",),
        convergence=np.zeros(1),
    )


def trunk_of(surface: RepairedSurface) -> Trunk:
    return find_trunk(seen_skin(surface), np.eye(3), height_of=np.array([0, 10.0, 0]))


@cache
def undressed() -> tuple[Trunk, TorsoSides]:
    surface = seen(bare())
    return trunk_of(surface), outline_torso(surface, np.eye(3))


@pytest.mark.parametrize("dressed", [with_belly, with_trousers, with_arms, with_one_arm])
@pytest.mark.slow
def test_the_trunk_and_its_breasts_are_as_without(dressed: Callable[[], TriangleMesh]) -> None:
    surface = seen(dressed())
    trunk, (alone, outlined) = trunk_of(surface), undressed()
    assert trunk.half_width_mm == pytest.approx(alone.half_width_mm, abs=4.0)
    assert trunk.origin[[0, 2]] == pytest.approx(alone.origin[[0, 2]], abs=6.0)
    found = outline_torso(surface, np.eye(3))
    assert [each.name for each in found.boundaries] == ["left", "right"]
    for mine, other in zip(found.boundaries, outlined.boundaries, strict=True):
        away = np.linalg.norm(mine.points_world[:, None] - other.points_world[None], axis=2).min(axis=1)
        assert away.max() < 4.0  # two pixels of the relief
