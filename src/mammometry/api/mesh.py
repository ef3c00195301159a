"""Measurement of a scanner's mesh, with the boundaries, walls, interval and report of a session.

::

    from mammometry.api.mesh import MeshFiles, MeshJob

    job = MeshJob(MeshFiles(mesh=Path("scan.obj"), units="mm", boundary=Path("b.json")), Path("out"))
    print(job.run().volumes_cc)
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, nullcontext
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from mammometry.api.mesh_inputs import copies_of, inputs_of
from mammometry.api.previews import load
from mammometry.api.results import is_refusal_shown, show_refusal, withdraw_refusal
from mammometry.api.session_job import Job
from mammometry.base.child_process import CallCancelledError, CallError, ChildProcess
from mammometry.base.errors import MammometryError, MeasureError, SessionError
from mammometry.base.identity import Identity
from mammometry.base.machine.cores import available_cores, one_blas_thread
from mammometry.base.notices import Notice
from mammometry.base.notices.words import maybe_words
from mammometry.base.progress import Progress, no_progress
from mammometry.geometry import Array, Float64, Rig, TriangleMesh
from mammometry.geometry.nearest import barycentric, closest_on_mesh
from mammometry.io.drawn import (
    BOUNDARIES,
    LANDMARK_FILE,
    DrawnBoundaries,
    boundaries_in,
    landmarks_in,
)
from mammometry.io.meshes.foreign import ForeignMesh, read_foreign, unit_notice
from mammometry.io.meshes.measured import MeshFiles, describe, has_own_folder, with_edits, without_photographs
from mammometry.io.meshes.merged import merge_scans, sigma_mm, stored_sources
from mammometry.io.meshes.scans import skin_colours
from mammometry.io.outputs import require_apart, require_own_folder, take_folder
from mammometry.io.results.store import Store, Watch, unwatched
from mammometry.io.session import Session
from mammometry.io.subject import check_mesh
from mammometry.job.graph import Method, Plan
from mammometry.job.inputs import CameraSet, FinishedSurface, Inputs, SubjectKind
from mammometry.job.method import method
from mammometry.job.products import NONE_GIVEN, Given, Key, Stage, at_hand
from mammometry.job.stages import calibrate, measure, surface
from mammometry.job.stages.report import PageInputs
from mammometry.measure.landmarks.landmarks import PICKED_SIGMA_MM
from mammometry.settings import Settings

if TYPE_CHECKING:
    from mammometry.report.content import ReportContent, ReportPicture
    from mammometry.report.privacy import Privacy
    from mammometry.report.scene import ViewerScene
    from mammometry.report.words.stage_facts import Facts
    from mammometry.surface.repair.repair import RepairedSurface


__all__ = ["MeshFiles", "MeshJob"]
T = TypeVar("T")
_NAMES = ("model", "left", "right")
_COMMAND = "measure"
_LOG = logging.getLogger(__name__)
_LEAST_FACES = 10_000  # fewest faces for a second process for drawing, which takes one processor second to start
_DENSE = 300_000  # faces from which vertex colours are fine enough for a page
_DARK, _LIGHT = 70.0, 160.0  # 8-bit grey of a colourless mesh without light, and added by full light; for display only
WORLD = "The mesh file's own frame, in mm."


class MeshJob(Job):
    """The job on a mesh. Current results in the folder are not computed again."""

    stages = ("measure", "report")
    world = WORLD
    date = None

    def __init__(
        self,
        files: MeshFiles,
        folder: Path,
        settings: Settings | None = None,
        *,
        watch: Watch = unwatched,
        edited: bool = True,
        method: Method = method,
        given: Given = NONE_GIVEN,
    ) -> None:
        """Read the mesh and its files.

        Args:
            files: the mesh and its drawings.
            folder: folder for the results, with the layout of a session's.
            settings: settings of the measurement; None for the recommended ones.
            watch: called for each product that is computed.
            edited: whether to include boundaries and landmarks that were drawn in the folder.
            method: plans the products, as for `api.job.open_session`.
            given: product of the method → another function that computes it.

        Raises:
            StorageError: the folder contains one of the files, or other results.
            SessionError: a file is missing, unreadable, or not as documented; the unit is unknown; a drawing or an
                earlier result is of another subject.
            MeasureError: the mesh cannot be measured, the boundary is not on it, or a landmark is off it or on the
                wrong side.
        """
        self._assumed: Notice | None = None
        self._method, self._given = method, given
        try:
            self._open(files, folder, settings or Settings(), watch, edited=edited)
        except MammometryError as error:
            raise (error.of_mesh() if isinstance(error, MeasureError) else error).with_remark(
                maybe_words(self._assumed)
            ) from None

    def _open(self, files: MeshFiles, folder: Path, settings: Settings, watch: Watch, *, edited: bool) -> None:
        from mammometry.measure import scanned
        from mammometry.measure.boundary.trace import check_curve
        from mammometry.measure.landmarks.landmarks import picked_landmarks
        from mammometry.measure.scan_repair import repair_scan

        given = (files.boundary, files.landmarks)
        apart = [path for path in given if path not in (folder / BOUNDARIES, folder / LANDMARK_FILE)]
        require_apart(folder, (files.mesh, *files.also, *apart, files.back))
        require_own_folder(folder, command=_COMMAND)
        self._described = has_own_folder(files, folder)
        if self._described and edited:
            files = with_edits(files, folder)
        check_mesh(files.mesh, (files.boundary, files.landmarks), folder, files.subject)
        drawn = DrawnBoundaries() if files.boundary is None else boundaries_in(files.boundary, _NAMES)
        of_torso = "model" not in drawn.curves
        foreign = read_foreign(files.mesh, files.units, of_torso=of_torso)
        self._assumed = foreign.assumed if files.scan is None else unit_notice(files.scan.units)
        if files.boundary is None and files.landmarks is None and not files.automatic:
            remedy = "Add --boundary b.json, or --landmarks l.json with the protocol's landmarks, or --automatic"
            expected = "the boundary of the breast on this mesh"
            raise SessionError(
                str(files.mesh), found="neither a boundary nor landmarks", expected=expected, remedy=remedy
            )
        if given[0] is not None and given[0] in apart and files.automatic and files.scan is None:
            remedy = "Leave out --boundary or --automatic"
            expected = "one of the two"
            raise SessionError(
                str(files.boundary), found="a boundary file together with --automatic", expected=expected, remedy=remedy
            )
        merged = None
        if files.also:
            others = [(path, read_foreign(path, files.units, of_torso=of_torso)) for path in files.also]
            merged = merge_scans(foreign, others, largest=files.largest, of_torso=of_torso)
            foreign = merged.foreign
        self.stage_seconds = {}
        self.also = merged.also if merged is not None else files.scan.also if files.scan is not None else ()
        own = replace(settings.measure, surface_sigma_mm=float(np.hypot(files.surface_std_mm, sigma_mm(self.also))))
        if given[0] is None and not files.automatic:
            own = replace(own, boundary="landmarks")
        self.settings = replace(settings, measure=own)
        self.files = files
        self.folder, self.brought = folder if self._described else files.mesh.parent, (files.mesh,)
        self.identity = Identity.of(files.mesh if files.scan is None else files.mesh.parent, files.subject)
        self.store: Store = _StoreOfMesh(folder, watch, files.subject)
        self.units = foreign.units if files.scan is None else files.scan.units
        self.posture = files.posture or ("" if files.scan is None else files.scan.posture)
        self.scanner = "" if files.scan is None else files.scan.scanner
        if drawn.automatic and not files.automatic:
            raise SessionError(
                f"{files.boundary}: {drawn.automatic[0]}",
                found="a boundary to be found automatically",
                expected="the points of each boundary: nothing is found automatically on a mesh",
                remedy="Draw it, or take it out of the file",
            )
        curves = drawn.curves
        if "model" in curves and len(curves) > 1:
            remedy = "Name the patient's own sides"
            expected = "model alone, or left and right"
            raise SessionError(
                str(files.boundary), found=f"boundaries {', '.join(curves)}", expected=expected, remedy=remedy
            )
        self.kind: SubjectKind = "model" if "model" in curves else "torso"
        places = {} if files.landmarks is None else landmarks_in(files.landmarks, self.kind)
        self.merged = tuple(also.as_table() for also in self.also)
        scan = repair_scan(foreign.mesh, largest=files.largest, skin_alone=self.kind == "torso")
        by_axes = self.kind == "torso" and (files.automatic or files.head is not None)
        frame = self._frame_from_axes(scan.mesh, files) if by_axes else None
        if frame is not None:
            scan, frame = scanned.own_front(scan, frame)
        checked = files.sides_checked or (files.scan is not None and bool(files.scan.sides))
        self.sides_doubtful = self.kind == "torso" and scan.inside_out and not checked
        of_file = foreign.notices if files.scan is None else files.scan.notices or filter(None, [self._assumed])
        self.notices: tuple[Notice, ...] = (
            *([Notice(code="sides-doubtful")] if self.sides_doubtful else []),
            *of_file,
            *scan.notices,
        )
        mesh = scan.mesh
        curves = {name: scanned.in_mesh_unit(curve, mesh, foreign.mm_per_unit) for name, curve in curves.items()}
        drawn = replace(drawn, curves=curves)
        for name, curve in curves.items():
            check_curve(name, curve, mesh)
        near = [mesh.vertices] if files.automatic else [*curves.values(), *places.values()]
        scan = scanned.finer_scan(scan, near)
        repaired, fine = scanned.as_scanned(scan.mesh, scan.invented, scan.at_fold), scan.mesh
        for name, curve in curves.items():
            if self.kind == "torso":  # a cast is cut at its base, not along the curve
                scanned.check_cut(name, curve, fine)
        if frame is None:
            frame = scanned.viewing_frame(repaired, curves, places)
        middle = np.mean([curve.mean(axis=0) for curve in curves.values()], axis=0) if len(curves) == 2 else None
        sides = frame if self.kind == "torso" else None
        picked_landmarks(places, fine, sides, sigma_mm=PICKED_SIGMA_MM, middle_world=middle)
        self._rig = scanned.viewer(frame, fine)
        self.inputs = inputs_of(files, self.kind, drawn, places)
        self._copies = copies_of(files, drawn)
        by_drawing = {} if self.kind == "torso" and files.automatic else _drawn(self.inputs)
        self._lay_out(repaired, foreign, by_drawing)
        self._sources = None
        if self.also:
            skin = repaired.mesh.vertices
            self._sources = stored_sources(files.mesh, skin) if merged is None else merged.sources_at(skin)

    def _frame_from_axes(self, mesh: TriangleMesh, files: MeshFiles) -> Float64[Array, "3 3"]:
        """Patient's left, head, straight ahead (rows). Where the front is not known, a page shows all sides."""
        from mammometry.measure.scanned import DirectionError, frame_from_axes
        from mammometry.report.figures.refused import directions_seen

        try:
            return frame_from_axes(mesh, files.head, files.ahead)
        except DirectionError as refused:
            take_folder(self.store.folder, command=_COMMAND)
            fronts = refused.fronts
            show_refusal(
                self.store.folder, self.identity, refused, lambda: {"directions": directions_seen(mesh, fronts)}
            )
            raise

    @property
    def session(self) -> Session:
        """Always an error: a mesh has no photographs."""
        raise without_photographs(self.folder)

    @property
    def rig(self) -> Rig:
        """A viewer straight ahead of the patient."""
        return self._rig

    def surface(self) -> FinishedSurface:
        """The surface with its colours."""
        return self.finished

    def _lay_out(self, repaired: RepairedSurface, foreign: ForeignMesh, by_drawing: dict[str, str]) -> None:
        """Plan the measurement as for a session, with the products of earlier stages given.

        Args:
            repaired: the surface to be measured.
            foreign: the mesh with its colours.
            by_drawing: digests of the drawings, if they determine the viewer's position.
        """
        from mammometry.measure.trunk.body import rig_frame
        from mammometry.surface.texture.texture import TexturedMesh

        closest = closest_on_mesh(repaired.mesh.vertices, foreign.mesh)
        faces = foreign.mesh.faces[closest.faces]
        weights = barycentric(closest.points, foreign.mesh.vertices[faces])
        colours = np.einsum("nk,nkj->nj", weights, foreign.colours[faces]).round().clip(0, 255).astype(np.uint8)
        if self.files.scan is not None and len(foreign.mesh.faces) < _DENSE:
            colours = skin_colours(self.files.mesh.parent, self.files.scan, repaired.mesh.vertices, colours)
        if not np.ptp(
            foreign.colours, axis=0
        ).any():  # one colour does not show the shape, so shade it with a light at the viewer
            facing = np.abs(repaired.mesh.vertex_normals() @ rig_frame(self._rig)[2])
            colours = np.repeat((_DARK + _LIGHT * facing[:, None]).astype(np.uint8), 3, axis=1)
        textured = TexturedMesh(mesh=repaired.mesh, colours=colours)
        self.finished = FinishedSurface(repaired=repaired, textured=textured)
        cameras = CameraSet(rig=self._rig, std={}, world=WORLD, rms_px=None)
        digests = {"mesh": self.inputs.digests["mesh"]}
        given = partial(at_hand, stage="surface")
        known: Given = {
            surface.corrected_cameras: given(
                cameras, name="cameras", version=calibrate.cameras.version, inputs={**digests, **by_drawing}
            ),
            surface.repaired: given(repaired, name="repaired", version=surface.repaired.version, inputs=digests),
            surface.mesh: given(self.finished, name="mesh", version=surface.mesh.version, inputs=digests),
        }
        known = {**known, **self._given}
        self.plan = Plan(self._method, self.inputs, self.settings, self.store, stages=("measure",), given=known)

    def require_sides(self) -> None:
        """Raise an error if a scan may be a mirror image, before it is exported or compared.

        Raises:
            SessionError: its sides have not been compared with the patient.
        """
        if self.sides_doubtful:
            raise SessionError(
                str(self.files.mesh), found="a scan that may be a mirror image",
                expected="left and right as on the patient",
                remedy="Compare a mole, the operated side or a tattoo, and then measure it with --sides-checked",
            )  # fmt: skip

    def ensure(self, stage: Stage, *, drawn: bool = True) -> None:
        """Measure, and write the report, if they are not current.

        Args:
            stage: ``measure`` or ``report``.
            drawn: whether to draw pictures of a refusal.

        Raises:
            SessionError: another stage, which needs photographs.
            MammometryError: the first error.
        """
        if stage not in self.stages:
            raise without_photographs(self.folder)
        report, begun = stage == "report", time.monotonic()
        take_folder(self.store.folder, command=_COMMAND)
        if self._described:
            describe(self.store.folder, self.files, self._copies)
        beside = report and len(self.finished.repaired.mesh.faces) >= _LEAST_FACES and available_cores() > 1
        pages = [self.content_key, self.report_key] if report else []
        current = self.store.all_current([*self.keys("measure"), *pages]) and not is_refusal_shown(self.store.folder)
        with nullcontext() if current else self.store.taken(), one_blas_thread(), ExitStack() as stack:
            begin = None
            if beside and not self.store.has(self.content_key):
                begin = stack.enter_context(self._drawing_beside())
            try:
                self.plan.value(measure.measurements)
                pictures = None if begin is None else begin()
                self.plan.ensure("measure")
            except MeasureError as refused:
                error = refused.with_remark(maybe_words(self._assumed) or f"The unit of the mesh: {self.units}")
                if drawn:
                    show_refusal(self.store.folder, self.identity, error, self._refused)
                raise error from None
            withdraw_refusal(self.store.folder)
            self.stage_seconds["measure"] = time.monotonic() - begun
            if report:
                self._write_report(partial(self._gathered, drawn=pictures))

    def keys(self, stage: Stage) -> tuple[Key, ...]:
        """Keys of a stage's products, or of the report's content. Empty for a stage of photographs."""
        return (self.content_key,) if stage == "report" else tuple(product.key for product in self.plan.products(stage))

    def previews(self, stage: Stage) -> dict[str, bytes]:
        """Always empty: the pictures of a mesh are drawn for the report."""
        return {}

    @contextmanager
    def _drawing_beside(self) -> Iterator[Callable[[], Callable[[], Mapping[str, ReportPicture]]]]:
        """Start a second process for drawing.

        Yields:
            A function that starts drawing after the measurement, and returns one that waits for the pictures.
        """
        from mammometry.report.gather import drawn_mesh, mesh_result

        def draw() -> Mapping[str, ReportPicture]:
            shown = mesh_result(self.plan, self._rig, self.finished.textured, self._sources)
            try:
                return child.call(drawn_mesh, shown)
            except CallCancelledError:
                raise
            except CallError as why:
                _LOG.warning("the pictures are drawn here: %s", why)
                return drawn_mesh(shown)

        def begin() -> Callable[[], Mapping[str, ReportPicture]]:
            drawn = pool.submit(draw)

            def wait() -> Mapping[str, ReportPicture]:
                from mammometry.report.documents import html, pdf  # noqa: F401  # for the pages

                return drawn.result()

            return wait

        with ThreadPoolExecutor(2) as pool, ChildProcess() as child:
            pool.submit(child.call, load)
            yield begin

    def _refused(self) -> Mapping[str, bytes]:
        """Pictures for the page of a refusal: the mesh, and the boundaries that were found."""
        from mammometry.measure.trunk.body import rig_frame
        from mammometry.report.figures.refused import surface_seen

        drawn = surface_seen(
            self.finished,
            rig_frame(self._rig),
            self.plan.current(measure.boundaries) or (),
            of_patient=self.kind == "torso",
        )
        return {"surface": drawn}

    def _report_content(
        self,
        privacy: Privacy,
        progress: Progress = no_progress,
        facts: Mapping[Stage, Facts] = MappingProxyType({}),
        scene: ViewerScene | None = None,
    ) -> ReportContent:
        return self._gathered(progress, privacy)

    @property
    def _posture_noted(self) -> str | None:
        return self.posture if self.kind == "torso" else None

    def _gathered(
        self,
        progress: Progress,
        privacy: Privacy | None = None,
        drawn: Callable[[], Mapping[str, ReportPicture]] | None = None,
    ) -> ReportContent:
        from mammometry.report.gather import gather_mesh
        from mammometry.report.words.mesh_facts import MeshOrigin

        origin = MeshOrigin(
            kind=self.kind,
            units=self.units,
            world=WORLD,
            scanner=self.scanner,
            notices=self.notices,
            posture=self.posture,
            sides_doubtful=self.sides_doubtful,
            sources=self._sources,
            also=tuple(scan.words for scan in self.also),
        )
        return gather_mesh(
            self.plan,
            self._rig,
            self._page_inputs,
            origin,
            drawn=drawn,
            privacy=privacy,
            progress=progress,
        )

    def _page_key(self, page: PageInputs) -> Key:
        stated = {"units": self.units, "posture": self.posture, "scanner": self.scanner}
        stated |= {"sides": "doubtful"} if self.sides_doubtful else {}
        return page.key(self.plan.products(), {"mesh": self.inputs.digests["mesh"], **stated})

    @property
    def _page_inputs(self) -> PageInputs:
        return PageInputs(identity=self.identity, settings=self.settings)


def _drawn(inputs: Inputs) -> dict[str, str]:
    """Inputs other than the mesh that determine the viewer's position."""
    return {name: inputs.digests[name] for name in ("boundaries", "landmarks")}


class _StoreOfMesh(Store):
    """Results of a mesh, whose errors have the wording for meshes."""

    def recall(self, key: Key, prepare: Callable[[], Callable[[Progress], T]]) -> T:
        """Recall a product, as `Store.recall` does."""
        try:
            return super().recall(key, prepare)
        except MeasureError as error:
            raise error.of_mesh() from None
