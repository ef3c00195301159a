"""The rule by which two volumes of a breast may be compared.

Pages, charts, tables and studies all use this rule.

Two volumes are comparable if they have the same definition of the breast, settings, posture, wall, and origin of the
boundary. Others are shown separately, with the reason.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from mammometry.clinic.models import Measurement, Visit
from mammometry.report.words.volumes import MEANINGS

if TYPE_CHECKING:
    from mammometry.clinic.models import Operation

BOUNDARIES = {"automatic": "found automatically", "landmarks": "by the protocol's landmarks", "drawn": "drawn by hand"}
"""Origin of a boundary → its text."""
_NO_SETTINGS = "not recorded"


@dataclass(frozen=True, slots=True, kw_only=True)
class Basis:
    """Properties that two volumes must share to be comparable."""

    definition: str
    """Definition of the breast."""
    posture: str
    """A value of `Visit.Posture`. Empty: not entered."""
    settings: str
    """Settings that differ from the defaults, as JSON. Empty: not recorded (versions before 1.1)."""
    wall: str
    """Name of the wall that closed the breast. Empty: not recorded."""
    boundary: str
    """Origin of the boundary, a key of `BOUNDARIES`. Empty: not recorded."""


def basis_of(visit: Visit, measurement: Measurement, side: str, definition: str) -> Basis:
    """Basis of one volume of a measurement."""
    return basis(visit.posture, measurement.how, side, definition)


def basis(posture: str, how: Mapping[str, Any], side: str, definition: str) -> Basis:
    """Basis on which a volume is comparable, from plain values of the database.

    Args:
        posture: posture of the visit.
        how: basis of the measurement, as recorded by `clinic.jobs.work`.
        side: left, right or model.
        definition: definition of the breast.
    """
    return Basis(
        definition=definition,
        posture=posture,
        settings=json.dumps(how["settings"], sort_keys=True) if "settings" in how else "",
        wall=how.get("walls", {}).get(side, ""),
        boundary=how.get("boundaries", {}).get(side, ""),
    )


def why_apart(one: Basis, other: Basis, *, measured_alike: bool = False) -> str:
    """Reason why two volumes must not be compared, without a full stop. Empty if they may be compared.

    Args:
        one: basis of the volume in question.
        other: basis of the volume to compare it with.
        measured_alike: whether both are measured again with the same settings, as in a comparison of two surfaces. Then
            only the posture must be the same.
    """
    reasons = [_posture_apart(one.posture, other.posture)]
    if not measured_alike:
        reasons += [_definition_apart(one, other), _settings_apart(one.settings, other.settings)]
        reasons += [
            _apart("another wall", one.wall, other.wall),
            _apart("another boundary", _boundary(one), _boundary(other)),
        ]
    return "; ".join(reason for reason in reasons if reason)


def posture_apart(before: Visit, after: Visit) -> str:
    """Reason why the surfaces of two visits must not be compared. Empty if they may be compared."""
    bases = [
        Basis(definition="", posture=visit.posture, settings="", wall="", boundary="") for visit in (before, after)
    ]
    return why_apart(bases[0], bases[1], measured_alike=True)


def is_between(operation: Operation, first: Visit, last: Visit) -> bool:
    """Whether an operation was done after one visit and before another."""
    return operation.is_after(first) and not operation.is_after(last)


def _posture_apart(one: str, other: str) -> str:
    if one == other:
        return ""
    words = [Visit.Posture(posture).label.lower() if posture else "not entered" for posture in (one, other)]
    return f"another posture ({words[0]} instead of {words[1]})"


def _definition_apart(one: Basis, other: Basis) -> str:
    words = [MEANINGS.get(made.definition, made.definition) for made in (one, other)]
    return _apart("a different definition of the breast", *words)


def _settings_apart(one: str, other: str) -> str:
    if one == other:
        return ""
    if not one or not other:
        return f"the settings of {'this' if not one else 'the other'} measurement are {_NO_SETTINGS}: measure it again"
    ours, theirs = json.loads(one), json.loads(other)
    names = sorted(name for name in {*ours, *theirs} if ours.get(name) != theirs.get(name))
    return f"other settings ({', '.join(names)})"


def _apart(what: str, one: str, other: str) -> str:
    return "" if one == other else f"{what} ({one or _NO_SETTINGS} instead of {other or _NO_SETTINGS})"


def _boundary(made: Basis) -> str:
    return BOUNDARIES.get(made.boundary, made.boundary)
