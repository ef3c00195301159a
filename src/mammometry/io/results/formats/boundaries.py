"""Boundaries of breasts: boundaries.json, which a session may bring, and .npz."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from mammometry.io.results.formats.arrays import with_json
from mammometry.io.results.formats.registry import FORMATS

if TYPE_CHECKING:
    from mammometry.measure.boundary.boundary import Boundary


def _table(product: str, boundaries: tuple[Boundary, ...]) -> dict[str, Any]:
    curves = {curve.name: {"method": curve.method, "points": curve.points_world.tolist()} for curve in boundaries}
    return {"units": "mm", "frame": "world", "boundaries": curves}


FORMATS.add("boundaries")(with_json(_table))
