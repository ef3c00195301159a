"""Content of the report before layout: numbers with units, sentences, warnings."""

from __future__ import annotations

import datetime
from collections.abc import Mapping
from dataclasses import dataclass, field

from mammometry.base.identity import Identity
from mammometry.base.notices import Notice
from mammometry.measure.boundary import BoundaryRemark
from mammometry.study.tables import TextTable

DISCLAIMER = (
    "For research use only. mammometry is not a certified medical device. Do not base a diagnosis or a treatment on it."
)


@dataclass(frozen=True, slots=True, kw_only=True)
class ReportPicture:
    """A picture of a report with its caption."""

    title: str
    text: str
    width: int
    height: int
    webp: bytes
    """Picture for the page."""
    jpeg: bytes = b""
    """Picture for the PDF. Empty if it is not in the PDF."""


@dataclass(frozen=True, slots=True)
class Fact:
    """One line of a list: label, and its value as text."""

    label: str
    value: str


@dataclass(frozen=True, slots=True, kw_only=True)
class LargeNumber:
    """A number on the first page."""

    title: str
    value: str
    """Such as "354 cc"."""
    interval: str = ""
    """Such as "95 %: 300 to 410 cc"."""
    note: str = ""
    """What the number means."""
    colour: str = ""
    """Colour of its boundary in the pictures, #rrggbb. Empty: none."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Meaning:
    """One definition of the breast with its volumes."""

    title: str
    sentences: str
    """Explanation for a patient."""
    volumes: tuple[Fact, ...]
    """Breast → volume, interval, weight."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BreastReport:
    """One measured breast, as text."""

    name: str
    """``model``, ``left`` or ``right``."""
    title: str
    """Heading of its section."""
    number: LargeNumber
    """Its volume, on the first page."""
    facts: tuple[Fact, ...]
    """Further measures of the breast."""
    interval_note: str = ""
    wall_label: str = ""
    """Name of this subject's wall: "Chest wall", or "Base" of a cast."""
    wall: str = ""
    """Name and definition of the wall."""
    boundary: str = ""
    """Origin of the boundary. Like wall and interval, it is empty for a side that was not measured."""
    boundary_remarks: tuple[BoundaryRemark, ...] = ()
    """Facts about the boundary used by the report."""
    curve: str = ""
    """Digest of the measured boundary. Empty for a side that was not measured."""
    absence: Notice | None = None
    """Reason for having no volume. None if there is one."""
    tables: tuple[TextTable, ...] = ()
    """Components of the interval, and the volume with other walls."""

    @property
    def rows(self) -> tuple[Fact, ...]:
        """All rows of its table."""
        if self.absence is not None:
            return self.facts
        return (
            Fact("Boundary", self.boundary),
            Fact(self.wall_label, self.wall),
            Fact("95 % interval", self.interval_note),
            *self.facts,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class StageReport:
    """One stage of the computation, for the technician."""

    stage: str
    title: str
    facts: tuple[Fact, ...]
    tables: tuple[TextTable, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ReportContent:
    """All text, pictures and models of a report."""

    identity: Identity
    """Identity of the subject. The page contains no other names."""
    created: str
    """Time of the report, as text."""
    subject: str
    """The subject, as text."""
    world: str
    """Definition of the world frame."""
    warnings: tuple[Notice, ...]
    """Warnings about the volumes, worst first. Those about boundaries are added when the report is rendered."""
    concerns: tuple[Notice, ...] = ()
    """Warnings of calibration and matching."""
    calibration_doubts: tuple[Notice, ...] = ()
    """Warnings about single photographs of the calibration. They come last, and a clinic's reports omit them."""
    breasts: tuple[BreastReport, ...]
    comparison: tuple[Fact, ...]
    """Differences between both sides. Empty if neither was measured."""
    difference: LargeNumber | None = None
    """Difference of the two volumes. None if there are not two."""
    meanings: tuple[Meaning, ...] = ()
    """The volumes with every definition of the breast, the leading one first. Empty for a cast."""
    lengths: TextTable | None = None
    """Surgical lengths. None if they were not measured."""
    lengths_note: str = ""
    """Lengths that are missing in the table."""
    stages: tuple[StageReport, ...]
    timings: tuple[Fact, ...]
    changed_settings: tuple[Fact, ...]
    """Settings that differ from the defaults."""
    all_settings: tuple[Fact, ...]
    versions: tuple[Fact, ...]
    pictures: Mapping[str, Mapping[str, ReportPicture]] = field(default_factory=dict)
    """Stage → name → picture."""
    scene: str = ""
    """Scene of the 3D viewer, from `scene.to_json`. Empty: no viewer."""
    key: str = ""
    """Digest of the page's content, which shows later whether the page is current."""
    contains: str = "photographs of the subject, and no name except those in its heading"
    """Personal data in the report."""

    @property
    def about(self) -> str:
        """The line below the heading."""
        return " · ".join(filter(None, (self.identity.subtitle, self.created, self.subject)))


def sentence(text: str, *, capital: bool = True) -> str:
    """Add a full stop to a text.

    Its first letter becomes a capital, unless the text continues a sentence.
    """
    text = text.strip().rstrip(".")
    return f"{text[:1].upper() if capital else text[:1]}{text[1:]}." if text else ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Signed:
    """A person's statement, with the person's name and the time."""

    by: str
    at: datetime.datetime
    text: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Clinical:
    """The patient, earlier operations, and the clinician's conclusion.

    A report is rendered with these data but never stored with them: names are only in the clinic's database.
    """

    patient: str = ""
    """Family name, given name."""
    born: datetime.date | None = None
    record: str = ""
    """Number of the patient's record."""
    taken: datetime.datetime | None = None
    """Time of the photographs or the scan, local time."""
    occasion: str = ""
    """Occasion of the visit, such as "6 weeks after"."""
    posture: str = ""
    """Such as "leaning forward", "standing", "lying". Empty: unknown."""
    operations: tuple[str, ...] = ()
    """One sentence each, the newest first: "Implant inserted, left, 2026-03-02, 300 cc"."""
    change: tuple[str, ...] = ()
    """Verdict on the change since the previous visit, one sentence per breast. Empty if there is none."""
    confirmed: Signed | None = None
    """Confirmation of the measured boundaries. None if they are not confirmed."""
    conclusions: tuple[Signed, ...] = ()
    """Newest first. The newest one amends the others."""
