"""Plan of the removal of dents. Which range data are kept, and those data."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from mammometry.base.progress import Progress
from mammometry.job.inputs import Inputs
from mammometry.job.products import Memo, Product, Remade
from mammometry.job.stage_values import CameraSet

if TYPE_CHECKING:  # The stages bring compilers and image libraries, which a plan alone need not wait for.
    from mammometry.matching.foreground.all_cameras import Subjects
    from mammometry.surface.motion.motion_test import Stillness
    from mammometry.surface.ranges.dents import Kept, ValidPatches
    from mammometry.surface.ranges.range_image import RangeImage
    from mammometry.surface.settings import SurfaceSettings


def kept_data(
    inputs: Inputs,
    cameras: Product[CameraSet],
    stillness: Product[Stillness],
    ranges: Mapping[str, Product[RangeImage]],
    subjects: Product[Subjects] | None,
    settings: SurfaceSettings,
    memo: Memo,
) -> tuple[Product[Kept], Product[ValidPatches]]:
    """Which range data are kept, and those data.

    Only the former are stored: the data themselves are in the range images.
    """

    def choose(
        cameras: CameraSet,
        stillness: Stillness,
        ranges: Mapping[str, RangeImage],
        subjects: Subjects | None,
        *,
        progress: Progress,
    ) -> Kept:
        from mammometry.surface.ranges import decompose, dents
        from mammometry.surface.ranges import foreign_pieces as scraps

        images = tuple(stillness.carry(image, cameras.rig) for image in ranges.values())
        patches = decompose.decompose(images, settings.decompose) if settings.dents.rule == "patch" else None
        valid = dents.remove_dents(images, patches, settings.dents)
        keep = [image.valid for image in valid.range_images]
        unseen = set() if subjects is None else set(subjects.blind)
        blind = [name for name, pair in cameras.rig.pair_names.items() if unseen & set(pair)]
        if (
            blind or inputs.subject_kind == "surface"
        ):  # a solid's pieces beside the largest are left out when it is meshed
            keep = scraps.subject_data(valid.range_images, blind, None if subjects is None else subjects.middle_world)
        return dents.Kept(keep=tuple(keep), angles_rad=valid.angles_rad)

    def take(
        cameras: CameraSet, stillness: Stillness, ranges: Mapping[str, RangeImage], kept: Kept, *, progress: Progress
    ) -> ValidPatches:
        return kept.of([stillness.carry(image, cameras.rig) for image in ranges.values()])

    kept: Product[Kept] = Product(
        memo,
        "surface",
        "valid",
        choose,
        parents={"cameras": cameras, "stillness": stillness, "ranges": ranges, "subjects": subjects},
        settings=(settings.decompose, settings.dents),
        inputs={"subject": inputs.digests["subject"]},
    )
    valid: Product[ValidPatches] = Product(
        Remade(),
        "surface",
        "data",
        take,
        parents={"cameras": cameras, "stillness": stillness, "ranges": ranges, "kept": kept},
    ).letting_go(*ranges.values(), kept)
    return kept, valid
