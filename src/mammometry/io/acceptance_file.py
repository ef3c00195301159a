"""Folder of an acceptance test: a description in TOML, and a mesh, scan or session per position."""

from __future__ import annotations

import datetime
import json
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

from mammometry.base.errors import SessionError
from mammometry.base.listing import visible
from mammometry.base.parse import numbers, parsing, read_text, shown, toml_table
from mammometry.base.units import UNIT_NAMES, unit_named
from mammometry.geometry.mesh_files.mesh_file import SUFFIXES
from mammometry.study.acceptance.artefacts import (
    KINDS,
    POSITIONS,
    AcceptanceTest,
    Artefact,
    Bar,
    Cast,
    Kind,
    Limits,
    Plane,
    Sphere,
)

DESCRIPTION = "acceptance.toml"
RESULTS = "results"
_FORMAT = 1  # version of the description; others are not read
_EXPECTED = "an acceptance test as `mammometry acceptance new FOLDER` writes it"
_KEYS: Mapping[Kind, Mapping[str, tuple[float, float]]] = MappingProxyType(
    {
        "sphere": {"diameter_mm": (20, 500), "diameter_std_mm": (1e-4, 5), "form_std_mm": (1e-4, 5)},
        "bar": {
            "distance_mm": (50, 2000), "distance_std_mm": (1e-4, 5), "diameter_mm": (10, 300),
            "diameter_std_mm": (1e-4, 5),
        },
        "plane": {"flatness_std_mm": (1e-4, 5)},
        "cast": {"volume_cc": (20, 5000), "volume_std_cc": (1e-3, 100)},
    }
)  # fmt: skip
"""Artefact → its quantities, each with the smallest and largest allowed value."""
_KINDS: Mapping[Kind, Callable[..., Artefact]] = MappingProxyType(
    {"sphere": Sphere, "bar": Bar, "plane": Plane, "cast": Cast}
)
_LIMITS = {"form_mm": 20.0, "size_mm": 20.0, "length_share": 0.1, "flatness_mm": 20.0, "volume_share": 0.5}
"""Limit → its largest value."""
_DEVICE = ("name", "software", "person", "date", "units")
_LONGEST = 200  # characters of a text
_NUMBER = re.compile(r"[0-9]+", re.ASCII)


def read_test(folder: Path) -> AcceptanceTest:
    """Read the description of an acceptance test.

    Raises:
        SessionError: it is missing, or not as documented.
    """
    path = folder / DESCRIPTION
    subject = str(path)
    if not path.is_file():
        remedy = "Make it with `mammometry acceptance new FOLDER`, and fill in your artefacts"
        raise SessionError(str(folder), found=f"no {DESCRIPTION}", expected=_EXPECTED, remedy=remedy)
    table = toml_table(read_text(path, subject, _EXPECTED, most_mib=1), subject, _EXPECTED)
    with parsing("wrong content", subject, _EXPECTED):
        if table.get("format") != _FORMAT:
            raise ValueError(f"format {shown(table.get('format'))}, not {_FORMAT}")
        _only(table, ("format", "device", "limits", *KINDS), "")
        device = _table(table, "device")
        _only(device, _DEVICE, "device.")
        date = device.get("date")
        if not isinstance(date, datetime.date) or isinstance(date, datetime.datetime):
            raise ValueError(f"device.date {shown(date)}, not a date such as 2026-11-29")
        units = _text(device, "units", "device.", empty=True)
        if units and unit_named(units) is None:
            raise ValueError(f"device.units {shown(units)}, not {UNIT_NAMES}")
        artefacts = {kind: _artefact(kind, _table(table, kind)) for kind in KINDS if kind in table}
        if not artefacts:
            raise ValueError(f"no artefact: one of {', '.join(KINDS)}")
        return AcceptanceTest(
            device=_text(device, "name", "device."),
            software=_text(device, "software", "device.", empty=True),
            person=_text(device, "person", "device."),
            date=date,
            units=units,
            artefacts=artefacts,
            limits=_limits(_table(table, "limits") if "limits" in table else {}),
        )


def _artefact(kind: Kind, table: dict[str, Any]) -> Artefact:
    wanted = _KEYS[kind]
    _only(table, (*wanted, "source"), f"{kind}.")
    values = {name: _number(table, name, f"{kind}.", low, high) for name, (low, high) in wanted.items()}
    return _KINDS[kind](**values, source=_text(table, "source", f"{kind}."))


def _limits(table: dict[str, Any]) -> Limits:
    _only(table, tuple(_LIMITS), "limits.")
    return Limits(**{name: _number(table, name, "limits.", 1e-6, _LIMITS[name]) for name in table})


