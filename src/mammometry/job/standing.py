"""Plan of the tests whether cameras and body stood still."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

from mammometry.base.progress import Progress
from mammometry.job.products import Memo, Product
from mammometry.job.stage_values import CameraSet

if TYPE_CHECKING:  # The stages bring compilers and image libraries, which a plan alone need not wait for.
    from mammometry.calibration.adjust.calibrated import Calibration
    from mammometry.matching.dense.match import DisparityMap
    from mammometry.surface.motion.agreement import RowErrors
    from mammometry.surface.motion.motion_test import Stillness
    from mammometry.surface.ranges.range_image import RangeImage
    from mammometry.surface.settings import StillnessSettings


def rows_of(disparities: Mapping[str, Product[DisparityMap]], memo: Memo) -> dict[str, Product[RowErrors]]:
    """Pair → its vertical disparity, summed up."""

    def summed_up(disparity: DisparityMap, *, progress: Progress) -> RowErrors:
        from mammometry.surface.motion.agreement import row_errors

        return row_errors(disparity)

    return {
        pair: Product(memo, "match", f"rows/{pair}", summed_up, parents={"disparity": disparity})
        for pair, disparity in disparities.items()
    }


def what_moved(
    cameras: Product[CameraSet],
    calibration: Product[Calibration] | None,
    ranges: Mapping[str, Product[RangeImage]],
    rows: Mapping[str, Product[RowErrors]],
    settings: StillnessSettings,
    memo: Memo,
) -> Product[Stillness]:
    """Motion between calibration and exposures, from pairs that see the same skin."""

    def compare(
        cameras: CameraSet,
        calibration: Calibration | None,
        ranges: Mapping[str, RangeImage],
        rows: Mapping[str, RowErrors],
        *,
        progress: Progress,
    ) -> Stillness:
        from mammometry.surface.motion import motion_test as stillness

        covariance = None if calibration is None else calibration.covariance
        return stillness.find(cameras.rig, tuple(ranges.values()), rows, covariance, settings)

    return Product(
        memo,
        "surface",
        "stillness",
        compare,
        parents={"cameras": cameras, "calibration": calibration, "ranges": ranges, "rows": rows},
        settings=settings,
    )


def where_they_stood(cameras: Product[CameraSet], stillness: Product[Stillness], memo: Memo) -> Product[CameraSet]:
    """The cameras as they most probably stood at the exposures. As calibrated, if nothing moved."""

    def stand(cameras: CameraSet, stillness: Stillness, *, progress: Progress) -> CameraSet:
        return replace(cameras, rig=stillness.rig(cameras.rig))

    return Product(memo, "surface", "stood", stand, parents={"cameras": cameras, "stillness": stillness})
