"""Virtual rigs by name, or from a TOML file (docs/how-to/simulate.md) that is checked strictly."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from mammometry.base.errors import SessionError, UnknownWordError
from mammometry.base.parse import read_text, shown, toml_table
from mammometry.geometry.camera import Rig
from mammometry.simulate.rigs.build import (
    NO_LENGTH,
    REFERENCE,
    CameraPlan,
    LensPlan,
    PairPlan,
    RigErrors,
    RigPlan,
    Triple,
    build_rig,
    flashes,
    pairs_of,
    triple,
)

_WIDEST_BASELINE = 1.7
"""Largest baseline relative to the distance: 116° between the lines of sight. With 2, the cameras would be on opposite
sides."""
_STRICT = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False)

Number = Annotated[float, Field(strict=False)]
"""A number for which integers are accepted, too."""
Positive = Annotated[float, Field(strict=False, gt=0)]
Deviation = Annotated[float, Field(strict=False, ge=0)]
Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*$")]
Point = Annotated[list[Number], Field(min_length=3, max_length=3)]
Size = Annotated[list[Annotated[int, Field(ge=16, le=30000)]], Field(min_length=2, max_length=2)]


class _Lens(BaseModel):
    model_config = _STRICT

    size: Size | None = None
    focal_px: Positive | None = None
    distortion: Annotated[list[Number], Field(min_length=5, max_length=5)] | None = None
    principal_point_px: Annotated[list[Number], Field(min_length=2, max_length=2)] | None = None


class _Camera(_Lens):
    name: Name
    position_mm: Point
    target_mm: Point = [0.0, 0.0, 0.0]
    right: Point = [1.0, 0.0, 0.0]


class _Pair(_Lens):
    name: Name
    left: Name | None = None
    right: Name | None = None
    towards: Point | None = None
    along: Point | None = None
    distance_mm: Positive | None = None
    baseline_mm: Positive | None = None
    convergence_deg: Annotated[float, Field(strict=False, gt=0, lt=120)] | None = None

    @model_validator(mode="after")
    def _one_kind(self) -> _Pair:
        named = self.left is not None or self.right is not None
        placed = [self.towards, self.along, self.distance_mm, self.baseline_mm, self.convergence_deg]
        if named:
            if self.left is None or self.right is None or any(value is not None for value in placed):
                raise ValueError("either left and right, two of [[cameras]], or a place: towards, along, distance_mm")
        elif self.towards is None or self.along is None or self.distance_mm is None:
            raise ValueError("either left and right, two of [[cameras]], or a place: towards, along, distance_mm")
        elif (self.baseline_mm is None) == (self.convergence_deg is None):
            raise ValueError("one of baseline_mm and convergence_deg")
        elif self.baseline_mm is not None and self.baseline_mm >= _WIDEST_BASELINE * self.distance_mm:
            raise ValueError(f"a baseline_mm well below twice the distance of {self.distance_mm:g} mm")
        return self


class _Flash(BaseModel):
    model_config = _STRICT

    position_mm: Point
    strength: Positive = 1.0


class _Errors(BaseModel):
    """Keys of ``[errors]``. Defaults are those of `RigErrors`."""

    model_config = _STRICT

    position_mm: Deviation | None = None
    aim_mm: Deviation | None = None
    roll_deg: Deviation | None = None
    focal: Deviation | None = None
    aspect: Deviation | None = None
    principal_point: Deviation | None = None
    distortion: Annotated[list[Deviation], Field(min_length=4, max_length=4)] | None = None

    def drawn(self) -> RigErrors:
        given: dict[str, Any] = self.model_dump(exclude_none=True)
        if self.distortion is not None:
            given["distortion"] = tuple(self.distortion)
        return RigErrors(**given)


class _RigFile(BaseModel):
    model_config = _STRICT

    format: Literal[1]
    name: Name
    lean_deg: Annotated[float, Field(strict=False, ge=-90, le=90)] | None = None
    lens: _Lens = _Lens()
    pairs: Annotated[list[_Pair], Field(min_length=1)]
    cameras: list[_Camera] = []
    flashes: list[_Flash] = []
    errors: _Errors = _Errors()

    @model_validator(mode="after")
    def _names_fit(self) -> _RigFile:
        alone = [camera.name for camera in self.cameras]
        made = [f"{pair.name}_{side}" for pair in self.pairs if pair.left is None for side in ("left", "right")]
        used = {name for pair in self.pairs for name in (pair.left, pair.right) if name is not None}
        for what, names in (("pairs", [pair.name for pair in self.pairs]), ("cameras", alone + made)):
            double = sorted({name for name in names if names.count(name) > 1})
            if double:
                raise ValueError(f"{what} of different names, not two called {double[0]!r}")
        for pair in self.pairs:
            for name in (pair.left, pair.right):
                if name is not None and name not in alone:
                    raise ValueError(f"cameras of pair {pair.name!r} that are in [[cameras]], not {name!r}")
            if pair.left is not None and pair.left == pair.right:
                raise ValueError(f"two different cameras in pair {pair.name!r}, not {pair.left!r} twice")
        idle = [name for name in alone if name not in used]
        if idle:
            raise ValueError(f"every camera in a pair, but {idle[0]!r} is in none")
        return self


def read_rig_plan(path: Path) -> RigPlan:
    """Read and check a rig's file.

    Raises:
        SessionError: it is missing, is not TOML, has an unknown or invalid key, or does not describe a rig. The message
        states the file and the key, camera or pair.
    """
    expected = "a rig described in TOML"
    table = toml_table(read_text(path, str(path), expected, most_mib=1), str(path), expected)
    try:
        file = _RigFile.model_validate(table)
    except ValidationError as error:
        raise _explained(path, table, error) from None
    plan = _plan(path, file)
    try:
        rig = build_rig(plan, 1.0, 0)
        flashes(1.0, plan)
    except ValueError as error:
        raise _refused(str(path), str(error), "a rig that can stand") from None
    for pair in rig.pairs:
        if pair.left.camera_from_world.apply(pair.right.centre_world)[0] <= 0.0:
            raise _refused(
                f"{path}: pair {pair.name}",
                f"{pair.right.name} to the left of {pair.left.name}, as the cameras see it",
                "the left camera on the left",
            )
    return plan


def _plan(path: Path, file: _RigFile) -> RigPlan:
    stations: list[PairPlan | CameraPlan] = []
    pairs: list[tuple[str, str, str]] = []
    for camera in file.cameras:
        stations.append(
            CameraPlan(
                name=camera.name,
                centre_mm=triple(camera.position_mm),
                target_mm=triple(camera.target_mm),
                right=triple(camera.right),
                lens=_lens(f"{path}: camera {camera.name}", camera, file.lens),
            )
        )
    for pair in file.pairs:
        if pair.left is not None and pair.right is not None:
            pairs.append((pair.name, pair.left, pair.right))
        elif pair.towards is not None and pair.along is not None and pair.distance_mm is not None:
            angle = pair.convergence_deg
            if pair.baseline_mm is not None:
                angle = math.degrees(2.0 * math.asin(0.5 * pair.baseline_mm / pair.distance_mm))
            assert angle is not None  # validated: either the angle or the baseline is given
            stations.append(
                PairPlan(
                    name=pair.name,
                    towards=triple(pair.towards),
                    along=triple(pair.along),
                    distance_mm=pair.distance_mm,
                    convergence_deg=(angle, angle),
                    lens=_lens(f"{path}: pair {pair.name}", pair, file.lens),
                )
            )
    return RigPlan(
        name=file.name,
        stations=tuple(stations),
        pairs=tuple(pairs),
        flashes_mm=tuple(triple(flash.position_mm) for flash in file.flashes) or REFERENCE.flashes_mm,
        strengths=tuple(flash.strength for flash in file.flashes) or None,
        facing=_facing(stations),
        errors=file.errors.drawn(),
        lean_rad=None if file.lean_deg is None else math.radians(file.lean_deg),
    )


def _lens(subject: str, own: _Lens, common: _Lens) -> LensPlan:
    """The camera's own lens, completed by ``[lens]`` of the file."""
    size, focal = own.size or common.size, own.focal_px or common.focal_px
    if size is None or focal is None:
        missing = "size" if size is None else "focal_px"
        raise _refused(f"{subject}: {missing}", "nothing", "this key, there or in [lens]")
    k1, k2, p1, p2, k3 = own.distortion or common.distortion or [0.0] * 5
    principal = own.principal_point_px or common.principal_point_px
    return LensPlan(
        size_wh=(size[0], size[1]),
        focal_px=focal,
        distortion=(k1, k2, p1, p2, k3),
        principal_point_px=None if principal is None else (principal[0], principal[1]),
    )


