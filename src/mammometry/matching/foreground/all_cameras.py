"""Find the subject in all photographs of a capture.

Coarse depths of all pairs show where the subject is, what is near in each photograph, and what the subject is on.
`segment` and `seeded` find it in each. Then the photographs are compared, since all show the same subject. A silhouette
that contradicts the others is not used: everything that its pair sees is matched, and it carves nothing.

A silhouette is rejected only if another explanation of all views is better (`check_masks`):

- It must contain what the other silhouettes agree on, otherwise it is wrong and they are right. Objects outside the
  other silhouettes, such as a support, a rail or a hand, do not count.
- Together they must contain a good part of what the pairs see nearby, apart from a board or table under the subject.
  Otherwise all of them show something else.
- Their visual hull must fill each of them: a silhouette that is much too large or inverted does not fit.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from scipy import ndimage

from mammometry.base.machine.cores import available_cores
from mammometry.base.photograph import Photograph
from mammometry.base.value import value
from mammometry.geometry import Array, Bool, Camera, Float64, Rig
from mammometry.matching.coarse_stereo import (
    CoarseDepths,
    coarse_depths,
    depth_seeds,
    near_points,
    sort_depths,
    subject_middle,
)
from mammometry.matching.foreground.foreground import Blocks, blocks_of, subject_blocks
from mammometry.matching.settings import ForegroundSettings

_AT_ONCE = 4  # photographs in memory at once; 40 MB each at full size


@value(eq=False)
class Subjects:
    """Position of the subject, and its blocks in each photograph."""

    middle_world: Float64[Array, 3] | None
    """Point near its centre, world frame, mm. None if no pair sees anything."""
    blocks: Mapping[str, Bool[Array, "h w"]]
    """Camera → the subject's blocks, without cameras whose silhouette is unknown."""
    blind: tuple[str, ...]
    """Cameras whose silhouette is unknown: everything that they see may be the subject."""
    doubts: Mapping[str, str]
    """Camera → reason why its silhouette is unknown. Empty: its partner's is unknown, and both are treated the same."""


def find_subjects(
    rig: Rig,
    photographs: Mapping[str, Photograph],
    settings: ForegroundSettings = ForegroundSettings(),
    *,
    given: Mapping[str, Bool[Array, "h w"]] = MappingProxyType({}),
) -> Subjects:
    """Find the subject in all photographs.

    Args:
        rig: calibrated cameras.
        photographs: camera → its photograph, read on look-up.
        settings: mode and levels.
        given: camera → mask of the subject, drawn or segmented by another program, which is used as it is.

    Raises:
        MatchingError: a photograph is black.
    """
    depths = _depths(rig, photographs)
    middle = subject_middle(rig, depths)
    if settings.mode == "all":
        blind = tuple(name for name in photographs if name not in given)
        return Subjects(middle_world=middle, blocks={}, blind=blind, doubts={})
    by_depth = [] if middle is None else sort_depths(depths, middle)
    seeds = [one for pair in by_depth for one in depth_seeds(pair)]

    def search(camera: str) -> tuple[Blocks, Bool[Array, "h w"] | None]:
        photograph = photographs[camera]
        blocks = blocks_of(photograph)
        own = [one for one in seeds if one.camera == camera]
        return blocks, subject_blocks(photograph.name, blocks, own)

    wanted = [name for name in photographs if name not in given]
    with ThreadPoolExecutor(min(_AT_ONCE, available_cores())) as pool:
        searched = dict(zip(wanted, pool.map(search, wanted), strict=True))
    doubts = {
        name: "neither brightness nor colour nor depth separates the subject from the rest"
        for name, (_, mask) in searched.items()
        if mask is None
    }
    masks = {name: mask for name, (_, mask) in searched.items() if mask is not None}
    if middle is not None:
        points = [(pair.depths, near_points(pair)) for pair in by_depth]
        steps = {name: searched[name][0].step for name in masks}
        seen = [({camera.name for camera in pair.cameras}, found) for pair, found in points if len(found)]
        checked = check_masks(rig, masks, steps, seen, middle)
        masks, doubts = dict(checked.masks), doubts | dict(checked.doubts)
    for name in _partners(rig, set(doubts)) - set(given) - set(doubts):
        doubts[name] = ""
    return Subjects(
        middle_world=middle,
        blocks={name: mask for name, mask in masks.items() if name not in doubts},
        blind=tuple(doubts),
        doubts=doubts,
    )


