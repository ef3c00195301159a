"""The main job, which `api.job.open_session` opens: run stages, read values."""

from __future__ import annotations

import datetime
import os
import re
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

from mammometry.api.previews import Previews, PreviewTasks
from mammometry.api.results import Results, is_refusal_shown, seen, show_refusal, withdraw_refusal
from mammometry.api.stored_report import Reported
from mammometry.base.errors import (
    CalibrationError,
    MammometryError,
    MatchingError,
    MeasureError,
    SessionError,
    SurfaceError,
)
from mammometry.base.machine.cores import one_blas_thread
from mammometry.base.machine.system import peak_memory_mb, reuse_freed_memory
from mammometry.base.notices import Notice, words_of
from mammometry.base.progress import Progress, no_progress
from mammometry.geometry.arrays import Array, Float64
from mammometry.geometry.camera import Rig
from mammometry.io.looked_up import shared
from mammometry.io.outputs import require_apart, require_free, write_output
from mammometry.io.results.store import State, Store, Watch, unwatched
from mammometry.io.session import Session
from mammometry.job.graph import Background, Method, Plan
from mammometry.job.inputs import CameraSet, FinishedSurface
from mammometry.job.method import method
from mammometry.job.products import NONE_GIVEN, STAGES, Given, Key, Stage
from mammometry.job.stages import calibrate, match, measure, surface
from mammometry.job.stages.report import PageInputs, previews_key
from mammometry.report.words.doubts import torso_notices
from mammometry.settings import Settings

if TYPE_CHECKING:
    from mammometry.calibration.adjust.calibrated import Calibration
    from mammometry.calibration.judge.check import RigCheck
    from mammometry.matching.dense.match import DisparityMap
    from mammometry.measure.volume.measurement import VolumeDeficit, VolumeMeasurement
    from mammometry.report.content import ReportContent
    from mammometry.report.privacy import Privacy
    from mammometry.report.scene import ViewerScene
    from mammometry.report.words.stage_facts import Facts

_DRAWN = STAGES[:-1]  # stages with previews
_HEAD = 4096  # first characters of a page, which contain its key
_PAGE_KEY = re.compile(r'<meta name="mammometry-key" content="([0-9a-f,]+)">')


