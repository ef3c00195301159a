"""session.toml: the description of a session, validated strictly."""

from __future__ import annotations

import datetime
import re
from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, StringConstraints, ValidationError, model_validator

from mammometry.base.errors import SessionError
from mammometry.base.identity import subject_id
from mammometry.base.parse import read_text, shown, toml_table
from mammometry.measure.settings import Posture

MANIFEST = "session.toml"
_NAME = re.compile(r"^[A-Za-z0-9][A-Za-z0-9_.-]*$")
_STRICT = ConfigDict(extra="forbid", strict=True, frozen=True)


def _is_name(value: str) -> str:
    if not _NAME.match(value):
        raise ValueError("a name of letters, digits, _ . and -, since it is also a file name")
    return value


Name = Annotated[str, AfterValidator(_is_name)]


MountingName: TypeAlias = Literal["upright", "upside-down", "left", "right"]


class PairEntry(BaseModel):
    """Two cameras that view the same skin."""

    model_config = _STRICT

    name: Name
    left: Name
    right: Name


class RigEntry(BaseModel):
    """The rig: its name and its stereo pairs."""

    model_config = _STRICT

    name: Annotated[str, StringConstraints(min_length=1)]
    pairs: Annotated[list[PairEntry], Field(min_length=1)]
    mounting: MountingName | dict[str, MountingName] = "upright"
    """Direction of the cameras' tops, seen from behind: for all, or by camera. Cameras not listed are upright."""

    @model_validator(mode="after")
    def _pairs_differ(self) -> RigEntry:
        names = [pair.name for pair in self.pairs]
        for pair in self.pairs:
            if names.count(pair.name) > 1:
                raise ValueError(f"different names for pairs, not {pair.name!r} twice")
            if pair.left == pair.right:
                raise ValueError(f"two different cameras in pair {pair.name!r}, not {pair.left!r} twice")
        return self

    @model_validator(mode="after")
    def _mounted_cameras_exist(self) -> RigEntry:
        cameras = [camera for pair in self.pairs for camera in (pair.left, pair.right)]
        for name in self.mounting if isinstance(self.mounting, dict) else ():
            if name not in cameras:
                raise ValueError(f"mounting of cameras of the rig, not of {name!r}")
        return self

    @property
    def turned(self) -> dict[str, MountingName]:
        """Camera → mounting, for cameras that are not upright."""
        if isinstance(self.mounting, dict):
            return {name: how for name, how in self.mounting.items() if how != "upright"}
        cameras = dict.fromkeys(camera for pair in self.pairs for camera in (pair.left, pair.right))
        return {} if self.mounting == "upright" else dict.fromkeys(cameras, self.mounting)


class SubjectEntry(BaseModel):
    """The photographed subject."""

    model_config = _STRICT

    kind: Literal["model", "torso", "surface"]
    id: Annotated[str, AfterValidator(subject_id)] | None = None
    """Pseudonym of the subject, written into every product. None: not given."""
    rim_radius_mm: float | None = Field(default=None, ge=0, le=10)
    """Radius of a cast's rounded rim, mm, if measured."""
    posture: Posture | Literal["unknown"] = "leaning"
    """A patient's posture. unknown: not given. Casts have none."""

    @model_validator(mode="after")
    def _only_a_cast_has_a_rim(self) -> SubjectEntry:
        if self.rim_radius_mm is not None and self.kind != "model":
            raise ValueError("no rim_radius_mm: only a cast (kind model) has a rim")
        return self

    @property
    def patient_posture(self) -> str:
        """The patient's posture. Empty if there is none or it is unknown."""
        return self.posture if self.kind == "torso" and self.posture != "unknown" else ""


class IntrinsicsEntry(BaseModel):
    """Separate, unsynchronised photographs for calibrating each camera's lens."""

    model_config = _STRICT

    target: dict[str, Any]


_Point = Annotated[list[float], Field(min_length=3, max_length=3)]
_Place = Annotated[list[float], Field(min_length=2, max_length=2)]


