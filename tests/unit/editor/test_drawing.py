"""What is drawn lies on the surface and encloses what it should; what nobody touched stays exactly as it was."""

import numpy as np
import pytest
import trimesh

from mammometry.editor.drawing import DrawingBoard, Handle, drawing_board, handle_indices
from mammometry.geometry.camera import Camera, Rig
from mammometry.geometry.mesh import TriangleMesh
from mammometry.geometry.transform import Transform
from mammometry.measure.boundary.boundary import Boundary
from mammometry.measure.settings import MeasureSettings
from mammometry.measure.trunk.body import rig_frame
from mammometry.surface.repair.repair import Provenance, RepairedSurface

RADIUS_MM = 60.0


def ball(subdivisions: int = 6) -> RepairedSurface:
    """Measured above, invented below; the camera looks down on it."""
    mesh = trimesh.creation.icosphere(subdivisions=subdivisions, radius=RADIUS_MM)
    vertices = np.asarray(mesh.vertices, dtype=np.float64)
    above = vertices[:, 2] > 30.0
    return RepairedSurface(
        mesh=TriangleMesh(vertices=vertices, faces=np.asarray(mesh.faces, dtype=np.int32)),
        provenance=np.where(above, Provenance.MEASURED, Provenance.INVENTED).astype(np.uint8),
        sigma_mm=np.where(above, np.float32(0.1), np.float32(np.nan)),
        pair_bits=above.astype(np.int32),
        pair_names=("one",),
        convergence=np.array([0.1]),
    )


def rig() -> Rig:
    """A pair above the ball that looks down."""
    cameras = {}
    for name, x in (("a", -50.0), ("b", 50.0)):
        down = np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]])
        cameras[name] = Camera(
            name=name,
            size_wh=(400, 300),
            matrix=np.array([[1000.0, 0, 200], [0, 1000.0, 150], [0, 0, 1]]),
            distortion=np.zeros(5),
            camera_from_world=Transform(rotation=down, translation_mm=-down @ np.array([x, 0.0, 800.0])),
        )
    return Rig(name="r", cameras=cameras, pair_names={"one": ("a", "b")})


@pytest.fixture(scope="module")
def board() -> DrawingBoard:
    return drawing_board(ball(), rig_frame(rig()), MeasureSettings(), triangles=30_000)


def circle(height_mm: float, count: int) -> np.ndarray:
    angle = 2 * np.pi * np.arange(count) / count
    radius = np.sqrt(RADIUS_MM**2 - height_mm**2)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), np.full(count, height_mm)], axis=1)


@pytest.mark.parametrize("height_mm", [0.0, 20.0])
def test_a_drawn_circle_encloses_its_cap(board: DrawingBoard, height_mm: float) -> None:
    live = board.measure({"model": board.laid(circle(height_mm, 12))})["model"]
    assert live.problem is None
    # A handle every 30 degrees leaves the spline 0.1 mm from the circle, thinning 0.05 mm: 0.2 mm of height over
    # the cap's base.
    tall = RADIUS_MM - height_mm
    true_cc = np.pi * tall**2 * (RADIUS_MM - tall / 3) / 1000
    base_cm2 = np.pi * (RADIUS_MM**2 - height_mm**2) / 100
    assert live.volume_cc == pytest.approx(true_cc, abs=base_cm2 * 0.02)
    assert np.abs(np.linalg.norm(live.curve_world, axis=1) - RADIUS_MM).max() < 0.1
    assert np.abs(live.curve_world[:, 2] - height_mm).max() < 0.5


def test_a_curve_that_cannot_be_closed_says_why(board: DrawingBoard) -> None:
    there_and_back = np.concatenate([circle(0.0, 40)[:8], circle(0.0, 40)[6:0:-1]])
    live = board.measure({"left": board.laid(there_and_back)})["left"]
    assert live.volume_cc is None
    assert live.problem is not None
    assert "'left'" in live.problem


def wavy(count: int = 700) -> np.ndarray:
    """A closed curve with waves of 12 mm length and 3 mm height, on the ball."""
    angle = 2 * np.pi * np.arange(count) / count
    height = 20.0 + 3.0 * np.sin(28 * angle)
    radius = np.sqrt(RADIUS_MM**2 - height**2)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), height], axis=1)


def handles(curve: np.ndarray) -> list[Handle]:
    return [Handle(point_world=curve[k], at=int(k)) for k in handle_indices(curve)]


