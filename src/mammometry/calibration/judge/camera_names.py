"""Test whether photographs have the right camera names, and whether something moved.

Features that both photographs of a pair share must be on each other's epipolar lines, and their points must be in the
cameras' common field of view. Nearly all features of another camera's photograph fail this test. Then the photographs
are permuted until the pairs agree. If the names are right but all features are off their lines by a similar small
amount, something moved between the two exposures.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, field
from functools import cache
from itertools import combinations, permutations
from typing import TypeAlias

import numpy as np
from scipy.special import bdtrc

from mammometry.calibration.detection.detect import Detection
from mammometry.calibration.features.keypoints import WIDTH_PX, Keypoints, matched, show_the_same
from mammometry.geometry import Array, Camera, Float64, Rig

_NEAR_PX = 2.0  # largest distance from the epipolar line, pixels of the reduced images
_BY_CHANCE_NEAR = 0.01  # share of random matches within this distance: the band's share of an image
_FAR_PX = 16.0  # the same, if something moved; a startled patient moves 10 mm, about 8 px
_DEPTH = (0.5, 2.0)  # range of the subject's distance, relative to the target's
_FEWEST = 12  # fewest matches of a pair for a decision
_RIGHT = 0.5  # smallest share of matches that fit if the names are right (benchmarks.accuracy.exchanged)
_FOREIGN = 0.25  # largest share for two unrelated photographs, by the same benchmark; in between: undecided
_UNLIKELY = 1e-5  # probability of a chance fit below which matches count as fitting
_UNLIKELY_NEARER = 1e-3  # the same for the test that matches are on the lines, not only near them
_MANY = 30  # fewest matches of photographs of the same subject; others have 5 to 24 by chance, by the same benchmark
_RICH = 200  # features of a photograph above which its partner shares at least a sixteenth, by the same benchmark
# fewest fitting matches that are not chance; unrelated photographs have at most two, by the same benchmark
_BY_CHANCE = 5
_WIDER = 1.3  # largest angle of a pair that must share features, relative to other pairs that do
_BUMPED_MM = 3.0  # largest offset from the lines after a bump; smaller motions are corrected later
_GAIN = 0.2  # smallest increase of two pairs' shares, summed, by swapping them: 0.4 with wrong names, 0 with right ones
_STILL_MM = 1.0  # largest offset from the epipolar lines of a rig at rest; calibrated ones have below 0.1 mm
"""If the two photographs of a pair are swapped, the share of fitting matches is 0 to 0.9 (larger for more symmetric
cameras), and the offset is 2 to 20 mm."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PairAgreement:
    """Agreement between the matches of a pair's photographs and its cameras."""

    matches: int
    fitting: float
    """Share of matches near the epipolar line, with a plausible depth."""
    offset_mm: float
    """Median signed distance of the inliers from the epipolar line, at the subject's depth, mm. NaN without any."""
    supported: bool = False
    """Whether more matches fit than by chance, even if their share is small."""

    @property
    def is_sufficient(self) -> bool:
        """Whether there are enough matches for a decision."""
        return self.matches >= _FEWEST

    @property
    def is_consistent(self) -> bool:
        """Whether the matches fit the cameras that the photographs are named after."""
        return self.is_sufficient and self.fitting >= _RIGHT

    @property
    def fitting_matches(self) -> int:
        """Number of matches that fit."""
        return round(self.fitting * self.matches)

    @property
    def moved(self) -> bool:
        """Whether the matches are farther from their lines, by a common offset, than in a rig at rest."""
        return abs(self.offset_mm) > _STILL_MM

    @property
    def sure(self) -> bool:
        """Whether the photographs are certainly of these cameras, and nothing moved."""
        return self.is_consistent and not self.moved


@dataclass(frozen=True, slots=True, kw_only=True)
class PhotographCheck:
    """Result of testing the photographs' names by their features."""

    pairs: Mapping[str, PairAgreement]
    exchanged: Mapping[str, str] = field(default_factory=dict)
    """Camera → camera whose name its photograph has, if swaps make the pairs agree."""
    misfitting: tuple[str, ...] = ()
    """Pairs whose photographs show the same subject, but not from the calibrated cameras' poses."""
    unrelated: tuple[str, ...] = ()
    """Pairs whose photographs do not show the same subject, although other pairs' do."""
    foreign: tuple[str, ...] = ()
    """Of those pairs, cameras whose photographs match no other's, while their partners' do."""
    unknown: tuple[str, ...] = ()
    """Pairs for which no decision is possible."""

    @property
    def cycles(self) -> tuple[tuple[str, ...], ...]:
        """Groups of cameras whose photographs are swapped among each other."""
        left = dict(self.exchanged)
        found = []
        while left:
            name = next(iter(left))
            cycle = []
            while name in left:
                cycle.append(name)
                name = left.pop(name)
            found.append(tuple(cycle))
        return tuple(found)

    @property
    def another_rig(self) -> bool:
        """Whether most pairs' photographs do not fit the calibration."""
        return len(self.misfitting) > max(1, len(self.pairs) / 2)

    @property
    def right(self) -> bool:
        """Whether there is no sign of a wrong photograph."""
        return not (self.exchanged or self.misfitting or self.unrelated)


