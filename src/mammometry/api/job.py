"""The main job in Python: open a session, run stages, read values.

::

    import mammometry as mm

    job = mm.open_session("SESSION")
    print(job.run().volumes_cc)
"""

from __future__ import annotations

import json
import re
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from datetime import datetime
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from mammometry.api.previews import Drawing, Previews
from mammometry.api.refused import seen, show_refusal, withdraw_refusal
from mammometry.base.cores import one_blas_thread
from mammometry.base.errors import (
    CalibrationError,
    MatchingError,
    MeasureError,
    SessionError,
    SurfaceError,
)
from mammometry.base.identity import NAMELESS, Identity
from mammometry.base.memory import peak_memory_mb, return_freed_arrays
from mammometry.base.progress import Progress, no_progress
from mammometry.geometry.camera import Rig
from mammometry.io.outputs import require_apart, require_free, write_output, write_outputs
from mammometry.io.results.store import State, Store, Watch, unwatched
from mammometry.io.session import Session
from mammometry.io.write import write_text
from mammometry.job.beside import Beside, beside_the_next_stage
from mammometry.job.measuring import Measured
from mammometry.job.pipeline import CameraSet, FinishedSurface, Plan, plan
from mammometry.job.products import STAGES, Key, Product, Stage
from mammometry.report.page_inputs import PageInputs
from mammometry.settings import Settings

if TYPE_CHECKING:
    from mammometry.calibration.adjust.bundle import Calibration
    from mammometry.calibration.judge.check import RigCheck
    from mammometry.matching.match import DisparityMap
    from mammometry.measure.volume.measurement import Lacking, VolumeMeasurement
    from mammometry.report.content import ReportContent
    from mammometry.report.privacy import Privacy
    from mammometry.report.scene import ViewerScene
    from mammometry.report.stage_facts import Facts

WARNINGS = "warnings.json"
"""The report's warnings, for programs: a list of sentences."""
_HEAD = 4096  # characters of a page that hold its key: it stands first in the head
_PAGE_KEY = re.compile(r'<meta name="mammometry-key" content="([0-9a-f,]+)">')


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Results:
    """What a run came to."""

    measurements: Mapping[str, VolumeMeasurement]
    """``model``, or the patient's ``left`` and ``right`` → its volume measurement. Empty for a surface."""
    watertight: bool
    """Whether every measured solid is closed. False for an open surface."""
    seconds: float
    """Wall time, s."""
    stage_seconds: Mapping[str, float]
    """Stage → wall time, s. Almost 0 if its results existed already."""
    peak_memory_mb: float | None
    """Peak memory of the process or a child, MB. None if the system does not report it (Windows)."""
    world: str
    """Which frame the results are in, in words."""
    folder: Path
    """Where the results lie."""
    report: Path | None
    """The report's page. None if it was not wanted."""
    no_breast: Mapping[str, str] = field(default_factory=dict)
    """Side of a torso without a breast → the evidence for that."""
    lacking: Mapping[str, Lacking] = field(default_factory=dict)
    """Side of a torso → what it lacks compared with the mirrored other side."""
    made: tuple[str, ...] = ()
    """``stage/product`` of everything that this run made. Empty if everything existed already."""
    made_at: str | None = None
    """When the newest of the results was made, ISO 8601, UTC."""

    @property
    def volumes_cc(self) -> dict[str, float]:
        """Name → volume, cc."""
        return {name: measured.volume_cc for name, measured in self.measurements.items()}

    @property
    def intervals_cc(self) -> dict[str, tuple[float, float] | None]:
        """Name → 95 % interval, cc. None where none is known."""
        return {name: measured.interval_cc for name, measured in self.measurements.items()}

    def as_table(self) -> dict[str, Any]:
        """All of it as plain data for JSON, as ``--json`` prints it."""
        return {
            "volumes_cc": {name: round(value, 3) for name, value in self.volumes_cc.items()},
            "intervals_cc": {
                name: None if interval is None else [round(bound, 3) for bound in interval]
                for name, interval in self.intervals_cc.items()
            },
            "as_defined_cc": {
                name: None if measured.as_defined_cc is None else [round(bound, 3) for bound in measured.as_defined_cc]
                for name, measured in self.measurements.items()
            },
            "definitions": {
                name: {
                    each.meaning: {
                        "volume_cc": round(each.volume_cc, 3),
                        "interval_cc": [round(bound, 3) for bound in each.interval_cc],
                        "weight_g": round(each.weight_g[0], 1),
                        "weight_half_g": round(each.weight_g[1], 1),
                    }
                    for each in measured.definitions
                }
                for name, measured in self.measurements.items()
            },
            "no_breast": dict(self.no_breast),
            "lacking_cc": {name: round(found.volume_cc, 3) for name, found in self.lacking.items()},
            "lacking_interval_cc": {
                name: None if found.interval_cc is None else [round(bound, 3) for bound in found.interval_cc]
                for name, found in self.lacking.items()
            },
            "watertight": self.watertight,
            "seconds": round(self.seconds, 3),
            "stage_seconds": {stage: round(value, 3) for stage, value in self.stage_seconds.items()},
            "peak_memory_mb": self.peak_memory_mb,
            "world": self.world,
            "results": str(self.folder),
            "report": None if self.report is None else str(self.report),
            "made": list(self.made),
            "made_at": self.made_at,
        }


