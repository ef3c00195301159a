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
    """For the page."""
    jpeg: bytes = b""
    """For the PDF. Empty if it is not in the PDF."""


@dataclass(frozen=True, slots=True)
class Fact:
    """One line of a list: label, and its value as text."""

    label: str
    value: str


@dataclass(frozen=True, slots=True, kw_only=True)
class LargeNumber:
    """A number of the first page."""

    title: str
    value: str
    """"354 cc"."""
    interval: str = ""
    """"95 %: 300 to 410 cc"."""
    note: str = ""
    """Meaning of the number."""
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
    """model, left, right."""
    title: str
    """Its title."""
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
    """Origin of the boundary. This, wall and interval are empty for a side that was not measured."""
    boundary_remarks: tuple[BoundaryRemark, ...] = ()
    """Facts about the boundary used by the report."""
    curve: str = ""
    """Digest of the measured boundary. Empty for a side that was not measured."""
    absence: Notice | None = None
    """Reason for having no volume. None if there is one."""
    tables: tuple[TextTable, ...] = ()
    """Terms of the interval, and the volume with other walls."""

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
    """One stage, for the technician."""

    stage: str
    title: str
    facts: tuple[Fact, ...]
    tables: tuple[TextTable, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ReportContent:
    """All text, pictures and models of a report."""

    identity: Identity
    """Identity of the subject: the only names on the page."""
    created: str
    """Time of the report, as text."""
    subject: str
    """The subject, as text."""
    world: str
    """Definition of the world frame."""
    warnings: tuple[Notice, ...]
    """Warnings about the volumes, worst first. Those of boundaries are added when the report is rendered."""
    concerns: tuple[Notice, ...] = ()
    """Warnings of calibration and matching."""
    calibration_doubts: tuple[Notice, ...] = ()
    """Warnings about single photographs of the calibration, last. A clinic's reports omit them."""
    breasts: tuple[BreastReport, ...]
    comparison: tuple[Fact, ...]
    """Differences between both sides. Empty if neither was measured."""
    difference: LargeNumber | None = None
    """Difference of both volumes. None without two."""
    meanings: tuple[Meaning, ...] = ()
    """The volumes in every definition of the breast, the leading one first. Empty for a cast."""
    lengths: TextTable | None = None
    """Surgical lengths. None: not measured."""
    lengths_note: str = ""
    """Lengths missing in the table."""
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
    """Digest of the page's content, to check later whether it is current."""
    contains: str = "photographs of the subject, and no name except those in its heading"
    """Personal data in the report."""

    @property
    def about(self) -> str:
        """The line below the heading."""
        return " · ".join(filter(None, (self.identity.subtitle, self.created, self.subject)))


def sentence(text: str, *, capital: bool = True) -> str:
    """The text with a full stop at its end.

    Its first letter becomes a capital unless it continues a sentence.
    """
    text = text.strip().rstrip(".")
    return f"{text[:1].upper() if capital else text[:1]}{text[1:]}." if text else ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Signed:
    """A person's statement, with name and time."""

    by: str
    at: datetime.datetime
    text: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Clinical:
    """The patient, earlier operations, and the clinician's conclusion.

    A report is rendered with it but never stored with it: names are only in the clinic's database.
    """

    patient: str = ""
    """Family name, given name."""
    born: datetime.date | None = None
    record: str = ""
    """Number of the patient's record."""
    taken: datetime.datetime | None = None
    """Time of the photographs or the scan, local time."""
    occasion: str = ""
    """Occasion of the visit: "6 weeks after"."""
    posture: str = ""
    """ "leaning forward", "standing", "lying"; empty: unknown."""
    operations: tuple[str, ...] = ()
    """One sentence each, the newest first: "Implant inserted, left, 2026-03-02, 300 cc"."""
    change: tuple[str, ...] = ()
    """The verdict against the previous visit, one sentence per breast. Empty: none."""
    confirmed: Signed | None = None
    """Confirmation of the measured boundaries. None: not confirmed."""
    conclusions: tuple[Signed, ...] = ()
    """Newest first; it amends the others."""