@dataclass(frozen=True, slots=True, kw_only=True)
class WrongPhotographs:
    """Photographs that cannot be measured together, with texts for the user."""

    cameras: tuple[str, ...]
    found: str
    remedy: str

    @property
    def listed(self) -> str:
        """The cameras, for a sentence."""
        return " and ".join(part for part in (", ".join(self.cameras[:-1]), self.cameras[-1]) if part)


def wrong_photographs(names: PhotographCheck, pairs: Mapping[str, tuple[str, str]]) -> Iterator[WrongPhotographs]:
    """Explain which photographs are wrong, and what to do.

    Args:
        names: result of `check_names`.
        pairs: pair → its cameras.
    """
    for cycle in names.cycles:
        way = "each shows the other's view" if len(cycle) == 2 else "each shows another camera's view"
        yield WrongPhotographs(
            cameras=cycle,
            found=f"photographs that seem to be exchanged: by the calibration, {way}",
            remedy="Give each photograph the name of the camera that took it",
        )
    if names.another_rig:
        yield WrongPhotographs(
            cameras=tuple(dict.fromkeys(name for pair in names.misfitting for name in pairs[pair])),
            found="photographs that seem to be from another rig, or from this one before a change: most pairs do not "
            "fit the calibration",
            remedy="Use the photographs of this rig, or calibrate it again",
        )
        return
    for pair in names.misfitting:
        yield WrongPhotographs(
            cameras=pairs[pair],
            found="photographs that show the same subject, but not from the calibrated camera positions",
            remedy="Use the photographs of these cameras. If they are the right ones, calibrate again",
        )
    for pair in names.unrelated:
        foreign = tuple(name for name in pairs[pair] if name in names.foreign)
        yield WrongPhotographs(
            cameras=foreign or pairs[pair],
            found="a photograph that seems to be from another exposure or of another patient"
            if foreign
            else "photographs that do not show the same subject",
            remedy="Use the photographs of one exposure of one patient",
        )


_Cameras: TypeAlias = tuple[str, str]
_Agreement: TypeAlias = "Callable[[str, str, str, str], PairAgreement]"
_Score: TypeAlias = tuple[int, float]
_Assignment: TypeAlias = tuple[_Score, dict[str, str]]


def check_names(rig: Rig, seen: Mapping[str, Keypoints]) -> PhotographCheck:
    """Find photographs with wrong names, and those that do not belong to the others.

    Args:
        rig: the calibrated rig.
        seen: camera → features of the photograph with its name; cameras may be missing.
    """
    pairs = {name: both for name, both in rig.pair_names.items() if set(both) <= set(seen)}

    @cache
    def correspondences(one: str, other: str) -> tuple[Float64[Array, "m 2"], Float64[Array, "m 2"]]:
        if one > other:
            return correspondences(other, one)[::-1]
        return matched(seen[one], seen[other])

    @cache
    def agreement(left: str, right: str, of_left: str, of_right: str) -> PairAgreement:
        return pair_agreement(
            rig.cameras[left], rig.cameras[right], *correspondences(of_left, of_right), rig.target_middle_world
        )

    own = {pair: agreement(*both, *both) for pair, both in pairs.items()}
    suspects = {pair: pairs[pair] for pair, found in own.items() if not found.sure}
    exchanged: dict[str, str] = {}
    if suspects:  # usually photographs are swapped among the pairs that look wrong, but some look wrong by chance
        exchanged = _best_exchange(suspects, own, agreement) or _best_exchange(pairs, own, agreement)
    exchanged = exchanged or _mirrored_pairs(pairs, own, agreement)
    unsolved = {pair: both for pair, both in suspects.items() if not set(both) & set(exchanged)}
    poor = {pair: both for pair, both in unsolved.items() if own[pair].fitting < _FOREIGN and not own[pair].supported}
    shared = [pair for pair in unsolved if own[pair].matches >= _MANY]
    misfitting = tuple(pair for pair in shared if pair in poor and show_the_same(*correspondences(*pairs[pair])))
    misplaced = tuple(pair for pair in shared if pair in misfitting or abs(own[pair].offset_mm) > _BUMPED_MM)
    if len(misplaced) > max(1, len(pairs) / 2):  # one pair may be misplaced, but not most pairs
        misfitting = misplaced
    rich = {name for name, features in seen.items() if len(features.uv) >= _RICH}
    reach = max((_angle_deg(rig, pairs[pair]) for pair in _plain(own, pairs, rich)), default=0.0)
    unrelated = {
        pair: both
        for pair, both in poor.items()
        if pair not in misfitting
        and set(both) <= rich
        and own[pair].fitting_matches < _BY_CHANCE
        and _angle_deg(rig, both) < _WIDER * reach
    }
    return PhotographCheck(
        pairs=own,
        exchanged=exchanged,
        misfitting=misfitting,
        unrelated=tuple(unrelated),
        foreign=_foreign(unrelated, [name for name in seen if name not in exchanged], agreement),
        unknown=tuple(
            pair for pair in unsolved if pair not in (*misfitting, *unrelated) and not own[pair].is_consistent
        ),
    )


