"""Find the positions of further photographs of a walk, with the lens fixed.

Corners of boards seen at a flat angle are inaccurate, and must not affect the lens or the positions of other
photographs. So only the positions of these photographs are fitted (decision 52).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from scipy.optimize import least_squares

from mammometry.calibration.adjust.calibrated import ParameterCovariance
from mammometry.calibration.adjust.network import POSE_NAMES_CAMERA
from mammometry.calibration.detection.detect import Detection
from mammometry.calibration.judge.expected_error import derivatives
from mammometry.geometry import Array, Camera, Float64, Transform
from mammometry.walk.stations import Stations

_MOST_RMS_PX = 1.5  # largest residual of a usable board, as in `stations`. Boards at 60 to 80 degrees fit to 0.06 px
_SIGMAS = 2.0  # residual beyond which a corner has less weight, standard deviations
_STEP = np.array([1e-3, 1e-3, 1e-3, 1.0, 1.0, 1.0])  # rad and mm: similar effects in the image


def with_held_lens(stations: Stations, boards: Mapping[str, Detection], starts: Mapping[str, Camera]) -> Stations:
    """Add further photographs to the stations.

    The covariance of each added position includes that of the lens. Photographs whose corners do not fit are left out.

    Args:
        stations: of the other photographs.
        boards: name of a further photograph → the board in it.
        starts: name → its approximate camera in the board's frame.
    """
    expanded = stations.expanded
    cameras, covariance = dict(expanded.rig.cameras), expanded.covariance
    held: dict[str, Detection] = {}
    lens = next(iter(cameras.values()))
    for name, board in boards.items():
        points = stations.calibration.target_points[board.ids]
        start = replace(lens, name=name, camera_from_world=starts[name].camera_from_world)
        camera = _fitted(start, points, board)
        if np.sqrt(np.mean((camera.project(points) - board.uv) ** 2)) > _MOST_RMS_PX:
            continue
        cameras[name], held[name] = camera, board
        covariance = _extended(covariance, lens.name, camera, points, board, stations.calibration.noise_factor)
    rig = replace(expanded.rig, cameras={name: cameras[name] for name in sorted(cameras)})
    return replace(stations, expanded=replace(expanded, rig=rig, covariance=covariance), held=held)


def _fitted(camera: Camera, points: Float64[Array, "n 3"], board: Detection) -> Camera:
    """The camera in the pose that fits best."""
    weights = np.linalg.inv(np.linalg.cholesky(board.covariance_px2))

    def moved(step: Float64[Array, 6]) -> Camera:
        turn, shift = _STEP[:3] * step[:3], _STEP[3:] * step[3:]
        rotation = Transform.from_rotation_vector(turn, np.zeros(3)).rotation @ camera.camera_from_world.rotation
        centre = camera.centre_world + shift
        return replace(camera, camera_from_world=Transform(rotation=rotation, translation_mm=-rotation @ centre))

    def residuals(step: Float64[Array, 6]) -> Float64[Array, " m"]:
        return np.einsum("nij,nj->ni", weights, moved(step).project(points) - board.uv).ravel()

    return moved(least_squares(residuals, np.zeros(6), loss="soft_l1", f_scale=_SIGMAS).x)


def _extended(
    covariance: ParameterCovariance,
    first: str,
    camera: Camera,
    points: Float64[Array, "n 3"],
    board: Detection,
    noise_factor: float,
) -> ParameterCovariance:
    """Extend the covariance by a camera that has the lens of the first one."""
    column = {name: index for index, name in enumerate(covariance.names)}
    own = [name.removeprefix(f"{first}.") for name in column if name.startswith(f"{first}.")]
    of_lens = [name for name in own if name not in POSE_NAMES_CAMERA]
    names = tuple(f"{camera.name}.{name}" for name in (*of_lens, *POSE_NAMES_CAMERA))
    _, by_parameter = derivatives(camera, points, names)
    weights = np.linalg.inv(np.linalg.cholesky(board.covariance_px2)) / noise_factor
    rows = np.einsum("nij,njk->nik", weights, by_parameter).reshape(-1, len(names))
    lens, pose = rows[:, : len(of_lens)], rows[:, len(of_lens) :]
    alone = np.linalg.inv(pose.T @ pose)
    select = np.zeros((len(of_lens), len(column)))
    select[np.arange(len(of_lens)), [column[f"{first}.{name}"] for name in of_lens]] = 1.0
    whole = np.concatenate([np.eye(len(column)), select, -alone @ pose.T @ lens @ select])
    # Errors common to the points of a photograph are assumed to be as large as in the other photographs.
    poses = [index for name, index in column.items() if name.rpartition(".")[2] in POSE_NAMES_CAMERA]
    shared = float(np.median(np.diag(covariance.matrix)[poses] / np.diag(covariance.independent)[poses]))
    matrix, independent = whole @ covariance.matrix @ whole.T, whole @ covariance.independent @ whole.T
    matrix[-6:, -6:] += shared * alone
    independent[-6:, -6:] += alone
    return ParameterCovariance(names=(*covariance.names, *names), matrix=matrix, independent=independent)
