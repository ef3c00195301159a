"""The subject in all photographs of a capture.

Coarse depths of all pairs say where it stands and what of each photograph is near. `segment` and `seeded` find it in
each. Then the photographs are compared: one subject is seen in all of them. A silhouette that the others contradict is
not used: everything that its pair sees there is matched, and it carves nothing away.
"""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from types import MappingProxyType

from mammometry.base.machine.cores import available_cores
from mammometry.base.photograph import Photograph
from mammometry.base.value import value
from mammometry.geometry.arrays import Array, Bool, Float64
from mammometry.geometry.camera import Rig
from mammometry.matching.coarse_stereo import CoarseDepths, coarse_depths, depth_seeds, near_points, subject_middle
from mammometry.matching.foreground.foreground import Blocks, blocks_of, subject_blocks
from mammometry.matching.foreground.mask_agreement import check_masks
from mammometry.matching.settings import ForegroundSettings

_AT_ONCE = 4  # photographs in memory; at full size each has 40 MB


@value(eq=False)
class Subjects:
    """Where the subject stands, and its blocks in each photograph."""

    middle_world: Float64[Array, 3] | None
    """Point about which it stands, world frame, mm. None where no pair sees anything."""
    blocks: Mapping[str, Bool[Array, "h w"]]
    """Camera → the subject's blocks. It lacks cameras whose silhouette is not known."""
    blind: tuple[str, ...]
    """Cameras whose silhouette is not known: all that they see may be the subject."""
    doubts: Mapping[str, str]
    """Camera → why its silhouette was sought and is not known."""


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
        photographs: camera → its photograph; read when looked up.
        settings: mode and levels.
        given: camera → the subject's pixels, drawn or segmented elsewhere. Nothing is sought there.

    Raises:
        MatchingError: a photograph is black.
    """
    depths = _depths(rig, photographs)
    middle = subject_middle(rig, depths)
    if settings.mode == "all":
        blind = tuple(name for name in photographs if name not in given)
        return Subjects(middle_world=middle, blocks={}, blind=blind, doubts={})
    seeds = [one for pair in depths if middle is not None for one in depth_seeds(pair, middle)]

    def search(camera: str) -> tuple[Blocks, Bool[Array, "h w"] | None]:
        photograph = photographs[camera]
        blocks = blocks_of(photograph)
        own = [one for one in seeds if one.camera == camera]
        return blocks, subject_blocks(photograph.name, blocks, settings, own)

    wanted = [name for name in photographs if name not in given]
    with ThreadPoolExecutor(min(_AT_ONCE, available_cores())) as pool:
        searched = dict(zip(wanted, pool.map(search, wanted), strict=True))
    doubts = {
        name: "neither brightness nor colour nor depth parts the subject from the rest"
        for name, (_, mask) in searched.items()
        if mask is None
    }
    masks = {name: mask for name, (_, mask) in searched.items() if mask is not None}
    if middle is not None:
        points = [(pair, near_points(pair, middle)) for pair in depths]
        steps = {name: searched[name][0].step for name in masks}
        seen = [({camera.name for camera in pair.cameras}, found) for pair, found in points if len(found)]
        checked = check_masks(rig, masks, steps, seen, middle)
        masks, doubts = dict(checked.masks), doubts | dict(checked.doubts)
    for name in _partners(rig, set(doubts)) - set(given) - set(doubts):
        doubts[name] = "its partner's silhouette is not known"
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
    """These cameras and all that pairs tie to them: both pictures of a pair are cut alike."""
    while True:
        more = {name for pair in rig.pair_names.values() if names & set(pair) for name in pair}
        if more <= names:
            return names
        names = names | more
