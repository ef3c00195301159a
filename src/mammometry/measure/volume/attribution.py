"""Attribution: who drew a boundary, and who confirmed it by eye."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from mammometry.base.letters import isolated
from mammometry.geometry.arrays import Array, Float64
from mammometry.measure.boundary import TO_BE_CONFIRMED

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
        attributions: breast → what boundaries.json tells.
        named: whether names, dates and people's own words are said, which a de-identified report must not do.
    """
    attribution = attributions.get(measured.name, Attribution())
    words = attributed_words(measured.boundary_method, curve_digest(measured.boundary_world), attribution, named=named)
    return replace(measured, boundary_method=words)


def attributed_words(method: str, curve: str, attribution: Attribution, *, named: bool = True) -> str:
    """A boundary's method with who drew and who confirmed it.

    Args:
        method: how it was found or given.
        curve: its digest.
        attribution: what boundaries.json tells.
        named: as of `attributed`.
    """
    if method.startswith("given:"):
        if not named:
            method = method.split(",")[0]
        elif attribution.origin:
            method = f"{method.split(',')[0]}, {attribution.origin}"
    return confirmed_words(method, curve, attribution.confirmation, named=named)


def seen_words(method: str) -> str:
    """Method of a confirmed boundary, without the request to confirm it."""
    seen = "; confirmed by eye"
    return f"{method.removesuffix(TO_BE_CONFIRMED).removesuffix(seen).rstrip(',; ')}{seen}"


def confirmed_words(method: str, curve: str, confirmation: Confirmation | None, *, named: bool = True) -> str:
    """A boundary's method with what is known of its confirmation.

    Args:
        method: how it was found or drawn.
        curve: its digest.
        confirmation: of this curve or of an earlier one.
        named: whether name and date are said.
    """
    if confirmation is None:
        return method
    who = f" by {isolated(confirmation.by)} on {confirmation.at[:10]}" if named else ""
    if confirmation.curve == curve:
        return f"{seen_words(method)}{who}"
    return f"{method}; an earlier curve was confirmed by eye{who}, but not this one"
