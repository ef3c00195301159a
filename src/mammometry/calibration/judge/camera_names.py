"""Test whether photographs bear the right names, and nobody moved.

Features that the two photographs of a pair share must lie on one another's epipolar lines, as the calibration has them,
and the points they show must lie where the rig's cameras look. A photograph of another camera fails that nearly
everywhere. Then photographs are exchanged in thought until the pairs agree. If they are the right ones but all features
miss their lines by a little and alike, something moved between the two exposures.
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

_NEAR_PX = 2.0  # of the reduced pictures' pixels from the epipolar line
_BY_CHANCE_NEAR = 0.01  # share of matches by chance that are so near: the band's share of a picture
_FAR_PX = 16.0  # likewise, within which something that moved still is; a patient's start moves 10 mm, some 8 px
_DEPTH = (0.5, 2.0)  # of the distance to where the target was held, between which the subject is
_FEWEST = 12  # matches of a pair, fewer tell nothing
_RIGHT = 0.5  # share of a pair's matches that fits at least where the names are right (benchmarks.accuracy.exchanged)
_FOREIGN = 0.25  # share up to which two photographs have nothing to do with one another, likewise; between: undecided
_UNLIKELY = 1e-5  # probability below which matches do not fit by chance
_UNLIKELY_NEARER = 1e-3  # the same, of lying on the lines rather than a little off them
_MANY = 30  # matches of photographs that show the same; others have 5 to 24 by chance, likewise
_RICH = 200  # features of a photograph, from which a sixteenth and more is found again in its partner, likewise
_BY_CHANCE = 5  # fitting matches; photographs of different things have none to two, likewise
_WIDER = 1.3  # times the angle at which other pairs share features, up to which a pair must, too
_ASTRAY_MM = 3.0  # offset from the lines that no touch of a camera explains; what moved less is put right later
_GAIN = 0.2  # of both shares that fit, summed, by the exchange of two pairs: of wrong names .4, of right ones none
_STILL_MM = 1.0  # offset from the epipolar lines at the subject: a calibrated rig's are below 0.1 mm
"""A pair's own two photographs exchanged fit by 0 to 0.9, the more the better both cameras mirror one another, and are
then 2 to 20 mm off."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PairAgreement:
    """Agreement of the matches of a pair's photographs with its cameras."""

    matches: int
    fitting: float
    """Share that lies near the epipolar line, with a depth where the subject may be."""
    offset_mm: float
    """Median distance from the epipolar line of the matches that are not wild, with its sign, at the subject's depth,
    mm. NaN where there are none."""
    supported: bool = False
    """Whether more matches fit than chance explains, however few of all they are."""

    @property
    def tells(self) -> bool:
        """Whether there are enough matches to tell."""
        return self.matches >= _FEWEST

    @property
    def fits(self) -> bool:
        """Whether the photographs are of these cameras."""
        return self.tells and self.fitting >= _RIGHT

    @property
    def fitting_matches(self) -> int:
        """Number of matches that fit."""
        return round(self.fitting * self.matches)

    @property
    def moved(self) -> bool:
        """Whether all lies further from its lines than when still."""
        return abs(self.offset_mm) > _STILL_MM

    @property
    def sure(self) -> bool:
        """Whether the photographs are of these cameras, which stood still."""
        return self.fits and not self.moved


@dataclass(frozen=True, slots=True, kw_only=True)
class Names:
    """Verdict of the features on the photographs' names."""

    pairs: Mapping[str, PairAgreement]
    exchanged: Mapping[str, str] = field(default_factory=dict)
    """Camera → camera under whose name its photograph stands, where exchanges make pairs agree."""
    misfitting: tuple[str, ...] = ()
    """Pairs whose photographs show the same, but not from where the calibration has the cameras."""
    unrelated: tuple[str, ...] = ()
    """Pairs whose photographs do not show the same, though other pairs' do."""
    foreign: tuple[str, ...] = ()
    """Of those pairs, cameras whose photographs fit no other's, while their partners' do."""
    unknown: tuple[str, ...] = ()
    """Pairs of which it cannot be told."""

    @property
    def cycles(self) -> tuple[tuple[str, ...], ...]:
        """Cameras whose photographs are exchanged among one another."""
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
        """Whether most pairs' photographs do not fit."""
        return len(self.misfitting) > max(1, len(self.pairs) / 2)

    @property
    def right(self) -> bool:
        """Whether nothing shows that a photograph is a wrong one."""
        return not (self.exchanged or self.misfitting or self.unrelated)