class WalkEntry(BaseModel):
    """Results of `mammometry photos` for photographs from one telephone, each photograph is a camera."""

    model_config = _STRICT

    region_mm: Annotated[list[_Point], Field(min_length=2, max_length=2)]
    """Lowest and highest corner of a box around the body, world frame, mm."""
    scale_std: Annotated[float, Field(gt=0, le=0.1)]
    """Relative standard uncertainty of all lengths, from the printed board's size."""
    point_std_mm: Annotated[float, Field(ge=0, le=10)]
    """Standard uncertainty of a reconstructed point from the telephone's poses and lens, mm."""
    card_scale: Annotated[float, Field(gt=0.9, lt=1.1)] | None = None
    """Length on the print by a bank card on it, relative to the length as drawn or typed."""
    board_mm: Annotated[list[_Place], Field(min_length=2, max_length=2)]
    """Lowest and highest corner (x, y) of the board's points, world frame, mm."""

    @model_validator(mode="after")
    def _is_a_box(self) -> WalkEntry:
        if not all(low < high for low, high in zip(*self.region_mm, strict=True)):
            raise ValueError("region_mm with a lowest and a highest corner")
        return self


class Manifest(BaseModel):
    """Content of session.toml, format 1."""

    model_config = _STRICT

    format: Literal[1]
    units: Literal["mm"]
    rig: RigEntry
    subject: SubjectEntry
    date: datetime.date | None = None
    """Date of the photographs. It orders two dates in a comparison. No number depends on it."""
    target: dict[str, Any] | None = None
    """Its keys depend on its kind: `calibration.targets.table.target_from_table`."""
    intrinsics: IntrinsicsEntry | None = None
    walk: WalkEntry | None = None
    """Only in sessions of `mammometry photos`."""


_MODELS: dict[tuple[str, ...], type[BaseModel]] = {
    (): Manifest,
    ("rig",): RigEntry,
    ("rig", "pairs"): PairEntry,
    ("subject",): SubjectEntry,
    ("intrinsics",): IntrinsicsEntry,
    ("walk",): WalkEntry,
}


def parse_manifest(text: str) -> Manifest:
    """Read the text of a session.toml.

    Raises:
        SessionError: invalid TOML, an unknown or missing key, or a value that is not allowed; names the key.
    """
    table = toml_table(text, MANIFEST, "a manifest as `mammometry new` writes it")
    try:
        return Manifest.model_validate(table)
    except ValidationError as error:
        first = error.errors()[0]
        raise _explained(first["loc"], first["type"], first["msg"], first.get("input")) from None


def read_manifest(path: Path) -> Manifest:
    """Read a session.toml.

    Raises:
        SessionError: it is missing or cannot be read, or as `parse_manifest`.
    """
    if not path.exists():
        raise SessionError(
            str(path.parent),
            found="no session.toml" if path.parent.is_dir() else "a file" if path.parent.exists() else "no such folder",
            expected="a session folder with a session.toml",
            remedy="Check the path. For photographs, make an empty session with `mammometry new`. "
            "For a scan, use `mammometry import mesh`",
        )
    text = read_text(path, str(path), "TOML", most_mib=1)
    return parse_manifest(text)


def _explained(location: tuple[int | str, ...], kind: str, message: str, value: object) -> SessionError:
    table = tuple(part for part in location[:-1] if isinstance(part, str))
    dotted = ".".join(str(part + 1) if isinstance(part, int) else part for part in location) or "manifest"
    allowed = ", ".join(_MODELS[table].model_fields) if table in _MODELS else ""
    if kind == "extra_forbidden":
        found, expected = "an unknown key", f"only {allowed}"
    elif kind == "missing":
        found, expected = "nothing", "this key, which is required"
    else:
        found = shown(value) if isinstance(value, (str, int, float, bool)) else "an invalid value"
        expected = re.sub(r"^(Input should be|Value error,) ?", "", message).strip()
    return SessionError(
        f"{MANIFEST}: {dotted}", found=found, expected=expected, remedy="Correct it; `mammometry new` writes an example"
    )


