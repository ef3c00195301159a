"""Content of the report before layout: numbers with units, sentences, warnings."""

from __future__ import annotations

import datetime
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from mammometry.base.identity import Identity
from mammometry.base.notices import Notice
from mammometry.measure.boundary import BoundaryRemark
from mammometry.study.tables import Table

DISCLAIMER = (
    "For research use only. mammometry is not a certified medical device. Do not base a diagnosis or a treatment on it."
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Picture:
    """A picture of a report with its caption."""

    title: str
    text: str
    width: int
    height: int
    webp: bytes
    """For the page."""
    jpeg: bytes = b""
    """For paper. Empty where paper does not show it."""


@dataclass(frozen=True, slots=True)
class Fact:
    """One line of a list: what, and its value in words."""

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
    """What the number means."""
    colour: str = ""
    """Of its boundary in the pictures, #rrggbb. Empty: it has none."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Meaning:
    """One meaning of the breast with its volumes."""

    title: str
    sentences: str
    """What is counted, for a patient."""
    volumes: tuple[Fact, ...]
    """Breast → volume, interval, weight."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BreastReport:
    """One measured breast, in words."""

    name: str
    """model, left, right."""
    title: str
    """What to call it."""
    number: LargeNumber
    """Its volume, on the first page."""
    interval_note: str
    facts: tuple[Fact, ...]
    """Further measures of the breast."""
    wall_label: str
    """Name of this subject's wall: "Chest wall", or "Base" of a cast."""
    wall: str
    """Name and definition of the wall."""
    boundary: str
    """How the boundary was found or drawn. Of a side that was not measured: why."""
    boundary_remarks: tuple[BoundaryRemark, ...] = ()
    """Facts about the boundary by which the report decides."""
    curve: str = ""
    """Digest of the measured boundary. Empty for a side that was not measured."""
    unmeasured: Literal["", "none", "unclear", "refused"] = ""
    """Why there is no volume. Empty where there is one."""
    tables: tuple[Table, ...] = ()
    """What the interval is made of, and the volume with other walls."""


@dataclass(frozen=True, slots=True, kw_only=True)
class StageReport:
    """One stage, for the technician."""

    stage: str
    title: str
    facts: tuple[Fact, ...]
    tables: tuple[Table, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ReportContent:
    """All words, pictures and models of a report."""

    identity: Identity
    """Whose results these are. The only names on the page."""
    created: str
    """When the report was made, in words."""
    subject: str
    """What was photographed, in words."""
    world: str
    """What the world frame is."""
    warnings: tuple[Notice, ...]
    """Of what the volumes rest on, the gravest first. Those of boundaries follow when the report is rendered."""
    concerns: tuple[Notice, ...] = ()
    """Warnings of calibration and matching."""
    calibration_doubts: tuple[Notice, ...] = ()
    """Warnings of single photographs of the calibration: for who keeps the rig, last of all. A clinic's reports omit
    them."""
    breasts: tuple[BreastReport, ...]
    comparison: tuple[Fact, ...]
    """Differences between both sides. Empty where neither was measured."""
    difference: LargeNumber | None = None
    """Difference of both volumes. None without two."""
    meanings: tuple[Meaning, ...] = ()
    """The volumes in every meaning of the breast, the leading one first. Empty for a cast."""
    lengths: Table | None = None
    """Lengths that surgeons plan with. None: none was measured."""
    lengths_note: str = ""
    """What the table leaves out."""
    stages: tuple[StageReport, ...]
    timings: tuple[Fact, ...]
    changed_settings: tuple[Fact, ...]
    """Those that differ from the recommended ones."""
    all_settings: tuple[Fact, ...]
    versions: tuple[Fact, ...]
    pictures: Mapping[str, Mapping[str, Picture]] = field(default_factory=dict)
    """Stage → name → picture."""
    scene: str = ""
    """What the 3D viewer shows, as `scene.to_json` writes it. Empty leaves it out."""
    key: str = ""
    """Digest of everything that the page shows, to tell later whether it is current."""
    contains: str = "photographs of the subject, and no name except those in its heading"
    """What the report reveals of the subject."""

    @property
    def about(self) -> str:
        """The line below the heading."""
        return " · ".join(filter(None, (self.identity.subtitle, self.created, self.subject)))


def sentence(text: str, *, capital: bool = True) -> str:
    """The text with a full stop at its end.

    Its first letter is made a capital unless it continues a sentence.
    """
    text = text.strip().rstrip(".")
    return f"{text[:1].upper() if capital else text[:1]}{text[1:]}." if text else ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Signed:
    """Something that somebody said, with name and time."""

    by: str
    at: datetime.datetime
    text: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Clinical:
    """The patient, earlier operations, and the clinician's conclusion.

    A report is rendered with it and never stored with it: names stand in the clinic's database alone.
    """

    patient: str = ""
    """Family name, given name."""
    born: datetime.date | None = None
    record: str = ""
    """Number of the patient's record."""
    taken: datetime.datetime | None = None
    """When the photographs or the scan were taken, local time."""
    occasion: str = ""
    """Why the patient came: "6 weeks after"."""
    posture: str = ""
    """ "leaning forward", "standing", "lying"; empty: nobody said."""
    operations: tuple[str, ...] = ()
    """One sentence each, the newest first: "Implant inserted, left, 2026-03-02, 300 cc"."""
    change: tuple[str, ...] = ()
    """The verdict against the visit before, a sentence a breast. Empty: there is none."""
    confirmed: Signed | None = None
    """Who looked at the measured boundaries and found them right. None: nobody yet."""
    conclusions: tuple[Signed, ...] = ()
    """The newest first; the others were amended by it."""