@dataclass(frozen=True, slots=True, kw_only=True)
class WrongPhotographs:
    """Photographs that cannot be measured together, in words."""

    cameras: tuple[str, ...]
    found: str
    remedy: str

    @property
    def listed(self) -> str:
        """The cameras, as a sentence names them."""
        return " and ".join(part for part in (", ".join(self.cameras[:-1]), self.cameras[-1]) if part)


def wrong_photographs(names: Names, pairs: Mapping[str, tuple[str, str]]) -> Iterator[WrongPhotographs]:
    """Say which photographs are wrong, and what to do.

    Args:
        names: as found.
        pairs: pair → its cameras.
    """
    for cycle in names.cycles:
        way = "each shows the other's view" if len(cycle) == 2 else "each shows another one's view"
        yield WrongPhotographs(
            cameras=cycle,
            found=f"photographs that seem to be exchanged: by the calibration, {way}",
            remedy="Give each photograph the name of the camera that took it",
        )
    if names.another_rig:
        yield WrongPhotographs(
            cameras=tuple(dict.fromkeys(name for pair in names.misfitting for name in pairs[pair])),
            found="photographs that seem to be of another rig, or of this one before it was changed: most pairs do not "
            "fit the calibration",
            remedy="Choose the photographs of this rig, or calibrate it again",
        )
        return
    for pair in names.misfitting:
        yield WrongPhotographs(
            cameras=pairs[pair],
            found="photographs that show the same, but not from where these cameras were calibrated",
            remedy="Choose the photographs of these cameras; if they are the right ones, calibrate again",
        )
    for pair in names.unrelated:
        foreign = tuple(name for name in pairs[pair] if name in names.foreign)
        yield WrongPhotographs(
            cameras=foreign or pairs[pair],
            found="a photograph that seems to be of another exposure or patient"
            if foreign
            else "photographs that do not show the same",
            remedy="Choose the photographs of one exposure of one patient",
        )


_Cameras: TypeAlias = tuple[str, str]
_Agreement: TypeAlias = "Callable[[str, str, str, str], PairAgreement]"
_Score: TypeAlias = tuple[int, float]
_Assignment: TypeAlias = tuple[_Score, dict[str, str]]


def check_names(rig: Rig, seen: Mapping[str, Keypoints]) -> Names:
    """Find photographs under wrong names, and those that do not belong to the others.

    Args:
        rig: calibrated.
        seen: camera → features of the photograph with its name; may lack cameras.
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
    if suspects:  # mostly photographs are exchanged among the pairs that look wrong; some do so by chance only
        exchanged = _best_exchange(suspects, own, agreement) or _best_exchange(pairs, own, agreement)
    exchanged = exchanged or _mirrored_pairs(pairs, own, agreement)
    unsolved = {pair: both for pair, both in suspects.items() if not set(both) & set(exchanged)}
    poor = {pair: both for pair, both in unsolved.items() if own[pair].fitting < _FOREIGN and not own[pair].supported}
    shared = [pair for pair in unsolved if own[pair].matches >= _MANY]
    misfitting = tuple(pair for pair in shared if pair in poor and show_the_same(*correspondences(*pairs[pair])))
    astray = tuple(pair for pair in shared if pair in misfitting or abs(own[pair].offset_mm) > _ASTRAY_MM)
    if len(astray) > max(1, len(pairs) / 2):  # one pair may have moved by so much, most have not
        misfitting = astray
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
    return Names(
        pairs=own,
        exchanged=exchanged,
        misfitting=misfitting,
        unrelated=tuple(unrelated),
        foreign=_foreign(unrelated, [name for name in seen if name not in exchanged], agreement),
        unknown=tuple(pair for pair in unsolved if pair not in (*misfitting, *unrelated) and not own[pair].fits),
    )


def _plain(own: Mapping[str, PairAgreement], pairs: Mapping[str, tuple[str, str]], rich: Set[str]) -> Iterator[str]:
    """Pairs that show how many features are shared where the photographs belong together."""
    for pair, found in own.items():
        if found.sure and found.fitting_matches >= _MANY and set(pairs[pair]) <= rich:
            yield pair


def _angle_deg(rig: Rig, both: tuple[str, str]) -> float:
    """Angle between two cameras' axes: the wider it is, the fewer features look alike."""
    cosine = rig.cameras[both[0]].axis_world @ rig.cameras[both[1]].axis_world
    return float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))


