"""Motion of the body between the photographs of a walk, from the disagreement of its pairs.

The board is on the belly, and the breasts move relative to it by breathing and swaying. Each photograph gets a small
rigid motion of the body relative to the board, the same in all its pairs, so that pairs that see the same skin agree,
as do the rows of each pair. The motions are the most probable ones, no larger than the disagreement requires.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from mammometry.base.errors import SurfaceError
from mammometry.base.normal import MAD
from mammometry.base.value import value
from mammometry.calibration.adjust.linear_model import Fit, linear_model
from mammometry.calibration.adjust.network import POSE_NAMES_CAMERA
from mammometry.calibration.judge.pose_motion import shifts
from mammometry.geometry import Array, Camera, Float64, Rig
from mammometry.geometry.twist import as_motion, rigid_motions
from mammometry.surface.motion.agreement import Differences, RowErrors, differences
from mammometry.surface.motion.moved_images import retriangulated
from mammometry.surface.motion.rigid_motion import Effects, Observed, observed
from mammometry.surface.ranges.range_image import RangeImage

_OTHER_SKIN_MM = 12.0  # pairs that differ by more see different skin; a badly held breath makes some mm
_SIZES_MM = (0.01, 0.03, 0.1, 0.3, 1.0, 3.0)  # standard deviations of a photograph's motion that are tried, mm
_LEVER_MM = 150.0  # from the body's centre to its sides: ratio of the shift to the turn that moves skin as much
_CELL_MM = 0.05  # own error of a cell's distance
_HUBER = 2.0  # threshold of Huber's loss, standard deviations
_ROUNDS = 5  # rounds of reweighting
_STILL_MM = 0.3
"""Disagreement up to which a body counts as still. Pairs of still virtual walks disagree by 0.16 to 0.27 mm: matching
errs at flat angles. Motions that explain this away doubled the errors of the positions (decision 52)."""
_REST_MM = 1.0
"""Largest disagreement after the correction. Half of it in each pair, over the 300 cm² of a breast's skin, is 15 cc."""


@value(eq=False)
class WalkMotion:
    """Motion of the body relative to the board at each photograph."""

    cameras: tuple[str, ...]
    """Photographs that are in pairs."""
    turn_rad: Float64[Array, "n 3"]
    """Rotation of the body about `centre_world`, world axes."""
    shift_mm: Float64[Array, "n 3"]
    """Shift of the body, world axes."""
    centre_world: Float64[Array, 3]
    size_mm: float
    """Most probable standard deviation of a photograph's motion, mm."""
    before_mm: float
    """Disagreement of pairs that see the same skin before the correction, standard deviation, mm."""
    rest_mm: float
    """The same after the correction, mm."""
    point_std_mm: float
    """Standard uncertainty of a reconstructed point after the correction, mm."""

    def rig(self, calibrated: Rig) -> Rig:
        """The cameras' poses relative to a body at rest."""
        cameras = {
            name: before_still_body(calibrated.cameras[name], np.concatenate([turn, shift]), self.centre_world)
            for name, turn, shift in zip(self.cameras, self.turn_rad, self.shift_mm, strict=True)
        }
        return replace(calibrated, cameras={**calibrated.cameras, **cameras})

    def apply_motion(self, image: RangeImage, calibrated: Rig) -> RangeImage:
        """A range image, triangulated again with the cameras relative to a body at rest."""
        return retriangulated(image, calibrated.pair(image.name), self.rig(calibrated).pair(image.name))


def find_motion(rig: Rig, range_images: Sequence[RangeImage], rows: Mapping[str, RowErrors]) -> WalkMotion:
    """Most probable motion of the body at each photograph.

    Args:
        rig: poses of the photographs relative to the board, and their pairs.
        range_images: range images of the pairs with these poses.
        rows: pair → its vertical disparity.

    Raises:
        SurfaceError: the pairs disagree by more than such motions explain.
    """
    apart = differences(range_images, _OTHER_SKIN_MM)
    cameras = tuple(sorted({name for pair in rig.pair_names.values() for name in pair}))
    points = [comparison.points for comparison in apart] or [image.valid_points_world() for image in range_images]
    centre = np.concatenate(points).mean(axis=0)
    seen = observed(rig, apart, rows, None, partial(_effects, cameras, centre), _noise_mm2)
    before_mm = _robust(seen.values[seen.distances])
    fits = {size_mm: _robust_fit(seen, size_mm) for size_mm in (_SIZES_MM if before_mm > _STILL_MM else _SIZES_MM[:1])}
    size_mm = max(fits, key=lambda size_mm: fits[size_mm][0])
    fit = fits[size_mm][1]
    rest = (seen.values - seen.by_unknown @ fit.motions)[seen.distances]
    effect = seen.by_unknown[seen.distances]
    spread = np.sqrt(np.einsum("np,pq,nq->n", effect, fit.covariance, effect))
    found = WalkMotion(
        cameras=cameras,
        turn_rad=fit.motions.reshape(-1, 6)[:, :3].copy(),
        shift_mm=fit.motions.reshape(-1, 6)[:, 3:].copy(),
        centre_world=centre,
        size_mm=size_mm,
        before_mm=before_mm,
        rest_mm=_robust(rest),
        point_std_mm=float(np.hypot(_robust(spread), _robust(rest)) / np.sqrt(2)),
    )
    if found.rest_mm > _REST_MM:
        raise _moved_too_much(found)
    return found


