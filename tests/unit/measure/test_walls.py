"""Each wall against a surface that it must reproduce: Scherk's, a bilinear patch, a plane, a chest that is known."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from solids import as_surface, rig_around
from trunks import LEFT, RADIUS_MM, edge_of, trunk_mesh, volume_cc

from mammometry.base.errors import MeasureError
from mammometry.geometry.mesh import TriangleMesh
from mammometry.measure.boundary.boundary import Boundary
from mammometry.measure.solid.cut import OpenPart
from mammometry.measure.trunk.body import rig_frame
from mammometry.measure.wall import chest_wall
from mammometry.measure.wall.heights import plate
from mammometry.measure.wall.kinds.over_boundary import coons, membrane, plane, thin_plate
from mammometry.measure.wall.open_breast import OpenBreast
from mammometry.surface.repair.repair import RepairedSurface

RIG = rig_around()
EDGE = edge_of(LEFT, "left")


def lid(corners: np.ndarray, height) -> OpenPart:  # type: ignore[no-untyped-def]
    """A cap over a loop that lies on a surface z = height(x, y), bulging towards +z; star-shaped about the origin."""
    share = np.linspace(1.0, 0.0, 24)[:-1]
    rings = corners[None] * share[:, None, None]
    x, y = rings[..., 0], rings[..., 1]
    z = height(x, y) + 30.0 * (1 - share[:, None] ** 2)
    points = np.stack([x, y, z], axis=-1).reshape(-1, 3)
    n = len(corners)
    grid = np.arange(len(points)).reshape(-1, n)
    a, b = grid[:-1], np.roll(grid, -1, axis=1)[:-1]
    c, d = grid[1:], np.roll(grid, -1, axis=1)[1:]
    top = np.stack([grid[-1], np.roll(grid[-1], -1), np.full(n, len(points))], axis=1)
    faces = np.concatenate(
        [np.stack([a, b, d], axis=-1).reshape(-1, 3), np.stack([a, d, c], axis=-1).reshape(-1, 3), top]
    )
    apex = [[0.0, 0.0, float(height(np.zeros(1), np.zeros(1))[0]) + 30.0]]
    return OpenPart(
        mesh=TriangleMesh(vertices=np.concatenate([points, apex]), faces=faces.astype(np.int32)), loops=(np.arange(n),)
    )


def opened(part: OpenPart) -> OpenBreast:
    """A breast of which the cut is given."""
    rim = Boundary(name="left", points_world=part.mesh.vertices[part.loops[0]], method="")
    breast = OpenBreast(boundary=rim, surface=as_surface(part.mesh))
    vars(breast)["part"] = part
    return breast


def circle(radius: float, n: int = 160) -> np.ndarray:
    t = 2 * np.pi * np.arange(n) / n
    return radius * np.stack([np.cos(t), np.sin(t)], axis=1)


def square(half: float, n: int = 40) -> np.ndarray:
    s = np.linspace(-half, half, n, endpoint=False)
    e = np.full(n, half)
    return np.concatenate([np.stack(side, axis=1) for side in ((s, -e), (e, s), (-s, e), (-e, -s))])


def test_the_membrane_is_scherks_surface() -> None:
    """Z = a ln(cos(x/a) / cos(y/a)) has no mean curvature: of all surfaces through its own edge it has least area."""
    a = 45.0

    def scherk(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return a * np.log(np.cos(x / a) / np.cos(y / a))

    part = lid(circle(50.0), scherk)
    found = membrane(opened(part))
    assert found.solid.is_watertight()
    x, y, z = found.wall.vertices.T
    # The edge rises and sinks by 40 mm; 2.5 mm squares bend by h²/8 of its curvature, some hundredths of a millimetre.
    assert np.ptp(z) > 30
    assert np.abs(z - scherk(x, y)).max() < 0.15
    for other in (thin_plate(opened(part)), coons(opened(part))):
        assert found.wall.area_mm2() < other.wall.area_mm2() * 1.0005


def test_coons_reproduces_a_bilinear_patch() -> None:
    found = coons(opened(lid(square(50.0), lambda x, y: 0.004 * x * y + 0.1 * x)))
    x, y, z = found.wall.vertices.T
    assert found.solid.is_watertight()
    assert np.abs(z - (0.004 * x * y + 0.1 * x)).max() < 0.02
    assert len(found.wall.vertices) > 400


def test_coons_needs_one_opening() -> None:
    part = lid(circle(40.0), lambda x, y: 0 * x)
    with pytest.raises(MeasureError, match=r"coons wall: .*\b2 openings"):
        coons(opened(replace(part, loops=part.loops * 2)))


@pytest.mark.parametrize("shape", [plane, membrane, thin_plate, coons])
def test_over_a_plane_every_wall_is_that_plane(shape) -> None:  # type: ignore[no-untyped-def]
    part = lid(circle(40.0), lambda x, y: 0.3 * x - 0.1 * y)
    found = shape(opened(part))
    x, y, z = found.wall.vertices.T
    assert np.allclose(z, 0.3 * x - 0.1 * y, atol=1e-6)
    # A paraboloid of 30 mm over a polygon of nearly a disc: half its cylinder.
    assert found.solid.volume_mm3() == pytest.approx(np.pi * 40.0**2 * 30.0 / 2, rel=0.01)


def test_a_place_that_is_there_twice_does_not_make_a_plate_singular() -> None:
    """As where a boundary cuts a scanner's mesh at one of its vertices."""
    angle = np.linspace(0, 2 * np.pi, 60, endpoint=False)
    places = np.stack([50 * np.cos(angle), 50 * np.sin(angle), 3 * np.cos(2 * angle)], axis=1)
    once, twice = plate(places), plate(np.repeat(places, 1 + (np.arange(60) == 7), axis=0))
    inside = 0.5 * places[:, :2]
    np.testing.assert_allclose(twice(inside), once(inside), atol=1e-9)


