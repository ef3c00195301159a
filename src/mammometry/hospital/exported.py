"""The exported content of a session: one value for all formats."""

from __future__ import annotations

import datetime
import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal, TypeAlias

from mammometry.base.normal import COVERAGE_95
from mammometry.base.notices import Notice
from mammometry.base.photograph import Photograph
from mammometry.base.rounding import half_width, rounded
from mammometry.hospital.codes import require_text
from mammometry.measure.boundary import BoundaryRemark, boundary_words
from mammometry.report.content import Clinical

Side: TypeAlias = Literal["left", "right", "model", ""]
"""The patient's left or right breast, a model, or neither."""
Unit: TypeAlias = Literal["cm3", "cm2", "mm"]
"""Symbol in UCUM."""
Sex: TypeAlias = Literal["", "F", "M", "O"]
"""In DICOM's notation. Empty: not given."""


def plain_name(name: str) -> str:
    """A name without DICOM's separators of parts."""
    return " ".join(name.replace("^", " ").replace("=", " ").replace("\\", " ").split())


def person_name(name: str) -> str:
    """A person's name in DICOM's notation.

    All of it is the family name, because its parts are unknown.
    """
    return f"{plain_name(name)}^"


def as_patient_id(subject: str) -> str:
    """The id of a patient from the session's subject or folder.

    Raises:
        SettingsError: DICOM does not allow it as an id.
    """
    remedy = "Enter a pseudonym as id under [subject] in session.toml, or give --patient-id"
    return require_text(subject, "LO", "the session's name as the patient's id", remedy=remedy)


@dataclass(frozen=True, slots=True, kw_only=True)
class ExportedPatient:
    """Patient in other systems."""

    id: str = ""
    """Number of the patient's record, or a pseudonym."""
    name: str = ""
    """``Family^Given``, in DICOM's notation. Empty: not given."""
    born: datetime.date | None = None
    sex: Sex = ""

    def __post_init__(self) -> None:
        """Require texts that DICOM allows.

        Raises:
            SettingsError: names the field, and does not quote it.
        """
        require_text(self.id, "LO", "the patient's id")
        require_text(self.name, "PN", "the patient's name")


@dataclass(frozen=True, slots=True, kw_only=True)
class Order:
    """The order from a worklist."""

    accession: str = ""
    study_uid: str = ""
    """Study Instance UID of the order. Empty: derived from the content."""
    referring: str = ""
    """Referring physician, ``Family^Given``."""
    procedure_id: str = ""
    """Requested Procedure ID."""
    procedure: str = ""
    """Requested procedure in words."""

    def __post_init__(self) -> None:
        """Require texts that DICOM allows.

        Raises:
            SettingsError: names the field, and does not quote it.
        """
        require_text(self.accession, "SH", "the accession number")
        require_text(self.study_uid, "UI", "the study's UID")
        require_text(self.referring, "PN", "the referring physician's name")
        require_text(self.procedure_id, "SH", "the requested procedure's id")
        require_text(self.procedure, "LO", "the requested procedure")


@dataclass(frozen=True, slots=True, kw_only=True)
class Quantity:
    """One measured number with its error."""

    code: str
    """Of our own code system (`codes`), the same for both sides."""
    title: str
    side: Side
    value: float
    unit: Unit
    interval_95: tuple[float, float] | None = None
    """95 % interval, in `unit`. None: not known."""
    sigma: float | None = None
    """Standard uncertainty, in `unit`. None if there is an interval or nothing is known."""
    method: str
    """Method: a key of `codes.METHODS`."""
    boundary: str = ""
    """Origin of the boundary, one sentence. Empty if there is none."""
    boundary_remarks: tuple[BoundaryRemark, ...] = ()
    """Facts about the boundary."""
    wall: str = ""
    """Name of the wall behind the breast. Empty if there is none."""
    wall_definition: str = ""
    """Definition of that surface, one sentence."""
    note: str = ""
    """Errors included in the interval, one sentence."""

    @property
    def boundary_words(self) -> str:
        """Origin of the boundary, and whether it is confirmed. Empty if there is none."""
        return boundary_words(self.boundary, self.boundary_remarks) if self.boundary else ""

    @property
    def name(self) -> str:
        """Code and side: the name of its column in tables."""
        return f"{self.code}_{self.side}" if self.side else self.code

    def rounded(self) -> Quantity:
        """The quantity, rounded to the digits that its uncertainty justifies, which itself keeps two."""
        half = half_width(self.interval_95) if self.sigma is None else COVERAGE_95 * self.sigma
        low, high = self.interval_95 or (0.0, 0.0)
        ends = None if self.interval_95 is None else (rounded(low, half), rounded(high, half))
        sigma = None if self.sigma is None else float(f"{self.sigma:.2g}")
        return replace(self, value=rounded(self.value, half), interval_95=ends, sigma=sigma)


