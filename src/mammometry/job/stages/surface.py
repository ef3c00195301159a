"""Surface stage: from disparities to the repaired surface and its colours. Paper 2.4 to 2.6."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

from mammometry.geometry.arrays import Array, Bool
from mammometry.job.inputs import CameraSet, FinishedSurface
from mammometry.job.products import Context, product, product_of_each

if TYPE_CHECKING:  # the stages import compilers and image libraries, which a plan does not need
    from mammometry.calibration.adjust.calibrated import Calibration
    from mammometry.geometry.mesh import TriangleMesh
    from mammometry.matching.dense.match import DisparityMap
    from mammometry.matching.foreground.all_cameras import Subjects
    from mammometry.matching.foreground.foreground import Foreground
    from mammometry.surface.fusion.fuse import FusedField
    from mammometry.surface.motion.agreement import RowErrors
    from mammometry.surface.motion.motion_detection import MotionEstimate
    from mammometry.surface.occlusion import Occlusion
    from mammometry.surface.ranges.dents import KeepMasks, ValidPatches
    from mammometry.surface.ranges.range_image import RangeImage
    from mammometry.surface.repair.repair import RepairedSurface
    from mammometry.surface.texture.texture_atlas import Atlas
    from mammometry.walk.motion import WalkMotion


@product_of_each(
    "surface",
    version=3,
    name="range/{item}",
    settings="surface.triangulate",
    inputs=("region",),
    large=True,
    threads=1,
)
def range_image(disparity: DisparityMap, *, job: Context) -> RangeImage:
    """Range image of a pair, with the cameras as calibrated. Paper 2.4."""
    from mammometry.surface.ranges.range_image import triangulate

    image = triangulate(disparity, job.settings.surface.triangulate)
    if job.inputs.walk is None:
        return image
    inside = image.valid.copy()
    inside[image.valid] = job.inputs.walk.region.contains(image.valid_points_world())
    return image.keeping(inside)


@product("surface", version=8, settings="surface.stillness")
def stillness(
    cameras: CameraSet,
    calibration: Calibration | None,
    range_images: Mapping[str, RangeImage],
    vertical_residuals: Mapping[str, RowErrors],
    subjects: Subjects | None,
    *,
    job: Context,
) -> MotionEstimate:
    """Motion between the calibration and the exposures, estimated from pairs that see the same skin."""
    from mammometry.matching.foreground.outlines_first import outlines_first
    from mammometry.surface.motion import feature_evidence
    from mammometry.surface.motion import motion_detection as stillness

    if job.inputs.walk is not None:
        return stillness.assumed_still(cameras.rig)
    covariance = None if calibration is None else calibration.covariance
    images = tuple(range_images.values())
    with outlines_first({} if subjects is None else subjects.doubts):
        return stillness.find(
            cameras.rig,
            images,
            vertical_residuals,
            covariance,
            job.settings.surface.stillness,
            shared=lambda: feature_evidence.shared_features(cameras.rig, job.inputs.photographs),
        )


@product("surface", version=4, inputs=("region",))
def walk_motion(
    cameras: CameraSet,
    range_images: Mapping[str, RangeImage],
    vertical_residuals: Mapping[str, RowErrors],
    *,
    job: Context,
) -> WalkMotion:
    """Motion of the body at each photograph of a walk, estimated from pairs that see the same skin."""
    from mammometry.walk.motion import find_motion

    assert job.inputs.walk is not None
    return find_motion(cameras.rig, tuple(range_images.values()), vertical_residuals, job.inputs.walk.board_mm)


@product("surface", version=2, name="stood")
def corrected_cameras(
    cameras: CameraSet, stillness: MotionEstimate, walk_motion: WalkMotion | None, *, job: Context
) -> CameraSet:
    """The cameras in their most probable poses at the exposures. As calibrated if nothing moved."""
    return replace(cameras, rig=(walk_motion or stillness).rig(cameras.rig))


def _dent_settings(job: Context) -> object:
    return job.settings.surface.decompose, job.settings.surface.dents


@product("surface", large=True)
def moved_ranges(
    cameras: CameraSet,
    stillness: MotionEstimate,
    walk_motion: WalkMotion | None,
    range_images: Mapping[str, RangeImage],
    *,
    job: Context,
) -> Mapping[str, RangeImage]:
    """Pair → its range image with the cameras' poses at the exposures."""
    motion = walk_motion or stillness
    moved = {name: motion.apply_motion(image, cameras.rig) for name, image in range_images.items()}
    if job.inputs.walk is None:
        return moved
    from mammometry.walk.data_edges import with_edge_errors

    return {name: with_edge_errors(image, cameras.rig.pair(name)) for name, image in moved.items()}


@product("surface", version=7, name="valid", settings=_dent_settings, inputs=("subject",), large=True)
def keep_masks(
    cameras: CameraSet, moved_ranges: Mapping[str, RangeImage], subjects: Subjects | None, *, job: Context
) -> KeepMasks:
    """Masks of the range data that remain after the removal of dents (paper 2.6.1, 2.6.2)."""
    from mammometry.surface.ranges import dents

    settings, rig, images = job.settings.surface, cameras.rig, tuple(moved_ranges.values())
    patches = dents.decompose(images, settings.decompose) if settings.dents.rule == "patch" else None
    valid = dents.remove_dents(images, patches, settings.dents)
    keep = [image.valid for image in valid.range_images]
    unseen = set() if subjects is None else set(subjects.blind)
    # Masks of a walk contain everything near the body.
    blind = [name for name, pair in rig.pair_names.items() if job.inputs.walk or unseen & set(pair)]
    if blind or job.inputs.subject_kind == "surface":  # a solid's smaller pieces are removed when it is meshed
        middle_world = None if subjects is None else subjects.middle_world
        keep = dents.subject_data(valid.range_images, blind, middle_world)
    return dents.KeepMasks(keep=tuple(keep), angles_rad=valid.angles_rad)


