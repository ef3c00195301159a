"""All stages' settings as one value, read from and written to TOML. An unknown name is an error."""

from __future__ import annotations

import difflib
import json
import re
import tomllib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, fields, is_dataclass
from functools import cache
from importlib.resources import files
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeVar, get_type_hints

from mammometry.base.errors import MammometryError, SettingsError
from mammometry.base.parse import LimitSettings, read_text, shown, toml_table
from mammometry.calibration.settings import CalibrateSettings
from mammometry.matching.settings import MatchSettings
from mammometry.measure.settings import SINCE, CompareSettings, MeasureSettings
from mammometry.measure.wall.registry import check_wall
from mammometry.surface.settings import SurfaceSettings

_S = TypeVar("_S")

RANGES: Mapping[str, tuple[float, float]] = MappingProxyType(
    {
        "calibration.bundle.target_prior_mm": (0.001, 10.0),  # a print is no better, a board that bows more is no board
        "calibration.quality.focal_std_refuse": (0.0, 0.1),  # relative; 0 refuses all
        "calibration.check.refuse_mm": (0.001, 10.0),  # 10 mm: the interval of a volume would be as large as it
        "matching.window_px": (3.0, 51.0),  # σ 0.9 to 15 px: less is one pixel, more flattens a breast at every scale
        "surface.triangulate.spacing_mm": (0.0, 5.0),  # 0: each pixel; wider ones lose a fold
        "surface.stillness.most_mm": (0.0, 30.0),  # more is another posture
        "surface.stillness.most_unexplained_mm": (0.0, 10.0),  # more: the views show other bodies
        "surface.decompose.epsilon_mm": (0.01, 10.0),  # the noise of ranges is some 0.1 mm, a fold is 10 mm deep
        "surface.dents.angle_deg": (0.0, 90.0),  # skin seen at more faces away
        "surface.dents.neighbourhood_mm": (0.1, 20.0),  # fewer hold no points, more round a breast off
        "surface.extract.cube_mm": (0.1, 5.0),  # finer ones fill the memory, coarser ones lose a nipple; 0 chooses
        "surface.repair.rho": (0.001, 1000.0),  # the paper's is 1; beyond, one of two energies no longer counts
        "surface.repair.rounds": (0, 20),  # displacements stop shrinking after 2 to 6
        "surface.repair.taper_mm": (0.0, 30.0),  # a matching window on the skin is some 5 mm wide
        "surface.repair.fade_mm": (0.0, 30.0),  # as the taper
        "measure.base_rim.rim_radius_mm": (0.0, 20.0),  # casts are 3 to 20 mm thick
        "measure.base_rim.minimum_sectors": (1, 72),  # of 72
        "measure.nipple.least_probability": (0.0, 1.0),
        "measure.layer.*": (0.0, 100.0),  # real women have 24 ± 8 mm where it is thickest
        "measure.surface_sigma_mm": (0.0, 5.0),  # a surface less certain than 5 mm is no measurement of a volume
        "measure.observers.*": (0.0, 50.0),  # persons differ by 2 to 4 mm; 50 mm is half a breast
        "compare.doubt_mm": (0.001, 50.0),  # of trunks; two bodies differ by 2 to 10 mm
        "compare.refuse_mm": (0.001, 50.0),
        "limits.megapixels": (0.0001, 1000.0),  # OpenCV reads no more
    }
)
"""Dotted name of each number, ``*`` for all of a group → least and largest usable value. Others are refused."""
_CHOSEN = {"surface.extract.cube_mm": 0.0}  # values outside the range that mean "choose automatically"


