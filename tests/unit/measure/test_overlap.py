"""What lies on a breast leaves grooves inside its border. A bare breast, a nipple, a scar and noise do not."""

import json
from pathlib import Path

import numpy as np
import pytest
from tests.first_cases import first
from tests.unit.measure.trunks import LEFT, RIGHT, edge_of, radius_mm, trunk_mesh

from mammometry.api.mesh import MeshFiles, MeshJob
from mammometry.base.errors import MeasureError
from mammometry.geometry.mesh import TriangleMesh
from mammometry.geometry.mesh_files.ply import write_ply
from mammometry.job.stages import measure
from mammometry.measure import scanned
from mammometry.measure.boundary.grooves import find_overlap

SIDES = {"left": LEFT, "right": RIGHT}


def lifted(lift_mm: np.ndarray | None = None, noise_mm: float = 0.0) -> TriangleMesh:
    mesh = trunk_mesh(3.0)
    x, _, z = mesh.vertices.T
    out = np.maximum(np.hypot(x, z), 1e-9)
    grown = np.random.default_rng(1).normal(0.0, noise_mm, len(out)) if noise_mm else np.zeros(len(out))
    scale = 1 + np.where(out > 90, grown + (0.0 if lift_mm is None else lift_mm), 0.0) / out
    return TriangleMesh(vertices=mesh.vertices * np.stack([scale, np.ones(len(out)), scale], axis=1), faces=mesh.faces)


def around(breast: tuple[float, float, float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Place of each vertex about a breast's middle, across and up, mm."""
    x, y, z = trunk_mesh(3.0).vertices.T
    out = radius_mm(np.array([breast[0]]), np.array([breast[1]]))[0]
    return out * (np.arctan2(x, z) - breast[0]), y - breast[1]


def hand_mm(thick_mm: float, low_mm: float = -8.0) -> np.ndarray:
    """Lift of the skin by a hand, 25 mm or so thick, that comes from the side and lies over the lower half."""
    across, up = around(LEFT)
    inside = np.minimum(across + 15, low_mm - up)  # distance from its edge, of fingertips and of the index finger
    inside = np.minimum(inside, up - low_mm + 90)
    return thick_mm * np.sqrt(np.clip(1 - (1 - np.clip(inside / 12.5, 0, 1)) ** 2, 0, 1))


def groove_cm2(mesh: TriangleMesh) -> dict[str, float]:
    surface = scanned.as_scanned(mesh)
    return {s: find_overlap(edge_of(b, s), surface).groove_cm2 for s, b in SIDES.items()}


@pytest.mark.requirement("R-VOL-12")
@pytest.mark.parametrize("thick_mm", [15.0, 25.0])
def test_a_hand_on_a_breast_is_found_on_its_side(thick_mm: float) -> None:
    mesh = lifted(hand_mm(thick_mm), noise_mm=0.3)
    left, right = (find_overlap(edge_of(breast, name), scanned.as_scanned(mesh)) for name, breast in SIDES.items())
    assert left.is_covered
    assert not right.is_covered


@pytest.mark.slow
@pytest.mark.requirement("R-VOL-12")
def test_a_drawn_breast_under_a_hand_is_refused(tmp_path: Path) -> None:
    inside = np.clip((55 - np.hypot(*around(LEFT))) / 10, 0, 1)  # the drawn border stays on the skin
    mesh = lifted(hand_mm(25.0) * inside)
    mesh = mesh.submesh(mesh.corners().mean(axis=1)[:, 2] > -40)
    write_ply(tmp_path / "a.ply", mesh, {})
    curves = {"left": {"points": edge_of(LEFT, "left").points_world.tolist()}}
    (tmp_path / "b.json").write_text(json.dumps({"boundaries": curves}))
    files = MeshFiles(mesh=tmp_path / "a.ply", units="mm", boundary=tmp_path / "b.json", head="y", ahead="z")
    with pytest.raises(MeasureError, match=r"^breast 'left': .*hand") as refused:
        MeshJob(files, tmp_path / "out").plan[measure.measurements]()
    assert "left" in refused.value.subject
    assert "bare_confirmed" in refused.value.remedy


@pytest.mark.parametrize("what", first(2, ["noise", "nipple", "bare", "scar", "areola"]))
def test_what_belongs_to_a_breast_is_no_hand(what: str) -> None:
    across, up = around(LEFT)
    away = np.hypot(across, up)
    lift = {
        "bare": 0.0 * away,
        "noise": 0.0 * away,
        "nipple": 5.0 * (away < 6),
        "scar": -1.5 * (np.abs(up + 10) < 3),
        "areola": 3.0 * np.clip(1 - (away / 22) ** 2, 0, None),
    }[what]
    found = groove_cm2(lifted(lift, noise_mm=0.5 if what == "noise" else 0.0))
    assert max(found.values()) < 1.0  # half of the limit
