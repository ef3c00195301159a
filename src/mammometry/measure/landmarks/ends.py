"""Propose the ends of a breast: the fold's lowest point, the medial and the lateral end."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import uniform_filter1d

from mammometry.geometry.arrays import Array, Float64
from mammometry.measure.landmarks.landmarks import Landmark

_PARTS, _EVEN_MM = 4, 15.0  # of each edge of the curve; length over which its points' scatter is evened out
_ROUND_MM = 8.0  # where a border runs around the flank its end is known by no more: scans of virtual women, 7 to 14 mm
_FLAT_MM = 0.3  # of an end: as good as the end itself
_ALIKE = 0.15  # share of the boundary's uncertainty by which its places differ: 41 of 42 ends of scans lie within 2 σ


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class EndSigmas:
    """Standard uncertainty of the boundary across itself, mm."""

    lower_mm: float
    medial_mm: float
    lateral_mm: float
    across_mm: Float64[Array, " b"] | None = None
    """Of each point, beside that of its end: how little the skin shows of the border there. None: nothing beside."""


def propose_ends(
    side: str, boundary_world: Float64[Array, "b 3"], frame: Float64[Array, "3 3"], sigmas: EndSigmas
) -> Iterator[Landmark]:
    """Yield the three ends of one breast.

    An end's place along a flat piece of the boundary is hardly known: it is taken in the middle of that piece. Wherever
    the boundary comes nearly as far, for what is known of it there, the end may lie too: its uncertainty is that of all
    these places.

    Args:
        side: the patient's ``left`` or ``right``.
        boundary_world: closed curve, mm.
        frame: rows: the patient's left, the head, straight ahead.
        sigmas: of the boundary.
    """
    outwards = frame[0] if side == "left" else -frame[0]
    share = np.linspace(0, 1, _PARTS, endpoint=False)[:, None]
    steps = np.roll(boundary_world, -1, axis=0) - boundary_world
    dense = (boundary_world[:, None] + share * steps[:, None]).reshape(-1, 3)
    step_mm = float(np.linalg.norm(steps, axis=1).mean()) / _PARTS
    across = np.zeros(len(boundary_world)) if sigmas.across_mm is None else sigmas.across_mm
    across = np.repeat(across, _PARTS)
    even = uniform_filter1d(dense, max(1, round(_EVEN_MM / step_mm)), axis=0, mode="wrap")
    for name, direction, sigma in (
        ("inframammary_fold", -frame[1], sigmas.lower_mm),
        ("medial", -outwards, sigmas.medial_mm),
        ("lateral", outwards, float(np.hypot(sigmas.lateral_mm, _ROUND_MM))),
    ):
        far = even @ direction
        piece = dense[far > far.max() - _FLAT_MM]
        middle = piece.mean(axis=0)
        place = piece[np.argmin(np.linalg.norm(piece - middle, axis=1))]
        likely = np.exp(-(((far.max() - far) / np.hypot(_FLAT_MM, _ALIKE * across)) ** 2) / 2)
        along = np.sqrt(np.average(((dense - place) ** 2).sum(axis=1), weights=likely))
        yield Landmark(
            name=f"{name}_{side}",
            points_world=place[None],
            method="proposed: the boundary's end in this direction; to be confirmed by eye",
            sigma_mm=float(np.linalg.norm([sigma, along, np.average(across, weights=likely)])),
        )
