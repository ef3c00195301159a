"""The report in a results folder: its content, and what is rendered of it."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from mammometry.base.machine.cores import one_blas_thread
from mammometry.base.progress import Progress
from mammometry.io.results.store import Store
from mammometry.job.products import Key
from mammometry.report.page_inputs import report_key

if TYPE_CHECKING:
    from mammometry.measure.volume.attribution import Attribution
    from mammometry.report.clinical import Clinical
    from mammometry.report.content import ReportContent
    from mammometry.report.documents.rendering import RenderedReport

WARNINGS = "warnings.json"
"""The report's warnings, for programs: a list of sentences."""


@dataclass(frozen=True, slots=True, kw_only=True)
class StoredReport:
    """The report of one measurement."""

    store: Store
    content_key: Key
    """What its content depends on."""
    attributions: Mapping[str, Attribution]
    """Breast → who drew its boundary, and who confirmed it."""

    def ensure(self, gather: Callable[[Progress], ReportContent]) -> None:
        """Make the content, then the report, where they are not current.

        A confirmation alone makes nothing anew but the rendering.

        Args:
            gather: collects the content.
        """

        def content() -> Callable[[Path, Progress], None]:
            from mammometry.report.stored_content import CONTENT, packed

            return lambda folder, progress: _write(folder, {CONTENT: packed(gather(progress))})

        self.store.write_folder(self.content_key, content)
        self.render()

    def render(self) -> None:
        """Write the report's files from the stored content, where they are not current."""

        def report() -> Callable[[Path, Progress], None]:
            from mammometry.report.documents import html, pdf

            def write(folder: Path, progress: Progress) -> None:
                made = self.rendered(None)
                words = json.dumps(list(made.warnings), ensure_ascii=False, indent=1) + "\n"
                _write(folder, {html.PAGE: made.html, pdf.DOCUMENT: made.pdf, WARNINGS: words.encode()})

            return write

        self.store.write_folder(report_key(self.content_key, self.attributions), report)

    def rendered(self, clinical: Clinical | None) -> RenderedReport:
        """The report from its stored content.

        Args:
            clinical: what a clinic knows. None: the reader has the command line.

        Raises:
            StorageError: the content is not as it was written.
        """
        from mammometry.report.documents.rendering import render
        from mammometry.report.stored_content import CONTENT, unpacked

        with one_blas_thread():
            content = unpacked(self.store.files(self.content_key)[CONTENT])
            return render(content, self.attributions, clinical)


def _write(folder: Path, files: Mapping[str, bytes]) -> None:
    for name, data in files.items():
        (folder / name).write_bytes(data)