@dataclass(frozen=True, slots=True, kw_only=True)
class ExportedOperation:
    """One operation before the visit."""

    kind: str
    """A key of `codes.OPERATIONS`, or another kind without a code."""
    title: str
    """The kind in words."""
    side: str
    """``left``, ``right`` or ``both``."""
    day: datetime.date
    sentence: str
    """Known facts, one sentence."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Absent:
    """A side without a volume, with the reason."""

    side: Side
    why: str
    kind: Literal["none", "unclear", "refused"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ExportedMesh:
    """One closed or open mesh as a binary STL."""

    name: str
    """``left``, ``right``, ``model`` or ``surface``."""
    title: str
    side: Side
    stl: bytes
    """mm, world frame."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CoveredModel:
    """One mesh as an OBJ, textured with photographs."""

    name: str
    """As of `ExportedMesh`."""
    title: str
    side: Side
    obj: bytes
    """mm, world frame. Names ``model.mtl``."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CoveredModels:
    """Meshes with one texture from photographs."""

    models: tuple[CoveredModel, ...]
    """The whole surface is the first."""
    mtl: bytes
    """Names ``model.jpg``."""
    jpeg: bytes


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Exported:
    """Everything of one session that leaves mammometry."""

    subject: str
    """Pseudonym of the session's subject, otherwise the folder's name. Empty if de-identified."""
    kind: Literal["model", "torso", "surface"]
    taken: datetime.date | None
    """Day of the photographs. None: not given, or de-identified."""
    made: datetime.datetime | None
    """Time of the newest result, UTC. None if de-identified."""
    software: str
    """Version of mammometry."""
    source: str
    """SHA-256 of the photographs: equal for results of the same photographs."""
    quantities: tuple[Quantity, ...] = ()
    absent: tuple[Absent, ...] = ()
    notices: tuple[Notice, ...] = ()
    """Warnings about the volumes, worst first."""
    report_pdf: bytes | None = None
    models: tuple[ExportedMesh, ...] = ()
    covered: CoveredModels | None = None
    """None if its photographic colours are left out."""
    photographs: Mapping[str, Photograph] = field(default_factory=dict)
    """Camera → photograph, read on access. Empty if de-identified."""
    apart: Mapping[str, str] = field(default_factory=dict)
    """Side → reason why its volumes are not comparable with most of the exported study."""
    photograph_files: Mapping[str, Path] = field(default_factory=dict)
    """Camera → its file."""
    deidentified: bool = False
    clinical: Clinical = field(default_factory=Clinical)
    """Confirmation and conclusions, with names. Empty if de-identified."""
    operations: tuple[ExportedOperation, ...] = ()
    """The newest first. Empty if de-identified."""
    is_final: bool = False
    """Whether exactly these numbers were confirmed and concluded."""
    organization: str = ""
    """Organization of the people in `clinical`. Empty: unknown."""

    def __post_init__(self) -> None:
        """Require texts that DICOM allows. Confirmed results are no longer called "to be confirmed".

        Raises:
            SettingsError: names the field, and does not quote it.
        """
        require_text(self.organization, "LO", "the organization's name")
        if self.clinical.confirmed is not None:
            seen = tuple(replace(quantity, boundary_remarks=("confirmed",)) for quantity in self.quantities)
            object.__setattr__(self, "quantities", seen)
            require_text(
                person_name(self.clinical.confirmed.by), "PN", "the name of the person who confirmed the boundaries"
            )
        for conclusion in self.clinical.conclusions:
            require_text(person_name(conclusion.by), "PN", "the name of the person who concluded")
            require_text(conclusion.text, "UT", "the conclusion")
        for operation in self.operations:
            require_text(operation.sentence, "UT", "an operation before the visit")

    @property
    def digest(self) -> str:
        """SHA-256 digest of the exported numbers."""
        rows: list[list[object]] = [
            [quantity.name, quantity.value, quantity.interval_95, quantity.sigma, quantity.wall]
            for quantity in self.quantities
        ]
        rows += [[absence.side, absence.kind, absence.why] for absence in self.absent]
        rows += [[notice.code, notice.about, sorted(notice.values.items())] for notice in self.notices]
        return hashlib.sha256(json.dumps([self.source, rows]).encode()).hexdigest()
