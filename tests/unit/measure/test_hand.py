"""A hand that lies on a virtual woman's breast, as a telephone scans both."""

from functools import partial
from html import unescape
from pathlib import Path

import pytest

from mammometry.api.mesh import MeshFiles, MeshJob
from mammometry.io.meshes.own import write_ply
from mammometry.simulate.disturbances.registry import disturbed
from mammometry.simulate.recipe import parse_situation
from mammometry.simulate.scan import QUALITIES, scan
from mammometry.simulate.subjects.hand import with_hand
from mammometry.simulate.subjects.registry import make_subject


@pytest.mark.slow
@pytest.mark.requirement("R-VOL-12")
def test_a_hand_is_said_by_side_in_terminal_report_and_first_page(tmp_path: Path) -> None:
    reshape = partial(disturbed, stage="patient", situation=parse_situation("posture=standing"), seed=8001)
    bare = make_subject("torso_8001", 0, edge_mm=2.5, reshape=reshape)
    covered = with_hand(bare, "left", fingers_deg=135.0, shift_mm=(20.0, -20.0))
    assert covered.volumes_cc == bare.volumes_cc
    made = scan(covered, QUALITIES["telephone"], 1)
    write_ply(tmp_path / "a.ply", made.mesh, made.ply_colours)
    results = MeshJob(MeshFiles(mesh=tmp_path / "a.ply", units="mm", automatic=True), tmp_path / "out").run()
    assert results.volumes_cc["left"] > 1.2 * bare.volumes_cc["left"]  # what the warning is for
    (said,) = (note for note in results.notes if "lies on the" in note)
    assert "left breast" in said
    assert results.report is not None
    page = unescape(results.report.read_text(encoding="utf-8")).replace("\u00a0", " ")
    assert page.index("do not use this volume: something lies on the breast") < page.index(said)
