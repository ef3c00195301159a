"""Camera errors of known size come out as that size, and a rigid motion of the whole rig as none."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from mammometry.geometry.camera import Camera, Rig
from mammometry.geometry.mesh import TriangleMesh
from mammometry.geometry.transform import Transform
from mammometry.study.accuracy import compare_rigs, nearest_points, rigid, working_volume

POINTS = working_volume(
    TriangleMesh(
        vertices=np.array([[-60.0, -60, -60], [60, 60, 60], [60, -60, 0]]), faces=np.array([[0, 1, 2]], dtype=np.int32)
    )
)


def camera(name: str, angle_deg: float) -> Camera:
    """A camera 800 mm from the origin that looks at it, turned about y."""
    angle = np.radians(angle_deg)
    rotation = np.array([[np.cos(angle), 0, -np.sin(angle)], [0, 1, 0], [np.sin(angle), 0, np.cos(angle)]])
    return Camera(
        name=name,
        size_wh=(1126, 750),
        matrix=np.array([[2000.0, 0, 560], [0, 2001, 370], [0, 0, 1]]),
        distortion=np.array([-0.05, 0.1, 2e-4, -1e-4, 0]),
        camera_from_world=Transform(rotation=rotation, translation_mm=np.array([0, 0, 800.0])),
    )


def rig(*cameras: Camera) -> Rig:
    return Rig(
        name="virtual",
        cameras={each.name: each for each in cameras},
        pair_names={"front": ("a", "b"), "side": ("c", "d")},
    )


TRUE = rig(camera("a", -8), camera("b", 8), camera("c", 40), camera("d", 55))


def moved(each: Camera, new_from_world: Transform) -> Camera:
    return replace(each, camera_from_world=each.camera_from_world @ new_from_world.inverse())


def test_working_volume_is_the_box_grown_by_a_fifth() -> None:
    assert POINTS.shape == (343, 3)
    assert POINTS.min(axis=0) == pytest.approx([-72, -72, -72])
    assert POINTS.max(axis=0) == pytest.approx([72, 72, 72])


def test_a_rig_in_another_frame_has_no_error() -> None:
    world_from_rig = Transform.from_rotation_vector(np.array([0.5, -1.1, 0.3]), np.array([120.0, -40, 300]))
    found = compare_rigs(rig(*(moved(each, world_from_rig) for each in TRUE.cameras.values())), TRUE, POINTS)
    assert found.projection_rms_px < 1e-6
    assert found.worst_pair[1] < 1e-6
    assert found.centre_rms_mm < 1e-6
    assert found.rig_from_world.matrix == pytest.approx(world_from_rig.inverse().matrix, abs=1e-7)


def projection_rms_px(rig_from_world: Transform, calibrated: Rig) -> float:
    points_world = rig_from_world.inverse().apply(POINTS)
    squares = []
    for name, true in TRUE.cameras.items():
        uv = true.project(POINTS)
        seen = ((uv >= 0) & (uv <= np.array(true.size_wh) - 1)).all(axis=1)
        squares.append(((calibrated.cameras[name].project(points_world) - uv)[seen] ** 2).sum(axis=1))
    return float(np.sqrt(np.mean(np.concatenate(squares))))


def test_the_alignment_is_the_best_one() -> None:
    # One camera's principal point is 0.3 px off: the alignment absorbs some of it, and no rigid step absorbs more.
    wrong = TRUE.cameras["d"].matrix.copy()
    wrong[0, 2] += 0.3
    calibrated = rig(*{**TRUE.cameras, "d": replace(TRUE.cameras["d"], matrix=wrong)}.values())
    found = compare_rigs(calibrated, TRUE, POINTS)
    assert projection_rms_px(Transform.identity(), calibrated) == pytest.approx(0.15, abs=0.01)  # one camera of four
    assert 0.03 < found.projection_rms_px < 0.15
    assert found.projection_rms_px == pytest.approx(projection_rms_px(found.rig_from_world, calibrated))
    for axis in range(6):
        for sign in (-1, 1):
            step = sign * np.eye(6)[axis] * np.array([1e-4, 1e-4, 1e-4, 0.05, 0.05, 0.05])
            other = Transform.from_rotation_vector(step[:3], step[3:]) @ found.rig_from_world
            assert projection_rms_px(other, calibrated) > found.projection_rms_px
    assert found.worst_pair[0] == "side"


def test_a_larger_rig_is_a_triangulation_error_in_proportion() -> None:
    larger = [
        replace(
            each,
            camera_from_world=Transform(
                rotation=each.camera_from_world.rotation.copy(),
                translation_mm=1.001 * each.camera_from_world.translation_mm,
            ),
        )
        for each in TRUE.cameras.values()
    ]
    found = compare_rigs(rig(*larger), TRUE, POINTS)
    # Similar triangles: every point comes out 0.1 % farther from the middle.
    seen = np.sqrt(np.mean(np.sum((0.001 * POINTS) ** 2, axis=1)))
    for error in found.triangulation_rms_mm.values():
        assert error == pytest.approx(seen, rel=0.15)  # not every point is in every frame
    assert found.projection_rms_px < 0.3
    assert found.centre_rms_mm == pytest.approx(0.8, abs=0.15)


def test_focal_lengths_are_compared_with_their_sign() -> None:
    shorter = TRUE.cameras["a"].matrix.copy()
    shorter[[0, 1], [0, 1]] *= 0.998
    cameras = {**TRUE.cameras, "a": replace(TRUE.cameras["a"], matrix=shorter)}
    found = compare_rigs(rig(*cameras.values()), TRUE, POINTS)
    assert found.focal_worst_percent == pytest.approx(-0.2)


def test_triangulation_finds_the_point_whose_projections_were_given() -> None:
    pair = TRUE.pair("front")
    points = POINTS[::20]
    found = nearest_points(pair, pair.left.project(points), pair.right.project(points))
    assert found == pytest.approx(points, abs=1e-7)


def test_a_rig_that_looks_away_is_refused() -> None:
    with pytest.raises(ValueError, match="sees"):
        compare_rigs(TRUE, TRUE, POINTS + np.array([0, 5000.0, 0]))


def test_rigid_never_mirrors() -> None:
    flat = trimesh.creation.icosphere(subdivisions=1).vertices * (3.0, 2.0, 0.0)
    found = rigid(flat, flat * (1, 1, -1) + np.array([1.0, 2.0, 3.0]))
    assert np.linalg.det(found.rotation) == pytest.approx(1.0)
    assert found.apply(flat) == pytest.approx(flat + np.array([1.0, 2.0, 3.0]))
