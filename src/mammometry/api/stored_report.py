"""The report in a results folder: its content as one file, and its rendered pages."""

from __future__ import annotations

import io
import json
import zipfile
import zlib
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from mammometry.base.errors import StorageError
from mammometry.base.identity import NAMELESS, Identity
from mammometry.base.machine.cores import one_blas_thread
from mammometry.base.notices.words import words_of
from mammometry.base.progress import Progress
from mammometry.io.drawn import read_boundaries
from mammometry.io.outputs import require_apart, require_free, write_outputs
from mammometry.io.results.store import Store
from mammometry.job.graph import Plan
from mammometry.job.inputs import FinishedSurface, Inputs
from mammometry.job.products import Key, Product
from mammometry.job.stages import surface
from mammometry.job.stages.report import PageInputs, report_key
from mammometry.report.content import ReportContent, ReportPicture
from mammometry.report.scene import SCENE
from mammometry.settings import Settings

if TYPE_CHECKING:
    from pydantic import TypeAdapter

    from mammometry.report.content import Clinical, ReportContent
    from mammometry.report.documents.rendering import RenderedReport
    from mammometry.report.privacy import Privacy


WARNINGS = "warnings.json"
"""The report's warnings, for programs: sentences under ``warnings``, their codes and values under ``notices``."""


class Reported(ABC):
    """A session or a scan with a report among its results."""

    inputs: Inputs
    settings: Settings
    store: Store
    plan: Plan
    """Products of the session or scan, at least those of the measurement."""
    identity: Identity
    """Identity of the subject on pages."""
    folder: Path
    """Folder of boundaries.json and landmarks.json."""

    @abstractmethod
    def run(self) -> object:
        """Measure, and write the report."""

    @property
    @abstractmethod
    def _page_inputs(self) -> PageInputs:
        """Content of a report that is not in products."""

    def _photographs(self) -> Mapping[str, str]:
        """Photographs that the report's page links: name → relative address. Empty for a mesh."""
        return {}

    def _page_key(self, page: PageInputs) -> Key:
        return page.key(self.plan.products())

    @property
    def mesh(self) -> Product[FinishedSurface]:
        """The measured surface with its colours."""
        return self.plan[surface.mesh]

    @property
    def page(self) -> Path:
        """The report's page."""
        return self.store.folder / "report" / "report.html"

    @property
    def content_key(self) -> Key:
        """Key of the report's content: all products, and its other content."""
        return self._page_key(self._page_inputs)

    @property
    def report_key(self) -> Key:
        """Key of the rendered report: its content, and the authors and confirmations of the boundaries."""
        return report_key(self.content_key, self.inputs.attributions)

    def page_digest(self, *, deidentify: bool) -> str:
        """Digest of all that the report would show now, with or without names."""
        page = self._page_inputs
        return self._page_key(replace(page, identity=NAMELESS) if deidentify else page).digest

    def rendered(self, clinical: Clinical) -> RenderedReport:
        """The report with a clinic's data on the visit, which is not stored. Stale results are computed first.

        Args:
            clinical: names, operations, the confirmation, the conclusion.

        Raises:
            MammometryError: the first error.
        """
        if not self.store.has(self.content_key):
            self.run()
        return self._render(clinical)

    def render_report(self) -> None:
        """Render the report again with the present authors and confirmations, if its content is current.

        Raises:
            MammometryError: another run is in progress, or boundaries.json is invalid.
        """
        drawn = read_boundaries(self.folder, self.inputs.subject_kind, self.store.subject)
        self.inputs = replace(self.inputs, attributions=drawn.attributions)
        if self.store.has(self.content_key):
            self._write_pages()

    def _write_report(self, gather: Callable[[Progress], ReportContent]) -> None:
        """Make the content and the report, if they are not current. A confirmation changes only the report."""

        def content() -> Callable[[Path, Progress], None]:

            return lambda folder, progress: _write(folder, {CONTENT: packed(gather(progress))})

        self.store.write_folder(self.content_key, content)
        self._write_pages()

    def _write_for_others(
        self, folder: Path, privacy: Privacy, gather: Callable[[], ReportContent], brought: Iterable[Path]
    ) -> Path:
        """Write a report for others into a folder, replacing that of an earlier call, and return its page.

        Args:
            folder: folder for report.html and report.pdf.
            privacy: what to omit.
            gather: collects the content, without the omitted parts.
            brought: the user's own files, which must not be in the folder.

        Raises:
            StorageError: other files are in the way; nothing was computed.
        """
        from mammometry.report.documents import html, pdf
        from mammometry.report.documents.rendering import render

        require_apart(folder, brought)
        require_free(folder, [html.PAGE, pdf.DOCUMENT], command="report")
        content = gather()
        with one_blas_thread():
            made = render(content, self.inputs.attributions, named=not privacy.deidentify)
        write_outputs(folder, {html.PAGE: made.html, pdf.DOCUMENT: made.pdf}, command="report")
        return folder / html.PAGE

    def _write_pages(self) -> None:
        """Write the report's files from the stored content, if they are not current."""

        def report() -> Callable[[Path, Progress], None]:
            from mammometry.report.documents import html, pdf

            def write(folder: Path, progress: Progress) -> None:
                made = self._render(None)
                lines = {
                    "warnings": [words_of(notice) for notice in made.warnings],
                    "notices": [notice.as_table() for notice in made.warnings],
                }
                words = json.dumps(lines, ensure_ascii=False, indent=1) + "\n"
                _write(folder, {html.PAGE: made.html, pdf.DOCUMENT: made.pdf, WARNINGS: words.encode()})

            return write

        self.store.write_folder(self.report_key, report)

    def _render(self, clinical: Clinical | None) -> RenderedReport:
        """The rendered report. Without a clinic's data its text refers to the command line.

        Raises:
            StorageError: the content is damaged.
        """
        from mammometry.report.documents.rendering import render

        with one_blas_thread():
            content = unpacked(self.store.files(self.content_key)[CONTENT])
            photographs = {} if clinical is not None else self._photographs()
            return render(content, self.inputs.attributions, clinical, photographs=photographs)