@product("surface", version=1, stored=False, inputs=("capture",))
def strands(
    cameras: CameraSet, range_images: Mapping[str, RangeImage], *, job: Context
) -> Mapping[str, Bool[Array, "h w"]]:
    """Pair → data on hair, straps or cords in front of a torso's skin."""
    from mammometry.base.machine.cores import map_in_threads
    from mammometry.surface.ranges.strands import strands_in

    def found(name: str) -> Bool[Array, "h w"]:
        left, _ = cameras.rig.pair_names[name]
        return strands_in(range_images[name], job.inputs.photographs[left], cameras.rig.cameras[left])

    return dict(zip(range_images, map_in_threads(found, list(range_images)), strict=True))


@product("surface", version=1, name="data", stored=False, large=True)
def valid_patches(
    moved_ranges: Mapping[str, RangeImage],
    keep_masks: KeepMasks,
    strands: Mapping[str, Bool[Array, "h w"]] | None,
    *,
    job: Context,
) -> ValidPatches:
    """The range data that remain, without strands. They are read from the range images when needed."""
    masks = keep_masks if strands is None else keep_masks.without([strands[name] for name in moved_ranges])
    return masks.of(list(moved_ranges.values()))


@product("surface", version=8, name="blocked")
def occlusions(
    corrected_cameras: CameraSet, valid_patches: ValidPatches, foregrounds: Mapping[str, Foreground], *, job: Context
) -> Mapping[str, Occlusion]:
    """Camera → places where something hides the subject. Cameras without such places are left out."""
    from mammometry.surface.occlusion import find_occlusions

    return find_occlusions(valid_patches.range_images, foregrounds, corrected_cameras.rig)


@product("surface", version=1, stored=False, large=True)
def walk_outlines(
    corrected_cameras: CameraSet, valid_patches: ValidPatches, foregrounds: Mapping[str, Foreground], *, job: Context
) -> Mapping[str, Foreground]:
    """Camera → mask of the body in a walk's photograph."""
    from mammometry.walk.outlines import outlines

    return outlines(valid_patches.range_images, foregrounds, corrected_cameras.rig)


@product("surface", large=True)
def solid(
    corrected_cameras: CameraSet,
    valid_patches: ValidPatches,
    foregrounds: Mapping[str, Foreground],
    occlusions: Mapping[str, Occlusion],
    subjects: Subjects | None,
    *,
    job: Context,
) -> FusedField | None:
    """Solid from range data and silhouettes (paper 2.5). None for an open surface."""
    from mammometry.matching.foreground.outlines_first import outlines_first
    from mammometry.surface import occlusion
    from mammometry.surface.fusion import fuse as extract

    if job.inputs.subject_kind == "surface":
        return None
    opened = occlusion.without_occluded(foregrounds, occlusions)
    extraction = job.settings.surface.extract.of(job.inputs.subject_kind)
    with outlines_first({} if subjects is None else subjects.doubts):
        return extract.solid_of(valid_patches.range_images, opened, corrected_cameras.rig, extraction.rule)


def _extraction(job: Context) -> object:
    return job.settings.surface.extract.of(job.inputs.subject_kind)


@product("surface", version=10, name="first", settings=_extraction, inputs=("subject",), large=True)
def initial_surface(valid_patches: ValidPatches, solid: FusedField | None, *, job: Context) -> TriangleMesh:
    """The first surface: the zero level of the views' averaged signed distances. Paper 2.5."""
    from mammometry.surface.fusion import fuse as extract

    extraction = job.settings.surface.extract.of(job.inputs.subject_kind)
    if solid is None:
        return extract.extract_open(valid_patches.range_images, progress=job.progress)
    return extract.meshed(solid, extraction, progress=job.progress)


@product("surface", version=6, name="repaired", settings="surface.repair")
def repaired(initial_surface: TriangleMesh, valid_patches: ValidPatches, *, job: Context) -> RepairedSurface:
    """The surface after elastic repair (paper 2.6.3). An open one is returned as measured."""
    from mammometry.surface.repair import repair

    if job.inputs.subject_kind == "surface":
        return repair.as_measured(initial_surface, valid_patches)
    return repair.repair(initial_surface, valid_patches, job.settings.surface.repair, progress=job.progress)


@product("surface", version=6, settings="surface.texture", inputs=("capture",), threads=1, deferrable=True)
def model(corrected_cameras: CameraSet, repaired: RepairedSurface, *, job: Context) -> Atlas:
    """Atlas for viewing: fewer triangles, with the photographs at full resolution."""
    from mammometry.surface.texture import texture_atlas, unmeasured

    rig = corrected_cameras.rig
    covered = texture_atlas.cover(repaired.mesh, job.inputs.photographs, rig, progress=job.progress)
    return texture_atlas.as_jpeg(unmeasured.faded_atlas(covered, repaired))


@product("surface", version=4, settings="surface.texture", inputs=("capture",), threads=1)
def mesh(corrected_cameras: CameraSet, repaired: RepairedSurface, *, job: Context) -> FinishedSurface:
    """The repaired surface with a colour at each vertex."""
    from mammometry.surface.texture.texture import paint

    textured = paint(repaired.mesh, job.inputs.photographs, corrected_cameras.rig)
    return FinishedSurface(repaired=repaired, textured=textured)
