"""A tiny virtual session against its truth, from the command line."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree

from mammometry.cli import main
from mammometry.io.truth import read_truth
from mammometry.report.figures.canvas import caption_of
from mammometry.study.rays import RayScene, seen_by_pairs


def evaluated(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, dict]:
    code = main.run(["evaluate", *arguments, "--json"])
    return code, json.loads(capsys.readouterr().out)


def hidden_mm(session: Path) -> float:
    """Mean distance of a cast's true base from the true skin that its pair sees, mm."""
    truth = read_truth(session / "truth", {"front": ("front_left", "front_right")})
    looked_at, by_pair = seen_by_pairs(RayScene(truth.mesh), truth.rig, every=1)
    seen = truth.mesh.vertices[looked_at[by_pair["front"]]]
    return float(cKDTree(seen).query(truth.boundaries["model"])[0].mean())


@pytest.mark.slow
def test_every_stage_is_judged(
    tiny_finished: Path, tiny_settings: Path, tiny_demo: dict, capsys: pytest.CaptureFixture[str]
) -> None:
    before = {path: path.stat().st_mtime_ns for path in tiny_finished.rglob("*") if path.is_file()}
    code, table = evaluated(capsys, str(tiny_finished), "--settings", str(tiny_settings))
    assert code == 0, table
    # Corners to .05 px, 1900 of them for a camera's 15 unknowns: .05·√(15/1900) px, and twice that.
    calibration = table["calibration"]
    assert 0 < calibration["projection_rms_px"] < 0.01
    # A pixel of disparity is 3.5 mm of depth here (`test_tilted_plate`).
    assert 0 < calibration["worst_pair_triangulation_mm"] < 0.04
    assert calibration["worst_pair"] == "front"
    assert set(calibration["cameras"]) == {"front_left", "front_right"}
    matching = table["matching"]["front"]
    assert matching["median_px"] < 0.06
    assert matching["complete_percent"] > 99
    assert abs(table["ranges"]["front"]["bias_mm"]) < 0.18  # .05 px, common to all
    for name in ("first", "repaired"):
        surface = table["surfaces"][name]
        assert surface["unaligned"]["median_mm"] < 0.21  # .06 px, as of matching
        assert surface["aligned"]["rms_mm"] <= surface["unaligned"]["rms_mm"] * 1.05
    assert 50 < table["surfaces"]["repaired"]["claimed"]["claimed_percent"] <= 100
    # One pair sees part of this rim. Where it does not, the curve is off by no more than skin hides.
    assert table["boundaries"]["model"]["mean_mm"] < hidden_mm(tiny_finished)
    volume = table["volumes"]["model"]
    mesh = trimesh.load(tiny_finished / "truth" / "mesh.ply", process=False)
    assert volume["true_cc"] == pytest.approx(mesh.volume / 1000, rel=1e-6)
    assert volume["measured_cc"] == pytest.approx(tiny_demo["volumes_cc"]["model"], abs=1e-3)
    low, high = volume["interval_cc"]
    assert volume["covered"] == (low <= volume["true_cc"] <= high)
    folder = tiny_finished / "evaluation"
    assert json.loads((folder / "evaluation.json").read_text()).items() <= table.items()
    written = (folder / "evaluation.md").read_text(encoding="utf-8")
    for stage in ("Calibration", "Silhouettes", "Matching", "Range images", "Surface", "Boundary", "Volume"):
        assert f"**{stage}" in written
    assert "mm" in caption_of((folder / "error-map.png").read_bytes()).text
    assert {path: path.stat().st_mtime_ns for path in before} == before  # results and photographs are as they were
    assert main.run(["evaluate", str(tiny_finished), "--settings", str(tiny_settings)]) == 0  # replaces the first one
    assert "holds" in capsys.readouterr().out


def test_stages_without_results_are_left_out(
    tiny_finished: Path, tiny_settings: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for stage in ("match", "surface", "measure", "report"):
        shutil.rmtree(tiny_finished / "results" / stage)
    code, table = evaluated(capsys, str(tiny_finished), "--settings", str(tiny_settings))
    assert code == 0
    assert table["calibration"]["projection_rms_px"] < 0.01
    assert (table["matching"], table["surfaces"], table["volumes"]) == ({}, {}, {})
    assert not (tiny_finished / "evaluation" / "error-map.png").exists()


def test_no_results_no_truth_and_stale_results(
    tiny_finished: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = tmp_path / "other.toml"
    other.write_text("[calibration.quality]\nfocal_std_refuse = 0.01\n")
    code, table = evaluated(capsys, str(tiny_finished), "--settings", str(other))
    assert (code, table["found"]) == (3, "results of other photographs or settings")
    shutil.rmtree(tiny_finished / "results")
    code, table = evaluated(capsys, str(tiny_finished))
    assert (code, table["found"]) == (3, "no results")
    shutil.rmtree(tiny_finished / "truth")
    code, table = evaluated(capsys, str(tiny_finished))
    assert (code, table["found"]) == (3, "no truth.json")
    (tmp_path / "bad").mkdir()
    (tmp_path / "bad" / "truth.json").write_text("{}")
    code, table = evaluated(capsys, str(tiny_finished), "--truth", str(tmp_path / "bad"))
    assert code == 3
    assert "Traceback" not in table["error"]


@pytest.mark.parametrize(
    "what",
    [pytest.param("size", marks=pytest.mark.slow), "rig", pytest.param("name", marks=pytest.mark.slow), "picture"],
)
def test_truth_of_something_else_is_refused(
    tiny_finished: Path, tiny_settings: Path, capsys: pytest.CaptureFixture[str], what: str
) -> None:
    truth = tiny_finished / "truth"
    if what == "size":  # another subject: half as large again
        mesh = trimesh.load(truth / "mesh.ply", process=False)
        mesh.vertices = mesh.centroid + 1.5 * (mesh.vertices - mesh.centroid)
        (truth / "mesh.ply").write_bytes(trimesh.exchange.ply.export_ply(mesh, vertex_normal=False))
    elif what == "name":
        facts = json.loads((truth / "truth.json").read_text())
        (truth / "truth.json").write_text(json.dumps(facts | {"volumes_cc": {"left": 300.0, "right": 310.0}}))
    else:
        cameras = json.loads((truth / "cameras.json").read_text())
        for number, camera in enumerate(cameras["cameras"].values()):
            if what == "picture":
                camera["image_size"] = [4504, 3000]
            elif number:
                camera["K"] = (np.array(camera["K"]) * [[1.3, 1, 1], [1, 1.3, 1], [1, 1, 1]]).tolist()
        (truth / "cameras.json").write_text(json.dumps(cameras))
    code, table = evaluated(capsys, str(tiny_finished), "--settings", str(tiny_settings))
    assert (code, table["kind"]) == (3, "SessionError")
    said = {
        "size": "results of another subject",
        "name": "model among the results",
        "rig": "results of another rig",
        "picture": "4504 × 3000 pixels",
    }
    assert said[what] in table["error"]
    assert not (tiny_finished / "evaluation").exists()
