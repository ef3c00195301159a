"""Plan of the test whether photographs bear the right names, before anything is matched."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING

from mammometry.base.errors import MatchingError
from mammometry.base.machine.cores import available_cores
from mammometry.base.progress import Progress
from mammometry.job.inputs import Inputs
from mammometry.job.products import Product, Remade
from mammometry.job.stage_values import CameraSet

if TYPE_CHECKING:  # The stages bring compilers and image libraries, which a plan alone need not wait for.
    from mammometry.calibration.features.keypoints import Keypoints
    from mammometry.calibration.judge.cameras.names import Names

_AT_ONCE = 4  # photographs in memory; at full size each has 40 MB


def right_names(inputs: Inputs, cameras: Product[CameraSet]) -> Product[Names]:
    """Plan to compare all photographs with the calibration, which refuses wrong ones by name.

    Nothing of it is stored: a run that is refused leaves the results as they were.
    """
    in_pairs = sorted({name for both in inputs.pair_names.values() for name in both})

    def compare(cameras: CameraSet, *, progress: Progress) -> Names:
        from mammometry.calibration.features.keypoints import keypoints
        from mammometry.calibration.judge.cameras.names import check_names, wrong_photographs

        def features(camera: str) -> tuple[tuple[int, int], Keypoints]:
            photograph = inputs.photographs[camera]
            height, width = photograph.pixels.shape[:2]
            return (width, height), keypoints(photograph)

        with ThreadPoolExecutor(min(_AT_ONCE, available_cores())) as pool:
            seen = dict(zip(in_pairs, pool.map(features, in_pairs), strict=True))
        # Where sizes differ, rectification says so.
        fitting = {
            name: found for name, (size_wh, found) in seen.items() if size_wh == cameras.rig.cameras[name].size_wh
        }
        names = check_names(cameras.rig, fitting)
        for wrong in wrong_photographs(names, inputs.pair_names):
            raise MatchingError(
                f"capture, {wrong.listed}", found=wrong.found,
                expected="each camera's own photograph, all of one exposure", remedy=wrong.remedy,
            )  # fmt: skip
        return names

    digests = {f"capture/{camera}": inputs.digests[f"capture/{camera}"] for camera in in_pairs}
    return Product(Remade(), "match", "names", compare, parents={"cameras": cameras}, inputs=digests)
