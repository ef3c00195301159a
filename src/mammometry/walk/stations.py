"""Pose of the telephone at each photograph of a walk, from the board in the photograph.

The telephone is one camera, and each photograph shows the board in another pose. So the bundle adjustment of rigs gives
the lens, all poses, the board's bow and their joint covariance at once. Here its result is converted to the board's
frame: a rig with one camera per photograph, all with the same lens.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from mammometry.base.errors import BoardSizeError, CalibrationError
from mammometry.base.photograph import Photograph
from mammometry.base.progress import Progress, no_progress
from mammometry.base.sizes import Size, fitting
from mammometry.calibration.adjust import bundle
from mammometry.calibration.adjust.calibrated import Calibration, ParameterCovariance
from mammometry.calibration.adjust.network import POSE_NAMES_CAMERA, POSE_NAMES_STATION
from mammometry.calibration.detection.detect import Detection, Observations, detect
from mammometry.calibration.judge.expected_error import expected_std_mm
from mammometry.calibration.settings import CalibrateSettings
from mammometry.calibration.targets.target import Target
from mammometry.geometry import Array, Camera, Float64, Rig, Transform
from mammometry.walk.region import Region

TELEPHONE = "telephone"
"""Name of the single camera of a walk's calibration."""
FEWEST = 8
"""Fewest photographs that must show the board. With fewer, the lens is undetermined, and most skin is in one pair."""
_MOST_RMS_PX, _MOST_BOW_MM = 1.5, 3.0
"""Largest residual and bow of a usable board. Good boards fit to 0.05 px, blurred photographs to 0.3 px, a board bent
round the belly to 8 px; a bow of 3 mm was still corrected (decision 52)."""
_NEAR_MM, _NEAREST = 60.0, 4  # distance within which the board's heights are averaged, and the fewest corners
_DISTANCE_MM, _USUAL_DISTANCE_MM = (150.0, 3000.0), (300.0, 1500.0)
"""Possible and usual distances of a telephone that sees both breasts and the board. The instructions say 500 to 650."""
_STEPS = 7  # points along each side of the grid over which the stations' errors are averaged


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Stations:
    """The telephone at each photograph that shows the board."""

    calibration: Calibration
    """Calibration of the single camera. Its poses are the photographs."""
    expanded: Calibration
    """The same with one camera per photograph, in the board's frame, without pairs. Its covariance is the joint one."""
    held: Mapping[str, Detection] = field(default_factory=dict)
    """Photograph whose position was fitted with the lens fixed → the board in it."""

    @property
    def rig(self) -> Rig:
        """One camera per photograph, in the board's frame, mm."""
        return self.expanded.rig

    def point_std_mm(self, rig: Rig, region: Region) -> float:
        """Standard uncertainty of reconstructed points due to the telephone's poses and lens, mm.

        Root mean square over the middle of the body's region, propagated from the covariance through the pairs'
        triangulation. A motion or scale common to all pairs does not count.

        Args:
            rig: the cameras with their pairs.
            region: region of the body.

        Raises:
            CalibrationError: no pair sees it.
        """
        third = (region.high_world - region.low_world) / 6
        steps = [np.linspace(middle - half, middle + half, _STEPS) for middle, half in
                 zip(region.middle_world, third, strict=True)]  # fmt: skip
        points = np.stack(np.meshgrid(*steps, indexing="ij"), axis=-1).reshape(-1, 3)
        std_mm = expected_std_mm(rig, self.expanded.covariance, points)
        seen = np.concatenate(list(std_mm.values()))
        seen = seen[np.isfinite(seen)]
        if not len(seen):
            raise CalibrationError(
                "the photographs",
                found="no two neighbouring ones that show the body above the board",
                expected="the board and both breasts in every photograph",
                remedy="Photograph again from 50 to 65 cm, with the board at the lower edge of the picture",
            )
        return float(np.sqrt(np.mean(seen**2)))

    def plane_mm(self, place: tuple[float, float]) -> float:
        """Height z of the board near a position (x, y) on it, mm. Not 0 if the board is bowed."""
        away = np.linalg.norm(self.calibration.target_points[:, :2] - np.array(place), axis=1)
        near = away <= max(_NEAR_MM, float(np.sort(away)[_NEAREST - 1]))
        return float(self.calibration.target_points[near, 2].mean())

    def require_distance(self) -> None:
        """Refuse a board described in another unit than mm: the telephone would be impossibly near or far.

        Raises:
            BoardSizeError: states the distance, and the size that would fit.
        """
        middle = self.calibration.target_points.mean(axis=0)
        away = [float(np.linalg.norm(camera.centre_world - middle)) for camera in self.rig.cameras.values()]
        distance = Size(
            mm=float(np.median(away)),
            name="distance",
            possible_mm=_DISTANCE_MM,
            usual_mm=_USUAL_DISTANCE_MM,
            words="the telephone is {} from the board",
        )
        if distance.is_possible:
            return
        name, stated_mm = self.calibration.observations.target.stated_size
        raise BoardSizeError(
            "the printed board",
            found=f"{name} = {stated_mm:g}, with which {distance}",
            expected=distance.expected,
            remedy=f"Enter millimetres in board.toml{fitting(stated_mm, [distance])}",
        )

    @property
    def bow_mm(self) -> float:
        """Bow of the board: range of the shifts of its points along its normal, mm."""
        moved = self.calibration.target_points - self.calibration.observations.target.points_target
        return float(np.ptp(moved[:, 2]))


