"""The main job on captures that are not ours: an independent renderer's sessions, and a real two-camera capture."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from benchmarks.accuracy.multidic import SETTINGS, fit_cylinder, speckled, target_error_mm
from benchmarks.accuracy.scans import measured
from benchmarks.accuracy.walls import SIDES, as_seen
from benchmarks.rendered import make_session, read_truth

import mammometry as mm
from mammometry.geometry.mesh import TriangleMesh
from mammometry.geometry.nearest import closest_on_mesh, point_tree
from mammometry.job.stages import surface
from mammometry.measure.boundary.boundary import Boundary
from mammometry.measure.settings import MeasureSettings
from mammometry.measure.trunk.body import find_body
from mammometry.measure.volume.deficit import volume_deficit
from mammometry.measure.volume.measurement import VolumeMeasurement
from mammometry.measure.volume.volumes import measure
from mammometry.measure.wall import chest_wall
from mammometry.measure.wall.open_breast import open_breasts
from mammometry.surface.ranges.range_image import triangulate
from mammometry.surface.repair.repair import Provenance, RepairedSurface

pytestmark = [pytest.mark.slow, pytest.mark.data]


@pytest.mark.requirement("R-VOL-1")
def test_a_casts_volume_is_within_half_a_percent_and_its_interval(shared_data: Path, tmp_path: Path) -> None:
    session = make_session(shared_data / "rendered", "plaster_b", tmp_path / "plaster_b")
    results = mm.open_session(session).run()
    true_cc = read_truth(shared_data / "rendered", "plaster_b").volumes_cc["model"]
    assert results.volumes_cc["model"] == pytest.approx(true_cc, rel=0.005)  # what its rim's black strip leaves
    interval = results.intervals_cc["model"]
    assert interval is not None
    assert interval[0] <= true_cc <= interval[1]
    assert results.watertight
    assert results.report is not None
    assert results.report.is_file()


@dataclass(frozen=True)
class Torso:
    """The rendered torso, measured from its photographs, and what is true of it in the renderer's frame, mm."""

    found: Mapping[str, VolumeMeasurement]
    true_cc: Mapping[str, float]
    """What stands out of the same body without the breasts."""
    skin: RepairedSurface
    as_measured: RepairedSurface
    """The same true skin, but seen where it was measured: a wall is fitted to as much of the trunk."""
    true_boundaries: tuple[Boundary, ...]
    found_boundaries: tuple[Boundary, ...]
    """As they were found, on the true skin."""

    def by_the_same_wall_cc(self, name: str, boundaries: tuple[Boundary, ...], skin: RepairedSurface) -> float:
        """What the kind of wall that was fitted makes of the true skin within a boundary."""
        opened = open_breasts(boundaries, skin, MeasureSettings())
        breast = next(each for each in opened if each.boundary.name == name)
        return chest_wall.fit(breast, self.found[name].wall_kind).closed.volume_mm3() / 1000


@pytest.fixture(scope="module")
def torso(shared_data: Path, tmp_path_factory: pytest.TempPathFactory) -> Torso:
    session = make_session(shared_data / "rendered", "torso", tmp_path_factory.mktemp("rendered") / "torso")
    job = mm.open_session(session)
    job.run()
    found = job.measure()
    truth = read_truth(shared_data / "rendered", "torso")
    rig_from_world = truth.world_from_rig.inverse()
    mesh = trimesh.load(truth.folder / "mesh.ply", process=False)
    skin = as_seen(TriangleMesh(vertices=np.asarray(mesh.vertices), faces=np.asarray(mesh.faces, dtype=np.int32)))
    repaired = job.surface().repaired
    away_mm, near = point_tree(rig_from_world.apply(repaired.mesh.vertices)).query(skin.mesh.vertices)
    return Torso(
        found=found,
        true_cc=truth.volumes_cc,
        skin=skin,
        as_measured=replace(
            skin, provenance=np.where(away_mm < 3.0, repaired.provenance[near], Provenance.INVENTED).astype(np.uint8)
        ),
        true_boundaries=tuple(
            Boundary(name=name, points_world=np.loadtxt(truth.folder / f"boundary_patient_{name}.xyz"), method="true")
            for name in SIDES
        ),
        found_boundaries=tuple(
            Boundary(name=name, points_world=rig_from_world.apply(found[name].boundary_world), method="found")
            for name in SIDES
        ),
    )


@pytest.mark.requirement("R-MASK-1")
def test_a_small_cast_on_a_speckled_board_is_measured(shared_data: Path, tmp_path: Path) -> None:
    """Two thirds of what the pairs see near are the board. The paper's casts are measured to 1 %."""
    session = make_session(shared_data / "rendered2", "plaster_c", tmp_path / "plaster_c")
    measured = mm.open_session(session).measure()["model"]
    true_cc = read_truth(shared_data / "rendered2", "plaster_c").volumes_cc["model"]
    assert measured.volume_cc == pytest.approx(true_cc, rel=0.01)
    assert measured.interval_cc is not None
    assert measured.interval_cc[0] <= true_cc <= measured.interval_cc[1]


@pytest.mark.xdist_group("rendered torso")
@pytest.mark.parametrize("name", SIDES)
def test_a_torsos_breast_is_off_as_documented(torso: Torso, name: str) -> None:
    """The wide interval holds the truth; the error itself is that of the wall on bodies of this family.

    Decision 9: +81 ± 44 cc over 60 breasts, for there the skin without the breast stands further out than the wall.
    """
    found = torso.found[name]
    error_cc = found.volume_cc - torso.true_cc[name]
    assert found.interval_cc is not None
    assert found.interval_cc[0] <= torso.true_cc[name] <= found.interval_cc[1]
    assert abs(error_cc - 81) < 2 * 44


