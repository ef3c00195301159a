"""Plan of finding the subject: photographs, the subject in all of them, foregrounds."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mammometry.base.photograph import Photograph
from mammometry.base.progress import Progress
from mammometry.job.inputs import Inputs
from mammometry.job.products import Memo, Product
from mammometry.job.stage_values import CameraSet

if TYPE_CHECKING:  # The stages bring compilers and image libraries, which a plan alone need not wait for.
    from mammometry.matching.foreground.all_cameras import Subjects
    from mammometry.matching.foreground.foreground import Foreground
    from mammometry.matching.settings import MatchSettings


def find_subjects(
    inputs: Inputs, cameras: Product[CameraSet], settings: MatchSettings, memo: Memo
) -> tuple[dict[str, Product[Photograph]], Product[Subjects] | None, dict[str, Product[Foreground]]]:
    """Plan photographs, the subject in all of them, and foregrounds.

    The subject is not sought where all masks are given.
    """

    def photograph(camera: str) -> Product[Photograph]:
        def read(*, progress: Progress) -> Photograph:
            return inputs.photographs[camera]

        digests = {f"capture/{camera}": inputs.digests[f"capture/{camera}"]}
        return Product(None, "match", f"photograph/{camera}", read, inputs=digests)

    photographs = {camera: photograph(camera) for camera in inputs.photographs}

    def search(cameras: CameraSet, *, progress: Progress) -> Subjects:
        from mammometry.matching.foreground import all_cameras as subjects

        return subjects.find_subjects(cameras.rig, inputs.photographs, settings.foreground, given=inputs.masks)

    subjects: Product[Subjects] | None = None
    if set(photographs) - set(inputs.masks):
        names = [f"capture/{camera}" for camera in photographs] + [f"masks/{camera}" for camera in inputs.masks]
        subjects = Product(
            memo,
            "match",
            "subjects",
            search,
            parents={"cameras": cameras},
            settings=settings.foreground,
            inputs={name: inputs.digests[name] for name in names},
        )

    def foreground(camera: str) -> Product[Foreground]:
        def outline(photograph: Photograph, subjects: Subjects | None, *, progress: Progress) -> Foreground:
            from mammometry.matching.foreground.foreground import estimate_foreground

            subject = None if subjects is None else subjects.blocks.get(camera)
            given = inputs.masks.get(camera)
            return estimate_foreground(photograph, camera, settings.foreground, given=given, subject=subject)

        name = f"masks/{camera}"
        digests = {name: inputs.digests[name]} if camera in inputs.masks else {}
        return Product(
            memo,
            "match",
            f"foreground/{camera}",
            outline,
            parents={"photograph": photographs[camera], "subjects": None if camera in inputs.masks else subjects},
            settings=settings.foreground,
            inputs=digests,
        )

    foregrounds = {camera: foreground(camera) for camera in inputs.photographs}
    return photographs, subjects, foregrounds
