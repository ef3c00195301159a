"""Whether pictures bear the right names, and nobody moved.

Features that the two pictures of a pair share must lie on one another's epipolar lines, as the calibration has them,
and the points they show must lie where the rig's cameras look. A picture of another camera fails that nearly
everywhere. Then cables are exchanged in thought, two at a time, until all pairs agree. If the pictures are the right
ones but all features miss their lines by a little and alike, something moved between the two exposures.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from itertools import combinations

import numpy as np

from mammometry.calibration.detection.detect import Detection
from mammometry.calibration.features.keypoints import WIDTH_PX, Keypoints, matched
from mammometry.calibration.judge.working_volume import meeting_point
from mammometry.geometry.arrays import Array, Float64
from mammometry.geometry.camera import Camera, Rig

_NEAR_PX = 2.0  # of the reduced pictures' pixels from the epipolar line: a match by chance is so near once in a hundred
_FAR_PX = 16.0  # likewise, within which something that moved still is; a patient's start moves 10 mm, some 8 px
_DEPTH = (0.5, 2.0)  # of the distance to where the axes meet, between which the subject is
_FEWEST = 12  # matches of a pair, fewer tell nothing
_RIGHT = 0.5  # share of a pair's matches that must fit; right pairs have 0.9 and more, another pair's pictures 0.1 and
# less, and a pair's two pictures exchanged 0.3 to 0.6 (four pairs of the virtual rig), with an offset of 2 mm and more
_STILL_MM = 1.0  # offset from the epipolar lines at the subject: a calibrated rig's are below 0.1 mm


@dataclass(frozen=True, slots=True, kw_only=True)
class PairAgreement:
    """How the matches of a pair's pictures fit its cameras."""

    matches: int
    fitting: float
    """Share that lies near the epipolar line, with a depth where the subject may be."""
    offset_px: float
    """Median distance from the epipolar line of the matches that are not wild, with its sign, px of the picture. NaN
    where there are none."""
    offset_mm: float
    """The same, at the depth where the axes meet."""

    @property
    def tells(self) -> bool:
        """Whether there are enough matches."""
        return self.matches >= _FEWEST

    @property
    def fits(self) -> bool:
        """Whether the pictures are of these cameras."""
        return self.tells and self.fitting >= _RIGHT

    @property
    def moved(self) -> bool:
        """Whether all lies further from its lines than when still."""
        return abs(self.offset_mm) > _STILL_MM


@dataclass(frozen=True, slots=True, kw_only=True)
class Names:
    """What the features say of the names."""

    pairs: Mapping[str, PairAgreement]
    swapped: tuple[tuple[str, str], ...] = ()
    """Cameras whose pictures are exchanged, if that explains everything."""
    wrong: tuple[str, ...] = ()
    """Pairs whose pictures fit no exchange."""
    unknown: tuple[str, ...] = ()
    """Pairs with too few features."""


def check_names(rig: Rig, seen: Mapping[str, Keypoints]) -> Names:
    """Find exchanged cables.

    Args:
        rig: calibrated.
        seen: camera → features of the picture with its name; may lack cameras.
    """
    pairs = {name: both for name, both in rig.pair_names.items() if set(both) <= set(seen)}
    middle = meeting_point(rig)

    def agreement(pair: str, source: Mapping[str, str]) -> PairAgreement:
        left, right = pairs[pair]
        both = matched(seen[source[left]], seen[source[right]])
        return pair_agreement(rig.cameras[left], rig.cameras[right], *both, middle)

    own = {name: name for name in seen}
    found = {pair: agreement(pair, own) for pair in pairs}
    unknown = tuple(pair for pair, one in found.items() if not one.tells)
    bad = [pair for pair, one in found.items() if not one.fits]
    still = len(bad) == len(unknown)
    if still:  # A pair whose own two pictures are exchanged may fit by half, and look moved: exchanged, it keeps still.
        bad = [pair for pair, one in found.items() if one.fits and one.moved]
    suspects = list(dict.fromkeys(camera for pair in bad for camera in pairs[pair]))
    best: tuple[float, tuple[str, str]] | None = None
    for one, other in combinations(suspects, 2):
        source = {**own, one: other, other: one}
        touched = [pair for pair in bad if {one, other} & set(pairs[pair])]
        if set(bad) - set(touched):
            continue  # a pair would stay wrong
        tried = [agreement(pair, source) for pair in touched]
        score = min(each.fitting for each in tried)
        explained = all(each.fits and not (still and each.moved) for each in tried)
        if explained and (best is None or score > best[0]):
            best = (score, (one, other))
    if best is not None:
        return Names(pairs=found, swapped=(best[1],))
    wrong = () if still else tuple(pair for pair in bad if pair not in unknown)
    return Names(pairs=found, wrong=wrong, unknown=unknown)


