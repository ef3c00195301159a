"""A hole at a fold that a breast hides is closed as both skins go on; other holes are not."""

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from solids import ball
from trunks import trunk_mesh

from mammometry.geometry import TriangleMesh
from mammometry.geometry.nearest import closest_on_mesh
from mammometry.measure.fold_patch import continued, edge_of_hole, fold_patch
from mammometry.measure.scan_repair import WIDEST_HOLE_MM, repair_scan
from mammometry.measure.scanned import as_scanned, finer_scan
from mammometry.measure.solid.cut import opening_loops
from mammometry.surface.repair.repair import Provenance

# Height and depth (mm) of a hanging breast's middle profile, from above over the pole and the fold to the chest below.
PROFILE = np.array(
    [(120, 0), (60, 8), (0, 45), (-45, 72), (-80, 62), (-92, 40), (-80, 20), (-62, 5), (-58, 1), (-75, 0), (-110, 0),
     (-170, 0)], dtype=float
)  # fmt: skip
T = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(PROFILE, axis=0), axis=1))])
HIDDEN_T = (T[5] - 4.0, T[9] + 18.0)  # from the pole's lowest skin to the chest below the fold
HALF_MM = 52.0  # half width of the part that is not seen


def hanging(step_mm: float = 3.0) -> tuple[TriangleMesh, TriangleMesh]:
    """A chest with a breast that hangs over its fold, whole and without its hidden part."""
    x, t = np.arange(-110.0, 110.1, step_mm), np.arange(0.0, T[-1], step_mm)
    profile = CubicSpline(T, PROFILE)(t)
    share = np.where(np.abs(x) < 100, np.cos(np.pi * x / 200) ** 2, 0.0)[:, None]
    y = share * profile[:, 0] + (1 - share) * (120 - 290 * t / t[-1])
    z = share * profile[:, 1]
    vertices = np.stack([np.broadcast_to(x[:, None], y.shape), y, z], axis=-1).reshape(-1, 3)
    first = (np.arange(len(x) - 1)[:, None] * len(t) + np.arange(len(t) - 1)).ravel()
    below, aside = first + 1, first + len(t)
    faces = np.concatenate([np.stack([first, below, aside], axis=1), np.stack([below, aside + 1, aside], axis=1)])
    whole = TriangleMesh(vertices=vertices, faces=faces.astype(np.int32))
    middle, half = np.mean(HIDDEN_T), np.ptp(HIDDEN_T) / 2
    away = np.hypot(np.repeat(x, len(t)) / HALF_MM, (np.tile(t, len(x)) - middle) / half)
    return whole, whole.submesh((away[faces] > 1).all(axis=1))


WHOLE, SEEN = hanging()


def hole_of(mesh: TriangleMesh) -> np.ndarray:
    """The second longest edge of an open mesh."""
    return opening_loops(mesh.faces.astype(np.int64), len(mesh.vertices))[1]


def test_a_hole_in_a_paraboloid_is_closed_by_the_paraboloid() -> None:
    """As Δ²(r²) = 0. Without its slope, the patch would be 1.1 mm off in its middle."""
    r, turn = np.arange(0.0, 60.1, 2.0)[1:], np.arange(120) * np.pi / 60
    flat = (r[:, None, None] * np.stack([np.cos(turn), np.sin(turn)], axis=1)).reshape(-1, 2)
    vertices = np.column_stack([flat, -(flat**2).sum(axis=1) / 800])
    ring = np.arange(len(r) - 1)[:, None] * 120
    a, b = (ring + np.arange(120)).ravel(), (ring + (np.arange(120) + 1) % 120).ravel()
    faces = np.concatenate([np.stack([a, a + 120, b], axis=1), np.stack([b, a + 120, b + 120], axis=1)])
    mesh = TriangleMesh(vertices=vertices, faces=faces.astype(np.int32))
    mesh = mesh.submesh((np.linalg.norm(mesh.vertices[faces][..., :2], axis=2) > 29).all(axis=1))
    loop = min(
        opening_loops(mesh.faces.astype(np.int64), len(mesh.vertices)), key=lambda one: np.ptp(mesh.vertices[one])
    )
    edge = edge_of_hole(mesh, loop)
    assert edge is not None
    points, _ = continued(edge)
    off_mm = points[:, 2] + (points[:, :2] ** 2).sum(axis=1) / 800
    assert np.abs(off_mm).max() < 0.25  # the slope is that of the 12 mm outside the edge


def test_the_patch_turns_with_the_scan() -> None:
    patch = fold_patch(SEEN, hole_of(SEEN))
    assert patch is not None
    turn = np.array([[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [0.48, 0.64, 0.6]])
    turned = TriangleMesh(vertices=SEEN.vertices @ turn.T + [30.0, -200.0, 900.0], faces=SEEN.faces)
    again = fold_patch(turned, hole_of(turned))
    assert again is not None
    back = (again[0] - [30.0, -200.0, 900.0]) @ turn
    closed = TriangleMesh(
        vertices=np.concatenate([SEEN.vertices[hole_of(SEEN)], patch[0]]), faces=patch[1].astype(np.int32)
    )
    assert np.linalg.norm(closest_on_mesh(back, closed).points - back, axis=1).max() < 1.0


@pytest.mark.parametrize("kind", ["tip", "cut"])
def test_a_hole_in_a_dome_and_a_cut_limb_are_no_folds(kind: str) -> None:
    if kind == "tip":
        mesh = ball(80.0, 4)
        mesh = mesh.submesh(mesh.corners().mean(axis=1)[:, 2] < 65)
        loop = opening_loops(mesh.faces.astype(np.int64), len(mesh.vertices))[0]
    else:
        mesh = trunk_mesh(4.0)
        mesh = mesh.submesh(mesh.corners().mean(axis=1)[:, 1] < 60)
        loop = opening_loops(mesh.faces.astype(np.int64), len(mesh.vertices))[0]
    assert fold_patch(mesh, loop) is None


def test_a_fold_wider_than_other_holes_is_closed_and_borders_see_it() -> None:
    wide = TriangleMesh(vertices=SEEN.vertices * 1.42, faces=SEEN.faces)
    scan = repair_scan(wide)
    assert (scan.at_fold == scan.invented).all()
    assert scan.notices[0].values["mm"] > WIDEST_HOLE_MM
    fine = finer_scan(scan, [scan.mesh.vertices[scan.at_fold]])
    assert fine.at_fold.sum() >= scan.at_fold.sum()
    provenance = as_scanned(fine.mesh, fine.invented, fine.at_fold).provenance
    assert ((provenance == Provenance.BRIDGED) == fine.at_fold).all()
    assert not (provenance == Provenance.INVENTED).any()
