"""How the body moved between the photographs of a walk, from the disagreement of its pairs.

The board is at the belly, the breasts are not: breathing and swaying move them against it. Each photograph gets one
small rigid motion of the body against the board, which all its pairs share. Pairs that see the same skin then agree,
and the rows of each pair. The motions are the most probable ones: no larger than the disagreement makes likely.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from mammometry.base.errors import SurfaceError
from mammometry.base.normal import MAD
from mammometry.base.value import value
from mammometry.calibration.adjust.network import POSE_NAMES_CAMERA
from mammometry.calibration.judge.pose_motion import shifts
from mammometry.geometry import Array, Camera, Float64, Rig, Transform
from mammometry.surface.motion.agreement import Differences, RowErrors, differences
from mammometry.surface.motion.moved_images import retriangulated
from mammometry.surface.ranges.range_image import RangeImage

_OTHER_SKIN_MM = 12.0  # pairs further apart see different skin; a breath held badly makes them disagree by some mm
_SIZES_MM = (0.01, 0.03, 0.1, 0.3, 1.0, 3.0)
"""Standard deviations of a photograph's motion that are tried, mm."""
_LEVER_MM = 150.0  # from the body's middle to its sides: a turn moves them as much as a shift moves all
_CELL_MM, _ROW_PX = 0.05, 0.1  # own errors of a cell's distance, and of a cell's vertical disparity
_HUBER = 2.0  # standard deviations beyond which a cell counts less
_ROUNDS = 5  # of reweighting
_REST_MM = 1.0
"""Disagreement after the correction from which a walk is refused: half of it in each pair, over the 300 cm² of a
breast's skin, is 15 cc."""


@value(eq=False)
class WalkMotion:
    """Motion of the body against the board, photograph by photograph."""

    cameras: tuple[str, ...]
    """Photographs of the pairs."""
    turn_rad: Float64[Array, "n 3"]
    """Rotation of the body about `centre_world`, world axes."""
    shift_mm: Float64[Array, "n 3"]
    """Shift of the body, world axes."""
    centre_world: Float64[Array, 3]
    size_mm: float
    """Most probable standard deviation of a photograph's motion."""
    before_mm: float
    """Disagreement of pairs that see the same skin, standard deviation, mm, with the places that the board shows."""
    rest_mm: float
    """The same after the correction."""
    point_std_mm: float
    """Standard uncertainty of a reconstructed point that the correction leaves, mm."""

    def rig(self, calibrated: Rig) -> Rig:
        """The cameras as they stood before the body, which is held still."""
        cameras = {
            name: _moved(camera, self.turn_rad[place], self.shift_mm[place], self.centre_world)
            for place, (name, camera) in self._placed(calibrated)
        }
        return replace(calibrated, cameras={**calibrated.cameras, **cameras})

    def carry(self, image: RangeImage, calibrated: Rig) -> RangeImage:
        """A range image with the cameras as they stood before the body."""
        return retriangulated(image, calibrated.pair(image.name), self.rig(calibrated).pair(image.name))

    def _placed(self, calibrated: Rig) -> Iterator[tuple[int, tuple[str, Camera]]]:
        return ((place, (name, calibrated.cameras[name])) for place, name in enumerate(self.cameras))


def find_motion(rig: Rig, range_images: Sequence[RangeImage], rows: Mapping[str, RowErrors]) -> WalkMotion:
    """Most probable motion of the body at each photograph.

    Args:
        rig: photographs' places by the board, and their pairs.
        range_images: what each pair measured with them.
        rows: pair → its vertical disparity.

    Raises:
        SurfaceError: the pairs disagree by more than such motions explain.
    """
    apart = differences(range_images, _OTHER_SKIN_MM)
    cameras = tuple(sorted({name for pair in rig.pair_names.values() for name in pair}))
    points = [comparison.points for comparison in apart] or [image.valid_points_world() for image in range_images]
    centre = np.concatenate(points).mean(axis=0)
    values, design, sigma = _observations(rig, apart, rows, cameras, centre)
    distances = np.arange(len(values)) < sum(len(comparison.points) for comparison in apart)
    solutions = [_solved(values, design, sigma, size_mm, len(cameras)) for size_mm in _SIZES_MM]
    _, motions, covariance, size_mm = max(solutions, key=lambda solution: solution[0])
    rest = (values - design @ motions)[distances]
    effect = design[distances]
    spread = np.sqrt(np.einsum("np,pq,nq->n", effect, covariance, effect)) if len(effect) else np.zeros(0)
    found = WalkMotion(
        cameras=cameras,
        turn_rad=motions.reshape(-1, 6)[:, :3].copy(),
        shift_mm=motions.reshape(-1, 6)[:, 3:].copy(),
        centre_world=centre,
        size_mm=size_mm,
        before_mm=_robust(values[distances]),
        rest_mm=_robust(rest),
        point_std_mm=float(np.hypot(_robust(spread), _robust(rest)) / np.sqrt(2)),
    )
    if found.rest_mm > _REST_MM:
        raise _moved_too_much(found)
    return found