def find_boards(
    photographs: Mapping[str, Photograph], target: Target, progress: Progress = no_progress
) -> Observations:
    """Find the board in each photograph.

    Each photograph is a pose of the board; the telephone is the only camera.

    Args:
        photographs: name → photograph, all of one size.
        target: the board.
        progress: fraction of the photographs searched.
    """
    return detect(_Shots(photographs), target, progress=progress)


def stations_of(observations: Observations, settings: CalibrateSettings = CalibrateSettings()) -> Stations:
    """Calibrate the telephone's lens and poses.

    Args:
        observations: the board in each photograph, as by `find_boards`.
        settings: settings of the adjustment.

    Raises:
        CalibrationError: too few photographs show the board, they do not determine the lens, or the board is bent.
    """
    found = [detection.pose for detection in observations.detections]
    if len(found) < FEWEST:
        raise CalibrationError(
            "the photographs",
            found=f"the board in {len(found)} of {len(found) + len(observations.missed)}",
            expected=f"the board in at least {FEWEST}",
            remedy="Keep the whole board in the picture, in focus. Describe a board of your own in board.toml",
        )
    calibration = bundle.calibrate(observations, {}, TELEPHONE, settings)
    found_at = Stations(calibration=calibration, expanded=expanded(calibration))
    if calibration.rms_px > _MOST_RMS_PX or found_at.bow_mm > _MOST_BOW_MM:
        raise CalibrationError(
            "the board",
            found=f"corners that fit to {calibration.rms_px:.1f} px, with a bow of {found_at.bow_mm:.1f} mm",
            expected=f"a flat board: at most {_MOST_RMS_PX:g} px and {_MOST_BOW_MM:g} mm",
            remedy="Glue the print to stiff card that stays flat on the belly, lock the focus, and photograph again",
        )
    return found_at


def expanded(calibration: Calibration) -> Calibration:
    """A single camera's calibration as one camera per pose, in the target's frame."""
    (camera,) = calibration.rig.cameras.values()
    cameras, covariance = station_cameras(camera, calibration.world_from_target, calibration.covariance)
    middle = calibration.target_points.mean(axis=0)
    return replace(
        calibration,
        rig=Rig(name=calibration.rig.name, cameras=cameras, pair_names={}, target_middle_world=middle),
        world=f"frame of the {calibration.observations.target.kind} board, mm",
        world_from_target={"board": Transform(rotation=np.eye(3), translation_mm=np.zeros(3))},
        covariance=covariance,
    )


