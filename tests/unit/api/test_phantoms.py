"""Bookkeeping of the nine-model study: what is made once, handed on, and comes out; the stages are stand-ins."""

import json
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from mammometry.api import truth
from mammometry.api.truth import PhantomResult, as_csv, measure_phantoms, paired
from mammometry.base.errors import CalibrationError, MeasureError, SessionError, SurfaceError
from mammometry.io.paired_tables import read_pairs
from mammometry.simulate.recipe import SessionRecipe

MODELS = ("plaster_1", "plaster_2", "plaster_3")


@dataclass
class Bench:
    simulated: list[tuple[str, float, int]]
    measured: list[str]
    calibrated: list[str]


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch) -> Bench:
    """Stand-ins for simulation and main job: model k has 100 k cc and is measured 1 cc too large."""
    did = Bench(simulated=[], measured=[], calibrated=[])

    def write_session(out: Path, recipe: SessionRecipe, *, progress: object) -> None:
        did.simulated.append((recipe.subject, recipe.scale, recipe.seed))
        (out / "truth").mkdir(parents=True)
        (out / "session.toml").write_text("")
        volume = 100.0 * int(recipe.subject[-1])
        (out / "truth" / "truth.json").write_text(json.dumps({"volumes_cc": {"model": volume}}))

    def open_session(session: Path, settings: object) -> SimpleNamespace:
        def run(*, report: bool) -> SimpleNamespace:
            did.measured.append(session.name)
            cameras = session / "results" / "calibrate" / "cameras.json"
            if not cameras.exists():
                did.calibrated.append(session.name)
                cameras.parent.mkdir(parents=True)
                cameras.write_text("{}")
            volume = 100.0 * int(session.name[-1]) + 1
            interval = (volume - 0.5, volume + 0.5) if session.name == "plaster_2" else (volume - 2, volume + 2)
            return SimpleNamespace(measurements={"model": SimpleNamespace(volume_cc=volume, interval_cc=interval)})

        return SimpleNamespace(run=run)

    monkeypatch.setattr(truth, "write_session", write_session)
    monkeypatch.setattr(truth, "open_session", open_session)
    return did


def test_one_calibration_serves_all_and_nothing_is_simulated_twice(tmp_path: Path, bench: Bench) -> None:
    out = tmp_path / "study"
    first = measure_phantoms(out, scale=0.5, seed=3, models=MODELS)
    assert bench.simulated == [(model, 0.5, 3) for model in MODELS]
    assert bench.calibrated == ["plaster_1"]
    assert [result.true_cc for result in first] == [100, 200, 300]
    assert [result.holds for result in first] == [True, False, True]
    again = measure_phantoms(out, scale=0.5, seed=3, models=MODELS)
    assert again == first
    assert len(bench.simulated) == 3
    with pytest.raises(SessionError, match="scale"):
        measure_phantoms(out, scale=0.25, seed=3, models=MODELS)


@pytest.mark.parametrize("record", ["[" * 100_000, '{"scale": 1' + "0" * 400 + "}", "[]"])
def test_a_folder_with_another_study_json_is_not_taken(tmp_path: Path, bench: Bench, record: str) -> None:
    (tmp_path / "study.json").write_text(record)
    with pytest.raises(SessionError, match=r"study.json"):
        measure_phantoms(tmp_path, scale=0.5, seed=3, models=MODELS)
    assert bench.simulated == []


def test_the_results_are_a_table_of_an_agreement_study(tmp_path: Path, bench: Bench) -> None:
    results = measure_phantoms(tmp_path / "study", models=MODELS)
    data = paired(results)
    assert np.array_equal(data.differences, [1, 1, 1])
    path = tmp_path / "table.csv"
    path.write_text(as_csv(results))
    read = read_pairs(path, reference="reference_cc", measured="measured_cc")
    assert (read.names, read.unit) == (MODELS, "cc")
    assert np.array_equal(read.measured, data.measured)


def test_a_refused_model_does_not_end_the_study(tmp_path: Path, bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    stand_in = truth.open_session

    def refusing(session: Path, settings: object) -> object:
        if session.name == "plaster_3":
            raise SurfaceError("surface", found="a hole", expected="none", remedy="Close it")
        return stand_in(session, settings)

    monkeypatch.setattr(truth, "open_session", refusing)
    models = (*MODELS, "plaster_4")
    results = measure_phantoms(tmp_path / "study", models=models)
    assert [result.measured_cc for result in results] == [101, 201, None, 401]
    assert [bool(result.failed) for result in results] == [False, False, True, False]
    assert (results[2].true_cc, results[2].holds) == (300, None)
    assert "hole" in results[2].failed
    assert paired(results).names == ("plaster_1", "plaster_2", "plaster_4")
    assert [row.split(",")[0] for row in as_csv(results).splitlines()[1:]] == ["plaster_1", "plaster_2", "plaster_4"]
    with pytest.raises(MeasureError, match=r"^plaster_3: .*\b2 .*hole"):
        paired(results[:3])


def test_a_refused_calibration_ends_the_study_with_its_own_error(
    tmp_path: Path, bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refusing(session: Path, settings: object) -> object:
        raise CalibrationError("camera a", found="2 views", expected="3", remedy="Take them again")

    monkeypatch.setattr(truth, "open_session", refusing)
    with pytest.raises(CalibrationError, match=r"\b2 .*\b3\. .*--scale") as caught:
        measure_phantoms(tmp_path / "study", models=MODELS)
    assert caught.value.exit_code == 5
    assert [name for name, *_ in bench.simulated] == ["plaster_1"]


def test_no_interval_is_neither_right_nor_wrong() -> None:
    result = PhantomResult(name="plaster_1", true_cc=1.0, measured_cc=1.0, interval_cc=None)
    assert result.holds is None
    assert as_csv([result]).splitlines()[1] == "plaster_1,1.0000,1.0000,,"
