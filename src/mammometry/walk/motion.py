"""Motion of the body between the photographs of a walk, from the disagreement of its pairs.

The board is on the belly, and breathing and swaying move the breasts relative to it. For each photograph, a small rigid
motion of the body relative to the board is estimated, the same in all its pairs, with which pairs that see the same
skin agree, and matched points of a pair lie on the same row. A lens that changed between the photographs looks like
such a motion, but has three degrees of freedom only (`walk.lens_freedom`). Motions and lens changes have normal priors,
with the sizes that make the disagreement most probable.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import product

import numpy as np
from scipy.linalg import block_diag

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
from mammometry.walk.lens_freedom import pose_errors

_OTHER_SKIN_MM = 12.0
"""Pairs that differ by more see different skin. A body that is farther apart in two photographs did not just move: a
badly held breath causes 3 to 6 mm; photographs of two women in one folder differed by 28 mm."""
_SIZES_MM = (0.01, 0.03, 0.1, 0.2, 0.3, 0.5, 0.7, 1.0, 2.0)
"""Standard deviations of a photograph's motion that are compared, mm."""
_LENS_PX = (0.0, 1.0, 2.0, 4.0, 8.0, 16.0)
"""Standard deviations that are compared, px: of a photograph's principal point, and of its focal length's effect at
half the picture's width."""
_SKIN_POINTS = 300  # points of the skin for `pose_errors`; limits time
_LEVER_MM = 150.0  # from the body's centre to its sides: a shift by 1 mm and a turn by 1 mm there are equally probable
_CELL_MM = 0.05  # standard deviation of a cell's distance in addition to its data's own
_HUBER = 2.0  # residual beyond which the loss is linear, standard deviations
_ROUNDS = 5  # rounds of reweighting
_REPORTED_MM = 0.1  # least size of motions that are reported
_STILL = 0.8
"""Largest disagreement of a still body, relative to that expected from the data's errors. Still virtual walks have 0.60
to 0.75; correcting that doubled the errors of the positions (decision 52)."""
_MATCHED = 0.7
"""Mean of that ratio for still bodies: the part of the disagreement that matching causes."""
_REST_MM = 0.38
"""Largest disagreement after the correction that matching does not cause, mm. Half of it over the 300 cm² of a breast's
skin is 6 cc. A held breath, a breath of ± 1 mm and a stabilised lens leave 0.2 to 0.32 mm; a breath of ± 2 mm leaves
0.45 mm and a wrong border (decision 52)."""


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
    lens_px: float
    """Most probable standard deviation of the lens's changes between photographs, px (`walk.lens_freedom`)."""
    before_mm: float
    """Disagreement of pairs about the same skin before the correction, standard deviation, mm."""
    rest_mm: float
    """The same after the correction, mm."""
    point_std_mm: float
    """Standard uncertainty of a reconstructed point after the correction, mm."""

    @property
    def distance_mm(self) -> Float64[Array, "n n"]:
        """Distance between the body's positions at any two photographs, mm."""
        return np.asarray(np.linalg.norm(self.shift_mm[:, None] - self.shift_mm[None], axis=-1))

    @property
    def moved(self) -> bool:
        """Whether the body moved enough to be reported."""
        return self.size_mm >= _REPORTED_MM

    def rig(self, calibrated: Rig) -> Rig:
        """The cameras' poses relative to a body at rest."""
        cameras = {
            name: before_still_body(calibrated.cameras[name], np.concatenate([turn, shift]), self.centre_world)
            for name, turn, shift in zip(self.cameras, self.turn_rad, self.shift_mm, strict=True)
        }
        return replace(calibrated, cameras={**calibrated.cameras, **cameras})

    def apply_motion(self, image: RangeImage, calibrated: Rig) -> RangeImage:
        """Triangulate a range image again, with the cameras relative to a body at rest."""
        return retriangulated(image, calibrated.pair(image.name), self.rig(calibrated).pair(image.name))