def station_cameras(
    camera: Camera, poses: Mapping[str, Transform], covariance: ParameterCovariance
) -> tuple[dict[str, Camera], ParameterCovariance]:
    """Pose → its camera in the target's frame, and the joint covariance of these cameras.

    With the camera x_c = R_c (x_w − C) and a pose x_w = R_s x_b + t, the station is R = R_c R_s with its centre at
    R_sᵀ (C − t). To first order, small changes of the calibration's parameters change it by

    - rotation: ω = ω_c + R_c ω_s
    - centre: R_sᵀ (dC − dt − ω_s × (C − t))

    Args:
        camera: camera of the calibration.
        poses: pose → world_from_target.
        covariance: covariance of the camera and its poses.
    """
    column = {name: index for index, name in enumerate(covariance.names)}
    own = [name.removeprefix(f"{camera.name}.") for name in column if name.startswith(f"{camera.name}.")]
    of_lens = [name for name in own if name not in POSE_NAMES_CAMERA]
    cameras = {
        pose: replace(camera, name=pose, camera_from_world=camera.camera_from_world @ placed)
        for pose, placed in poses.items()
    }
    names = tuple(f"{pose}.{name}" for pose in poses for name in (*of_lens, *POSE_NAMES_CAMERA))
    jacobian = np.concatenate([_station_rows(camera, pose, placed, of_lens, column) for pose, placed in poses.items()])
    matrix, independent = (jacobian @ of @ jacobian.T for of in (covariance.matrix, covariance.independent))
    return cameras, ParameterCovariance(names=names, matrix=matrix, independent=independent)


def _station_rows(
    camera: Camera, pose: str, world_from_target: Transform, of_lens: list[str], column: Mapping[str, int]
) -> Float64[Array, "k p"]:
    """Derivatives of a station's lens, rotation and centre by the calibration's parameters."""
    lens = np.zeros((len(of_lens), len(column)))
    for row, name in enumerate(of_lens):
        lens[row, column[f"{camera.name}.{name}"]] = 1.0
    turn, centre = np.zeros((3, len(column))), np.zeros((3, len(column)))
    rotation, back = camera.camera_from_world.rotation, world_from_target.rotation.T
    lever = camera.centre_world - world_from_target.translation_mm
    # Fixed parameters, such as the first pose, have no column and contribute nothing.
    for axis in range(3):
        unit = np.eye(3)[axis]
        if (of_camera := column.get(f"{camera.name}.{POSE_NAMES_CAMERA[axis]}")) is not None:
            turn[:, of_camera] = unit
        if (of_camera := column.get(f"{camera.name}.{POSE_NAMES_CAMERA[axis + 3]}")) is not None:
            centre[:, of_camera] = back @ unit
        if (of_pose := column.get(f"pose {pose}.{POSE_NAMES_STATION[axis]}")) is not None:
            turn[:, of_pose] = rotation @ unit
            centre[:, of_pose] = -back @ np.cross(unit, lever)
        if (of_pose := column.get(f"pose {pose}.{POSE_NAMES_STATION[axis + 3]}")) is not None:
            centre[:, of_pose] = -back @ unit
    return np.concatenate([lens, turn, centre])


class _Shots(Mapping[tuple[str, str], Photograph]):
    """Photographs of a walk by (pose, camera) of a calibration, read when looked up."""

    def __init__(self, photographs: Mapping[str, Photograph]) -> None:
        self._photographs = photographs

    def __getitem__(self, shot: tuple[str, str]) -> Photograph:
        return self._photographs[shot[0]]

    def __iter__(self) -> Iterator[tuple[str, str]]:
        return iter([(name, TELEPHONE) for name in self._photographs])

    def __len__(self) -> int:
        return len(self._photographs)
