"""Trunk and outlines are found in turn; a round that loses the crease is dropped."""

import numpy as np
import pytest
from solids import as_surface
from trunks import RADIUS_MM, trunk_mesh

from mammometry.measure.boundary import breasts
from mammometry.measure.boundary.crease import Crease
from mammometry.measure.settings import BreastSettings, ThoraxSettings
from mammometry.measure.trunk.body import Body
from mammometry.measure.trunk.thorax import seen_skin

TURN = np.linspace(0, 2 * np.pi, 144, endpoint=False)
CIRCLE = np.stack([40 * np.cos(TURN), 40 * np.sin(TURN)], axis=1)


def side(at_mm: float, concavity_per_mm: float) -> breasts._Side:
    crease = Crease(
        flat=CIRCLE + np.array([at_mm, 0.0]),
        concavity_per_mm=np.full(144, concavity_per_mm),
        seen=np.ones(144, dtype=bool),
        blur_mm=np.zeros(144),
    )
    return breasts._Side(middle=np.array([at_mm, 0.0]), crease=crease, standing=None, verdict="breast")


def rounds(monkeypatch: pytest.MonkeyPatch, right_per_mm: list[float]) -> breasts._Round:
    """The round that is taken if the right outline follows creases of these concavities in turn."""
    drawn = iter(right_per_mm)
    monkeypatch.setattr(breasts, "_sides", lambda *_: {"left": side(70, 0.1), "right": side(-70, next(drawn))})
    mesh = trunk_mesh(6.0)
    surface = as_surface(mesh, mesh.vertices[:, 2] > -0.35 * RADIUS_MM)
    body = Body(frame=np.eye(3), point_world=np.zeros(3), plane_sigma_mm=None, scatter_mm=None, how="given")
    return breasts._best_round(surface, seen_skin(surface), body, BreastSettings(), ThoraxSettings())


@pytest.mark.parametrize(
    ("right_per_mm", "taken"),
    [
        ([0.05, 0.06, 0.07], 0.07),  # settles
        ([0.06, 0.05, 0.055], 0.055),  # within what rounds differ by
        ([0.05, 0.02, 0.05], 0.05),  # diverges: the first stays, the third is not tried
        ([0.10, 0.08, 0.065], 0.08),  # creeps: against the best, not against the one before
    ],
)
def test_a_round_that_loses_its_crease_is_dropped(
    right_per_mm: list[float], taken: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    best = rounds(monkeypatch, right_per_mm)
    assert best.sides["right"].crease.concavity_per_mm[0] == taken
