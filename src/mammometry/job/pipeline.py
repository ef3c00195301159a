"""The whole method: values in, values out, through a memo.

A plan is laid out without computing anything. Each `Product` knows its key (stage version, own settings, digests of
its inputs) and how to make itself. It asks the memo when its value is needed. So one plan runs the job, resumes it,
and knows what is stale.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from concurrent.futures import Executor, Future
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar

from mammometry.base.errors import CalibrationError
from mammometry.base.photograph import Photograph
from mammometry.base.progress import Progress
from mammometry.job.camera_sets import adjust_rig, imported_cameras, trusted_cameras
from mammometry.job.inputs import Inputs
from mammometry.job.keeping import kept_data
from mammometry.job.measuring import Measured, Upstream, measure
from mammometry.job.names import right_names
from mammometry.job.products import Memo, Parent, Product, Products, Stage, side_by_side
from mammometry.job.stage_values import CameraSet, FinishedSurface
from mammometry.job.standing import rows_of, what_moved, where_they_stood
from mammometry.job.subjects import find_subjects
from mammometry.settings import Settings

if TYPE_CHECKING:  # The stages bring compilers and image libraries, which a plan alone need not wait for.
    from mammometry.calibration.adjust.bundle import Calibration
    from mammometry.calibration.detection.detect import Observations
    from mammometry.calibration.judge.cameras.names import Names
    from mammometry.calibration.settings import CalibrateSettings
    from mammometry.calibration.targets.target import Target
    from mammometry.geometry.mesh import TriangleMesh
    from mammometry.matching.dense.match import DisparityMap
    from mammometry.matching.foreground.all_cameras import Subjects
    from mammometry.matching.foreground.foreground import Foreground
    from mammometry.matching.rectify import RectifiedPair
    from mammometry.matching.settings import MatchSettings
    from mammometry.surface.fusion.fuse import Solid
    from mammometry.surface.motion.agreement import RowErrors
    from mammometry.surface.motion.motion_test import Stillness
    from mammometry.surface.occlusion.occlusion import Blocked
    from mammometry.surface.ranges.dents import Kept, ValidPatches
    from mammometry.surface.ranges.range_image import RangeImage
    from mammometry.surface.repair.repair import RepairedSurface
    from mammometry.surface.settings import SurfaceSettings
    from mammometry.surface.texture.texture_atlas import Atlas

__all__ = [
    "Calibrated", "CameraSet", "FinishedSurface", "Inputs", "Matched", "Measured", "Plan", "Surfaced",
    "calibrate", "match", "measure", "plan", "surface",
]  # fmt: skip


# --- 2.2 Calibration -------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Calibrated(Products):
    """Plan of the calibration."""

    observations: Mapping[str, Product[Observations]]
    """Pose → what was seen of the target in it. Empty if the cameras are given."""
    intrinsics: Mapping[str, Product[Observations]]
    """Camera → what it saw of the intrinsics target."""
    calibration: Product[Calibration] | None
    """None where the cameras come ready-made."""
    cameras: Product[CameraSet]


def calibrate(inputs: Inputs, settings: CalibrateSettings, memo: Memo) -> Calibrated:
    """Find the target in every photograph, then adjust cameras and poses. Paper 2.2."""
    if inputs.cameras is not None:

        def ready_made(*, progress: Progress) -> CameraSet:
            return imported_cameras(inputs)

        given = Product(
            memo,
            "calibrate",
            "cameras",
            ready_made,
            inputs={name: inputs.digests[name] for name in ("cameras", "rig", "subject")},
        )
        return Calibrated(observations={}, intrinsics={}, calibration=None, cameras=given)

    def detected(
        name: str, digests: dict[str, str], shots: Mapping[tuple[str, str], Photograph], target: Target
    ) -> Any:
        def detect(progress: Progress) -> Observations:
            from mammometry.calibration.detection import detect

            measured = {shot: inputs.measured_points[shot] for shot in shots if shot in inputs.measured_points}
            return detect.detect(shots, target, settings.detect, measured=measured, progress=progress)

        return Product(memo, "calibrate", f"observations/{name}", detect, settings=settings.detect, inputs=digests)

    if inputs.target is None:
        raise CalibrationError(
            "session.toml",
            found="neither a [target] nor ready-made cameras",
            expected="one of them",
            remedy="Describe the calibration target, or import cameras with `mammometry import-cameras`",
        )
    target = inputs.target
    observations: dict[str, Product[Observations]] = {}
    for pose in sorted({pose for pose, _ in inputs.calibration_photographs}):
        shots = _OnePose(inputs.calibration_photographs, pose)
        digests = {f"{pose}/{camera}": inputs.digests[f"calibration/{pose}/{camera}"] for pose, camera in shots}
        points = {f"points/{pose}/{camera}" for pose, camera in shots if (pose, camera) in inputs.measured_points}
        digests |= {name: inputs.digests[name] for name in points}
        observations[pose] = detected(pose, {"target": inputs.digests["target"], **digests}, shots, target)
    intrinsics: dict[str, Product[Observations]] = {}
    for camera, own_shots in inputs.intrinsics_photographs.items():
        assert inputs.intrinsics_target is not None
        digests = {exposure: inputs.digests[f"intrinsics/{camera}/{exposure}"] for exposure, _ in own_shots}
        digests["target"] = inputs.digests["intrinsics-target"]
        intrinsics[camera] = detected(f"intrinsics-{camera}", digests, own_shots, inputs.intrinsics_target)

    def adjust(
        poses: Mapping[str, Observations], lenses: Mapping[str, Observations], *, progress: Progress
    ) -> Calibration:
        return adjust_rig(inputs, tuple(poses.values()), lenses, settings, progress=progress)

    calibration: Product[Calibration] = Product(
        memo,
        "calibrate",
        "calibration",
        adjust,
        parents={"poses": observations, "lenses": intrinsics},
        settings=settings.bundle,
        inputs={name: inputs.digests[name] for name in ("rig", "subject", *(("prior",) if inputs.priors else ()))}
        | inputs.mounting_digest,
    )

    def trust(calibration: Calibration, *, progress: Progress) -> CameraSet:
        return trusted_cameras(calibration, inputs, settings)

    cameras = Product(
        memo, "calibrate", "cameras", trust, parents={"calibration": calibration}, settings=settings.quality
    )
    return Calibrated(observations=observations, intrinsics=intrinsics, calibration=calibration, cameras=cameras)


# --- 2.3 Matching ----------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Matched(Products):
    """Plan of the matching."""

    names: Product[Names]
    """Whether each photograph has its camera's name."""
    subjects: Product[Subjects] | None
    """Where the subject stands, and its blocks in each photograph. None where all masks are given."""
    foregrounds: Mapping[str, Product[Foreground]]
    """Camera → which of its pixels show the subject."""
    disparities: Mapping[str, Product[DisparityMap]]
    """Pair → where each left pixel is seen on the right."""
    rows: Mapping[str, Product[RowErrors]]
    """Pair → its vertical disparity, summed up."""
    pairs: tuple[tuple[str, str, str], ...]
    """Name, left and right camera of each pair."""

    def ensure(self, beside: Executor | None = None) -> list[Future[None]]:
        """Make everything the memo lacks, pair by pair on two cores each.

        Pair by pair, few pictures are held in memory.
        """
        if any(product.missing for product in self.products()):
            self.names()

        def one(pair: str, left: str, right: str) -> None:
            made: tuple[Product[Any], ...] = (
                self.disparities[pair],
                self.rows[pair],  # while the disparities are still in memory
                self.foregrounds[left],
                self.foregrounds[right],
            )
            for product in made:
                product.ensure()
            for product in made:
                product.release()  # large, and read back in a moment where wanted

        side_by_side((partial(one, *pair) for pair in self.pairs), threads=2)
        for product in self.foregrounds.values():  # of cameras that are in no pair
            product.ensure()
        return []