@pytest.mark.xdist_group("rendered torso")
@pytest.mark.parametrize("name", SIDES)
@pytest.mark.requirement("R-VOL-2")
def test_a_torsos_skin_is_right_within_a_tenth_of_a_millimetre_over_the_base(torso: Torso, name: str) -> None:
    """The same wall, fitted to as much of the trunk, within the same boundary on the true skin.

    What is left is the error of cameras and surface: .7 cc a side. Where the true skin is seen further around, the
    trunk's axis lies elsewhere, and the wall .6 mm (decision 9).
    """
    found = torso.found[name]
    error_cc = found.volume_cc - torso.by_the_same_wall_cc(name, torso.found_boundaries, torso.as_measured)
    assert abs(error_cc) < 0.1 * found.base_area_cm2 / 10


@pytest.mark.xdist_group("rendered torso")
@pytest.mark.parametrize("name", ["left", "right"])
def test_a_torsos_narrow_interval_holds_what_its_wall_makes_of_true_skin_and_boundary(torso: Torso, name: str) -> None:
    as_defined = torso.found[name].as_defined_cc
    assert as_defined is not None
    assert as_defined[0] <= torso.by_the_same_wall_cc(name, torso.true_boundaries, torso.skin) <= as_defined[1]


def test_what_one_side_lacks_is_held_though_the_chest_beneath_is_no_mirror_image(shared_data: Path) -> None:
    """On the true skin. The renderer's 662 cc are before the left chest; its right chest lies 1.6 to 1.9 mm deeper."""
    truth = read_truth(shared_data / "rendered", "torso_one_side")
    mesh = trimesh.load(truth.folder / "mesh.ply", process=False)
    skin = as_seen(TriangleMesh(vertices=np.asarray(mesh.vertices), faces=np.asarray(mesh.faces, dtype=np.int32)))
    curve = np.loadtxt(truth.folder / "boundary_patient_left.xyz")
    body = find_body(skin, np.eye(3), boundaries=[curve])
    edge = Boundary(name="left", points_world=curve, method="true")
    breast = open_breasts((edge,), skin, MeasureSettings(), frame=body.frame)[0]
    found = volume_deficit(skin, (measure(edge, chest_wall.fit(breast)),), body)
    assert found is not None
    assert found.interval_cc is not None
    assert found.interval_cc[0] <= truth.volumes_cc["left"] <= found.interval_cc[1]
    # Beside the breasts the trunk is alike to .6 mm. That alone claimed ± 36 cc.
    assert found.volume_cc - truth.volumes_cc["left"] == pytest.approx(35.0, abs=10.0)  # 32 to 38 cc by depth alone


def test_a_real_cylinder_comes_out_round_and_of_its_size(shared_data: Path, tmp_path: Path, repository: Path) -> None:
    """Tolerances are the project's: the tube's own radius is not documented, 57.0 mm is the target's."""
    import runpy
    import sys

    sample_data = shared_data / "multidic" / "sample_data"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", ["make_sessions.py", str(sample_data), str(tmp_path)])
        runpy.run_path(str(repository / "examples" / "multidic" / "make_sessions.py"), run_name="__main__")
    job = mm.open_session(tmp_path / "1", mm.Settings().overridden([SETTINGS]))
    rig = job.calibrate().rig
    calibration = job.calibration()
    assert calibration is not None
    assert calibration.rms_px <= 0.55
    assert target_error_mm(calibration.observations, rig) <= 0.07
    share, points = speckled(sample_data, rig, triangulate(job.match()["front"]))
    fitted = fit_cylinder(points, np.array([0.0, 0.0, 1.0]), 57.0)
    assert share >= 0.995
    assert abs(fitted.radius_mm - 57.15) <= 0.15
    assert fitted.rms_mm <= 0.1
    assert fitted.kept > 0.99


def test_a_rail_before_the_body_carves_nothing_away(shared_data: Path, tmp_path: Path) -> None:
    """The same body behind a rail and an upright, which cut the silhouettes of all eight photographs in two.

    Half of it was carved away. Now 91 % of the skin that some pair could see is within 2 mm (decision 25).
    """
    job = mm.open_session(make_session(shared_data / "rendered", "torso_rail", tmp_path / "torso_rail"))
    found = job.surface().repaired.mesh
    assert set(job.plan[surface.occlusions]()) == set(job.calibrate().rig.cameras)
    truth = read_truth(shared_data / "rendered", "torso_rail")
    mesh = trimesh.load(truth.folder / "mesh.ply", process=False)
    seen = np.load(truth.folder / "visibility.npz")["pair_bits"].ravel() > 0
    skin = truth.world_from_rig.apply(np.asarray(mesh.vertices)[seen])[::20]
    away_mm = closest_on_mesh(skin, found).distances_mm
    assert np.median(away_mm) < 0.1
    assert (away_mm < 2.0).mean() > 0.88


@pytest.mark.parametrize("number", range(1, 7))
def test_both_breasts_of_another_generators_woman_are_measured_clean_and_scanned(
    shared_data: Path, number: int
) -> None:
    kinds = (("clean", "mm"), ("scan", "m"))
    clean, scan = (
        measured(shared_data / "scans" / f"body_{number}_{kind}.ply", units, report=False) for kind, units in kinds
    )
    assert not clean["no_breast"]
    assert not scan["no_breast"]
    for side in SIDES:
        own, true = scan["sides"][side], clean["sides"][side]
        # 15 and 16 % for body 6, whose border has two near-equal solutions (decision 53); 7 % for the others.
        assert own["volume_cc"] == pytest.approx(true["volume_cc"], rel=0.17 if number == 6 else 0.07)
        assert own["interval_cc"][0] < true["volume_cc"] < own["interval_cc"][1]