def _best_exchange(
    pairs: Mapping[str, _Cameras], own: Mapping[str, PairAgreement], agreement: _Agreement
) -> dict[str, str]:
    """Exchange photographs so that more pairs agree, and none less.

    Args:
        pairs: pair → its cameras.
        own: pair → agreement of the photographs that have its cameras' names.
        agreement: of any two cameras with any two cameras' photographs.

    Returns:
        Camera → camera under whose name its photograph stands. Empty where no exchange makes more pairs agree.
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
    """Exchange two pairs that agree under each other's names, and better than under their own.

    Pairs that mirror one another, as a rig's left and right ones, have much the same epipolar lines.
    """
    for one, other in combinations((pair for pair in pairs if own[pair].sure), 2):
        in_others = agreement(*pairs[one], *pairs[other]), agreement(*pairs[other], *pairs[one])
        gained = sum(found.fitting for found in in_others) - own[one].fitting - own[other].fitting
        if all(found.sure for found in in_others) and gained > _GAIN and not set(pairs[one]) & set(pairs[other]):
            return dict(zip(pairs[one] + pairs[other], pairs[other] + pairs[one], strict=True))
    return {}


def _foreign(wrong: Mapping[str, _Cameras], cameras: Sequence[str], agreement: _Agreement) -> tuple[str, ...]:
    """Cameras of wrong pairs whose photographs fit no other's, while their partners' do."""

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
    """Find exchanged cables on pictures of the calibration board.

    Its points need no likeness: the same number is the same point. So any two cameras that see it are compared, not
    those of a pair alone.

    Args:
        rig: as calibrated before, or with the poses so far.
        seen: camera → what was detected in the picture with its name; lacks cameras that saw nothing.

    Returns:
        The two cameras whose exchange makes all agree; None where nothing is wrong, or no exchange explains it.
    """

    @cache
    def agreement(left: str, right: str, of_left: str, of_right: str) -> PairAgreement | None:
        if not {of_left, of_right} <= set(seen):
            return None
        one, other = seen[of_left], seen[of_right]
        _, rows, columns = np.intersect1d(one.ids, other.ids, return_indices=True)
        cameras = rig.cameras[left], rig.cameras[right]
        found = pair_agreement(*cameras, one.uv[rows], other.uv[columns], rig.target_middle_world)
        return found if found.tells else None

    def judged(source: Mapping[str, str]) -> dict[tuple[str, str], bool]:
        """Two cameras → whether their pictures agree, where they show it."""
        found = {both: agreement(*both, source[both[0]], source[both[1]]) for both in combinations(rig.cameras, 2)}
        return {both: agreement.fits for both, agreement in found.items() if agreement is not None}

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
    middle: Float64[Array, 3] | None,
) -> PairAgreement:
    """Measure how well two pictures' features fit two cameras.

    Args:
        left: calibrated, as `right`.
        right: the other camera.
        uv_left: places, px, in the picture that `left` is said to have taken.
        uv_right: of the same things, likewise of `right`.
        middle: world point, mm, about which the subject stands. None: it may stand anywhere before the cameras.
    """
    if len(uv_left) < _FEWEST:
        return PairAgreement(matches=len(uv_left), fitting=0.0, offset_mm=float("nan"))
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
    placed = np.all(depths > 0, axis=0)
    away = np.median(depths[:, placed], axis=1) if placed.any() else np.ones(2)
    if middle is not None:
        away = np.array([camera.camera_from_world.apply(middle[None])[0, 2] for camera in (left, right)])
        placed = np.all((depths > _DEPTH[0] * away[:, None]) & (depths < _DEPTH[1] * away[:, None]), axis=0)
    tame = placed & (np.abs(distance) < _FAR_PX * unit)
    offset = float(np.median(distance[tame])) if tame.sum() >= _FEWEST else float("nan")
    # What moved as a whole is of the right camera all the same: distances are taken from their median.
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
    """Whether matches speak for the cameras: more fit than chance explains.

    Photographs of the same by other cameras have many matches in the lines' neighbourhood as well, but as many a
    little off them as on them.
    """
    on_lines = float(bdtrc(near - 1, tame, _NEAR_PX / _FAR_PX))
    return on_lines < _UNLIKELY_NEARER and float(bdtrc(near - 1, matches, _BY_CHANCE_NEAR)) < _UNLIKELY
