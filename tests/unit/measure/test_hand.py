"""A hand that lies on a virtual woman's breast, as a telephone scans both."""

from functools import partial
from html import unescape
from pathlib import Path

import pytest
from benchmarks.hand import with_hand

from mammometry.api.mesh import MeshFiles, MeshJob
from mammometry.geometry.mesh_files.ply import write_ply
from mammometry.measure.settings import MeasureSettings
from mammometry.settings import Settings
from mammometry.simulate.disturbances.registry import disturbed
from mammometry.simulate.recipe import parse_situation
from mammometry.simulate.scan import QUALITIES, scan
from mammometry.simulate.subjects.registry import make_subject


@pytest.mark.slow
@pytest.mark.requirement("R-VOL-12")
def test_a_breast_under_a_hand_is_not_measured_unless_somebody_confirmed_that_it_is_bare(tmp_path: Path) -> None:
    reshape = partial(disturbed, stage="patient", situation=parse_situation("posture=standing"), seed=8001)
    bare = make_subject("torso_8001", 0, edge_mm=2.5, reshape=reshape)
    covered = with_hand(bare, "left", fingers_deg=135.0, shift_mm=(20.0, -20.0))
    assert covered.volumes_cc == bare.volumes_cc
    made = scan(covered, QUALITIES["telephone"], 1)
    write_ply(tmp_path / "a.ply", made.mesh, made.ply_colours)
    files = MeshFiles(mesh=tmp_path / "a.ply", units="mm", automatic=True)
    results = MeshJob(files, tmp_path / "out").run()
    assert set(results.volumes_cc) == {"right"}
    why = results.no_breast["left"]
    assert "hand" in why
    assert results.report is not None
    page = unescape(results.report.read_text(encoding="utf-8")).replace("\u00a0", " ")
    assert why[1:] in page  # where a sentence of it begins with a capital
    confirmed = Settings(measure=MeasureSettings(bare_confirmed=True))
    results = MeshJob(files, tmp_path / "sure", confirmed).run(report=False)
    # Whoever confirms is believed: the hand counts as breast.
    assert results.volumes_cc["left"] > bare.volumes_cc["left"]
    assert "left" not in results.no_breast
