"""What a detector returns for one photograph. It knows neither camera nor pose."""

from __future__ import annotations

from dataclasses import dataclass

from mammometry.geometry.arrays import Array, Float64, Int64


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FoundPoints:
    """Points of the target in one photograph."""

    ids: Int64[Array, " n"]
    """Rows of ``target.points_target``, ascending."""
    uv: Float64[Array, "n 2"]
    """Distorted pixels of the original photograph."""
    covariance_px2: Float64[Array, "n 2 2"]
    """Covariance of each point's `uv` by the fit alone, px²."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Cause:
    """What a photograph shows instead of a target that can be used."""

    found: str
    """What it shows, in words."""
    remedy: str
    """What to do. Empty if nothing is wrong: not every camera sees the target in every pose."""