def check_board_names(rig: Rig, seen: Mapping[str, Detection]) -> tuple[str, str] | None:
    """Find exchanged cables on pictures of the calibration board.

    Its points need no likeness: the same number is the same point. So any two cameras that see it are compared, not
    those of a pair alone.

    Args:
        rig: as calibrated before, or with the poses so far.
        seen: camera → what was detected in the picture with its name; lacks cameras that saw nothing.

    Returns:
        The two cameras whose exchange makes all agree; None where nothing is wrong, or no exchange explains it.
    """
    middle = meeting_point(rig)

    @cache
    def agreement(left: str, right: str, of_left: str, of_right: str) -> PairAgreement | None:
        if not {of_left, of_right} <= set(seen):
            return None
        one, other = seen[of_left], seen[of_right]
        _, rows, columns = np.intersect1d(one.ids, other.ids, return_indices=True)
        found = pair_agreement(rig.cameras[left], rig.cameras[right], one.uv[rows], other.uv[columns], middle)
        return found if found.tells else None

    def judged(source: Mapping[str, str]) -> dict[tuple[str, str], bool]:
        """Two cameras → whether their pictures agree, where they show it."""
        found = {both: agreement(*both, source[both[0]], source[both[1]]) for both in combinations(rig.cameras, 2)}
        return {both: each.fits for both, each in found.items() if each is not None}

    own = {name: name for name in rig.cameras}
    wrong = [set(both) for both, fits in judged(own).items() if not fits]
    if not wrong:
        return None
    best: tuple[int, tuple[str, str]] | None = None
    for pair in combinations(rig.cameras, 2):
        if not all(both & set(pair) for both in wrong):
            continue  # something would stay wrong
        after = judged({**own, pair[0]: pair[1], pair[1]: pair[0]})
        if after and all(after.values()):
            best = max(best or (0, pair), (len(after), pair))
    return None if best is None else best[1]


def pair_agreement(
    left: Camera,
    right: Camera,
    uv_left: Float64[Array, "n 2"],
    uv_right: Float64[Array, "n 2"],
    middle: Float64[Array, 3],
) -> PairAgreement:
    """How well two pictures' features fit two cameras.

    Args:
        left: calibrated, as `right`.
        right: the other camera.
        uv_left: places, px, in the picture that `left` is said to have taken.
        uv_right: of the same things, likewise of `right`.
        middle: world point, mm, where the subject stands.
    """
    if len(uv_left) < _FEWEST:
        return PairAgreement(matches=len(uv_left), fitting=0.0, offset_px=float("nan"), offset_mm=float("nan"))
    x, y = left.normalised_from_pixels(uv_left), right.normalised_from_pixels(uv_right)
    right_from_left = right.camera_from_world @ left.camera_from_world.inverse()
    tx, ty, tz = right_from_left.translation_mm
    essential = np.array([[0, -tz, ty], [tz, 0, -tx], [-ty, tx, 0]]) @ right_from_left.rotation
    rays, others = (np.concatenate([part, np.ones((len(part), 1))], axis=1) for part in (x, y))
    lines = rays @ essential.T  # in the right picture
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = (lines * others).sum(axis=1) / np.linalg.norm(lines[:, :2], axis=1) * right.matrix[1, 1]
        # Least squares of s x = R⁻¹(t' y) for depths along both rays.
        turned = rays @ right_from_left.rotation.T
        a11, a12, a22 = (turned**2).sum(1), -(turned * others).sum(1), (others**2).sum(1)
        b1 = -(turned @ right_from_left.translation_mm)
        b2 = others @ right_from_left.translation_mm
        determinant = a11 * a22 - a12**2
        depths = np.stack([(b1 * a22 - a12 * b2) / determinant, (a11 * b2 - a12 * b1) / determinant])
    unit = left.size_wh[0] / WIDTH_PX
    away = [float(camera.camera_from_world.apply(middle[None])[0, 2]) for camera in (left, right)]
    placed = np.all(
        (depths > _DEPTH[0] * np.array(away)[:, None]) & (depths < _DEPTH[1] * np.array(away)[:, None]), axis=0
    )
    tame = placed & (np.abs(distance) < _FAR_PX * unit)
    offset = float(np.median(distance[tame])) if tame.sum() >= _FEWEST else float("nan")
    # What moved as a whole is of the right camera all the same: distances are taken from their median.
    near = np.abs(distance - np.nan_to_num(offset)) < _NEAR_PX * unit
    return PairAgreement(
        matches=len(uv_left),
        fitting=float((placed & near).mean()),
        offset_px=offset,
        offset_mm=offset * away[1] / float(right.matrix[1, 1]),
    )