@dataclass(frozen=True, slots=True, kw_only=True)
class Settings:
    """All settings of the main job. The defaults are the recommended ones.

    On the command line a setting is called ``stage.name``, deeper ones ``stage.part.name``:
    ``--set matching.window_px=11``.
    """

    calibration: CalibrateSettings = field(default_factory=CalibrateSettings)
    """Detection of the target and bundle adjustment."""
    matching: MatchSettings = field(default_factory=MatchSettings)
    """Foreground, rectification and dense matching."""
    surface: SurfaceSettings = field(default_factory=SurfaceSettings)
    """From disparity maps to the repaired, coloured surface."""
    measure: MeasureSettings = field(default_factory=MeasureSettings)
    """Boundary, chest wall and volume."""
    compare: CompareSettings = field(default_factory=CompareSettings)
    """Two dates of one patient. No stage of its own."""
    limits: LimitSettings = field(default_factory=LimitSettings)
    """How large files may be. No stage of its own."""

    def __post_init__(self) -> None:
        check_wall(self.measure.wall)

    @classmethod
    def from_toml(cls, text: str, *, name: str = "settings") -> Settings:
        """Read settings from TOML text: one table per stage. Missing settings keep their defaults.

        Args:
            text: the TOML document.
            name: what to call it in messages, usually its file's name.

        Raises:
            SettingsError: it is not TOML, a name is unknown, or a value has the wrong type or is out of range.
        """
        expected = "TOML such as [matching] window_px = 11"
        table = toml_table(text, name, expected, finite=False, refusal=SettingsError)
        return _replaced(cls(), table, ())

    @classmethod
    def load(cls, path: Path) -> Settings:
        """Read a settings file, TOML.

        Raises:
            SettingsError: it cannot be read, or as `from_toml`.
        """
        text = read_text(path, str(path), "a TOML file", most_mib=1, refusal=SettingsError)
        return cls.from_toml(text, name=path.name)

    def overridden(self, assignments: Iterable[str]) -> Settings:
        """Return these settings with ``stage.name=value`` assignments applied, in order.

        Values are written as in TOML (``11``, ``0.5``, ``true``, ``[1, 2]``); a bare word is taken as a string.

        Raises:
            SettingsError: an assignment without ``=``, an unknown name, or an invalid value.
        """
        settings = self
        for assignment in assignments:
            name, equals, value = assignment.partition("=")
            parts = tuple(part.strip() for part in name.split("."))
            if not equals or not all(parts):
                raise SettingsError(
                    f"--set {assignment}",
                    found="no assignment",
                    expected="NAME=VALUE, such as matching.window_px=11",
                    remedy="Write it without spaces, or in quotes",
                )
            table: object = _parsed(value.strip())
            for part in reversed(parts):
                table = {part: table}
            assert isinstance(table, dict)
            settings = _replaced(settings, table, ())
        return settings

    def to_toml(self) -> str:
        """Write all settings as TOML that `from_toml` reads back unchanged."""
        lines: list[str] = []
        _write_tables(self, (), lines)
        return "\n".join(lines).lstrip("\n") + "\n"


def paper_method() -> str:
    """TOML settings of the paper's method as printed.

    Each line carries the section of the paper that it follows. `Settings.from_toml` reads the text.
    """
    return files("mammometry.study").joinpath("paper", "method.toml").read_text(encoding="utf-8")


def as_table(settings: object) -> dict[str, Any]:
    """Any settings dataclass as a plain nested dict."""
    if not is_dataclass(settings) or isinstance(settings, type):
        raise TypeError(f"settings are dataclasses, found {type(settings).__name__}")
    return {
        item.name: as_table(value) if is_dataclass(value := getattr(settings, item.name)) else value
        for item in fields(settings)
    }


def key_table(settings: object) -> dict[str, Any]:
    """Settings as in the keys of stored results, including numbers that are no longer settings.

    So a number that becomes a constant makes no result stale, and neither does a setting that is new.
    """
    own = {
        item.name: key_table(value) if is_dataclass(value := getattr(settings, item.name)) else value
        for item in fields(settings)  # type: ignore[arg-type]  # a dataclass by construction
        if not (item.metadata.get(SINCE) and getattr(settings, item.name) == item.default)
    }
    path = _groups().get(type(settings))
    return own if path is None else {**former_settings(*path), **own}


def keyed(settings: Settings, name: str) -> dict[str, Any]:
    """One group of settings by its dotted name, as `key_table`. It may be one of which no setting is left."""
    path = name.split(".")
    group: object = settings
    for part in path:
        group = getattr(group, part, None)
    return former_settings(*path) if group is None else key_table(group)


def former_settings(*path: str) -> dict[str, Any]:
    """Values of a group's former settings, which are constants now."""
    table = _former()
    for name in path:
        table = table.get(name, {})
    return table


@cache
def _former() -> dict[str, Any]:
    return tomllib.loads(files("mammometry").joinpath("former_settings.toml").read_text(encoding="utf-8"))


@cache
def _groups() -> dict[type, tuple[str, ...]]:
    """Class of a group of settings → its path."""

    def below(settings: object, path: tuple[str, ...]) -> Iterator[tuple[type, tuple[str, ...]]]:
        yield type(settings), path
        for item in fields(settings):  # type: ignore[arg-type]  # a dataclass by construction
            if is_dataclass(value := getattr(settings, item.name)):
                yield from below(value, (*path, item.name))

    return dict(below(Settings(), ()))


def names(settings: object, prefix: tuple[str, ...] = ()) -> list[str]:
    """Dotted names of all scalar settings below `settings`."""
    found: list[str] = []
    for item in fields(settings):  # type: ignore[arg-type]  # a dataclass by construction
        value = getattr(settings, item.name)
        path = (*prefix, item.name)
        found += names(value, path) if is_dataclass(value) else [".".join(path)]
    return found