def match(inputs: Inputs, cameras: Product[CameraSet], settings: MatchSettings, memo: Memo) -> Matched:
    """Compare names, find the subject in every photograph, then match all pairs densely. Paper 2.3."""
    names = right_names(inputs, cameras)
    photographs, subjects, foregrounds = find_subjects(inputs, cameras, settings, memo)

    def disparity(pair: str, left: str, right: str) -> Product[DisparityMap]:
        def resample(
            cameras: CameraSet,
            photographs: Mapping[str, Photograph],
            foregrounds: Mapping[str, Foreground],
            subjects: Subjects | None,
            *,
            progress: Progress,
        ) -> RectifiedPair:
            from mammometry.matching.rectify import rectify

            return rectify(
                cameras.rig.pair(pair),
                photographs[left],
                photographs[right],
                foregrounds[left],
                foregrounds[right],
                settings.rectify,
                middle_world=None if subjects is None else subjects.middle_world,
            )

        def matched(rectified: RectifiedPair, *, progress: Progress) -> DisparityMap:
            from mammometry.matching.dense.match import match

            return match(rectified, settings, progress=progress)

        rectified: Product[RectifiedPair] = Product(
            None,
            "match",
            f"rectified/{pair}",
            resample,
            parents={
                "cameras": cameras,
                # The photographs come first: the foregrounds are then made of the same ones, each decoded once.
                "photographs": {camera: photographs[camera] for camera in (left, right)},
                "foregrounds": {camera: foregrounds[camera] for camera in (left, right)},
                "subjects": subjects,
            },
        )
        parents = {"rectified": rectified}
        return Product(memo, "match", f"disparity/{pair}", matched, parents=parents, settings=settings)

    disparities = {pair: disparity(pair, left, right) for pair, (left, right) in inputs.pair_names.items()}
    rows = rows_of(disparities, memo)
    pairs = tuple((pair, left, right) for pair, (left, right) in inputs.pair_names.items())
    return Matched(
        names=names, subjects=subjects, foregrounds=foregrounds, disparities=disparities, rows=rows, pairs=pairs
    )


