"""Stations of a walk: each photograph's camera in the board's frame, with the covariance of all of them."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mammometry.calibration.adjust.calibrated import ParameterCovariance
from mammometry.calibration.adjust.network import POSE_NAMES_CAMERA, POSE_NAMES_STATION
from mammometry.geometry import Camera, Transform
from mammometry.walk.stations import TELEPHONE, station_cameras

POSES = ("a", "b", "c")
LENS = ("fx_px", "k1")


def turned(vector, rotation):
    return Rotation.from_rotvec(vector).as_matrix() @ rotation


@pytest.fixture
def one():
    rng = np.random.default_rng(7)
    camera = Camera(
        name=TELEPHONE,
        size_wh=(2000, 1500),
        matrix=np.array([[1500.0, 0, 1000], [0, 1500.0, 750], [0, 0, 1]]),
        distortion=np.array([0.05, 0, 0, 0, 0]),
        camera_from_world=Transform(
            rotation=Rotation.from_rotvec(rng.normal(size=3)).as_matrix(), translation_mm=rng.normal(size=3) * 300
        ),
    )
    poses = {"a": Transform(rotation=np.eye(3), translation_mm=np.zeros(3))}
    for name in POSES[1:]:
        poses[name] = Transform(
            rotation=Rotation.from_rotvec(rng.normal(size=3)).as_matrix(), translation_mm=rng.normal(size=3) * 200
        )
    names = [f"{TELEPHONE}.{name}" for name in (*LENS, *POSE_NAMES_CAMERA)]
    names += [f"pose {pose}.{name}" for pose in POSES[1:] for name in POSE_NAMES_STATION]
    root = rng.normal(size=(len(names), len(names))) * 1e-4
    matrix = root @ root.T
    return camera, poses, ParameterCovariance(names=tuple(names), matrix=matrix, independent=matrix)


def moved(camera, poses, names, step):
    """The calibration after a small step of its parameters, as the bundle adjustment counts them."""
    of = dict(zip(names, step, strict=True))

    def vector(owner, kinds):
        return np.array([of.get(f"{owner}.{kind}", 0.0) for kind in kinds])

    matrix, distortion = camera.matrix.copy(), camera.distortion.copy()
    matrix[0, 0] += of[f"{TELEPHONE}.fx_px"]
    distortion[0] += of[f"{TELEPHONE}.k1"]
    rotation = turned(vector(TELEPHONE, POSE_NAMES_CAMERA[:3]), camera.camera_from_world.rotation)
    centre = camera.centre_world + vector(TELEPHONE, POSE_NAMES_CAMERA[3:])
    other = replace(
        camera,
        matrix=matrix,
        distortion=distortion,
        camera_from_world=Transform(rotation=rotation, translation_mm=-rotation @ centre),
    )
    return other, {
        pose: Transform(
            rotation=turned(vector(f"pose {pose}", POSE_NAMES_STATION[:3]), placed.rotation),
            translation_mm=placed.translation_mm + vector(f"pose {pose}", POSE_NAMES_STATION[3:]),
        )
        for pose, placed in poses.items()
    }


def test_a_station_sees_the_board_as_the_telephone_saw_it(one):
    camera, poses, covariance = one
    cameras, _ = station_cameras(camera, poses, covariance)
    points = np.random.default_rng(1).normal(size=(20, 3)) * 100
    for pose, placed in poses.items():
        expected = camera.camera_from_world.apply(placed.apply(points))
        np.testing.assert_allclose(cameras[pose].camera_from_world.apply(points), expected, atol=1e-9)


def test_the_covariance_is_that_of_small_steps_of_the_calibration(one):
    """Against differences of the composed cameras, one parameter at a time."""
    camera, poses, covariance = one
    cameras, mapped = station_cameras(camera, poses, covariance)
    small = 1e-6
    columns = []
    for column in range(len(covariance.names)):
        step = np.zeros(len(covariance.names))
        step[column] = small
        changes = []
        for sign in (1, -1):
            other, placed = moved(camera, poses, covariance.names, sign * step)
            values = []
            for pose in POSES:
                station = other.camera_from_world @ placed[pose]
                was = cameras[pose]
                turn = Rotation.from_matrix(station.rotation @ was.camera_from_world.rotation.T).as_rotvec()
                centre = -station.rotation.T @ station.translation_mm
                values += [other.matrix[0, 0], other.distortion[0], *turn, *centre]
            changes.append(np.array(values))
        columns.append((changes[0] - changes[1]) / (2 * small))
    jacobian = np.stack(columns, axis=1)
    expected = jacobian @ covariance.matrix @ jacobian.T
    assert mapped.names[:3] == ("a.fx_px", "a.k1", "a.rotation_x_rad")
    np.testing.assert_allclose(mapped.matrix, expected, atol=1e-6 * np.abs(expected).max())