def _only(table: dict[str, Any], names: tuple[str, ...], where: str) -> None:
    unknown = next((name for name in table if name not in names), None)
    if unknown is not None:
        raise ValueError(f"{where}{shown(unknown)}, which is none of {', '.join(names)}")


def _table(table: dict[str, Any], name: str) -> dict[str, Any]:
    part = table.get(name)
    if not isinstance(part, dict):
        raise ValueError(f"no table [{name}]")
    return part


def _text(table: dict[str, Any], name: str, where: str, *, empty: bool = False) -> str:
    text = table.get(name, "" if empty else None)
    if not isinstance(text, str) or len(text) > _LONGEST or not (empty or text.strip()):
        raise ValueError(f"{where}{name} {shown(text)}, not a text of 1 to {_LONGEST} characters")
    return " ".join(text.split())


def _number(table: dict[str, Any], name: str, where: str, low: float, high: float) -> float:
    if name not in table:
        raise ValueError(f"no {where}{name}")
    try:
        (value,) = numbers(table[name], 1)
    except ValueError as error:
        raise ValueError(f"{where}{name}: {error}") from None
    if not low <= value <= high:
        raise ValueError(f"{where}{name} = {value:g}, not {low:g} to {high:g}")
    return float(value)


def position_files(folder: Path, kind: Kind) -> dict[str, Path]:
    """Position → its mesh file, scan folder or session, in the protocol's order.

    The files are in the subfolder named after the artefact's kind. Each name starts with the number of the position:
    ``sphere/03.ply``, ``sphere/3-upper-right.obj``, ``bar/7/session.toml``.

    Raises:
        SessionError: a name does not start with the number of a position, or two have the same.
    """
    place = folder / kind
    names = [position.name for position in POSITIONS[kind]]
    found: dict[str, Path] = {}
    for path in visible(place):
        if not path.is_dir() and path.suffix.lower() not in SUFFIXES:
            continue  # pictures and materials that belong to a mesh
        number = _NUMBER.match(path.name)
        name = number[0].lstrip("0") if number else ""
        if name not in names:
            raise SessionError(
                str(path), found="a name that begins with no position of the protocol",
                expected=f"a number from 1 to {len(names)}, such as 3{path.suffix}", remedy="Rename or remove it",
            )  # fmt: skip
        if name in found:
            raise SessionError(
                str(path), found=f"position {name} for the second time, after {found[name].name}",
                expected="one mesh, scan or session per position", remedy="Remove one of them",
            )  # fmt: skip
        found[name] = path
    return {name: found[name] for name in names if name in found}


def template(device: str, person: str, date: datetime.date) -> bytes:
    """A description to fill in. It is refused as long as any quantity of an artefact is 0."""
    name, initials = (json.dumps(" ".join(text.split()), ensure_ascii=False) for text in (device, person))
    limits = Limits()
    return f"""\
# An acceptance test. Fill in the artefacts that you have, and remove the tables of the others.
# A standard uncertainty (std) is half of the "± … mm" within which the value lies at 95 %.
format = 1

[device]
name = {name}
person = {initials}   # who tests: initials or a function
date = {date.isoformat()}
software = ""   # that made the meshes, with its version; empty: mammometry
units = "mm"    # of meshes whose file states no unit

[sphere]        # meshes, scans or sessions in sphere/: 1.ply to 10.ply
diameter_mm = 0.0       # by calliper: mean of ten directions
diameter_std_mm = 0.02
form_std_mm = 0.02      # standard deviation of the ten diameters
source = ""             # "calliper no. 7, 2026-11-02" or the certificate's number

[bar]           # in bar/: 1.ply to 7.ply
distance_mm = 0.0       # between the balls' centres: outside length minus one diameter
distance_std_mm = 0.03
diameter_mm = 0.0       # of both balls
diameter_std_mm = 0.02
source = ""

[plane]         # in plane/: 1.ply to 6.ply
flatness_std_mm = 0.02  # float glass of 6 mm or more
source = ""

[cast]          # closed meshes or sessions in cast/: 1.ply to 3.ply
volume_cc = 0.0         # by weighing in water
volume_std_cc = 0.5
source = ""

[limits]        # of the errors
form_mm = {limits.form_mm}           # shell with 95 % of a sphere's points
size_mm = {limits.size_mm}           # diameter of a sphere
length_share = {limits.length_share}    # of a distance
flatness_mm = {limits.flatness_mm}       # two planes with 95 % of the points
volume_share = {limits.volume_share}     # of a volume
""".encode()
