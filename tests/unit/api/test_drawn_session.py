"""What is drawn in a session is measured, told and confirmed as what it is; nothing else becomes another."""

import json
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from benchmarks.accuracy.dates import TrueVisit, true_visit
from dated_session import put_results, rig, write_session
from tests.unit.measure.solids import given_surface

from mammometry.api.job import open_session
from mammometry.cli.main import run
from mammometry.io.drawn_changes import ItemChange, change_drawn, drawn_entries, drawn_entry, entry_digest
from mammometry.job.graph import Plan
from mammometry.job.method import method
from mammometry.job.stages import measure
from mammometry.measure.volume.attribution import attributed, curve_digest
from mammometry.settings import Settings
from mammometry.simulate.subjects.torso_shape import torso_shape

LEFT, RIGHT = ("boundaries", "left"), ("boundaries", "right")


@pytest.fixture(scope="module")
def true() -> TrueVisit:
    return true_visit(torso_shape("torso_2", 0), "torso_2", 2, edge_mm=3.5)


@pytest.fixture(scope="module")
def folder(true: TrueVisit, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Automatic boundaries, as they were found."""
    folder = write_session(tmp_path_factory.mktemp("drawn") / "session", true, 3, drawn=False)
    put_results(folder, true)
    return folder


@pytest.fixture
def session(folder: Path) -> Iterator[Path]:
    """That session, with nothing drawn."""
    yield folder
    for name in ("boundaries.json", "landmarks.json"):
        (folder / name).unlink(missing_ok=True)


def keys(session: Path) -> tuple[str, ...]:
    job = open_session(session)
    boundaries, measurements = job.plan[measure.boundaries].key, job.plan[measure.measurements].key
    return boundaries.digest, measurements.digest, job.report_key.digest, job.content_key.digest


def confirm(session: Path, curve: np.ndarray) -> None:
    seen = {"by": "C. Eye", "at": "2026-11-22T10:00:00Z", "curve": curve_digest(curve)}
    base = entry_digest(drawn_entries(session, "torso").get(LEFT))
    change = ItemChange(entry={"automatic": True, "confirmed": seen}, base=base)
    change_drawn(session, "torso", {LEFT: change})


@pytest.mark.slow
def test_a_landmark_changes_no_boundary_and_no_volume(session: Path) -> None:
    before = keys(session)
    mark = drawn_entry(np.array([[1.0, 2.0, 3.0]]), method="picked by hand", author="A. Nurse")
    change_drawn(session, "torso", {("landmarks", "sternal_notch"): ItemChange(entry=mark, base=None)})
    assert keys(session)[:2] == before[:2]


@pytest.mark.slow
def test_a_confirmed_automatic_boundary_is_told_and_nothing_is_measured_anew(
    session: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = keys(session)
    made = {each.name: each for each in open_session(session).plan[measure.measurements]()}
    confirm(session, made["left"].boundary_world)
    after = keys(session)
    assert after[:2] == before[:2]
    assert after[2] != before[2]  # the report is rendered again and says it
    assert after[3] == before[3]  # its content is current

    given_attributions = open_session(session).inputs.attributions
    left = attributed(made["left"], given_attributions)
    assert left.interval_cc == made["left"].interval_cc
    assert re.match(r"automatic; .*C\. Eye .*2026-11-22$", left.boundary_method)
    assert attributed(made["left"], given_attributions, named=False).boundary_method.endswith("; confirmed by eye")
    assert left.boundary_remarks == ("confirmed",)
    assert attributed(made["right"], given_attributions).boundary_remarks == ("to-be-confirmed",)
    assert run(["info", str(session)]) == 0
    assert "C. Eye on 2026-11-22" in capsys.readouterr().out

    confirm(session, made["left"].boundary_world + 1.0)  # settings were others then
    left = attributed(made["left"], open_session(session).inputs.attributions)
    assert left.boundary_remarks == ("to-be-confirmed",)
    assert re.search(r"C\. Eye on 2026-11-22, ", left.boundary_method)


@pytest.mark.slow
def test_one_drawn_breast_leaves_the_other_automatic(session: Path, true: TrueVisit) -> None:
    drawn = true.torso.boundaries[0]
    assert drawn.name == "left"
    entry = drawn_entry(drawn.points_world, method="edited by hand", author="A. Nurse")
    change_drawn(session, "torso", {LEFT: ItemChange(entry=entry, base=None)})
    assert json.loads((session / "boundaries.json").read_text())["boundaries"]["right"] == {"automatic": True}
    given = given_surface(true.torso.surface, rig())
    plan = Plan(method, open_session(session).inputs, Settings(), None, stages=("measure",), given=given)
    left, right = plan[measure.boundaries]()
    assert np.array_equal(left.points_world, drawn.points_world)
    assert left.method.startswith(f"given: {len(drawn.points_world)} points, ")
    assert left.remarks == ("given",)
    assert right.name == "right"
    assert right.method.startswith("automatic")
    assert "to-be-confirmed" in right.remarks