class Job:
    """The main job on one session, resumed from disk where current."""

    def __init__(self, session: Session, settings: Settings, watch: Watch = unwatched) -> None:
        self.session = replace(session, limits=settings.limits)
        self.settings = settings
        self.store = Store(session.results, watch, session.manifest.subject.id)
        self.inputs = self.session.inputs()
        self.plan: Plan = plan(self.inputs, settings, self.store)
        """Every product, made or recalled when called: ``job.plan.matched.disparities["front"]()``."""
        self.stage_seconds: dict[str, float] = {}
        self._stages = self.plan.stages
        self._previews = Previews(
            session=self.session, settings=settings, inputs=self.inputs, plan=self.plan, store=self.store
        )

    @property
    def identity(self) -> Identity:
        """Whose photographs and results these are: what pages call them."""
        return self.session.identity

    @property
    def folder(self) -> Path:
        """Where boundaries.json and landmarks.json lie."""
        return self.session.path

    @property
    def rig(self) -> Rig:
        """The cameras in their places at the exposures."""
        return self.plan.calibrated.cameras().rig

    @property
    def mesh(self) -> Product[FinishedSurface]:
        """The surface that is measured, with its colours."""
        return self.plan.surfaced.mesh

    @property
    def measured(self) -> Measured:
        """Products of the measurement."""
        return self.plan.measured

    def products(self, stage: Stage) -> tuple[Product[Any], ...]:
        """Products of one stage, without the report, which has its own record."""
        return tuple(self._stages[stage].products()) if stage in self._stages else ()

    def ensure(self, stage: Stage, *, drawn: bool = True) -> None:
        """Make a stage and those before it, where they are not current.

        Args:
            stage: the last one.
            drawn: whether their previews are made, too, and pictures of what a stage refuses. The report needs them.

        Raises:
            MammometryError: whatever stands in the way, in one sentence.
        """
        self.session.require(stage)
        return_freed_arrays()
        stages = STAGES[: STAGES.index(stage) + 1]
        with (
            self.store.taken(),
            one_blas_thread(),
            self._previews.drawing(stages if drawn else ()) as drawing,
            beside_the_next_stage() as beside,
        ):
            for each in stages:
                begun = time.monotonic()
                if each == "report":
                    beside.wait()
                    self._ensure_report(drawing)
                else:
                    self._ensure_stage(each, drawing if drawn else None, beside)
                if each == "match":
                    self.plan.matched.release()  # large, and read back in a moment where wanted
                self.stage_seconds[each] = self.stage_seconds.get(each, 0.0) + time.monotonic() - begun
            beside.wait()
            if stage in ("measure", "report"):
                withdraw_refusal(self.session.results)

    def _ensure_stage(self, stage: Stage, drawing: Drawing | None, beside: Beside) -> None:
        try:
            beside.ensure(self._stages[stage])
        except (CalibrationError, MatchingError, SurfaceError, MeasureError) as error:
            if drawing is not None:
                show_refusal(self.session.results, self.identity, error, partial(self._seen, stage, drawing))
            raise
        if drawing is not None:
            drawing.begin(stage)

    def _seen(self, stage: Stage, drawing: Drawing) -> Mapping[str, bytes]:
        drawing.facts()  # all pictures that were begun are there then
        return seen(stage, self.plan, self.inputs, self.store, self.previews)

    def calibrate(self) -> CameraSet:
        """Calibrate the rig, or take the ready-made cameras."""
        self.ensure("calibrate")
        return self.plan.calibrated.cameras()

    def calibration(self) -> Calibration | None:
        """Residuals, covariance and target placements. None where the cameras came ready-made."""
        self.ensure("calibrate")
        return None if self.plan.calibrated.calibration is None else self.plan.calibrated.calibration()

    def check(self, image_set: Path | str, *, progress: Progress = no_progress) -> RigCheck:
        """Compare a later exposure of the target with the calibration.

        The result is added to the session's history of checks.

        Args:
            image_set: folder of the exposure, ``<camera>.<ext>`` in it, or of several such folders.
            progress: fraction of the photographs that are searched.

        Raises:
            MammometryError: whatever stands in the way, in one sentence.
        """
        from mammometry.calibration.detection.detect import detect
        from mammometry.calibration.judge import check
        from mammometry.io import drift
        from mammometry.report.figures.drift import drift as drawn

        folder = self.session.path / drift.FOLDER
        require_apart(folder, [Path(image_set)])
        require_free(folder, [drift.DRAWN], command="check")
        photographs, measured = self.session.image_set(Path(image_set))
        target = self.inputs.target
        if target is None:
            raise SessionError(
                "session.toml",
                found="no [target]",
                expected="a description of the target of that exposure",
                remedy="Describe it as `mammometry new` shows",
            )
        self.ensure("calibrate")
        calibration = self.calibration()
        reference = (
            check.Reference.of_cameras(self.plan.calibrated.cameras().rig, target)
            if calibration is None
            else check.Reference.of(calibration)
        )
        settings = self.settings.calibration
        with one_blas_thread():
            seen = detect(photographs, target, settings.detect, measured=measured, progress=progress)
            result = check.check(reference, seen, settings.check)
        drift.append_history(
            self.session.path,
            drift.entry_of(
                result,
                when=datetime.now().astimezone().isoformat(timespec="seconds"),
                image_set=str(image_set),
                calibration=self.plan.calibrated.cameras.key.digest[:12],
            ),
        )
        history = drift.read_history(self.session.path).entries
        write_output(folder / drift.DRAWN, drawn(history, settings.check.refuse_mm), command="check")
        return result

    def match(self) -> dict[str, DisparityMap]:
        """Match every pair: pair → disparity map."""
        self.ensure("match")
        return {pair: product() for pair, product in self.plan.matched.disparities.items()}

    def surface(self) -> FinishedSurface:
        """Build, repair and colour the surface."""
        self.ensure("surface")
        return self.plan.surfaced.mesh()

    def measure(self) -> dict[str, VolumeMeasurement]:
        """Side or ``model`` → volume. Empty for an open surface."""
        self.ensure("measure")
        product = self.plan.measured.measurements
        return {} if product is None else {measured.name: measured for measured in product()}

    def no_breast(self) -> dict[str, str]:
        """Unmeasured sides of a torso → no breast, unclear or refused."""
        self.ensure("measure")
        absent = self.plan.measured.absent
        return {} if absent is None else {side.name: side.why for side in absent()}

    def lacking(self) -> tuple[Lacking, ...]:
        """What a side of a torso lacks to the mirrored other one."""
        self.ensure("measure")
        return () if self.plan.measured.lacking is None else self.plan.measured.lacking()

    def report(self) -> Path:
        """Write the report and return its page."""
        self.ensure("report")
        return self._report_page

    def run(self, *, report: bool = True) -> Results:
        """Calibrate, match, build the surface, measure, report.

        What is current is not done again.

        Args:
            report: whether to write the report too.

        Raises:
            MammometryError: whatever stands in the way, in one sentence.
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
            world=self.plan.calibrated.cameras().world,
            folder=self.session.results,
            report=self._report_page if report else None,
            no_breast=self.no_breast(),
            lacking={found.name: found for found in self.lacking()},
            made=tuple(self.store.made[before:]),
            made_at=self.made_at(last),
        )

    @property
    def _report_page(self) -> Path:
        return self.session.results / "report" / "report.html"

    @property
    def report_key(self) -> Key:
        """What the report depends on: every product, and whatever else it shows."""
        return self._page_key(self._page_inputs)

    def page_digest(self, *, deidentify: bool) -> str:
        """Digest of everything a report would show now, with or without names."""
        page = self._page_inputs
        return self._page_key(replace(page, identity=NAMELESS) if deidentify else page).digest

    def pages(self) -> dict[str, State]:
        """Pages in results/ for others or of two dates → whether current."""
        folder = self.session.results
        here = {self.page_digest(deidentify=deidentify) for deidentify in (False, True)}
        found = sorted([*folder.glob("*/report.html"), *folder.glob("compare/*/compare.html")])
        return {
            page.relative_to(folder).as_posix(): "current" if here & _keys_in(page) else "stale"
            for page in found
            if page != self._report_page
        }

    def _page_key(self, page: PageInputs) -> Key:
        drawn = {"attributions": repr(self.inputs.attributions)} if self.inputs.attributions else {}
        return page.key(self.plan.products(), drawn)

    @property
    def _page_inputs(self) -> PageInputs:
        return PageInputs(
            identity=self.identity,
            settings=self.settings,
            stage_seconds=self._all_seconds(),
        )

    def keys(self, stage: Stage) -> tuple[Key, ...]:
        """Keys of a stage's products and pictures, or the report's own key."""
        if stage == "report":
            return (self.report_key,)
        return (*(product.key for product in self.products(stage)), self.previews_key(stage))

    def made_at(self, stage: Stage) -> str | None:
        """Time of the newest result up to a stage, ISO 8601, UTC."""
        stages = STAGES[: STAGES.index(stage) + 1]
        return self.store.made_at([key for each in stages for key in self.keys(each)])

    def share(self, folder: Path, privacy: Privacy) -> Path:
        """Write a report for others into a folder, and return its page.

        The session's own report stays as it is. What an earlier call wrote there is replaced; other files in the way
        are refused before anything is computed.

        Args:
            folder: for report.html and report.pdf.
            privacy: what to leave out.

        Raises:
            MammometryError: whatever stands in the way, in one sentence.
        """
        from mammometry.report import html, pdf

        require_apart(folder, self.session.brought)
        require_free(folder, [html.PAGE, pdf.DOCUMENT], command="report")
        self.ensure("measure")
        with one_blas_thread():
            said = self._report_content(privacy)
        files = {html.PAGE: html.render(said).encode(), pdf.DOCUMENT: pdf.render(said)}
        write_outputs(folder, files, command="report")
        return folder / html.PAGE

    def _ensure_report(self, drawing: Drawing) -> None:
        scene = None
        if drawing.waiting:  # the last pictures: meanwhile what needs none of them
            from mammometry.report import gather

            scene = gather.whole_scene(self.plan, self.inputs)
        facts = drawing.facts()

        def prepare() -> Callable[[Path, Progress], None]:
            from mammometry.report import html, pdf  # a run with nothing to do needs neither
            from mammometry.report.privacy import Privacy

            def write(folder: Path, progress: Progress) -> None:
                said = self._report_content(Privacy(), progress, facts, scene)
                html.write(folder, said)
                pdf.write(folder, said)
                write_text(folder / WARNINGS, json.dumps(list(said.warnings), ensure_ascii=False, indent=1) + "\n")

            return write

        self.store.write_folder(self.report_key, prepare)

    def _report_content(
        self,
        privacy: Privacy,
        progress: Progress = no_progress,
        facts: Mapping[Stage, Facts] = MappingProxyType({}),
        scene: ViewerScene | None = None,
    ) -> ReportContent:
        from mammometry.report import gather
        from mammometry.report.stage_facts import Shown

        return gather.gather(
            self.plan,
            self.inputs,
            self._page_inputs,
            Shown(pictures={stage: self.previews(stage) for stage in self._stages}, facts=facts, scene=scene),
            privacy=privacy,
            progress=progress,
        )

    def _all_seconds(self) -> dict[str, float]:
        """Seconds that each stage took, in this run or an earlier one."""
        seconds: dict[str, float] = {}
        for stage in self._stages:
            records = [self.store.record(key) for key in self.keys(stage)]
            seconds[stage] = round(sum(record.seconds for record in records if record is not None), 1)
        return seconds

    def previews_key(self, stage: Stage) -> Key:
        """Key of a stage's previews: its products, the cameras, the photographs."""
        return self._previews.key(stage)

    def previews(self, stage: Stage) -> dict[str, bytes]:
        """PNG previews of a finished stage: name → file content.

        Raises:
            StorageError: one is not as it was written, or no picture.
        """
        return self._previews.files(stage)


def open_session(path: Path | str, settings: Settings | None = None, *, watch: Watch = unwatched) -> Job:
    """Open a session folder for the main job.

    Args:
        path: the session folder.
        settings: of all stages; None for the recommended ones.
        watch: called for every product that is made; gives the progress callback to use meanwhile.

    Raises:
        SessionError: the folder or its manifest is not as documented, or photographs are missing.
        ImageError: a photograph is unreadable, or of another size than its camera's others.
    """
    return Job(Session.open(path), settings or Settings(), watch)


def _keys_in(page: Path) -> set[str]:
    """Digests in a page's head. None if an earlier version made it."""
    with page.open(encoding="utf-8", errors="replace") as file:
        found = _PAGE_KEY.search(file.read(_HEAD))
    return set(found[1].split(",")) if found else set()
