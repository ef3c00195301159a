"""Plan of finding the subject: photographs, coarse depths, foregrounds."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from mammometry.base.photograph import Photograph
from mammometry.base.progress import Progress
from mammometry.job.inputs import Inputs
from mammometry.job.products import Memo, Parent, Product
from mammometry.job.stage_values import CameraSet

if TYPE_CHECKING:  # The stages bring compilers and image libraries, which a plan alone need not wait for.
    from mammometry.matching.foreground import Foreground
    from mammometry.matching.seeded import DepthSeeds
    from mammometry.matching.settings import MatchSettings


def find_subjects(
    inputs: Inputs, cameras: Product[CameraSet], settings: MatchSettings, memo: Memo
) -> tuple[dict[str, Product[Photograph]], dict[str, Product[Foreground]]]:
    """Plan photographs and foregrounds, by camera.

    A coarse stereo of each pair lies between them.
    """

    def photograph(camera: str) -> Product[Photograph]:
        def read(*, progress: Progress) -> Photograph:
            return inputs.photographs[camera]

        digests = {f"capture/{camera}": inputs.digests[f"capture/{camera}"]}
        return Product(None, "match", f"photograph/{camera}", read, inputs=digests)

    photographs = {camera: photograph(camera) for camera in inputs.photographs}

    def depth(pair: str, left: str, right: str) -> Product[tuple[DepthSeeds, ...]]:
        def sort(
            cameras: CameraSet, photographs: Mapping[str, Photograph], *, progress: Progress
        ) -> tuple[DepthSeeds, ...]:
            from mammometry.matching.coarse_depth import depth_seeds

            return depth_seeds(cameras.rig, pair, (photographs[left], photographs[right]))

        shots = {camera: photographs[camera] for camera in (left, right)}
        parents: dict[str, Parent] = {"cameras": cameras, "photographs": shots}
        return Product(None, "match", f"depth/{pair}", sort, parents=parents)

    depths = {pair: depth(pair, left, right) for pair, (left, right) in inputs.pair_names.items()}

    def foreground(camera: str) -> Product[Foreground]:
        def estimate(
            photograph: Photograph, depths: Mapping[str, tuple[DepthSeeds, ...]], *, progress: Progress
        ) -> Foreground:
            from mammometry.matching.foreground import estimate_foreground

            seeds = [one for of_pair in depths.values() for one in of_pair if one.camera == camera]
            given = inputs.masks.get(camera)
            return estimate_foreground(photograph, camera, settings.foreground, given=given, seeds=seeds)

        name = f"masks/{camera}"
        asked = camera not in inputs.masks and settings.foreground.mode == "auto"
        seen_by = {pair: depths[pair] for pair, names in inputs.pair_names.items() if asked and camera in names}
        digests = {name: inputs.digests[name]} if camera in inputs.masks else {}
        return Product(
            memo,
            "match",
            f"foreground/{camera}",
            estimate,
            parents={"photograph": photographs[camera], "depths": seen_by},
            settings=settings.foreground,
            inputs=digests,
        )

    foregrounds = {camera: foreground(camera) for camera in inputs.photographs}
    return photographs, foregrounds