def _plain(own: Mapping[str, PairAgreement], pairs: Mapping[str, tuple[str, str]], rich: Set[str]) -> Iterator[str]:
    """Pairs that share as many features as photographs of the same subject."""
    for pair, found in own.items():
        if found.sure and found.fitting_matches >= _MANY and set(pairs[pair]) <= rich:
            yield pair


def _angle_deg(rig: Rig, both: tuple[str, str]) -> float:
    """Angle between two cameras' axes: the larger it is, the fewer features match."""
    cosine = rig.cameras[both[0]].axis_world @ rig.cameras[both[1]].axis_world
    return float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))


def _best_exchange(
    pairs: Mapping[str, _Cameras], own: Mapping[str, PairAgreement], agreement: _Agreement
) -> dict[str, str]:
    """Swap photographs so that more pairs agree, and none agrees less.

    Args:
        pairs: pair → its cameras.
        own: pair → agreement of the photographs with the cameras that they are named after.
        agreement: returns the agreement of any two cameras' photographs with any two cameras.

    Returns:
        Camera → camera whose name its photograph has. Empty if no swap makes more pairs agree.
    """
    cameras = list(dict.fromkeys(name for both in pairs.values() for name in both))
    fitting = {
        pair: [
            (sources, found.fitting)
            for sources in permutations(cameras, 2)
            if (found := agreement(*both, *sources)).sure
        ]
        for pair, both in pairs.items()
    }

    def assignments(left: Sequence[str], taken: dict[str, str], score: _Score) -> Iterator[_Assignment]:
        if not left:
            yield score, taken
            return
        for sources, share in fitting[left[0]]:
            given = dict(zip(pairs[left[0]], sources, strict=True))
            others = {camera: name for camera, name in taken.items() if camera not in given}
            alike = all(taken.get(camera, name) == name for camera, name in given.items())
            if alike and not set(given.values()) & set(others.values()):
                yield from assignments(left[1:], {**taken, **given}, (score[0] + 1, score[1] + share))
        yield from assignments(left[1:], taken, score)

    at_least = sum(own[pair].sure for pair in pairs) + 1, 0.0
    ordered = sorted(assignments(list(pairs), {}, (0, 0.0)), key=lambda ranked: ranked[0], reverse=True)
    for score, right in ordered:
        moves = {camera: name for camera, name in right.items() if camera != name}
        if score < at_least:
            break
        touched = [pair for pair, both in pairs.items() if set(both) & set(moves)]
        named = {pair: tuple(right.get(name, name) for name in pairs[pair]) for pair in touched}
        gained = sum(agreement(*pairs[pair], *named[pair]).fitting - own[pair].fitting for pair in touched)
        if moves and set(moves) == set(moves.values()) and gained > 0.0:
            return moves
    return {}


def _mirrored_pairs(
    pairs: Mapping[str, _Cameras], own: Mapping[str, PairAgreement], agreement: _Agreement
) -> dict[str, str]:
    """Swap two pairs that agree better under each other's names.

    Pairs that are mirror images, such as a rig's left and right ones, have similar epipolar lines.
    """
    for one, other in combinations((pair for pair in pairs if own[pair].sure), 2):
        in_others = agreement(*pairs[one], *pairs[other]), agreement(*pairs[other], *pairs[one])
        gained = sum(found.fitting for found in in_others) - own[one].fitting - own[other].fitting
        if all(found.sure for found in in_others) and gained > _GAIN and not set(pairs[one]) & set(pairs[other]):
            return dict(zip(pairs[one] + pairs[other], pairs[other] + pairs[one], strict=True))
    return {}


def _foreign(wrong: Mapping[str, _Cameras], cameras: Sequence[str], agreement: _Agreement) -> tuple[str, ...]:
    """Cameras of wrong pairs whose photographs match no other's, although those of their partners do."""

    def belongs(name: str, partner: str) -> bool:
        others = (other for other in cameras if other not in (name, partner))
        return any(agreement(name, other, name, other).sure for other in others)

    found = set()
    for left, right in wrong.values():
        known = belongs(left, right), belongs(right, left)
        if known[0] != known[1]:
            found.add(right if known[0] else left)
    return tuple(name for name in cameras if name in found)