def on_ball(point: np.ndarray) -> np.ndarray:
    return point * RADIUS_MM / np.linalg.norm(point)


def test_handles_are_few_even_and_points_of_the_curve() -> None:
    curve = circle(0.0, 2000)
    held = handle_indices(curve)
    assert len(held) == int(2 * np.pi * RADIUS_MM / 18)
    gaps = np.linalg.norm(curve[held] - np.roll(curve[held], 1, axis=0), axis=1)
    assert np.ptp(gaps) < 0.4  # points are 0.19 mm apart
    assert len(handle_indices(curve / 20)) == 8
    assert handle_indices(curve[::400]).tolist() == [0, 1, 2, 3, 4]


def test_a_curve_that_nobody_touched_stays_exactly_as_it_is(board: DrawingBoard) -> None:
    curve = wavy()
    assert np.array_equal(board.edited(curve, handles(curve)), curve)


@pytest.mark.slow
@pytest.mark.parametrize("which", [0, 5, -1])
@pytest.mark.requirement("R-LOSS-11")
def test_a_moved_handle_changes_the_curve_only_up_to_its_neighbours(board: DrawingBoard, which: int) -> None:
    curve, held = wavy(), handles(wavy())
    goal = on_ball(curve[held[which].at] + [0.0, 0.0, 10.0])
    moved = [*held]
    moved[which] = Handle(point_world=goal)
    edited = board.edited(curve, moved)
    first, last = held[which - 1].at, held[(which + 1) % len(held)].at
    assert first is not None
    assert last is not None
    there = {tuple(point) for point in edited}
    kept = [k for k in range(len(curve)) if (k - last) % len(curve) <= (first - last) % len(curve)]
    assert len(kept) > 600
    assert all(tuple(curve[k]) in there for k in kept)
    new = np.array([point for point in edited if tuple(point) not in {tuple(one) for one in curve}])
    assert np.linalg.norm(new - goal, axis=1).min() < 1.5  # a step is 2 mm
    assert np.linalg.norm(new - goal, axis=1).max() < 30.0
    steps = np.linalg.norm(edited - np.roll(edited, 1, axis=0), axis=1)
    assert steps.max() < 3.0  # 2 mm along the chords between handles, more along the arc
    assert steps[0] < 3.0


def test_a_removed_and_an_added_handle_change_the_curve_only_there(board: DrawingBoard) -> None:
    curve, held = wavy(), handles(wavy())
    without = board.edited(curve, [*held[:4], *held[5:]])
    span = held[5].at - held[3].at  # type: ignore[operator]
    assert len({tuple(point) for point in curve} - {tuple(point) for point in without}) == span - 1
    middle = on_ball((held[4].point_world + held[5].point_world) / 2 + [0, 0, 6.0])
    added = board.edited(curve, [*held[:5], Handle(point_world=middle), *held[5:]])
    span = held[5].at - held[4].at  # type: ignore[operator]
    assert len({tuple(point) for point in curve} - {tuple(point) for point in added}) == span - 1
    assert np.linalg.norm(added - middle, axis=1).min() < 1.5


def test_a_curve_all_of_whose_handles_were_moved_is_laid_anew(board: DrawingBoard) -> None:
    moved = [Handle(point_world=point) for point in circle(10.0, 12)]
    assert np.array_equal(board.edited(wavy(), moved), board.laid(circle(10.0, 12)))


def test_a_sparse_given_curve_closes_over_a_short_step_when_it_is_edited(board: DrawingBoard) -> None:
    curve = circle(0.0, 9)  # 42 mm from point to point
    held = handles(curve)
    held[3] = Handle(point_world=on_ball(curve[3] + [0, 0, 10.0]))
    live = board.measure({"model": board.edited(curve, held)})["model"]
    assert live.problem is None
    assert live.interval_cc is not None


def test_an_automatic_boundary_is_measured_as_what_it_is(board: DrawingBoard) -> None:
    found = Boundary(name="model", points_world=circle(0.0, 200), method="found", sigma_mm=0.05)
    as_found = board.measure({"model": found.points_world}, {"model": found})["model"].interval_cc
    as_drawn = board.measure({"model": circle(0.0, 201)}, {"model": found})["model"].interval_cc
    assert as_found is not None
    assert as_drawn is not None
    assert np.ptp(as_drawn) > 2 * np.ptp(as_found)
