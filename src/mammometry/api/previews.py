"""Previews of a job's stages.

If cores are free, a second process draws them in parallel with the next stage, from the results on disk. If it fails,
they are drawn in this process, which reports errors in the usual way.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from mammometry.base.child_process import CallCancelledError, CallError, ChildProcess
from mammometry.base.errors import StorageError
from mammometry.base.machine.cores import available_cores
from mammometry.base.parse import error_text
from mammometry.base.progress import Progress
from mammometry.io.photographs.images import megapixels_of
from mammometry.io.results.store import Reader, Store
from mammometry.job.graph import Plan
from mammometry.job.method import method
from mammometry.job.products import Stage
from mammometry.job.stages.report import previews_key

if TYPE_CHECKING:
    from mammometry.io.session import Session
    from mammometry.job.inputs import Inputs
    from mammometry.report.words.stage_facts import Facts
    from mammometry.settings import Settings

_LOG = logging.getLogger(__name__)
_LEAST_MEGAPIXELS = 5.0  # smallest photographs for a second process, which takes two processor seconds to start


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Previews:
    """Pictures of the stages of one session's job."""

    session: Session
    settings: Settings
    inputs: Inputs
    plan: Plan
    store: Store

    def files(self, stage: Stage) -> dict[str, bytes]:
        """PNG previews of a finished stage: name → file content.

        Raises:
            StorageError: one was changed or is not a picture.
        """
        from mammometry.report.figures.canvas import caption_of

        pictures = {Path(name).stem: png for name, png in self.store.files(previews_key(stage, self.plan)).items()}
        for name, png in pictures.items():
            try:
                caption_of(png)
            except Exception as error:  # Pillow raises many kinds of error for a damaged file
                raise StorageError(
                    f"{stage}/{name}.png",
                    found=f"a picture that cannot be read ({error_text(error)})",
                    expected="the unchanged file",
                    remedy="Remove it and run the command again, which draws it again",
                ) from None
        return pictures

    @contextmanager
    def drawing(self, stages: Sequence[Stage]) -> Iterator[PreviewTasks]:
        """Context in which pictures are drawn as soon as their stages are complete.

        Args:
            stages: stages to be computed, in order. A second process is used only if pictures can be drawn in parallel
                with a later stage.
        """
        missing = any(not self.store.has(previews_key(stage, self.plan)) for stage in stages[:-1])
        usual = self.plan.method is method and not self.plan.given  # replaced functions exist only in this process
        if not missing or not usual or available_cores() < 2 or self._megapixels() < _LEAST_MEGAPIXELS:
            yield PreviewTasks(self._ensure, None)
            return
        with ThreadPoolExecutor(1) as pool, ChildProcess() as child:
            pool.submit(child.call, load)
            drawing = PreviewTasks(lambda stage: self._ensure(stage, child), pool)
            try:
                yield drawing
                drawing.facts()
            except BaseException:
                pool.shutdown(wait=False, cancel_futures=True)
                raise

    def _megapixels(self) -> float:
        folder = self.session.path / "capture"
        return megapixels_of(folder, self.session.limits) if folder.is_dir() else 0.0

    def _ensure(self, stage: Stage, child: ChildProcess | None = None) -> Facts:
        facts: Facts = None

        def prepare() -> Callable[[Path, Progress], None]:
            def write(folder: Path, progress: Progress) -> None:
                nonlocal facts
                pictures, facts = self._drawn(stage, child)
                for name, png in pictures.items():
                    (folder / f"{name}.png").write_bytes(png)

            return write

        if not self.store.has(previews_key(stage, self.plan)):
            self.store.write_folder(previews_key(stage, self.plan), prepare)
        return facts

    def _drawn(self, stage: Stage, child: ChildProcess | None) -> tuple[dict[str, bytes], Facts]:
        if child is not None:
            try:
                return child.call(_draw, self.session, self.settings, stage)
            except CallCancelledError:
                raise
            except CallError as why:
                _LOG.warning("the previews of %s are drawn here: %s", stage, why)
        from mammometry.report.words.stage_facts import drawn

        return drawn(stage, self.plan, self.inputs)


class PreviewTasks:
    """Pictures that are being drawn, in this process or the second one."""

    def __init__(self, ensure: Callable[[Stage], Facts], pool: ThreadPoolExecutor | None) -> None:
        self._ensure = ensure
        self._pool = pool
        self._begun: dict[Stage, Future[Facts]] = {}

    def begin(self, stage: Stage) -> None:
        """Start drawing the pictures of a complete stage."""
        if self._pool is None:
            done: Future[Facts] = Future()
            done.set_result(self._ensure(stage))
            self._begun[stage] = done
        else:
            self._begun[stage] = self._pool.submit(self._ensure, stage)

    @property
    def waiting(self) -> bool:
        """Whether started pictures are still being drawn."""
        return not all(future.done() for future in self._begun.values())

    def facts(self) -> dict[Stage, Facts]:
        """The report's facts by stage, after all started pictures are complete.

        Raises:
            MammometryError: a picture cannot be drawn.
        """
        return {stage: future.result() for stage, future in self._begun.items()}


def load() -> None:
    """Load the drawing libraries in the second process, by drawing a small picture."""
    import numpy as np

    from mammometry.geometry import TriangleMesh
    from mammometry.report.figures.canvas import PanelSheet
    from mammometry.report.figures.catalogue import previews_of
    from mammometry.report.figures.shading import ShadedMesh, standard_views

    previews_of("measure")
    triangle = TriangleMesh(vertices=np.eye(3), faces=np.array([[0, 1, 2]], dtype=np.int32))
    sheet = PanelSheet(1, 1, (8, 8))
    sheet.panel(0, "title").imshow(ShadedMesh(triangle).render(standard_views(triangle, np.eye(3))[0], size_px=8))
    sheet.png("", "")


def _draw(session: Session, settings: Settings, stage: Stage) -> tuple[dict[str, bytes], Facts]:
    """Draw a stage's pictures, in the second process, from the results on disk."""
    from mammometry.report.words.stage_facts import drawn

    inputs = session.inputs()
    stored = Reader(Store(session.results, subject=session.manifest.subject.id))
    return drawn(stage, Plan(method, inputs, settings, stored), inputs)