class Job(Reported):
    """The main job on one folder. Current results are read from disk.

    A session has photographs. `api.mesh.MeshJob` is the job on a scan, whose surface is given.
    """

    stages: tuple[Stage, ...] = STAGES
    """Stages in order."""
    world = ""
    """Frame of a given surface, as text. Empty: that of the cameras."""
    notices: tuple[Notice, ...] = ()
    """Changes of a scanner's mesh, and assumptions."""
    merged: tuple[Mapping[str, Any], ...] = ()
    """Further scans that were merged with the first one, as `AlsoScan.as_table`."""
    posture: str
    """``standing``, ``leaning`` or ``lying``. Empty: not given."""
    date: datetime.date | None
    """Date of the photographs. None: not given."""
    brought: tuple[Path, ...]
    """The user's own files and folders."""

    def __init__(
        self,
        session: Session,
        settings: Settings,
        watch: Watch = unwatched,
        *,
        method: Method = method,
        given: Given = NONE_GIVEN,
    ) -> None:
        self._session = replace(session, limits=settings.limits)
        self.identity, self.folder = session.identity, session.path
        self.posture, self.date = session.manifest.subject.patient_posture, session.manifest.date
        self.brought = session.brought
        self.settings = settings
        self.store = Store(session.results, watch, session.manifest.subject.id)
        self.inputs = self.session.inputs()
        self.plan = Plan(method, self.inputs, settings, self.store, given=given)
        """Every product, computed or read back when called: ``job.plan[match.disparity]["front"]()``."""
        self.stage_seconds: dict[str, float] = {}
        self._previews = Previews(
            session=self.session, settings=settings, inputs=self.inputs, plan=self.plan, store=self.store
        )

    @property
    def session(self) -> Session:
        """The photographs.

        Raises:
            SessionError: the folder is a scan, which has none.
        """
        return self._session

    @property
    def rig(self) -> Rig:
        """The cameras at their positions during the exposures, or the viewer of a scan."""
        return self.plan[calibrate.cameras]().rig

    @property
    def pictures(self) -> frozenset[str]:
        """Digests of the photographs, or of the mesh."""
        names = [f"capture/{camera}" for camera in self.inputs.photographs] or ["mesh"]
        return frozenset(self.inputs.digests[name] for name in names)

    @property
    def has_own_scale(self) -> bool:
        """Whether the scale comes from the session's own target."""
        return "target" in self.inputs.digests and self.inputs.cameras is None

    def frame(self) -> Float64[Array, "3 3"]:
        """Rows: the patient's left, the head, straight ahead. World frame."""
        from mammometry.report.figures.shading import front_of

        return front_of(self.rig, self.plan.value(measure.body))

    def require_sides(self) -> None:
        """Raise an error if a scan may be a mirror image, before it is exported or compared.

        Raises:
            SessionError: its sides have not been compared with the patient.
        """

    def ensure(self, stage: Stage, *, drawn: bool = True) -> None:
        """Compute a stage and those before it, unless they are current.

        Args:
            stage: the last stage.
            drawn: whether to draw their previews, and pictures of a refusal. The report needs them.

        Raises:
            MammometryError: a stage refuses.
        """
        self.session.require(stage)
        stages = STAGES[: STAGES.index(stage) + 1]
        if drawn and not self.store.at_work and self._all_current(stages):
            return  # works also in a read-only folder
        reuse_freed_memory()
        with (
            self.store.taken(),
            one_blas_thread(),
            shared(self.inputs.photographs),
            self._previews.drawing(stages if drawn else ()) as drawing,
            Background() as background,
        ):
            for current in stages:
                begun = time.monotonic()
                if current == "report":
                    background.wait()
                    self._ensure_report(drawing)
                else:
                    self._ensure_stage(current, drawing if drawn else None, background)
                self.stage_seconds[current] = self.stage_seconds.get(current, 0.0) + time.monotonic() - begun
            background.wait()
            if stage in ("measure", "report"):
                withdraw_refusal(self.store.folder)

    def _all_current(self, stages: Sequence[Stage]) -> bool:
        keys = [key for stage in stages for key in self.keys(stage)]
        keys += [self.report_key] if "report" in stages else []
        refused = stages[-1] in ("measure", "report") and is_refusal_shown(self.store.folder)
        return not refused and self.store.all_current(keys)

    def _ensure_stage(self, stage: Stage, drawing: PreviewTasks | None, background: Background) -> None:
        try:
            self.plan.ensure(stage, background)
        except (CalibrationError, MatchingError, SurfaceError, MeasureError) as error:
            if drawing is not None:
                show_refusal(self.store.folder, self.identity, error, partial(self._seen, stage, error, drawing))
            raise
        if drawing is not None:
            drawing.begin(stage)

    def _seen(self, stage: Stage, error: MammometryError, drawing: PreviewTasks) -> Mapping[str, bytes]:
        drawing.facts()  # waits for all started pictures
        return seen(stage, error, self.plan, self.inputs, self.previews)

    def calibrate(self) -> CameraSet:
        """Calibrate the rig, or use the given cameras."""
        self.ensure("calibrate")
        return self.plan[calibrate.cameras]()

    def calibration(self) -> Calibration | None:
        """Residuals, covariance and target placements. None for given cameras."""
        self.ensure("calibrate")
        return self.plan.value(calibrate.calibration)

    def check(self, image_set: Path | str, *, progress: Progress = no_progress) -> RigCheck:
        """Compare a later exposure of the target with the calibration.

        The result is added to the session's history of checks.

        Args:
            image_set: folder with the exposure's photographs, ``<camera>.<ext>``, or with several such folders.
            progress: called with the fraction of the photographs that were searched.

        Raises:
            MammometryError: the first error; also if photographs are those of the calibration itself, of an earlier
                check in another folder, or older than the calibration by their time stamps.
        """
        from mammometry.api.exposures import require_later
        from mammometry.calibration.detection.detect import detect
        from mammometry.calibration.judge import check
        from mammometry.io import drift
        from mammometry.report.figures.calibration import drift as drawn

        folder = self.session.path / drift.FOLDER
        require_apart(folder, [Path(image_set)])
        require_free(folder, [drift.DRAWN], command="check")
        photographs, measured = self.session.image_set(Path(image_set))
        target = self.inputs.target
        if target is None:
            remedy = "Describe it as `mammometry new` shows"
            expected = "a description of the target of that exposure"
            raise SessionError("session.toml", found="no [target]", expected=expected, remedy=remedy)
        self.ensure("calibrate")
        digest = self.plan[calibrate.cameras].key.digest[:12]
        earlier = (entry for entry in drift.read_history(self.session.path).entries if entry.calibration == digest)
        calibrated = self.session.calibration_files() if self.inputs.calibrates else {}
        paths = self.session.image_set_files(Path(image_set))
        files = {shot: path for shot, path in paths.items() if shot not in measured}  # otherwise the table counts
        pixels = require_later(Path(image_set), files, photographs, calibrated, earlier)
        calibration = self.calibration()
        reference = (
            check.Reference.of_cameras(self.plan[calibrate.cameras]().rig, target)
            if calibration is None
            else check.Reference.of(calibration)
        )
        settings = self.settings.calibration
        with one_blas_thread():
            seen = detect(photographs, target, measured=measured, progress=progress)
            result = check.check(reference, seen, settings.check)
        drift.append_history(
            self.session.path,
            drift.entry_of(
                result,
                when=datetime.datetime.now().astimezone().isoformat(timespec="seconds"),
                image_set=str(image_set),
                calibration=digest,
                photographs=pixels,
            ),
        )
        history = drift.read_history(self.session.path).entries
        write_output(folder / drift.DRAWN, drawn(history, settings.check.refuse_mm), command="check")
        return result

    def match(self) -> dict[str, DisparityMap]:
        """Pair → disparity map."""
        self.ensure("match")
        return {pair: product() for pair, product in self.plan[match.disparity].items()}

    def surface(self) -> FinishedSurface:
        """The repaired surface with its colours."""
        self.ensure("surface")
        return self.plan[surface.mesh]()

    def measure(self) -> dict[str, VolumeMeasurement]:
        """Side or ``model`` → volume. Empty for an open surface."""
        self.ensure("measure")
        return {measured.name: measured for measured in self.plan.value(measure.measurements) or ()}

    def no_breast(self) -> dict[str, str]:
        """Side of a torso without a volume → reason: no breast, unclear or refused."""
        self.ensure("measure")
        return {side.name: words_of(side.reason) for side in self.plan.value(measure.absent) or ()}

    def lacking(self) -> tuple[VolumeDeficit, ...]:
        """Volume deficit of the smaller side of a torso relative to the mirrored larger one."""
        self.ensure("measure")
        return self.plan.value(measure.lacking) or ()

    def report(self) -> Path:
        """Write the report and return its page."""
        self.ensure("report")
        return self.page

    def run(self, *, report: bool = True) -> Results:
        """Calibrate, match, build the surface, measure, report. Current results are not computed again.

        Args:
            report: whether to write the report.

        Raises:
            MammometryError: a stage refuses.
        """
        begun, before = time.monotonic(), len(self.store.made)
        self.stage_seconds.clear()
        last: Stage = "report" if report else "measure"
        self.ensure(last)
        measurements = self.measure()
        return Results(
            measurements=measurements,
            watertight=bool(measurements) and all(measured.watertight for measured in measurements.values()),
            seconds=time.monotonic() - begun,
            stage_seconds=dict(self.stage_seconds),
            peak_memory_mb=peak_memory_mb(),
            world=self.world or self.plan[calibrate.cameras]().world,
            folder=self.store.folder,
            report=self.page if report else None,
            no_breast=self.no_breast(),
            lacking={side.name: side for side in self.lacking()},
            notices=(*self.notices, *torso_notices(self.plan, self._posture_noted)),
            merged=self.merged,
            made=tuple(self.store.made[before:]),
            made_at=self.made_at(last),
        )

    @property
    def _posture_noted(self) -> str | None:
        """Posture for `torso_notices`."""
        return self.posture or None

    def pages(self) -> dict[str, State]:
        """Report for others, or comparison of two dates, in results/ → its state."""
        folder = self.store.folder
        here = {self.page_digest(deidentify=deidentify) for deidentify in (False, True)}
        paths = sorted([*folder.glob("*/report.html"), *folder.glob("compare/*/compare.html")])
        return {
            page.relative_to(folder).as_posix(): "current" if here & _keys_in(page) else "stale"
            for page in paths
            if page != self.page
        }

    @property
    def _page_inputs(self) -> PageInputs:
        return PageInputs(
            identity=self.identity,
            settings=self.settings,
            stage_seconds=self._all_seconds(),
            posture=self.posture,
        )

    def _photographs(self) -> Mapping[str, str]:
        if not self.inputs.photographs:
            return {}
        here = self.page.parent
        return {
            name: quote(os.fsencode(os.path.relpath(path, here)))
            for name, path in self.session.files().items()
            if name.startswith(("capture/", "calibration/"))
        }

    def keys(self, stage: Stage) -> tuple[Key, ...]:
        """Keys of a stage's products and pictures, or of the report's content."""
        if stage == "report":
            return (self.content_key,)
        return (*(product.key for product in self.plan.products(stage)), previews_key(stage, self.plan))

    def made_at(self, stage: Stage) -> str | None:
        """Time of the newest result up to a stage, ISO 8601, UTC."""
        stages = self.stages[: self.stages.index(stage) + 1]
        return self.store.made_at([key for earlier in stages for key in self.keys(earlier)])

    def share(self, folder: Path, privacy: Privacy) -> Path:
        """Write a report for others into a folder, and return its page.

        Files of an earlier call are replaced; other files in the way are refused before anything is computed.

        Args:
            folder: folder for report.html and report.pdf.
            privacy: what to leave out.

        Raises:
            MammometryError: a stage refuses.
        """

        def gather() -> ReportContent:
            self.ensure("measure")
            with one_blas_thread():
                return self._report_content(privacy)

        return self._write_for_others(folder, privacy, gather, self.brought)

    def _ensure_report(self, drawing: PreviewTasks) -> None:
        scene = None
        if drawing.waiting:  # meanwhile, compute products that do not need the last pictures
            from mammometry.report import gather

            scene = gather.whole_scene(self.plan)
        facts = drawing.facts()

        def gathered(progress: Progress) -> ReportContent:
            from mammometry.report.privacy import Privacy

            return self._report_content(Privacy(), progress, facts, scene)

        self._write_report(gathered)

    def _report_content(
        self,
        privacy: Privacy,
        progress: Progress = no_progress,
        facts: Mapping[Stage, Facts] = MappingProxyType({}),
        scene: ViewerScene | None = None,
    ) -> ReportContent:
        from mammometry.report import gather
        from mammometry.report.words.stage_facts import DrawnStages

        return gather.gather(
            self.plan,
            self.inputs,
            self._page_inputs,
            DrawnStages(pictures={stage: self.previews(stage) for stage in _DRAWN}, facts=facts, scene=scene),
            privacy=privacy,
            progress=progress,
        )

    def _all_seconds(self) -> dict[str, float]:
        """Seconds of each stage, in this run or an earlier one."""
        seconds: dict[str, float] = {}
        for stage in _DRAWN:
            records = [self.store.record(key) for key in self.keys(stage)]
            seconds[stage] = round(sum(record.seconds for record in records if record is not None), 1)
        return seconds

    def previews(self, stage: Stage) -> dict[str, bytes]:
        """PNG previews of a finished stage: name → file content.

        Raises:
            StorageError: one is damaged or not a picture.
        """
        return self._previews.files(stage)


def _keys_in(page: Path) -> set[str]:
    """Digests in a page's head. Empty for pages of earlier versions."""
    with page.open(encoding="utf-8", errors="replace") as file:
        match = _PAGE_KEY.search(file.read(_HEAD))
    return set(match[1].split(",")) if match else set()