def _facing(stations: list[PairPlan | CameraPlan]) -> Triple:
    """Mean direction from the rig's centre to the cameras."""
    places = [np.array(s.towards if isinstance(s, PairPlan) else s.centre_mm) for s in stations]
    total = sum(place / max(float(np.linalg.norm(place)), NO_LENGTH) for place in places)
    return triple(total / max(float(np.linalg.norm(total)), NO_LENGTH))


def _explained(path: Path, table: dict[str, Any], error: ValidationError) -> SessionError:
    """The first of the errors, with the pair or camera stated."""
    first = error.errors()[0]
    words: list[str] = []
    here: Any = table
    for step in first["loc"]:
        here = here[step] if (isinstance(here, dict) and step in here) or isinstance(step, int) else None
        if isinstance(step, int):
            name = here.get("name") if isinstance(here, dict) else None
            words[-1] += f"[{step}]" + (f" ({name})" if name else "")
        else:
            words.append(step)
    subject = ": ".join([str(path), *([".".join(words)] if words else [])])
    message = first["msg"].removeprefix("Value error, ")
    if first["type"] == "extra_forbidden":
        return _refused(subject, "a key that is not known", "a key of the rig's description")
    if first["type"] == "missing":
        return _refused(subject, "nothing", "this key")
    found = shown(here) if isinstance(here, str | int | float | bool | list) and words else "something else"
    return _refused(subject, found, message[:1].lower() + message[1:])


def _refused(subject: str, found: str, expected: str) -> SessionError:
    remedy = "Correct it; the documentation's page on simulating has a whole example"
    return SessionError(subject, found=found, expected=expected, remedy=remedy)


def make_rig(name: str, scale: float, seed: int) -> Rig:
    """A rig by name (``reference``), or some of its pairs (``reference:front,floor``).

    Raises:
        ValueError: there is no rig or pair of that name.
    """
    plan, pairs = find_plan(name)
    rig = build_rig(plan, scale, seed)
    return pairs_of(rig, pairs) if pairs else rig


def find_plan(name: str) -> tuple[RigPlan, tuple[str, ...]]:
    """Rig plan and pairs of ``reference``, ``reference:front``, ``rig.toml`` or ``rig.toml:front,floor``.

    Raises:
        ValueError: there is no rig of that name.
        SessionError: the file does not describe a rig.
    """
    base, _, pairs = name.partition(":")
    if base.lower().endswith(".toml"):
        plan = read_rig_plan(Path(base))
    elif base == REFERENCE.name:
        plan = REFERENCE
    else:
        raise UnknownWordError("rigs are reference, a part of it as in reference:front, or a TOML file", f"{name!r}")
    return plan, tuple(pairs.split(",")) if pairs else ()
