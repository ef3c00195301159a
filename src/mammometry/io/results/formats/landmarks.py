"""Landmarks: landmarks.json and .npz."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from mammometry.io.results.formats.arrays import with_json
from mammometry.io.results.formats.registry import FORMATS

if TYPE_CHECKING:
    from mammometry.measure.landmarks.landmarks import Landmark


def _table(product: str, landmarks: tuple[Landmark, ...]) -> dict[str, Any]:
    places = {
        landmark.name: {
            "method": landmark.method,
            "sigma_mm": landmark.sigma_mm,
            "probability": landmark.probability,
            "points": landmark.points_world.tolist(),
        }
        for landmark in landmarks
    }
    return {"units": "mm", "frame": "world", "landmarks": places}


FORMATS.add("landmarks")(with_json(_table))
