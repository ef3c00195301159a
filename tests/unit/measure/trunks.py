"""A trunk with two breasts of exactly known volume in front of a circular cylinder."""

import numpy as np

from mammometry.geometry.mesh import TriangleMesh
from mammometry.measure.boundary.boundary import Boundary

RADIUS_MM, LENGTH_MM = 125.0, 440.0
# Patient's left at +x: angle around the trunk, height, radius on the skin, height of the bump, mm.
LEFT = (0.52, 10.0, 58.0, 45.0)
RIGHT = (-0.56, 4.0, 54.0, 32.0)


def bump_mm(theta: np.ndarray, y: np.ndarray, breast: tuple[float, float, float, float]) -> np.ndarray:
    """A smooth cap (1 − ρ²)², zero with its slope at the breast's edge."""
    angle, height, reach, top = breast
    rho2 = ((RADIUS_MM * (theta - angle)) ** 2 + (y - height) ** 2) / reach**2
    return top * np.clip(1 - rho2, 0, None) ** 2


def radius_mm(theta: np.ndarray, y: np.ndarray) -> np.ndarray:
    return RADIUS_MM + bump_mm(theta, y, LEFT) + bump_mm(theta, y, RIGHT)


def volume_cc(breast: tuple[float, float, float, float], n: int = 1500) -> float:
    """∬ ((R + b)² − R²)/2 dθ dy over the breast, by the midpoint rule."""
    angle, height, reach, _ = breast
    s = (np.arange(n) + 0.5) / n * 2 - 1
    theta, y = np.meshgrid(angle + s * reach / RADIUS_MM, height + s * reach)
    b = bump_mm(theta, y, breast)
    cell = (2 * reach / n) ** 2 / RADIUS_MM
    return float((((RADIUS_MM + b) ** 2 - RADIUS_MM**2) / 2).sum() * cell / 1000)


def trunk_mesh(step_mm: float = 2.0) -> TriangleMesh:
    """Closed: the round trunk with both breasts, and two flat lids; the patient's head at +y, ahead is +z."""
    around = int(2 * np.pi * RADIUS_MM / step_mm)
    rows = int(LENGTH_MM / step_mm) + 1
    theta, y = np.meshgrid(
        np.linspace(-np.pi, np.pi, around, endpoint=False), np.linspace(-LENGTH_MM / 2, LENGTH_MM / 2, rows)
    )
    r = radius_mm(theta, y)
    vertices = np.stack([r * np.sin(theta), y, r * np.cos(theta)], axis=-1).reshape(-1, 3)
    grid = np.arange(rows * around).reshape(rows, around)
    a, b = grid[:-1], np.roll(grid, -1, axis=1)[:-1]
    c, d = grid[1:], np.roll(grid, -1, axis=1)[1:]
    sides = [np.stack([a, b, d], axis=-1).reshape(-1, 3), np.stack([a, d, c], axis=-1).reshape(-1, 3)]
    foot, head = len(vertices), len(vertices) + 1
    lids = [
        np.stack([np.full(around, foot), np.roll(grid[0], -1), grid[0]], axis=1),
        np.stack([np.full(around, head), grid[-1], np.roll(grid[-1], -1)], axis=1),
    ]
    ends = np.array([[0.0, -LENGTH_MM / 2, 0.0], [0.0, LENGTH_MM / 2, 0.0]])
    return TriangleMesh(vertices=np.concatenate([vertices, ends]), faces=np.concatenate(sides + lids).astype(np.int32))


def edge_of(breast: tuple[float, float, float, float], name: str, wider: float = 1.0, n: int = 160) -> Boundary:
    """The breast's true edge on the skin."""
    angle, height, reach, _ = breast
    t = np.linspace(0, 2 * np.pi, n, endpoint=False)
    theta, y = angle + wider * reach * np.cos(t) / RADIUS_MM, height + wider * reach * np.sin(t)
    r = radius_mm(theta, y)
    points = np.stack([r * np.sin(theta), y, r * np.cos(theta)], axis=1)
    return Boundary(name=name, points_world=points, method="drawn")  # type: ignore[arg-type]