def test_a_plate_goes_through_its_places_and_is_straight_where_they_are() -> None:
    rng = np.random.default_rng(2)
    places = rng.uniform(-50, 50, (60, 2))
    level = 0.2 * places[:, 0] - 0.4 * places[:, 1] + 7
    height = plate(np.column_stack([places, level]))
    away = rng.uniform(-50, 50, (40, 2))
    assert np.allclose(height(away), 0.2 * away[:, 0] - 0.4 * away[:, 1] + 7, atol=1e-8)
    bent = plate(np.column_stack([places, level + rng.normal(size=60)]))
    assert not np.allclose(bent(away), height(away), atol=0.1)


@cache
def one_sided() -> RepairedSurface:
    """The trunk with its left breast alone."""
    mesh = trunk_mesh(3.0)
    vertices = mesh.vertices.copy()
    right = (vertices[:, 0] < -5.0) & (np.hypot(vertices[:, 0], vertices[:, 2]) > 1.0)
    vertices[np.ix_(right, [0, 2])] *= (RADIUS_MM / np.hypot(vertices[right, 0], vertices[right, 2]))[:, None]
    return as_surface(TriangleMesh(vertices=vertices, faces=mesh.faces), vertices[:, 2] > -0.35 * RADIUS_MM)


def one_breast() -> OpenBreast:
    return OpenBreast(boundary=EDGE, surface=one_sided(), boundaries=(EDGE,), frame=rig_frame(RIG))


def bare_trunk() -> TriangleMesh:
    mesh = trunk_mesh(3.0)
    vertices = mesh.vertices.copy()
    side = np.hypot(vertices[:, 0], vertices[:, 2])
    vertices[:, [0, 2]] *= np.where(side > 1, RADIUS_MM / np.maximum(side, 1), 1)[:, None]
    return TriangleMesh(vertices=vertices, faces=mesh.faces)


@pytest.mark.slow
def test_a_side_without_a_breast_is_the_wall_of_the_other() -> None:
    walls = {wall.kind: wall for wall in chest_wall.fit_all(one_breast())}
    assert walls["mirrored"].closed.is_watertight()
    # 3 mm edges along the cut; the flat side is exactly the cylinder.
    assert walls["mirrored"].closed.volume_mm3() / 1000 == pytest.approx(volume_cc(LEFT), rel=0.02)
    assert "measured" not in walls


def test_a_wall_measured_by_itself_is_the_default() -> None:
    wall = chest_wall.fit(replace(one_breast(), back=bare_trunk()))
    assert wall.kind == "measured"
    assert "wall.ply" in wall.definition
    assert wall.closed.volume_mm3() / 1000 == pytest.approx(volume_cc(LEFT), rel=0.02)


def test_a_measured_wall_that_misses_the_breast_is_refused() -> None:
    trunk = bare_trunk()
    half = trunk.submesh((trunk.vertices[:, 1] > 20)[trunk.faces].all(axis=1))
    with pytest.raises(MeasureError, match=r"measured wall: .*\d+ %"):
        chest_wall.fit(replace(one_breast(), back=half))
    with pytest.raises(MeasureError, match=r"measured wall: .*frame"):
        chest_wall.fit(one_breast(), "measured")
