"""Attribution: who drew a boundary, and who confirmed it by eye."""

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

_DIGITS = 3  # micrometres: another machine's last bits are no other curve


@dataclass(frozen=True, slots=True, kw_only=True)
class Confirmation:
    """Somebody looked at one curve and found it right."""

    by: str
    """The name that was typed."""
    at: str
    """When, UTC, ISO 8601."""
    curve: str
    """Digest of the curve that was looked at (`curve_digest`)."""

    def holds(self, curve_world: Float64[Array, "n 3"]) -> bool:
        """Whether this is the curve that was looked at."""
        return self.curve == curve_digest(curve_world)


@dataclass(frozen=True, slots=True, kw_only=True)
class Attribution:
    """Origin of one boundary, as boundaries.json has it."""

    method: str | None = None
    """How it was drawn, without names. None where nobody says, or where it is found automatically."""
    origin: str | None = None
    """The same with names and dates."""
    confirmation: Confirmation | None = None


def curve_digest(curve_world: Float64[Array, "n 3"]) -> str:
    """SHA-256 of a curve's points to the micrometre, hexadecimal."""
    rounded = np.round(np.asarray(curve_world, dtype=np.float64), _DIGITS) + 0.0  # no negative zeros
    return hashlib.sha256(rounded.astype("<f8").tobytes()).hexdigest()


def attributed(
    measured: VolumeMeasurement, attributions: Mapping[str, Attribution], *, named: bool = True
) -> VolumeMeasurement:
    """Name who drew and who confirmed a boundary, in its description.

    Args:
        measured: one breast.
        attributions: breast → its entry in boundaries.json.
        named: whether names, dates and people's own words are given, which a de-identified report must not do.
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
    """A boundary's method with who drew and who confirmed it.

    Args:
        method: how it was found or given.
        remarks: facts about it.
        curve: its digest.
        attribution: its entry in boundaries.json.
        named: as of `attributed`.
    """
    if "given" in remarks:
        if not named:
            method = method.split(",")[0]
        elif attribution.origin:
            method = f"{method.split(',')[0]}, {attribution.origin}"
    return confirmed_words(method, curve, attribution.confirmation, remarks, named=named)


def attributed_remarks(
    remarks: Sequence[BoundaryRemark], curve: str, confirmation: Confirmation | None
) -> tuple[BoundaryRemark, ...]:
    """The remarks, with the newest confirmation if it is of this curve."""
    kept = tuple(code for code in remarks if code != "to-be-confirmed")
    return (*kept, "confirmed") if confirmation is not None and confirmation.curve == curve else tuple(remarks)


def confirmed_words(
    method: str,
    curve: str,
    confirmation: Confirmation | None,
    remarks: Sequence[BoundaryRemark] = (),
    *,
    named: bool = True,
) -> str:
    """A boundary's method with what is known of its confirmation.

    Args:
        method: how it was found or drawn.
        curve: its digest.
        confirmation: of this curve or of an earlier one.
        remarks: facts about the boundary.
        named: whether name and date are given.
    """
    words = boundary_words(method, attributed_remarks(remarks, curve, confirmation))
    if confirmation is None:
        return words
    who = f" by {isolated(confirmation.by)} on {confirmation.at[:10]}" if named else ""
    if confirmation.curve == curve:
        return f"{words}{who}"
    return f"{words}; an earlier curve was confirmed by eye{who}, but not this one"