TEMPLATE = """\
# A mammometry session. Lengths in mm. Folders next to this file:
#   calibration/<pose>/<camera>.jpg   the target in at least 3 poses, photographed by all cameras at once
#   capture/<camera>.jpg              the subject, one photograph per camera
#   masks/<camera>.png                optional: white where the subject is
#   results/                          written by mammometry only
# Photographs may be JPEG, PNG or TIFF, 8 or 16 bit, all of a camera at one size.
format = 1
units = "mm"
# date = 2026-01-31            # optional: date of the photographs; orders two dates of one patient

[rig]
name = "{rig}"
# One or more stereo pairs; names of cameras are also their file names.
pairs = [
{pairs}
]
# mounting = "upside-down"    # direction of the cameras' top, from behind: "upright", "upside-down", "left", "right"

{target}
[subject]
kind = "{subject}"    # "model": a cast, one closed solid; "torso": both breasts; "surface": an open surface, no volume
# id = "P-0421"         # the subject: a pseudonym, never a name; written into every result
# posture = "leaning"   # or "standing", "lying", "unknown": volumes of different postures are not compared
# rim_radius_mm = 0.0   # for a cast: radius of its rounded rim, if measured; 0 for a sharp edge

# Optional: lenses from separate photographs of a board, one folder per camera (intrinsics/<camera>/*.jpg)
# [intrinsics] target = {{ kind = "chessboard", squares = [10, 7], square_mm = 25.0 }}
"""

TARGETS = {
    "charuco": """\
[target]
kind = "charuco"             # `mammometry target` writes one to print
squares = [14, 10]           # columns, rows
square_mm = 25.0
marker_mm = 18.0
dictionary = "DICT_5X5_250"
# edge_mm = 350.0            # measured width of all 14 columns on the print; an error of 0.1 % changes volumes by 0.3 %
# edge_std_mm = 0.1          # its standard uncertainty
""",
    "chessboard": """\
[target]
kind = "chessboard"
squares = [10, 7]            # columns and rows of squares: inner corners + 1
square_mm = 25.0
# edge_mm = 250.0            # measured width of all 10 columns on the print; an error of 0.1 % changes volumes by 0.3 %
# edge_std_mm = 0.1          # its standard uncertainty
""",
    "circles": """\
[target]
kind = "circles"
grid = [11, 8]               # circles in a row, rows
pitch_mm = 20.0              # distance between neighbouring centres
diameter_mm = 12.0
asymmetric = false
""",
    "dotted-cylinder": """\
[target]
kind = "dotted-cylinder"     # surveyed: its frame is the world
dots = [20, 36]              # rows along the axis, columns around it
radius_mm = 57.15
row_pitch_mm = 10.0
column_pitch_mm = 9.97
""",
    "points": """\
[target]
kind = "points"              # surveyed: its frame is the world
points_mm = [                # x, y, z of each point
    [0.0, 0.0, 0.0],
    [100.0, 0.0, 0.0],
    [0.0, 100.0, 0.0],
    [0.0, 0.0, 100.0],
    [100.0, 100.0, 0.0],
    [100.0, 0.0, 100.0],
]
dot_diameter_mm = 8.0
""",
}
"""Kind of target → its commented table for a new manifest."""

RIGS = {"reference": ("front", "floor", "left", "right"), "single": ("front",)}
"""Rig of a new manifest → its pairs."""


def manifest_template(*, rig: str, target: str, subject: str = "model") -> str:
    """Text of a new, commented manifest.

    Args:
        rig: one of `RIGS`.
        target: one of `TARGETS`.
        subject: ``model``, ``torso`` or ``surface``.
    """
    pairs = "\n".join(f'    {{ name = "{name}", left = "{name}_left", right = "{name}_right" }},' for name in RIGS[rig])
    return TEMPLATE.format(rig=rig, pairs=pairs, target=TARGETS[target], subject=subject)