def _depths(rig: Rig, photographs: Mapping[str, Photograph]) -> list[CoarseDepths]:
    """Coarse depths of the pairs that have any."""

    def of_pair(pair: str) -> CoarseDepths | None:
        left, right = rig.pair_names[pair]
        return coarse_depths(rig, pair, (photographs[left], photographs[right]))

    with ThreadPoolExecutor(max(1, min(_AT_ONCE // 2, available_cores() // 2))) as pool:
        return [one for one in pool.map(of_pair, rig.pair_names) if one is not None]


def _partners(rig: Rig, names: set[str]) -> set[str]:
    """These cameras and their partners: both images of a pair get the same crop."""
    while True:
        more = {name for pair in rig.pair_names.values() if names & set(pair) for name in pair}
        if more <= names:
            return names
        names = names | more


# Chosen on the captures of benchmarks.accuracy.foreground; correct silhouettes are above 0.9 in all three.
_WITHIN = 0.4  # smallest share of the subject's points in the image that a silhouette must contain
_FEWEST = 150  # fewest of these points for a decision
_FILLED = 0.5  # smallest share of a silhouette that the hull must fill
_GRID = 48  # grid points of the hull along each side
_MOST = 0.5  # share of a cell above which it belongs to the silhouette
_REACH = 0.7  # half the grid's side, relative to the images' height at the subject's centre


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CheckedSilhouettes:
    """Silhouettes that agree with one another, and those that do not."""

    masks: Mapping[str, Bool[Array, "h w"]]
    """Camera → the subject's blocks, without parts that contradict the others."""
    doubts: Mapping[str, str]
    """Camera → reason why its silhouette is rejected."""


def check_masks(
    rig: Rig,
    masks: Mapping[str, Bool[Array, "h w"]],
    steps: Mapping[str, int],
    seen: Sequence[tuple[Set[str], Float64[Array, "n 3"]]],
    middle_world: Float64[Array, 3],
) -> CheckedSilhouettes:
    """Compare the cameras' silhouettes.

    Args:
        rig: calibrated cameras.
        masks: camera → the subject's blocks.
        steps: camera → pixels per block.
        seen: for each pair, its cameras and points of the working volume that it sees, world frame, mm.
        middle_world: point near the subject's centre, mm.
    """
    doubts = _contradicted(rig, masks, steps, seen)
    left = {name: mask for name, mask in masks.items() if name not in doubts}
    doubts |= _incomplete(rig, left, steps, seen)
    left = {name: mask for name, mask in left.items() if name not in doubts}
    grid = _grid(rig, middle_world)
    places = {name: _in_blocks(rig.cameras[name], grid, steps[name]) for name in left}
    while len(left) > 1:
        filled = _filled(left, places)
        if _least(filled) >= _FILLED:
            left = {name: _parts(mask, *filled[name]) for name, mask in left.items()}
            break
        worst = max(left, key=lambda name: _least(_filled({k: v for k, v in left.items() if k != name}, places)))
        share = 100 * left.pop(worst).mean()
        doubts[worst] = f"its silhouette of {share:.0f} % of the picture does not fit the other cameras'"
    return CheckedSilhouettes(masks=left, doubts=doubts)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Looked:
    """The pairs' points, as seen by one camera."""

    measured: Bool[Array, " n"]
    """Points of its own pairs."""
    inside: Bool[Array, " n"]
    """Points in its image."""
    held: Bool[Array, " n"]
    """Points in its silhouette."""


def _looked_up(
    rig: Rig,
    masks: Mapping[str, Bool[Array, "h w"]],
    steps: Mapping[str, int],
    seen: Sequence[tuple[Set[str], Float64[Array, "n 3"]]],
) -> dict[str, _Looked]:
    points = np.concatenate([np.empty((0, 3)), *(points for _, points in seen)])
    found = {}
    for name, mask in masks.items():
        rows, columns, inside = _in_blocks(rig.cameras[name], points, steps[name])
        measured = [np.full(len(points), name in cameras) for cameras, points in seen]
        found[name] = _Looked(
            measured=np.concatenate([np.empty(0, dtype=bool), *measured]),
            inside=inside,
            held=inside & mask[rows, columns],
        )
    return found


def _contradicted(
    rig: Rig,
    masks: Mapping[str, Bool[Array, "h w"]],
    steps: Mapping[str, int],
    seen: Sequence[tuple[Set[str], Float64[Array, "n 3"]]],
) -> dict[str, str]:
    """Silhouettes that do not contain what the others agree on, the worst first.

    A camera's partner in a pair is not counted: both are usually wrong for the same reason. If the others agree on
    nothing, everything nearby counts.
    """
    looked = _looked_up(rig, masks, steps, seen)
    doubts: dict[str, str] = {}
    while True:
        shares = {}
        for name, own in looked.items():
            evidence = own.inside & ~own.measured if not own.measured.all() else own.inside
            others = [other for key, other in looked.items() if key not in _partners_of(rig, name)]
            agreed = evidence & np.any([np.zeros_like(evidence), *(other.inside for other in others)], axis=0)
            agreed &= np.all([agreed, *(other.held | ~other.inside for other in others)], axis=0)
            by_others = np.count_nonzero(agreed) >= _FEWEST
            within = own.held[agreed if by_others else evidence]
            if len(within) >= _FEWEST:
                what = "what the other silhouettes agree on" if by_others else "what the pairs see near"
                shares[name] = float(within.mean()), what
        worst = min(shares, key=lambda name: shares[name][0], default=None)
        if worst is None or shares[worst][0] >= _WITHIN:
            return doubts
        share, what = shares[worst]
        doubts[worst] = f"only {100 * share:.0f} % of {what} is within its silhouette"
        del looked[worst]


def _partners_of(rig: Rig, name: str) -> set[str]:
    """A camera and its partners."""
    return {name, *(other for pair in rig.pair_names.values() if name in pair for other in pair)}


def _incomplete(
    rig: Rig,
    masks: Mapping[str, Bool[Array, "h w"]],
    steps: Mapping[str, int],
    seen: Sequence[tuple[Set[str], Float64[Array, "n 3"]]],
) -> dict[str, str]:
    """All silhouettes, if together they omit most of what is near: they show only a part of the subject."""
    looked = _looked_up(rig, masks, steps, seen).values()
    if not looked:
        return {}
    seeing = np.sum([one.inside for one in looked], axis=0)
    holding = np.sum([one.held for one in looked], axis=0)
    judged = seeing > 0
    if np.count_nonzero(judged) < _FEWEST:
        return {}
    within = (2 * holding >= seeing)[judged].mean()  # in most silhouettes: a rail may hide the subject from some
    if within >= _WITHIN:
        return {}
    return dict.fromkeys(
        masks, f"only {100 * within:.0f} % of what the pairs see near is within most of the silhouettes"
    )


def _grid(rig: Rig, middle_world: Float64[Array, 3]) -> Float64[Array, "n 3"]:
    """A cube about the subject's centre, as large as the field of view there."""
    heights = [
        float(np.linalg.norm(middle_world - camera.centre_world)) * min(camera.size_wh) / float(camera.matrix[0, 0])
        for camera in rig.cameras.values()
    ]
    ticks = _REACH * float(np.median(heights)) * np.linspace(-1.0, 1.0, _GRID)
    cube = np.stack(np.meshgrid(ticks, ticks, ticks, indexing="ij"), axis=-1).reshape(-1, 3)
    points: Float64[Array, "n 3"] = middle_world + cube
    return points


def _in_blocks(
    camera: Camera, points_world: Float64[Array, "n 3"], step: int
) -> tuple[Array, Array, Bool[Array, " n"]]:
    """Block row and column of each point, and whether it is in the image."""
    uv = camera.project(points_world)
    with np.errstate(invalid="ignore"):
        inside = np.all((uv > -0.5) & (uv < np.array(camera.size_wh) - 0.5), axis=1)
    places = np.where(inside[:, None], np.rint(uv), 0).astype(np.intp) // step
    return places[:, 1], places[:, 0], inside


_Filled = Mapping[str, tuple[Bool[Array, "H W"], Bool[Array, "H W"], int]]


def _least(filled: _Filled) -> float:
    """Smallest share of a silhouette that the hull fills."""
    return min(float(cells[part].mean()) if part.any() else 0.0 for part, cells, _ in filled.values())


def _filled(
    masks: Mapping[str, Bool[Array, "h w"]], places: Mapping[str, tuple[Array, Array, Bool[Array, " n"]]]
) -> _Filled:
    """Camera → its cells in the others' field of view, those filled by the hull, and blocks per cell."""
    hull, seen = np.ones(_GRID**3, dtype=bool), np.zeros(_GRID**3, dtype=np.int16)
    for name, mask in masks.items():
        rows, columns, inside = places[name]
        hull &= ~inside | mask[rows, columns]
        seen += inside
    found = {}
    for name, mask in masks.items():
        rows, columns, inside = places[name]
        by_others = inside & (seen > 1)
        cell = max(1, round(float(np.hypot(*mask.shape)) / _GRID))
        size = tuple(length // cell + 1 for length in mask.shape)
        pictures = np.zeros((2, *size), dtype=bool)
        for picture, chosen in zip(pictures, (by_others, by_others & hull), strict=True):
            picture[rows[chosen] // cell, columns[chosen] // cell] = True
        padded = np.pad(mask, [(0, count * cell - length) for count, length in zip(size, mask.shape, strict=True)])
        most = padded.reshape(size[0], cell, size[1], cell).mean(axis=(1, 3)) >= _MOST
        found[name] = most & pictures[0], pictures[1], cell
    return found


def _parts(
    mask: Bool[Array, "h w"], part: Bool[Array, "H W"], filled: Bool[Array, "H W"], cell: int
) -> Bool[Array, "h w"]:
    """The silhouette without connected parts that the hull hardly fills."""
    labels, count = ndimage.label(mask)
    if count < 2:
        return mask
    rows, columns = (np.arange(length) // cell for length in mask.shape)
    judged, kept = part[np.ix_(rows, columns)], filled[np.ix_(rows, columns)]
    numbers = np.arange(count + 1)
    sizes = np.maximum(ndimage.sum_labels(judged, labels, numbers), 1)
    alone = ndimage.sum_labels(judged & ~kept, labels, numbers) > (1 - _FILLED) * sizes
    alone[0] = False
    return mask & ~alone[labels]