def _write(folder: Path, files: Mapping[str, bytes]) -> None:
    for name, data in files.items():
        (folder / name).write_bytes(data)


CONTENT = "content.zip"
_WORDS = "content.json"
_LARGEST = 256 << 20  # largest total size of the members, bytes; real ones have a few MB
_ALWAYS = (1980, 1, 1, 0, 0, 0)  # time stamp of all members, so that equal contents give equal bytes


def packed(content: ReportContent) -> bytes:
    """The content as a ZIP: texts and captions as JSON, the viewer's scene, and the pictures."""
    bare = {
        stage: {name: replace(picture, webp=b"", jpeg=b"") for name, picture in drawn.items()}
        for stage, drawn in content.pictures.items()
    }
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_STORED) as archive:

        def add(name: str, data: bytes) -> None:
            archive.writestr(zipfile.ZipInfo(name, _ALWAYS), data)

        add(_WORDS, _adapter().dump_json(replace(content, pictures=bare, scene="")))
        add(SCENE, content.scene.encode())
        for name, data in _files(content.pictures):
            add(name, data)
    return buffer.getvalue()


def unpacked(data: bytes) -> ReportContent:
    """The content of a ZIP from `packed`.

    Raises:
        StorageError: it is damaged.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            if sum(member.file_size for member in archive.infolist()) > _LARGEST:
                raise ValueError(f"more than {_LARGEST >> 20} MB")
            members = set(archive.namelist())
            content = _adapter().validate_json(archive.read(_WORDS))
            pictures = {
                stage: {
                    name: replace(
                        picture,
                        webp=archive.read(f"{stage}/{name}.webp"),
                        jpeg=archive.read(f"{stage}/{name}.jpg") if f"{stage}/{name}.jpg" in members else b"",
                    )
                    for name, picture in drawn.items()
                }
                for stage, drawn in content.pictures.items()
            }
            scene = archive.read(SCENE).decode().replace("<", "\\u003c")  # safe inside a page, from any source
    except (OSError, ValueError, LookupError, EOFError, zipfile.BadZipFile, zlib.error, NotImplementedError) as error:
        remedy = "Run the command again, which computes it again"
        expected = "the file as it was written"
        raise StorageError(
            CONTENT, found=f"a result that cannot be read ({error})", expected=expected, remedy=remedy
        ) from None
    return replace(content, pictures=pictures, scene=scene)


def stored_scene(results: Path) -> str | None:
    """3D scene of the report's page as JSON, whether current or not. None if it is missing or unreadable."""
    path = results / "report" / CONTENT
    if not path.is_file() or path.is_symlink():
        return None
    try:
        with zipfile.ZipFile(path) as archive:
            if archive.getinfo(SCENE).file_size > _LARGEST:
                return None
            return archive.read(SCENE).decode() or None
    except (OSError, ValueError, LookupError, EOFError, zipfile.BadZipFile, zlib.error, NotImplementedError):
        return None


def _files(pictures: Mapping[str, Mapping[str, ReportPicture]]) -> Iterator[tuple[str, bytes]]:
    for stage, drawn in pictures.items():
        for name, picture in drawn.items():
            yield f"{stage}/{name}.webp", picture.webp
            if picture.jpeg:
                yield f"{stage}/{name}.jpg", picture.jpeg


def _adapter() -> TypeAdapter[ReportContent]:
    from pydantic import TypeAdapter

    return TypeAdapter(ReportContent)
