"""Many sessions on one self-contained page, and as tables.

The page has a sortable row with pictures for each session.
"""

import io
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from urllib.parse import quote

import numpy as np

from mammometry.base.csv_cells import csv_text
from mammometry.base.identity import as_utf_8
from mammometry.base.notices import Notice
from mammometry.base.notices.words import words_of
from mammometry.report.documents.pages import embed, render
from mammometry.report.figures.observers import bland_altman, scatter
from mammometry.study.agreement import LEAST_SUBJECTS, PairedMeasurements, agreement
from mammometry.study.agreement_tables import agreement_tables, summary
from mammometry.study.tables import TextTable, number

FILES = ("batch.html", "batch.csv", "batch.parquet")
_NAMES = {"model": "model", "left": "left breast", "right": "right breast"}


@dataclass(frozen=True, slots=True, kw_only=True)
class BatchVolume:
    """A volume of a session, with its interval and reference."""

    name: str
    """``model``, ``left`` or ``right``."""
    volume_cc: float
    interval_cc: tuple[float, float] | None
    """95 % interval."""
    reference_cc: float | None = None
    """Volume measured by another method."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BatchLine:
    """A session's row on the page."""

    session: str
    address: str
    state: str
    """``current``, ``measured``, ``failed`` or ``stopped``."""
    subject: str = ""
    date: str = ""
    volumes: tuple[BatchVolume, ...] = ()
    no_breast: Mapping[str, str] = field(default_factory=dict)
    """Side → reason why it was not measured."""
    notices: tuple[Notice, ...] = ()
    failed: str = ""
    seconds: float | None = None
    peak_memory_mb: float | None = None
    made_at: str = ""
    host: str = ""
    page: str = ""
    """Address of its report."""
    thumbnail: str | None = None
    """Small picture, WebP in base64."""

    @property
    def warnings(self) -> list[str]:
        """The notices as text."""
        return list(map(words_of, self.notices))


def batch_files(title: str, lines: Sequence[BatchLine]) -> dict[str, bytes]:
    """The page and the tables: file name → content.

    The Parquet table is left out if pyarrow is not installed. If three or more subjects have references, the page
    includes a study of agreement with them.

    Args:
        title: title of the page.
        lines: one row per session.
    """
    columns = _columns(lines)
    files = {
        "batch.html": as_utf_8(_page(title, lines)).encode(),
        "batch.csv": csv_text(columns, zip(*columns.values(), strict=True)).encode(),
    }
    parquet = _as_parquet(columns)
    return files if parquet is None else files | {"batch.parquet": parquet}


def _page(title: str, lines: Sequence[BatchLine]) -> str:
    paired = _paired(lines)
    figures = None if paired is None else agreement(paired)
    pictures: list[object] = []
    tables: list[TextTable] = []
    paragraphs: list[str] = []
    if paired is not None and figures is not None:
        pictures = [embed(bland_altman(paired, figures)), embed(scatter(paired))]
        tables, paragraphs = [*agreement_tables(paired, figures)], [*summary(paired, figures)]
    return render(
        "batch.html.j2",
        title=title,
        counts=counted(lines),
        lines=[_shown(line) for line in lines],
        pictures=pictures,
        tables=tables,
        summary=paragraphs,
    )


def counted(lines: Sequence[BatchLine]) -> str:
    """Number of sessions with each outcome, as text."""
    words = {
        "measured": "measured now",
        "current": "current already",
        "failed": "failed",
        "stopped": "not measured yet",
    }
    counts = {word: sum(line.state == state for line in lines) for state, word in words.items()}
    return (
        f"{len(lines)} session{'s' if len(lines) != 1 else ''}: "
        + ", ".join(f"{count} {word}" for word, count in counts.items() if count)
        + "."
    )


def _shown(line: BatchLine) -> dict[str, object]:
    remarks = [*([line.failed] if line.failed else []), *(f"{side}: {why}" for side, why in line.no_breast.items())]
    return {
        "line": line,
        "href": line.page if "://" in line.page else quote(os.fsencode(line.page)),
        "picture": None if line.thumbnail is None else f"data:image/webp;base64,{line.thumbnail}",
        "volumes": [
            {
                "name": _NAMES[volume.name],
                "value": number(volume.volume_cc, ".0f"),
                "interval": ""
                if volume.interval_cc is None
                else " … ".join(number(end, ".0f") for end in volume.interval_cc),
                "reference": "" if volume.reference_cc is None else number(volume.reference_cc, ".0f"),
            }
            for volume in line.volumes
        ],
        "largest": max((volume.volume_cc for volume in line.volumes), default=-1.0),
        "remarks": remarks,
        "seconds": "" if line.seconds is None else number(line.seconds, ".0f"),
        "memory": "" if line.peak_memory_mb is None else number(line.peak_memory_mb, ".0f"),
    }


def _paired(lines: Sequence[BatchLine]) -> PairedMeasurements | None:
    """Volumes with a reference. None if there are too few subjects for a study."""
    pairs = [
        (line.subject or line.session, volume)
        for line in lines
        for volume in line.volumes
        if volume.reference_cc is not None
    ]
    subjects = tuple(name for name, _ in pairs)
    if len(set(subjects)) < LEAST_SUBJECTS:
        return None
    return PairedMeasurements(
        names=tuple(name if pair.name == "model" else f"{name} {pair.name}" for name, pair in pairs),
        reference=np.array([pair.reference_cc for _, pair in pairs], dtype=np.float64),
        measured=np.array([pair.volume_cc for _, pair in pairs]),
        reference_name="reference",
        measured_name="photographs",
        unit="cc",
        subjects=subjects,
    )


def _columns(lines: Sequence[BatchLine]) -> dict[str, list[str | float | None]]:
    """One row per volume. A session without volumes has one row."""
    columns: dict[str, list[str | float | None]] = {}
    for line in lines:
        for volume in line.volumes or (None,):
            interval = None if volume is None else volume.interval_cc
            cells: dict[str, str | float | None] = {
                "session": line.session,
                "address": line.address,
                "subject": line.subject or None,
                "date": line.date or None,
                "state": line.state,
                "volume": None if volume is None else volume.name,
                "volume_cc": None if volume is None else round(volume.volume_cc, 3),
                "low_cc": None if interval is None else round(interval[0], 3),
                "high_cc": None if interval is None else round(interval[1], 3),
                "reference_cc": None if volume is None else volume.reference_cc,
                "no_breast": "; ".join(f"{side}: {why}" for side, why in line.no_breast.items()) or None,
                "warnings": " ".join(line.warnings) or None,
                "notices": " ".join(dict.fromkeys(notice.code for notice in line.notices)) or None,
                "failed": line.failed or None,
                "seconds": line.seconds,
                "peak_memory_mb": line.peak_memory_mb,
                "made_at": line.made_at or None,
                "report": line.page or None,
            }
            for name, cell in cells.items():
                columns.setdefault(name, []).append(as_utf_8(cell) if isinstance(cell, str) else cell)
    return columns


def _as_parquet(columns: Mapping[str, Sequence[str | float | None]]) -> bytes | None:
    try:
        import pyarrow as pa
        import pyarrow.parquet as pq
    except ImportError:
        return None
    numbers = {"volume_cc", "low_cc", "high_cc", "reference_cc", "seconds", "peak_memory_mb"}
    schema = pa.schema([(name, pa.float64() if name in numbers else pa.string()) for name in columns])
    buffer = io.BytesIO()
    pq.write_table(pa.table({name: list(cells) for name, cells in columns.items()}, schema=schema), buffer)
    return buffer.getvalue()