def _replaced(settings: _S, table: Mapping[str, Any], prefix: tuple[str, ...]) -> _S:
    from pydantic import TypeAdapter, ValidationError  # a third of a second that --help need not wait for

    hints = get_type_hints(type(settings))
    known = {item.name: getattr(settings, item.name) for item in fields(settings)}  # type: ignore[arg-type]
    changed: dict[str, Any] = {}
    for key, value in table.items():
        dotted = ".".join((*prefix, key))
        if key not in known:
            _accept_former(value, (*prefix, key))
            continue
        if is_dataclass(known[key]):
            if not isinstance(value, Mapping):
                raise SettingsError(
                    dotted,
                    found=shown(value),
                    expected="a group of settings",
                    remedy=f"Set one of its members: {', '.join(names(known[key], (*prefix, key))[:6])}",
                )
            changed[key] = _replaced(known[key], value, (*prefix, key))
            continue
        if isinstance(value, Mapping):
            raise SettingsError(dotted, found="a group", expected="a single value", remedy=f"Write {dotted} = …")
        try:
            # Through JSON, because there a strict reader still takes a list for a tuple, as TOML writes it.
            changed[key] = TypeAdapter(hints[key]).validate_json(json.dumps(value, default=str), strict=True)
        except ValidationError as error:
            raise SettingsError(
                dotted,
                found=shown(value),
                expected=" or ".join(
                    re.sub(r"^Input should be (an? )?(valid )?", "", part["msg"]) for part in error.errors()
                ),
                remedy=f"The default is {known[key]!r}",
            ) from None
        _require_usable(dotted, value, changed[key], known[key])
    try:
        return type(settings)(**{**known, **changed})
    except MammometryError:
        raise
    except ValueError as error:
        raise SettingsError(
            ".".join((*prefix, *(list(changed) if len(changed) == 1 else ()))) or "settings",
            found=", ".join(f"{key} = {shown(value)}" for key, value in changed.items()),
            expected=str(error),
            remedy="Choose a value within its range",
        ) from None


def _accept_former(value: object, path: tuple[str, ...]) -> None:
    """Accept a former setting of an older file, if it has the value of today's constant.

    Raises:
        SettingsError: there never was such a setting, or it has another value.
    """
    former: Any = former_settings(*path[:-1]).get(path[-1])
    if former is None:
        raise _unknown(".".join(path))
    if isinstance(former, dict) and isinstance(value, Mapping):
        for name, own in value.items():
            _accept_former(own, (*path, name))
    elif value != former:
        raise SettingsError(
            ".".join(path),
            found=shown(value),
            expected=f"{former!r}, since it is no longer a setting",
            remedy="Remove the line",
        )


def range_of(dotted: str) -> tuple[float, float] | None:
    """Least and largest usable value of a setting. None where it is no number."""
    return RANGES.get(dotted) or RANGES.get(f"{dotted.rpartition('.')[0]}.*")


def _require_usable(dotted: str, given: object, value: object, default: object) -> None:
    """Refuse a number outside its range, also one of several.

    Raises:
        SettingsError: a value is outside its range, which the error names.
    """
    usable = range_of(dotted)
    numbers = [number for number in (value if isinstance(value, tuple) else (value,)) if not isinstance(number, str)]
    if usable is None or value == _CHOSEN.get(dotted) or all(usable[0] <= number <= usable[1] for number in numbers):
        return
    chosen = f", or {_CHOSEN[dotted]:g} to leave it to mammometry" if dotted in _CHOSEN else ""
    raise SettingsError(
        dotted,
        found=shown(given),
        expected=f"{usable[0]:g} to {usable[1]:g}{chosen}",
        remedy=f"The default is {default!r}",
    )


def _unknown(dotted: str) -> SettingsError:
    every = names(Settings())
    last = dotted.rsplit(".", 1)[-1]
    near = difflib.get_close_matches(dotted, every, n=3, cutoff=0.6)
    near += [name for name in every if name.rsplit(".", 1)[-1] == last and name not in near]
    if not near:  # then what the stage or group has
        group = dotted.split(".")[0] + "."
        near = [name for name in every if name.startswith(group)][:8] or [
            "calibration",
            "matching",
            "surface",
            "measure",
            "compare",
            "limits",
        ]
    return SettingsError(
        dotted,
        found="an unknown setting",
        expected=f"a known name, such as {', '.join(near[:8])}",
        remedy="Correct the name; `mammometry settings` lists them all",
    )


def _parsed(text: str) -> object:
    try:
        return toml_table(f"value = {text}", "--set", "a value", finite=False)["value"]
    except MammometryError:
        return text


def _write_tables(settings: object, path: tuple[str, ...], lines: list[str]) -> None:
    scalars: list[tuple[str, Any]] = []
    groups: list[tuple[str, Any]] = []
    for item in fields(settings):  # type: ignore[arg-type]  # a dataclass by construction
        value = getattr(settings, item.name)
        (groups if is_dataclass(value) else scalars).append((item.name, value))
    if scalars:
        lines += ["", f"[{'.'.join(path)}]"] if path else []
        # A setting that is None has no TOML value: left out, which reads back as its default.
        lines += [f"{name} = {_toml_value(value)}" for name, value in scalars if value is not None]
    for name, value in groups:
        _write_tables(value, (*path, name), lines)


def _toml_value(value: object) -> str:
    if isinstance(value, (tuple, list)):
        return "[" + ", ".join(map(_toml_value, value)) + "]"
    if isinstance(value, float):
        return repr(value)  # inf and nan are TOML too
    return json.dumps(value, ensure_ascii=False)
