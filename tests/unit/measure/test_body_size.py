"""A body against the sizes of adults: a wrong unit or board is refused, an ordinary large or small person is not."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
import trimesh
from tests.unit.measure.trunks import LEFT, RADIUS_MM, RIGHT, edge_of, radius_mm, trunk_mesh

from mammometry.api.mesh import MeshFiles, MeshJob
from mammometry.base.errors import MeasureError
from mammometry.cli import main
from mammometry.geometry.mesh import TriangleMesh
from mammometry.job.stages import measure
from mammometry.measure import scanned
from mammometry.measure.settings import MeasureSettings
from mammometry.measure.shape.body_size import ADULTS, BodySize, require_adult
from mammometry.measure.trunk.thorax import seen_skin, trunk_breadth_mm
from mammometry.settings import Settings

# Trunk breadth, nipple distance, notch to nipple, mm.
ORDINARY = {
    "average woman": (269, 203, 198),  # ANSUR II; doi 10.1097/GOX.0000000000002326
    "average man": (289, 210, 200),  # ANSUR II; doi 10.1097/00000637-199601000-00007
    "small thin woman": (230, 165, 165),
    "obese woman with large breasts": (400, 280, 351),  # notch to nipple: mean before reductions, PMID 28403022
    "tall broad man": (350, 260, 235),
}


def size_of(trunk: float, nipples: float, notch: float, factor: float = 1.0) -> BodySize:
    named = zip(("trunk", "nipples", "notch"), (trunk, nipples, notch), strict=True)
    return BodySize(lengths_mm={name: factor * mm for name, mm in named})


@pytest.mark.parametrize("name", ORDINARY)
def test_an_ordinary_person_is_not_refused(name: str) -> None:
    size = size_of(*ORDINARY[name])
    assert not size.is_impossible
    assert size.is_rare == (name == "obese woman with large breasts")
    require_adult(size, MeasureSettings())


@pytest.mark.parametrize("factor", [0.1, 1 / 2.54, 0.5, 2.54, 10.0])
@pytest.mark.parametrize("name", ["average woman", "average man", "small thin woman", "tall broad man"])
@pytest.mark.requirement("R-UNIT-3")
def test_every_unit_twin_of_an_ordinary_person_is_noticed(name: str, factor: float) -> None:
    size = size_of(*ORDINARY[name], factor)
    assert size.is_rare
    assert size.is_impossible or name == "tall broad man"
    assert size.factor * factor == pytest.approx(size_of(*ORDINARY[name]).factor, rel=0.06)


@pytest.mark.parametrize("factor", [0.7, 1.5])
def test_an_average_body_of_a_model_without_scale_is_noticed(factor: float) -> None:
    assert size_of(*ORDINARY["average woman"], factor).is_rare


@pytest.mark.parametrize("lengths", [(327, 327, 205), (280, 205, 369), (400, 180, 205)])
@pytest.mark.requirement("R-UNIT-3")
def test_one_length_that_is_too_large_is_warned_of_though_the_others_are_usual(
    lengths: tuple[float, float, float],
) -> None:
    """Shared hanging scans × 1.5 have such nipples or such a notch, mm."""
    size = size_of(*lengths)
    assert abs(size.deviations) < 2.33
    assert size.is_rare
    assert not size.is_impossible
    assert size.words == "large"
    assert not size_of(280, 130, 240).is_rare  # a virtual woman with hanging breasts


@pytest.mark.requirement("R-UNIT-3")
def test_a_size_that_is_unknown_is_said() -> None:
    unknown = BodySize(lengths_mm={})
    assert (unknown.is_rare, unknown.is_impossible, unknown.factor) == (False, False, 1.0)
    assert unknown.notice is not None
    assert unknown.notice.code == "body-size-unknown"
    assert size_of(*ORDINARY["average woman"]).notice is None
    rare = size_of(327, 327, 205)
    assert rare.notice is not None
    assert rare.notice.code == "body-size-rare"
    assert rare.notice.values["factor"] == rare.factor
    assert rare.notice.values["volume_factor"] == pytest.approx(rare.factor**3)


def test_one_length_alone_refuses_what_is_absurd_and_several_that_disagree_nothing() -> None:
    assert BodySize(lengths_mm={"trunk": 621.0}).is_impossible  # shared body 6, its centimetres read as inches
    alone = BodySize(lengths_mm={"trunk": 500.0})
    assert alone.is_rare
    assert not alone.is_impossible
    assert not size_of(700, 205, 700).is_impossible  # one of them is a usual one


def test_ranges_hold_what_they_say() -> None:
    """Between the deviations of the normal distribution: 98 and 99.9 % on both sides."""
    for adult in ADULTS.values():
        (low, high), (least, most) = adult.within_mm(2.326), adult.within_mm(3.291)
        assert np.log(adult.median_mm / low) / 2.326 == pytest.approx(adult.below)
        assert np.log(most / adult.median_mm) / 3.291 == pytest.approx(adult.above)
        assert least < low < adult.median_mm < high < most


def apex(breast: tuple[float, float, float, float]) -> np.ndarray:
    angle, height = breast[:2]
    out = radius_mm(np.array([angle]), np.array([height]))[0]
    return np.array([out * np.sin(angle), height, out * np.cos(angle)])


def files(folder: Path, factor: float) -> MeshFiles:
    """A trunk with drawn boundaries and picked nipples, its lengths times a factor."""
    mesh = trunk_mesh(8.0)
    mesh = mesh.submesh(mesh.corners().mean(axis=1)[:, 2] > -40)
    curves = {"left": edge_of(LEFT, "left"), "right": edge_of(RIGHT, "right")}
    tables = {
        "b.json": {"boundaries": {s: {"points": (factor * c.points_world).tolist()} for s, c in curves.items()}},
        "l.json": {
            "landmarks": {
                f"nipple_{side}": {"points": [(factor * apex(breast)).tolist()]}
                for side, breast in (("left", LEFT), ("right", RIGHT))
            }
        },
    }
    for name, table in tables.items():
        (folder / name).write_text(json.dumps(table))
    mesh = TriangleMesh(vertices=factor * mesh.vertices, faces=mesh.faces)
    trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).export(folder / "a.ply")
    return MeshFiles(mesh=folder / "a.ply", units="mm", boundary=folder / "b.json", landmarks=folder / "l.json")


@pytest.mark.parametrize("factor", [0.3937, 0.7, 1.0, 1.5, 2.54, 10.0])
def test_the_trunks_breadth_scales_with_the_body(factor: float) -> None:
    mesh = trunk_mesh(8.0)
    mesh = mesh.submesh(mesh.corners().mean(axis=1)[:, 2] > -40).mapped(lambda points: factor * points)
    skin = seen_skin(scanned.as_scanned(mesh))
    breadth_mm = trunk_breadth_mm(skin, np.eye(3), height_of=np.array([0.0, 0.0, 0.0]))
    assert breadth_mm == pytest.approx(factor * 2 * RADIUS_MM, rel=0.03)  # skin of 75 to 100° shows .98 of it


@pytest.mark.slow
@pytest.mark.requirement("R-UNIT-3")
def test_centimetres_as_inches_are_refused_with_factor_and_unit(tmp_path: Path) -> None:
    """Before there is a volume, for every road that asks for one."""
    job = MeshJob(files(tmp_path, 2.54), tmp_path / "out")
    with pytest.raises(MeasureError) as refused:
        job.plan[measure.measurements]()
    assert refused.value.subject == "torso"
    true = BodySize(lengths_mm={"trunk": 2 * RADIUS_MM, "nipples": float(np.linalg.norm(apex(LEFT) - apex(RIGHT)))})
    assert float(re.findall(r"× (\S+)", str(refused.value))[0]) == pytest.approx(true.factor / 2.54, rel=0.05)
    assert "--units" in refused.value.remedy


@pytest.mark.slow
def test_a_refusal_names_the_unit_and_a_confirmed_size_is_measured(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    given = files(tmp_path, 2.54)
    call = [*("measure", str(given.mesh), "--units", "mm", "--out", str(tmp_path / "out"), "--json")]
    call += ["--boundary", str(given.boundary), "--landmarks", str(given.landmarks)]
    assert main.run(call) == 8
    answer = json.loads(capsys.readouterr().out)
    error = answer["error"]
    assert (answer["code"], answer["subject"]) == ("measurement", "torso")
    assert "--units" in error
    assert re.search(r"\bmm, ", error)
    assert not list((tmp_path / "out").glob("**/measurement.json"))
    confirmed = Settings(measure=MeasureSettings(size_confirmed=True))
    results = MeshJob(given, tmp_path / "sure", confirmed).run(report=False)
    assert set(results.measurements) == {"left", "right"}
    assert "body-size-rare" in {notice.code for notice in results.notices}
    assert (results.notices[-1].code, results.notices[-1].values) == ("posture", {"posture": "not given"})