# --- 2.4 to 2.6 Surface ----------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Surfaced(Products):
    """Plan of the surface."""

    side_by_side: ClassVar[tuple[tuple[str, ...], ...]] = (("ranges",), ("model", "mesh"))
    late: ClassVar[tuple[str, ...]] = ("model",)

    ranges: Mapping[str, Product[RangeImage]]
    """Pair → its range image, with the cameras as calibrated."""
    stillness: Product[Stillness]
    """What moved since the calibration."""
    cameras: Product[CameraSet]
    """The cameras where they most probably stood: as calibrated, if nothing moved."""
    kept: Product[Kept]
    """Which range data survived the removal of dents."""
    valid: Product[ValidPatches]
    """Those data: made from the range images when wanted, never stored."""
    blocked: Product[Mapping[str, Blocked]]
    """Camera → places with something in front of the subject, for cameras that have such places."""
    first: Product[TriangleMesh]
    repaired: Product[RepairedSurface]
    mesh: Product[FinishedSurface]
    model: Product[Atlas]
    """For looking: fewer triangles, the photographs at full resolution."""


def surface(
    inputs: Inputs, calibrated: Calibrated, matched: Matched, settings: SurfaceSettings, memo: Memo
) -> Surfaced:
    """Triangulate, remove dents, extract, repair and colour the surface. Paper 2.4 to 2.6."""
    extraction = settings.extract.of(inputs.subject_kind)

    def ranged(pair: str) -> Product[RangeImage]:
        def triangulate(disparity: DisparityMap, *, progress: Progress) -> RangeImage:
            from mammometry.surface.ranges import range_image

            return range_image.triangulate(disparity, settings.triangulate)

        disparity = matched.disparities[pair]
        return Product(
            memo,
            "surface",
            f"range/{pair}",
            triangulate,
            parents={"disparity": disparity},
            settings=settings.triangulate,
        ).letting_go(disparity)

    def find_blocked(
        cameras: CameraSet, valid: ValidPatches, foregrounds: Mapping[str, Foreground], *, progress: Progress
    ) -> Mapping[str, Blocked]:
        from mammometry.surface.occlusion import occlusion as occluders

        return occluders.find_blocked(valid.range_images, foregrounds, cameras.rig)

    def enclose(
        cameras: CameraSet,
        valid: ValidPatches,
        foregrounds: Mapping[str, Foreground],
        blocked: Mapping[str, Blocked],
        *,
        progress: Progress,
    ) -> Solid | None:
        from mammometry.surface.fusion import fuse as extract
        from mammometry.surface.occlusion import occlusion as occluders

        if inputs.subject_kind == "surface":
            return None
        opened = occluders.unblocked(foregrounds, blocked)
        return extract.solid_of(valid.range_images, opened, cameras.rig, extraction)

    def build(valid: ValidPatches, solid: Solid | None, *, progress: Progress) -> TriangleMesh:
        from mammometry.surface.fusion import fuse as extract

        if solid is None:
            return extract.extract_open(valid.range_images, extraction, progress=progress)
        return extract.meshed(solid, extraction, progress=progress)

    def mend(first: TriangleMesh, valid: ValidPatches, *, progress: Progress) -> RepairedSurface:
        from mammometry.surface.repair import repair

        if inputs.subject_kind == "surface":
            return repair.as_measured(first, valid)
        return repair.repair(first, valid, settings.repair, progress=progress)

    def paint(cameras: CameraSet, repaired: RepairedSurface, *, progress: Progress) -> FinishedSurface:
        from mammometry.surface.texture import texture

        textured = texture.paint(repaired.mesh, inputs.photographs, cameras.rig, settings.texture)
        return FinishedSurface(repaired=repaired, textured=textured)

    def cover(cameras: CameraSet, repaired: RepairedSurface, *, progress: Progress) -> Atlas:
        from mammometry.surface.texture import atlas_jpeg, unmeasured
        from mammometry.surface.texture import texture_atlas as atlas

        covered = atlas.cover(repaired.mesh, inputs.photographs, cameras.rig, settings.texture, progress=progress)
        return atlas_jpeg.as_jpeg(unmeasured.faded_atlas(covered, repaired))

    ranges = {pair: ranged(pair) for pair in matched.disparities}
    stillness = what_moved(calibrated.cameras, calibrated.calibration, ranges, matched.rows, settings.stillness, memo)
    cameras = where_they_stood(calibrated.cameras, stillness, memo)
    given = {"subject": inputs.digests["subject"]}
    kept, valid = kept_data(inputs, calibrated.cameras, stillness, ranges, matched.subjects, settings, memo)
    seen: dict[str, Parent] = {"cameras": cameras, "valid": valid, "foregrounds": matched.foregrounds}
    blocked: Product[Mapping[str, Blocked]] = Product(memo, "surface", "blocked", find_blocked, parents=seen)
    solid: Product[Solid | None] = Product(
        None, "surface", "solid", enclose, parents={**seen, "blocked": blocked}
    ).letting_go(*matched.foregrounds.values())
    body: dict[str, Parent] = {"valid": valid, "solid": solid}
    first: Product[TriangleMesh] = Product(
        memo, "surface", "first", build, parents=body, settings=extraction, inputs=given
    )
    repaired: Product[RepairedSurface] = Product(
        memo, "surface", "repaired", mend, parents={"first": first, "valid": valid}, settings=settings.repair
    ).letting_go(first, valid)
    coloured: dict[str, Parent] = {"cameras": cameras, "repaired": repaired}
    shots = {f"capture/{camera}": inputs.digests[f"capture/{camera}"] for camera in inputs.photographs}
    mesh: Product[FinishedSurface] = Product(
        memo, "surface", "mesh", paint, parents=coloured, settings=settings.texture, inputs=shots
    )
    model: Product[Atlas] = Product(
        memo, "surface", "model", cover, parents=coloured, settings=settings.texture, inputs=shots
    )
    return Surfaced(
        ranges=ranges,
        stillness=stillness,
        cameras=cameras,
        kept=kept,
        valid=valid,
        blocked=blocked,
        first=first,
        repaired=repaired,
        mesh=mesh,
        model=model,
    )