def check_board_names(rig: Rig, seen: Mapping[str, Detection]) -> tuple[str, str] | None:
    """Find swapped cables in images of the calibration board.

    Board points are identified by their numbers. So any two cameras that see the board are compared, not only pairs.

    Args:
        rig: as calibrated before, or with the poses so far.
        seen: camera → detection in the image with its name; without cameras that saw nothing.

    Returns:
        The two cameras whose swap makes all agree. None if nothing is wrong, or no swap explains the disagreement.
    """

    @cache
    def agreement(left: str, right: str, of_left: str, of_right: str) -> PairAgreement | None:
        if not {of_left, of_right} <= set(seen):
            return None
        one, other = seen[of_left], seen[of_right]
        _, rows, columns = np.intersect1d(one.ids, other.ids, return_indices=True)
        cameras = rig.cameras[left], rig.cameras[right]
        found = pair_agreement(*cameras, one.uv[rows], other.uv[columns], rig.target_middle_world)
        return found if found.is_sufficient else None

    def judged(source: Mapping[str, str]) -> dict[tuple[str, str], bool]:
        """Two cameras → whether their images agree, if that can be decided."""
        found = {both: agreement(*both, source[both[0]], source[both[1]]) for both in combinations(rig.cameras, 2)}
        return {both: agreement.is_consistent for both, agreement in found.items() if agreement is not None}

    own = {name: name for name in rig.cameras}
    wrong = [set(both) for both, fits in judged(own).items() if not fits]
    if not wrong:
        return None
    best: tuple[int, tuple[str, str]] | None = None
    for pair in combinations(rig.cameras, 2):
        if not all(both & set(pair) for both in wrong):
            continue  # something would remain wrong
        after = judged({**own, pair[0]: pair[1], pair[1]: pair[0]})
        if after and all(after.values()):
            best = max(best or (0, pair), (len(after), pair))
    return None if best is None else best[1]


def pair_agreement(
    left: Camera,
    right: Camera,
    uv_left: Float64[Array, "n 2"],
    uv_right: Float64[Array, "n 2"],
    middle: Float64[Array, 3] | None,
) -> PairAgreement:
    """Measure how well two images' features fit two cameras.

    Args:
        left: calibrated, as `right`.
        right: the other camera.
        uv_left: positions, px, in the image that has the name of `left`.
        uv_right: positions of the same features in the image that has the name of `right`.
        middle: world point, mm, near the subject. None: the subject may be anywhere in front of the cameras.
    """
    if len(uv_left) < _FEWEST:
        return PairAgreement(matches=len(uv_left), fitting=0.0, offset_mm=float("nan"))
    x, y = left.normalised_from_pixels(uv_left), right.normalised_from_pixels(uv_right)
    right_from_left = right.camera_from_world @ left.camera_from_world.inverse()
    tx, ty, tz = right_from_left.translation_mm
    essential = np.array([[0, -tz, ty], [tz, 0, -tx], [-ty, tx, 0]]) @ right_from_left.rotation
    rays, others = (np.concatenate([part, np.ones((len(part), 1))], axis=1) for part in (x, y))
    lines = rays @ essential.T  # in the right image
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
    placed = np.all(depths > 0, axis=0)
    away = np.median(depths[:, placed], axis=1) if placed.any() else np.ones(2)
    if middle is not None:
        away = np.array([camera.camera_from_world.apply(middle[None])[0, 2] for camera in (left, right)])
        placed = np.all((depths > _DEPTH[0] * away[:, None]) & (depths < _DEPTH[1] * away[:, None]), axis=0)
    tame = placed & (np.abs(distance) < _FAR_PX * unit)
    offset = float(np.median(distance[tame])) if tame.sum() >= _FEWEST else float("nan")
    # A common offset is a motion, not a wrong name: distances are relative to their median.
    near = placed & (np.abs(distance - np.nan_to_num(offset)) < _NEAR_PX * unit)
    return PairAgreement(
        matches=len(uv_left),
        fitting=float(near.mean()),
        offset_mm=offset * float(away[1]) / float(right.matrix[1, 1]),
        supported=_is_supported(
            int((placed & (np.abs(distance) < _NEAR_PX * unit)).sum()), int(tame.sum()), len(uv_left)
        ),
    )


def _is_supported(near: int, tame: int, matches: int) -> bool:
    """Whether more matches fit than by chance.

    Photographs of the same subject by other cameras also have many matches near the lines. But as many of them are
    beside the lines as on them.
    """
    on_lines = float(bdtrc(near - 1, tame, _NEAR_PX / _FAR_PX))
    return on_lines < _UNLIKELY_NEARER and float(bdtrc(near - 1, matches, _BY_CHANCE_NEAR)) < _UNLIKELY