def find_motion(
    rig: Rig, range_images: Sequence[RangeImage], rows: Mapping[str, RowErrors], board_mm: Float64[Array, "2 2"]
) -> WalkMotion:
    """Most probable motion of the body at each photograph.

    Args:
        rig: the photographs' cameras in the board's frame, and their pairs.
        range_images: range images of the pairs with these cameras.
        rows: pair → its vertical disparity.
        board_mm: lowest and highest corner of the board's points (x, y), mm.

    Raises:
        SurfaceError: the pairs still disagree too much with these motions, or the body is elsewhere on the board in
            some photographs: another patient, or a board that was moved.
    """
    apart = differences(range_images, _OTHER_SKIN_MM)
    cameras = tuple(sorted({name for pair in rig.pair_names.values() for name in pair}))
    points = [comparison.points for comparison in apart] or [image.valid_points_world() for image in range_images]
    skin = np.concatenate(points)
    centre = skin.mean(axis=0)
    seen = observed(rig, apart, rows, None, partial(_effects, cameras, centre), _noise_mm2)
    before_mm = _robust(seen.values[seen.distances])
    skin = skin[:: max(1, len(skin) // _SKIN_POINTS)]
    by_lens = [
        np.linalg.solve(_pose_by_twist(rig.cameras[name], centre), pose_errors(rig.cameras[name], board_mm, skin))
        for name in cameras
    ]
    expected_mm = float(np.median(np.concatenate([comparison.expected_mm for comparison in apart]))) if apart else 0.0
    is_still = before_mm <= _STILL * expected_mm
    sizes = [(_SIZES_MM[0], _LENS_PX[0])] if is_still else list(product(_SIZES_MM, _LENS_PX))
    (size_mm, lens_px), fit = _most_probable(seen, by_lens, sizes)
    rest = (seen.values - seen.by_unknown @ fit.motions)[seen.distances]
    effect = seen.by_unknown[seen.distances]
    spread = np.sqrt(np.einsum("np,pq,nq->n", effect, fit.covariance, effect))
    found = WalkMotion(
        cameras=cameras,
        turn_rad=fit.motions.reshape(-1, 6)[:, :3].copy(),
        shift_mm=fit.motions.reshape(-1, 6)[:, 3:].copy(),
        centre_world=centre,
        size_mm=size_mm,
        lens_px=lens_px,
        before_mm=before_mm,
        rest_mm=_robust(rest),
        point_std_mm=float(np.hypot(_robust(spread), _robust(rest)) / np.sqrt(2)),
    )
    most_mm = float(np.hypot(_REST_MM, _MATCHED * expected_mm))
    if found.distance_mm.max() > _OTHER_SKIN_MM:
        raise _another_body(found)
    if found.rest_mm > most_mm:
        raise _moved_too_much(found, most_mm)
    return found


def summary(found: WalkMotion) -> str:
    """One line about motion for the technician."""
    agree = f"pairs agree to {found.rest_mm:.3f} mm"
    moved = f"the body moved by about {found.size_mm:.1f} mm relative to the board" if found.moved else ""
    lens = f"the lens changed by about {found.lens_px:.0f} px" if found.lens_px > 0.0 else ""
    if changed := " and ".join(filter(None, (moved, lens))):
        return f"corrected: {changed} between the photographs; {agree}, {found.before_mm:.3f} mm before"
    return f"the body was still relative to the board; {agree}"


def _effects(
    cameras: tuple[str, ...], centre: Float64[Array, 3], rig: Rig, pair: str, points: Float64[Array, "n 3"]
) -> Effects:
    """Effects of the body's motion at each photograph (twist about the centre) on one pair's points."""
    names = tuple(f"{camera}.{name}" for camera in rig.pair_names[pair] for name in POSE_NAMES_CAMERA)
    moved = shifts(rig.pair(pair), points, names)
    by_point, by_angle = np.zeros((len(points), 3, 6 * len(cameras))), np.zeros((len(points), 6 * len(cameras)))
    for number, name in enumerate(rig.pair_names[pair]):
        of_pose = _pose_by_twist(rig.cameras[name], centre)
        own, into = (slice(6 * i, 6 * i + 6) for i in (number, cameras.index(name)))
        by_point[:, :, into] = moved.points_mm[:, :, own] @ of_pose
        by_angle[:, into] = moved.vertical_rad[:, own] @ of_pose
    return Effects(points_mm=by_point, vertical_rad=by_angle)


def _pose_by_twist(camera: Camera, centre: Float64[Array, 3]) -> Float64[Array, "6 6"]:
    """Derivatives of the camera's pose, relative to a body at rest, by the body's twist (r, s) about the centre.

    The camera is rotated by R r, and its centre C moves by −s − r × (C − centre).
    """
    of_pose = np.zeros((6, 6))
    of_pose[:3, :3] = camera.camera_from_world.rotation
    of_pose[3:] = -rigid_motions((camera.centre_world - centre)[None])[0]
    return of_pose


def _noise_mm2(comparison: Differences) -> Float64[Array, "n n"]:
    """Covariance of two pairs' distances, mm². Cells are assumed to be independent."""
    return np.diag(comparison.scatter_mm**2 + comparison.expected_mm**2 + _CELL_MM**2)


def _most_probable(
    seen: Observed, by_lens: Sequence[Float64[Array, "6 3"]], sizes: Sequence[tuple[float, float]]
) -> tuple[tuple[float, float], Fit]:
    """Most probable sizes of motions and lens changes, and the fit with them (Huber's loss).

    Args:
        seen: the disagreement.
        by_lens: twist of each photograph for lens changes of 1 px.
        sizes: standard deviations that are compared: of motions, mm, and of lens changes, px.
    """
    count = seen.by_unknown.shape[1]
    rows = np.column_stack([seen.by_unknown, seen.values]) / np.sqrt(seen.variance)[:, None]
    roots = {size: _prior_root(by_lens, *size) for size in sizes}
    weight = np.ones(len(rows))
    for _ in range(_ROUNDS):
        model = linear_model([rows * np.sqrt(weight)[:, None]], count)
        scaled = {
            size: replace(model, matrix=root.T @ model.matrix @ root, right=root.T @ model.right)
            for size, root in roots.items()
        }
        best = max(sizes, key=lambda size: scaled[size].log_evidence(np.ones((1, count)))[0])
        fit = scaled[best].fit(np.ones(count))
        motions = roots[best] @ fit.motions
        length = np.abs(rows[:, -1] - rows[:, :-1] @ motions)
        weight = np.minimum(1.0, _HUBER / np.maximum(length, 1e-12))
    return best, replace(fit, motions=motions, covariance=roots[best] @ fit.covariance @ roots[best].T)


def _prior_root(by_lens: Sequence[Float64[Array, "6 3"]], size_mm: float, lens_px: float) -> Float64[Array, "p p"]:
    """Square root of the prior covariance of all photographs' twists."""
    of_motion = np.diag(np.repeat([size_mm / _LEVER_MM, size_mm], 3) ** 2)
    root: Float64[Array, "p p"] = block_diag(
        *(np.linalg.cholesky(of_motion + lens_px**2 * lens @ lens.T) for lens in by_lens)
    )
    return root


def before_still_body(camera: Camera, twist: Float64[Array, 6], centre_world: Float64[Array, 3]) -> Camera:
    """The camera relative to a body at rest.

    Args:
        camera: camera in the pose found from the board.
        twist: motion of the body about the centre.
        centre_world: the centre, mm.
    """
    return replace(camera, camera_from_world=camera.camera_from_world @ as_motion(twist, about=centre_world))


def _robust(lengths: Float64[Array, " n"]) -> float:
    """Robust standard deviation, from the median absolute value."""
    return float(MAD * np.median(np.abs(lengths))) if len(lengths) else 0.0


def _moved_too_much(found: WalkMotion, most_mm: float) -> SurfaceError:
    order = np.argsort(-np.linalg.norm(found.shift_mm, axis=1))[:3]
    worst = ", ".join(f"{found.cameras[i]} ({np.linalg.norm(found.shift_mm[i]):.1f} mm)" for i in order)
    return SurfaceError(
        "the photographs",
        found=f"a body that moved relative to the board, most in photographs {worst}, numbered in order: pairs still "
        f"disagree by {found.rest_mm:.2f} mm after the correction",
        expected=f"at most {most_mm:.2f} mm",
        remedy="Have the patient hold her breath for each half of the walk, and photograph again. If she did, send the "
        "telephone's original files, without filters: strong compression and smoothed skin have the same effect",
    )


def _another_body(found: WalkMotion) -> SurfaceError:
    first, second = np.unravel_index(int(found.distance_mm.argmax()), found.distance_mm.shape)
    return SurfaceError(
        "the photographs",
        found=f"the body at two places on the board, {found.distance_mm.max():.0f} mm apart in photographs "
        f"{found.cameras[first]} and {found.cameras[second]}, numbered in order",
        expected=f"one patient and one walk: at most {_OTHER_SKIN_MM:.0f} mm",
        remedy="Keep the photographs of one patient and of one walk, in which the board was not moved, in one folder",
    )
