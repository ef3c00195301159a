"""A wall of one's own is one function with one decorator: chosen by settings, closed, measured, drawn and named."""

from collections.abc import Iterator

import numpy as np
import pytest
from solids import as_surface, rig_around
from trunks import LEFT, RADIUS_MM, RIGHT, bump_mm, edge_of, trunk_mesh, volume_cc

from mammometry.base.errors import MeasureError, SettingsError
from mammometry.measure.solid.patch import Closed
from mammometry.measure.trunk.body import rig_frame
from mammometry.measure.volume import volumes
from mammometry.measure.volume.uncertainty import VolumeEvidence
from mammometry.measure.wall import chest_wall
from mammometry.measure.wall.heights import TrunkChart, through
from mammometry.measure.wall.open_breast import OpenBreast
from mammometry.measure.wall.registry import CAST_WALLS, TORSO_WALLS, add_wall, in_order
from mammometry.report.figures import measure
from mammometry.report.figures.stage_results import MeasureResult
from mammometry.report.words.describe import breast_report
from mammometry.settings import Settings
from mammometry.surface.texture.texture import TexturedMesh

RIG = rig_around()
DENT_MM = 8.0
EDGES = (edge_of(LEFT, "left"), edge_of(RIGHT, "right"))


@pytest.fixture
def _dented() -> Iterator[None]:
    @add_wall(TORSO_WALLS, name="dented", definition="a cylinder with a dent behind the left breast")
    def dented(breast: OpenBreast) -> Closed:
        def radius_mm(flat: np.ndarray) -> np.ndarray:
            x, y, z = breast.trunk.world(np.column_stack([flat, np.full(len(flat), RADIUS_MM)])).T
            return RADIUS_MM - bump_mm(np.arctan2(x, z), y, (*LEFT[:3], DENT_MM))

        return through(breast.part, TrunkChart(trunk=breast.trunk), radius_mm, subject="dented wall")

    yield
    TORSO_WALLS._entries.pop("dented")


def breast(settings: Settings) -> OpenBreast:
    mesh = trunk_mesh(3.0)
    surface = as_surface(mesh, mesh.vertices[:, 2] > -0.35 * RADIUS_MM)
    return OpenBreast(
        boundary=EDGES[0], surface=surface, settings=settings.measure, boundaries=EDGES, frame=rig_frame(RIG)
    )


@pytest.mark.slow
@pytest.mark.usefixtures("_dented")
def test_a_wall_of_ones_own_is_chosen_measured_drawn_and_named() -> None:
    settings = Settings().overridden(["measure.wall=dented"])
    assert Settings.from_toml(settings.to_toml()) == settings
    opened = breast(settings)
    wall, *others = chest_wall.fit_all(opened)
    found = volumes.measure(
        opened.boundary, wall, settings.measure, alternatives=others, evidence=VolumeEvidence(boundary_std_cc=4.0)
    )
    assert found.wall_kind == "dented"
    assert found.wall_definition == "a cylinder with a dent behind the left breast"
    # ∬ Rb − b²/2 instead of a breast's ∬ Rb + b²/2; of b = h (1 − ρ²)² over a disc, ∬ b²/2 is 3/10 h ∬ b.
    share = 0.3 * DENT_MM / RADIUS_MM
    dent_cc = volume_cc((*LEFT[:3], DENT_MM)) * (1 - share) / (1 + share)
    assert found.volume_cc - found.alternatives_cc["cylinder-membrane"] == pytest.approx(dent_cc, rel=0.03)
    base_cm2 = found.base_area_cm2
    assert found.interval_terms_cc["chest wall"] == pytest.approx(0.95 * base_cm2 * np.sqrt(base_cm2 / 170))
    shown = MeasureResult(
        rig=RIG,
        measurements=[found],
        textured=TexturedMesh(mesh=found.closed, colours=np.zeros((len(found.closed.vertices), 3), np.uint8)),
    )
    assert measure.closed(shown, found).startswith(b"\x89PNG")
    assert breast_report(found).wall.startswith("Dented: ")


def test_a_wall_that_nobody_added_is_an_error_at_once() -> None:
    with pytest.raises(SettingsError, match=r"^measure\.wall: .*'dented', .*'default', 'rounded"):
        Settings().overridden(["measure.wall=dented"])
    with pytest.raises(MeasureError, match=r"^measure\.wall: .*dented, .*default, rounded"):
        chest_wall.fit(breast(Settings()), "dented")


def test_walls_stand_in_the_order_in_which_results_name_them() -> None:
    """The first is the default; results are lists in this order, so that it must not change."""
    assert in_order(TORSO_WALLS) == [
        "rounded-membrane", "cylinder-membrane", "thorax-fit", "tangent-continuous", "mirrored", "measured", "membrane",
        "thin-plate", "coons", "plane",
    ]  # fmt: skip
    assert in_order(CAST_WALLS) == ["plane", "convex-cylinder", "measured", "membrane", "thin-plate", "coons"]
    assert {name for name in TORSO_WALLS if not TORSO_WALLS[name].sees_the_chest} == {"plane", "membrane", "coons"}
