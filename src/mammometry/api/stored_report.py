"""The report in a results folder: its content, and what is rendered of it."""

from __future__ import annotations

import json
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from mammometry.base.identity import NAMELESS, Identity
from mammometry.base.machine.cores import one_blas_thread
from mammometry.base.progress import Progress
from mammometry.io.drawn import read_boundaries
from mammometry.io.results.store import Store
from mammometry.job.graph import Plan
from mammometry.job.inputs import Inputs
from mammometry.job.products import Key, Product
from mammometry.job.stages import surface
from mammometry.job.stages.report import PageInputs, report_key
from mammometry.job.values import FinishedSurface
from mammometry.settings import Settings

if TYPE_CHECKING:
    from mammometry.report.clinical import Clinical
    from mammometry.report.content import ReportContent
    from mammometry.report.documents.rendering import RenderedReport

WARNINGS = "warnings.json"
"""The report's warnings, for programs: a list of sentences."""


class Reported(ABC):
    """What is measured and has a report among its results: a session or a scan."""

    inputs: Inputs
    settings: Settings
    store: Store
    plan: Plan
    """Its products, those of the measurement at least."""
    identity: Identity
    """Whose photographs and results these are: what pages call them."""
    folder: Path
    """Where boundaries.json and landmarks.json lie."""

    @abstractmethod
    def run(self) -> object:
        """Measure, and write the report."""

    @property
    @abstractmethod
    def _page_inputs(self) -> PageInputs:
        """What the report shows beside products."""

    def _page_key(self, page: PageInputs) -> Key:
        return page.key(self.plan.products())

    @property
    def mesh(self) -> Product[FinishedSurface]:
        """The surface that is measured, with its colours."""
        return self.plan[surface.mesh]

    @property
    def page(self) -> Path:
        """The report's page."""
        return self.store.folder / "report" / "report.html"

    @property
    def content_key(self) -> Key:
        """What the report's content depends on: every product, and whatever else it shows."""
        return self._page_key(self._page_inputs)

    @property
    def report_key(self) -> Key:
        """What the rendered report depends on: its content, and who drew and confirmed the boundaries."""
        return report_key(self.content_key, self.inputs.attributions)

    def page_digest(self, *, deidentify: bool) -> str:
        """Digest of everything a report would show now, with or without names."""
        page = self._page_inputs
        return self._page_key(replace(page, identity=NAMELESS) if deidentify else page).digest

    def rendered(self, clinical: Clinical) -> RenderedReport:
        """The report with what a clinic knows of the visit, from stored results.

        It is not stored. What is not current is made first.

        Args:
            clinical: names, operations, the confirmation, the conclusion.

        Raises:
            MammometryError: whatever stands in the way, in one sentence.
        """
        if not self.store.has(self.content_key):
            self.run()
        return self._render(clinical)

    def render_report(self) -> None:
        """Render the report again with who drew and confirmed the boundaries by now.

        Nothing is measured. Where the report's content is not current, nothing happens.

        Raises:
            MammometryError: another run is at work, or boundaries.json is not as documented.
        """
        drawn = read_boundaries(self.folder, self.inputs.subject_kind, self.store.subject)
        self.inputs = replace(self.inputs, attributions=drawn.attributions)
        if self.store.has(self.content_key):
            self._write_pages()

    def _write_report(self, gather: Callable[[Progress], ReportContent]) -> None:
        """Make the content, then the report, where they are not current.

        A confirmation alone makes nothing anew but the rendering.
        """

        def content() -> Callable[[Path, Progress], None]:
            from mammometry.report.stored_content import CONTENT, packed

            return lambda folder, progress: _write(folder, {CONTENT: packed(gather(progress))})

        self.store.write_folder(self.content_key, content)
        self._write_pages()

    def _write_pages(self) -> None:
        """Write the report's files from the stored content, where they are not current."""

        def report() -> Callable[[Path, Progress], None]:
            from mammometry.report.documents import html, pdf

            def write(folder: Path, progress: Progress) -> None:
                made = self._render(None)
                words = json.dumps(list(made.warnings), ensure_ascii=False, indent=1) + "\n"
                _write(folder, {html.PAGE: made.html, pdf.DOCUMENT: made.pdf, WARNINGS: words.encode()})

            return write

        self.store.write_folder(self.report_key, report)

    def _render(self, clinical: Clinical | None) -> RenderedReport:
        """Render the stored content. Without what a clinic knows, the reader has the command line.

        Raises:
            StorageError: the content is not as it was written.
        """
        from mammometry.report.documents.rendering import render
        from mammometry.report.stored_content import CONTENT, unpacked

        with one_blas_thread():
            content = unpacked(self.store.files(self.content_key)[CONTENT])
            return render(content, self.inputs.attributions, clinical)


def _write(folder: Path, files: Mapping[str, bytes]) -> None:
    for name, data in files.items():
        (folder / name).write_bytes(data)
