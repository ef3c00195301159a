"""Matching stage: from photographs and cameras to foregrounds and disparities. Paper 2.3."""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING

from mammometry.base.errors import MatchingError
from mammometry.base.machine.cores import available_cores
from mammometry.base.photograph import Photograph
from mammometry.job.inputs import CameraSet
from mammometry.job.products import Context, product, product_of_each

if TYPE_CHECKING:  # the stages import compilers and image libraries, which a plan does not need
    from mammometry.calibration.features.keypoints import Keypoints
    from mammometry.calibration.judge.camera_names import PhotographCheck
    from mammometry.matching.dense.match import DisparityMap
    from mammometry.matching.foreground.all_cameras import Subjects
    from mammometry.matching.foreground.foreground import Foreground
    from mammometry.matching.rectify import RectifiedPair
    from mammometry.surface.motion.agreement import RowErrors

_AT_ONCE = 4  # photographs in memory at once; 40 MB each at full size


@product("match", version=2, stored=False, check=True)
def names(cameras: CameraSet, *, job: Context) -> PhotographCheck:
    """Check before matching that each photograph is from the camera that it is named after.

    The result is not stored: after a refusal the stored results are unchanged.

    Raises:
        MatchingError: lists photographs of another camera or of another exposure.
    """
    from mammometry.calibration.features.keypoints import keypoints
    from mammometry.calibration.judge.camera_names import check_names, wrong_photographs

    def features(camera: str) -> tuple[tuple[int, int], Keypoints]:
        photograph = job.inputs.photographs[camera]
        height, width = photograph.pixels.shape[:2]
        return (width, height), keypoints(photograph)

    if job.inputs.walk is not None:
        return check_names(cameras.rig, {})  # a walk's cameras were found in the photographs themselves
    in_pairs = sorted({camera for pair in job.inputs.pair_names.values() for camera in pair})
    with ThreadPoolExecutor(min(_AT_ONCE, available_cores())) as pool:
        seen = dict(zip(in_pairs, pool.map(features, in_pairs), strict=True))
    # Rectification reports photographs of a wrong size.
    fitting = {name: points for name, (size_wh, points) in seen.items() if size_wh == cameras.rig.cameras[name].size_wh}
    compared = check_names(cameras.rig, fitting)
    wrong = list(wrong_photographs(compared, job.inputs.pair_names))
    if wrong:
        alike = "; ".join(one.listed for one in wrong if one.found == wrong[0].found)
        expected = "each camera's own photograph, all of one exposure"
        raise MatchingError(f"capture, {alike}", found=wrong[0].found, expected=expected, remedy=wrong[0].remedy)
    return compared


@product_of_each("match", inputs=("capture/{item}",), large=True, threads=1)
def photograph(*, job: Context) -> Photograph:
    """The photograph of one camera, decoded once for foreground and rectification."""
    return job.inputs.photographs[job.item]


@product("match", version=5, settings="matching.foreground", inputs=("capture", "masks"))
def subjects(cameras: CameraSet, *, job: Context) -> Subjects:
    """Position of the subject, and its blocks in each photograph. None where all masks are given."""
    from mammometry.matching.foreground.all_cameras import find_subjects

    return find_subjects(cameras.rig, job.inputs.photographs, job.settings.matching.foreground, given=job.inputs.masks)


@product_of_each(
    "match",
    version=13,
    settings="matching.foreground",
    inputs=("masks/{item}",),
    large=True,
    threads=1,
)
def foreground(photograph: Photograph, subjects: Subjects | None, *, job: Context) -> Foreground:
    """Pixels of one camera that show the subject."""
    from mammometry.matching.foreground.foreground import estimate_foreground

    given = job.inputs.masks.get(job.item)
    subject = None if subjects is None else subjects.blocks.get(job.item)
    return estimate_foreground(photograph, job.item, given=given, subject=subject)


@product_of_each("match", large=True)
def rectified(
    cameras: CameraSet,
    photographs: Mapping[str, Photograph],  # first, so that the foregrounds use the decoded ones
    foregrounds: Mapping[str, Foreground],
    subjects: Subjects | None,
    *,
    job: Context,
) -> RectifiedPair:
    """Both photographs of a pair, resampled so that the same point is on the same row."""
    from mammometry.matching.rectify import rectify

    left, right = job.inputs.pair_names[job.item]
    return rectify(
        cameras.rig.pair(job.item),
        photographs[left],
        photographs[right],
        foregrounds[left],
        foregrounds[right],
        middle_world=None if subjects is None else subjects.middle_world,
    )


@product_of_each("match", version=17, settings="matching", large=True, threads=2)
def disparity(rectified: RectifiedPair, *, job: Context) -> DisparityMap:
    """Disparity at each pixel of the left photograph."""
    from mammometry.matching.dense.match import match

    return match(rectified, job.settings.matching, progress=job.progress)


@product_of_each("match", version=1, name="rows/{item}", threads=2)
def vertical_residual(disparity: DisparityMap, *, job: Context) -> RowErrors:
    """Vertical disparity of a pair, summarised while the whole map is in memory."""
    from mammometry.surface.motion.agreement import row_errors

    return row_errors(disparity)