def _effects(
    cameras: tuple[str, ...], centre: Float64[Array, 3], rig: Rig, pair: str, points: Float64[Array, "n 3"]
) -> Effects:
    """Effects of the body's motion at each photograph (a twist about the centre) on one pair's points."""
    names = tuple(f"{camera}.{name}" for camera in rig.pair_names[pair] for name in POSE_NAMES_CAMERA)
    moved = shifts(rig.pair(pair), points, names)
    by_point, by_angle = np.zeros((len(points), 3, 6 * len(cameras))), np.zeros((len(points), 6 * len(cameras)))
    for number, name in enumerate(rig.pair_names[pair]):
        # The camera relative to a body at rest: turned by R r, its centre moved by −s − r × (C − centre).
        of_pose = np.zeros((6, 6))
        of_pose[:3, :3] = rig.cameras[name].camera_from_world.rotation
        of_pose[3:] = -rigid_motions((rig.cameras[name].centre_world - centre)[None])[0]
        own, into = (slice(6 * i, 6 * i + 6) for i in (number, cameras.index(name)))
        by_point[:, :, into] = moved.points_mm[:, :, own] @ of_pose
        by_angle[:, into] = moved.vertical_rad[:, own] @ of_pose
    return Effects(points_mm=by_point, vertical_rad=by_angle)


def _noise_mm2(comparison: Differences) -> Float64[Array, "n n"]:
    """Variances of two pairs' distances, mm². Cells are assumed to be independent."""
    return np.diag(comparison.scatter_mm**2 + comparison.expected_mm**2 + _CELL_MM**2)


def _robust_fit(seen: Observed, size_mm: float) -> tuple[float, Fit]:
    """Log evidence and fit of motions of one size. Huber's loss by reweighting."""
    count = seen.by_unknown.shape[1]
    rows = np.column_stack([seen.by_unknown, seen.values]) / np.sqrt(seen.variance)[:, None]
    std = np.tile(np.repeat([size_mm / _LEVER_MM, size_mm], 3), count // 6)
    weight = np.ones(len(rows))
    for _ in range(_ROUNDS):
        used = weight
        fit = linear_model([rows * np.sqrt(used)[:, None]], count).fit(std)
        length = np.abs(rows[:, -1] - rows[:, :-1] @ fit.motions)
        weight = np.minimum(1.0, _HUBER / np.maximum(length, 1e-12))
    loss = np.where(length <= _HUBER, length**2, 2 * _HUBER * length - _HUBER**2).sum()
    return fit.log_evidence + float(used @ length**2 - loss) / 2, fit  # Huber's loss instead of the weighted squares


def before_still_body(camera: Camera, twist: Float64[Array, 6], centre_world: Float64[Array, 3]) -> Camera:
    """The camera relative to a body at rest.

    Args:
        camera: camera with the pose of the photograph.
        twist: motion of the body about the centre.
        centre_world: the centre, mm.
    """
    return replace(camera, camera_from_world=camera.camera_from_world @ as_motion(twist, about=centre_world))


def _robust(lengths: Float64[Array, " n"]) -> float:
    """Robust standard deviation, from the median absolute value."""
    return float(MAD * np.median(np.abs(lengths))) if len(lengths) else 0.0


def _moved_too_much(found: WalkMotion) -> SurfaceError:
    order = np.argsort(-np.linalg.norm(found.shift_mm, axis=1))[:3]
    worst = ", ".join(f"{found.cameras[i]} ({np.linalg.norm(found.shift_mm[i]):.1f} mm)" for i in order)
    return SurfaceError(
        "the photographs",
        found=f"a body that moved relative to the board: pairs disagree by {found.rest_mm:.1f} mm, most in {worst}",
        expected=f"at most {_REST_MM:g} mm",
        remedy="Have the patient hold her breath for each half of the walk, and photograph again",
    )