# --- All of it -------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Plan:
    """Every product of the main job, not yet made."""

    calibrated: Calibrated
    matched: Matched
    surfaced: Surfaced
    measured: Measured

    @property
    def stages(self) -> dict[Stage, Products]:
        """Plans of the stages, in the order of making."""
        return {"calibrate": self.calibrated, "match": self.matched, "surface": self.surfaced, "measure": self.measured}

    def products(self) -> Iterator[Product[Any]]:
        """All products in the order in which they are made."""
        for stage in self.stages.values():
            yield from stage.products()


def plan(inputs: Inputs, settings: Settings, memo: Memo) -> Plan:
    """Lay out the whole job: calibrate, match, build the surface, measure."""
    calibrated = calibrate(inputs, settings.calibration, memo)
    matched = match(inputs, calibrated.cameras, settings.matching, memo)
    surfaced = surface(inputs, calibrated, matched, settings.surface, memo)
    upstream = Upstream(
        cameras=surfaced.cameras,
        calibration=calibrated.calibration,
        stillness=surfaced.stillness,
        foregrounds=matched.foregrounds,
        valid=surfaced.valid,
        mesh=surfaced.mesh,
        repaired=surfaced.repaired,
    )
    measured = measure(inputs, upstream, settings.measure, memo)
    return Plan(calibrated=calibrated, matched=matched, surfaced=surfaced, measured=measured)


class _OnePose(Mapping[tuple[str, str], Photograph]):
    """The part of the lazily read calibration photographs that shows one pose."""

    def __init__(self, photographs: Mapping[tuple[str, str], Photograph], pose: str) -> None:
        self._photographs = photographs
        self._keys = tuple(key for key in photographs if key[0] == pose)

    def __getitem__(self, key: tuple[str, str]) -> Photograph:
        return self._photographs[key]

    def __iter__(self) -> Iterator[tuple[str, str]]:
        return iter(self._keys)

    def __len__(self) -> int:
        return len(self._keys)
