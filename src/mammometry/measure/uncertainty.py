"""The 95 % interval of a volume, term by term, from linear theory."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from mammometry.measure.boundary import Boundary
from mammometry.measure.chest_wall import ChestWall
from mammometry.measure.settings import MeasureSettings

_COVERAGE_95 = 1.96


@dataclass(frozen=True, slots=True, kw_only=True)
class Uncertainty:
    """A 95 % interval and what it is made of."""

    interval_cc: tuple[float, float] | None
    """95 % interval, cc; None where no honest one is known."""
    terms_cc: Mapping[str, float]
    """Half-width at 95 % of each source, cc."""
    note: str
    """One sentence on what is covered and what is not."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "terms_cc", MappingProxyType(dict(self.terms_cc)))


def interval(
    boundary: Boundary, wall: ChestWall, volume_cc: float, settings: MeasureSettings = MeasureSettings()
) -> Uncertainty:
    """Combine the known sources of a volume's uncertainty, taken as independent.

    A cast: the height of its base (scatter of the rim, and silhouettes that lie off by a fraction of a pixel) and the
    matched surface.
    A torso: the wall, .9 cc per cm² of base, and the boundary curve's own uncertainty.
    """
    area_cm2 = wall.mesh.area_mm2() / 100
    if boundary.name == "model":
        if boundary.sigma_mm is None:
            return Uncertainty(
                interval_cc=None, terms_cc={}, note="no interval: the boundary's uncertainty is not known"
            )
        terms = {
            "base": _COVERAGE_95 * boundary.sigma_mm * area_cm2 / 10,
            "surface": _COVERAGE_95 * settings.surface_sigma_mm * wall.skin.area_mm2() / 1000,
        }
        note = "95 % interval from the base's height and the matched surface; the calibration's scale is not in it"
    else:
        terms = {
            "chest wall": settings.wall_u95_mm * area_cm2 / 10,
            "boundary": _COVERAGE_95 * settings.boundary_jitter_mm * settings.boundary_cc_per_mm_cm2 * area_cm2,
        }
        note = "95 % interval from chest wall and boundary, provisional; calibration and surface add little to it"
    half = float(np.sqrt(sum(term**2 for term in terms.values())))
    return Uncertainty(interval_cc=(max(volume_cc - half, 0.0), volume_cc + half), terms_cc=terms, note=note)
