"""Attribution: who drew a boundary, and who confirmed it."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from mammometry.base.letters import isolated
from mammometry.geometry.arrays import Array, Float64
from mammometry.measure.boundary import BoundaryRemark, boundary_words

if TYPE_CHECKING:
    from mammometry.measure.volume.measurement import VolumeMeasurement

_DIGITS = 3  # decimals of mm: differences below a micrometre between machines do not matter


@dataclass(frozen=True, slots=True, kw_only=True)
class CurveConfirmation:
    """Confirmation of one curve by a person who looked at it."""

    by: str
    """The name that was typed."""
    at: str
    """Time, UTC, ISO 8601."""
    curve: str
    """Digest of the confirmed curve (`curve_digest`)."""

    def holds(self, curve_world: Float64[Array, "n 3"]) -> bool:
        """Whether this is the confirmed curve."""
        return self.curve == curve_digest(curve_world)


@dataclass(frozen=True, slots=True, kw_only=True)
class Attribution:
    """Origin of one boundary, from boundaries.json."""

    method: str | None = None
    """How it was drawn, without names. None if unknown or found automatically."""
    origin: str | None = None
    """The same, with names and dates."""
    confirmation: CurveConfirmation | None = None


def curve_digest(curve_world: Float64[Array, "n 3"]) -> str:
    """SHA-256 of a curve's points to the micrometre, hexadecimal."""
    rounded = np.round(np.asarray(curve_world, dtype=np.float64), _DIGITS) + 0.0  # no −0.0
    return hashlib.sha256(rounded.astype("<f8").tobytes()).hexdigest()


def attributed(
    measured: VolumeMeasurement, attributions: Mapping[str, Attribution], *, named: bool = True
) -> VolumeMeasurement:
    """The measurement, with who drew and who confirmed its boundary.

    Args:
        measured: one breast.
        attributions: breast → its entry in boundaries.json.
        named: whether to include names, dates and free text; false in a de-identified report.
    """
    attribution, curve = attributions.get(measured.name, Attribution()), curve_digest(measured.boundary_world)
    method, remarks = measured.boundary_method, measured.boundary_remarks
    return replace(
        measured,
        boundary_method=attributed_words(method, remarks, curve, attribution, named=named),
        boundary_remarks=attributed_remarks(remarks, curve, attribution.confirmation),
    )


def attributed_words(
    method: str, remarks: Sequence[BoundaryRemark], curve: str, attribution: Attribution, *, named: bool = True
) -> str:
    """Method and remarks of a boundary, with who drew and who confirmed it.

    Args:
        method: how it was found or given.
        remarks: facts about it.
        curve: its digest.
        attribution: its entry in boundaries.json.
        named: as in `attributed`.
    """
    if "given" in remarks:
        if not named:
            method = method.split(",")[0]
        elif attribution.origin:
            method = f"{method.split(',')[0]}, {attribution.origin}"
    return confirmed_words(method, curve, attribution.confirmation, remarks, named=named)


def attributed_remarks(
    remarks: Sequence[BoundaryRemark], curve: str, confirmation: CurveConfirmation | None
) -> tuple[BoundaryRemark, ...]:
    """The remarks, with the latest confirmation if it is of this curve."""
    kept = tuple(code for code in remarks if code != "to-be-confirmed")
    return (*kept, "confirmed") if confirmation is not None and confirmation.curve == curve else tuple(remarks)


def confirmed_words(
    method: str,
    curve: str,
    confirmation: CurveConfirmation | None,
    remarks: Sequence[BoundaryRemark] = (),
    *,
    named: bool = True,
) -> str:
    """A boundary's method, and whether this curve or an earlier one was confirmed.

    Args:
        method: how it was found or drawn.
        curve: its digest.
        confirmation: latest confirmation, of this curve or of an earlier one.
        remarks: facts about the boundary.
        named: whether to include name and date.
    """
    words = boundary_words(method, attributed_remarks(remarks, curve, confirmation))
    if confirmation is None:
        return words
    who = f" by {isolated(confirmation.by)} on {confirmation.at[:10]}" if named else ""
    if confirmation.curve == curve:
        return f"{words}{who}"
    return f"{words}; an earlier curve was confirmed by eye{who}, but not this one"