def _observations(
    rig: Rig,
    apart: Sequence[Differences],
    rows: Mapping[str, RowErrors],
    cameras: tuple[str, ...],
    centre: Float64[Array, 3],
) -> tuple[Float64[Array, " n"], Float64[Array, "n p"], Float64[Array, " n"]]:
    """Distances between pairs' surfaces and vertical angles, derivatives by the motions, standard deviations."""
    values, design, sigma = [np.zeros(0)], [np.zeros((0, 6 * len(cameras)))], [np.zeros(0)]
    for comparison in apart:
        first, second = (
            _effects(rig, name, comparison.points, cameras, centre)[0] for name in (comparison.first, comparison.second)
        )
        values.append(comparison.distance_mm)
        design.append(np.einsum("ni,nip->np", comparison.normals, second - first))
        sigma.append(np.sqrt(comparison.scatter_mm**2 + comparison.expected_mm**2 + _CELL_MM**2))
    for name, seen in rows.items():
        if len(seen.points):
            values.append(seen.angle_rad)
            design.append(_effects(rig, name, seen.points, cameras, centre)[1])
            sigma.append(np.full(len(seen.points), _ROW_PX * seen.pixel_rad))
    return np.concatenate(values), np.concatenate(design), np.concatenate(sigma)


def _effects(
    rig: Rig, pair: str, points: Float64[Array, "n 3"], cameras: tuple[str, ...], centre: Float64[Array, 3]
) -> tuple[Float64[Array, "n 3 p"], Float64[Array, "n p"]]:
    """Shifts of a pair's points, and of its vertical angles, by the body's motion at each photograph."""
    names = tuple(f"{camera}.{name}" for camera in rig.pair_names[pair] for name in POSE_NAMES_CAMERA)
    moved = shifts(rig.pair(pair), points, names)
    by_point, by_angle = np.zeros((len(points), 3, 6 * len(cameras))), np.zeros((len(points), 6 * len(cameras)))
    for number, name in enumerate(rig.pair_names[pair]):
        camera = rig.cameras[name]
        # The camera before a body that is held still: turned by R r, its centre moved by −s − r × (C − centre).
        of_camera = np.zeros((6, 6))
        of_camera[:3, :3] = camera.camera_from_world.rotation
        of_camera[3:, :3] = -np.cross(np.eye(3), camera.centre_world - centre).T
        of_camera[3:, 3:] = -np.eye(3)
        own = slice(6 * number, 6 * number + 6)
        into = slice(6 * cameras.index(name), 6 * cameras.index(name) + 6)
        by_point[:, :, into] = moved.points_mm[:, :, own] @ of_camera
        by_angle[:, into] = moved.vertical_rad[:, own] @ of_camera
    return by_point, by_angle


def _solved(
    values: Float64[Array, " n"], design: Float64[Array, "n p"], sigma: Float64[Array, " n"], size_mm: float, count: int
) -> tuple[float, Float64[Array, " p"], Float64[Array, "p p"], float]:
    """Log evidence, motions, their covariance, for motions of a certain size. Huber's loss by reweighting."""
    prior = np.tile(np.repeat([size_mm / _LEVER_MM, size_mm], 3), count) ** -2.0
    motions, weight = np.zeros(design.shape[1]), np.ones(len(values))
    for _ in range(_ROUNDS):
        scaled = design * (np.sqrt(weight) / sigma)[:, None]
        normal = scaled.T @ scaled + np.diag(prior)
        motions = np.linalg.solve(normal, scaled.T @ (values * np.sqrt(weight) / sigma))
        length = np.abs(values - design @ motions) / sigma
        weight = np.minimum(1.0, _HUBER / np.maximum(length, 1e-12))
    loss = np.where(length <= _HUBER, length**2, 2 * _HUBER * length - _HUBER**2).sum()
    fit = loss + motions @ (prior * motions)
    log_det = np.linalg.slogdet(normal)[1] - np.log(prior).sum()
    return float(-0.5 * (fit + log_det)), motions, np.linalg.inv(normal), size_mm


def _moved(camera: Camera, turn: Float64[Array, 3], shift: Float64[Array, 3], centre: Float64[Array, 3]) -> Camera:
    """The camera as it stood before a body that is held still."""
    from scipy.spatial.transform import Rotation

    rotation = Rotation.from_rotvec(turn.copy()).as_matrix()
    body = Transform(rotation=rotation, translation_mm=centre + shift - rotation @ centre)
    return replace(camera, camera_from_world=camera.camera_from_world @ body)


def _robust(lengths: Float64[Array, " n"]) -> float:
    """Standard deviation by the median: a few cells of other skin do not count."""
    return float(MAD * np.median(np.abs(lengths))) if len(lengths) else 0.0


def _moved_too_much(found: WalkMotion) -> SurfaceError:
    order = np.argsort(-np.linalg.norm(found.shift_mm, axis=1))[:3]
    worst = ", ".join(f"{found.cameras[i]} ({np.linalg.norm(found.shift_mm[i]):.1f} mm)" for i in order)
    return SurfaceError(
        "the photographs",
        found=f"a body that moved against the board: pairs disagree by {found.rest_mm:.1f} mm, most in {worst}",
        expected=f"at most {_REST_MM:g} mm",
        remedy="Have the patient hold her breath for each half of the walk, and photograph again",
    )
