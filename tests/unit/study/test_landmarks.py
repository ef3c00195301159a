"""Scores of landmarks and borders against closed forms, and faults of the two files."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from benchmarks.accuracy.landmarks import fold_curve

from mammometry.base.errors import TableError
from mammometry.cli import main
from mammometry.io.truth import read_found_landmarks, read_true_landmarks
from mammometry.study.landmarks import FORMS, Score, TrueWoman, distance_mm, score_tables, scores


def circle(radius_mm: float, middle_mm: tuple[float, float, float] = (0.0, 0.0, 0.0), turn: float = 0.0) -> np.ndarray:
    t = turn + 2 * np.pi * np.arange(720) / 720
    return np.array(middle_mm) + radius_mm * np.stack([np.cos(t), np.sin(t), 0 * t], axis=1)


def woman(kind: str = "clean", absent: tuple[str, ...] = (), **places: object) -> TrueWoman:
    return TrueWoman(
        kind=kind,
        generator="none",
        mesh="none.ply",
        places={name: np.array(place, dtype=float).reshape(-1, 3) for name, place in places.items()},
        absent=absent,
    )


def found(**places: object) -> dict[str, np.ndarray]:
    return dict(woman(**places).places)


def of(scored: tuple[Score, ...], landmark: str, kind: str = "clean") -> Score:
    (only,) = (one for one in scored if (one.landmark, one.kind) == (landmark, kind))
    return only


@pytest.mark.requirement("R-MARK-1")
def test_distances_of_points_lines_and_curves_are_their_closed_forms() -> None:
    assert distance_mm("point", np.array([[3.0, 4.0, 0.0]]), np.zeros((1, 3))) == 5.0
    assert distance_mm("curve", circle(65.0, turn=1.0), circle(60.0)) == pytest.approx(5.0, abs=0.01)
    lifted = circle(60.0, (0.0, 0.0, 7.0))[::-1]  # another direction and another beginning are the same curve
    assert distance_mm("curve", lifted, circle(60.0)) == pytest.approx(7.0, abs=0.01)
    true = np.array([[0.0, 0.0, 0.0], [0.0, 100.0, 0.0]])
    beyond = np.array([[3.0, 150.0, 0.0], [3.0, -50.0, 0.0]])  # a line may go on where the truth ends
    assert distance_mm("line", beyond, true) == pytest.approx(3.0, abs=0.01)
    half = np.array([[0.0, 0.0, 0.0], [0.0, 50.0, 0.0]])  # but not end before: 0 over one half, then 0 to 50
    assert distance_mm("line", half, true) == pytest.approx(12.5, abs=0.05)


def test_an_arc_of_the_true_border_is_not_the_border() -> None:
    """The mean of both directions: a part of a curve lies on it, but the rest of the curve has no counterpart."""
    quarter = circle(60.0)[:180]
    one_way = distance_mm("line", circle(60.0), quarter)
    assert one_way == pytest.approx(0.0, abs=0.05)  # of a step between its points
    assert distance_mm("curve", quarter, circle(60.0)) > 10.0


@pytest.mark.requirement("R-MARK-1")
def test_found_missing_and_invented_places_are_counted_by_kind() -> None:
    truth = {
        "a": woman(nipple_left=[0, 0, 0], nipple_right=[-100, 0, 0], sternal_notch=[0, 90, 0]),
        "b": woman(nipple_left=[0, 0, 0], absent=("nipple_right",)),
        "c": woman(kind="telephone", nipple_left=[0, 0, 0]),
    }
    output = {
        "a": found(nipple_left=[1, 0, 0], nipple_right=[-100, 3, 0]),
        "b": found(nipple_left=[0, 0, 8], nipple_right=[0, 0, 0], umbilicus=[0, -99, 0]),
    }
    scored = scores(output, truth)
    nipple = of(scored, "nipple")
    assert (nipple.found, nipple.true, nipple.invented) == (3, 3, 1)
    assert (nipple.median_mm, nipple.mean_mm, nipple.worst_mm) == (3.0, 4.0, 8.0)
    assert nipple.p95_mm == pytest.approx(7.5)
    assert of(scored, "sternal_notch").found == 0
    telephone = of(scored, "nipple", "telephone")  # she is not in the output at all
    assert (telephone.found, telephone.true, telephone.median_mm) == (0, 1, None)
    assert {one.landmark for one in scored} == {"nipple", "sternal_notch"}  # nothing is known of a navel
    assert len(score_tables(scored)[0].rows) == 3


@pytest.mark.parametrize(
    "spoil",
    [
        lambda points: points / 1000,  # metres
        lambda points: points[:, [2, 0, 1]],  # other axes
        lambda points: points * [-1, 1, 1],  # the observer's left
        lambda points: points + np.array([0, 0, 400]),  # another origin
    ],
)
@pytest.mark.requirement("R-MARK-1")
def test_another_frame_is_refused(spoil: Callable[[np.ndarray], np.ndarray]) -> None:
    places = {
        "nipple_left": [110, 1150, 160],
        "nipple_right": [-110, 1150, 160],
        "border_left": circle(60, (110, 1150, 90)),
    }
    truth = {"a": woman(**places)}
    right = {"a": found(**places)}
    assert all(one.worst_mm == pytest.approx(0.0, abs=0.05) for one in scores(right, truth))
    with pytest.raises(TableError):
        scores({"a": {name: spoil(points) for name, points in right["a"].items()}}, truth)


def test_a_woman_who_is_not_in_the_truth_is_refused() -> None:
    with pytest.raises(TableError):
        scores({"A": found(nipple_left=[0, 0, 0])}, {"a": woman(nipple_left=[0, 0, 0])})


def test_the_fold_of_a_circle_is_its_lower_quarter() -> None:
    fold = fold_curve(circle(60.0, (10.0, 20.0, 30.0), turn=-1.6), np.eye(3))  # begins within the fold
    angle = np.degrees(np.arctan2(fold[:, 0] - 10.0, 20.0 - fold[:, 1]))
    assert (angle.min(), angle.max()) == pytest.approx((-45.0, 45.0), abs=1.5)
    assert np.linalg.norm(np.diff(fold, axis=0), axis=1).max() < 1.1  # in order


TRUTH = {
    "women": {
        "a": {
            "kind": "clean", "generator": "none", "mesh": "a.ply",
            "landmarks": {"nipple_left": [[0, 0, 0]], "border_left": circle(60.0).tolist()}, "absent": ["nipple_right"],
        }
    }
}  # fmt: skip


@pytest.mark.requirement("R-MARK-1")
def test_the_command_scores_a_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    output, truth = tmp_path / "output.json", tmp_path / "truth.json"
    truth.write_text(json.dumps(TRUTH))
    output.write_text(json.dumps({"a": {"nipple_left": [0, 6, 8], "nipple_right": None}}))
    assert main.run(["study", "landmarks", str(output), str(truth), "--json"]) == 0
    nipple, border = json.loads(capsys.readouterr().out)["scores"]
    assert (nipple["landmark"], nipple["found"], nipple["invented"], nipple["median_mm"]) == ("nipple", 1, 0, 10.0)
    assert (border["landmark"], border["found"], border["true"], border["median_mm"]) == ("border", 0, 1, None)


@pytest.mark.parametrize(
    "output",
    [
        "{",
        "[]",
        '{"a": 3}',
        '{"a": {"nipple": [0, 0, 0]}}',
        '{"a": {"nipple_left": [0, 0]}}',
        '{"a": {"nipple_left": [0, 0, "0"]}}',
        '{"a": {"nipple_left": [0, 0, NaN]}}',
        '{"a": {"nipple_left": [[0, 0, 0], [1, 1, 1]]}}',
        '{"a": {"border_left": [[0, 0, 0], [1, 1, 1]]}}',
        '{"a": {"midline": [[0, 0, 0]]}}',
        '{"a": {"midline": []}}',
        '{"b": {}}',
        '{"a": {}, "a": {}}',
    ],
)
def test_faulty_files_are_one_sentence(tmp_path: Path, output: str, capsys: pytest.CaptureFixture[str]) -> None:
    path, truth = tmp_path / "output.json", tmp_path / "truth.json"
    path.write_text(output)
    truth.write_text(json.dumps(TRUTH))
    assert main.run(["study", "landmarks", str(path), str(truth), "--json"]) == TableError.exit_code
    answer = json.loads(capsys.readouterr().out)
    assert answer["code"] == TableError.code
    assert "\n" not in answer["error"]


@pytest.mark.parametrize("fault", [{"women": []}, {"women": {"a": {"kind": "clean"}}}, {}, {"women": {"a": []}}])
def test_faulty_truths_are_refused(tmp_path: Path, fault: object) -> None:
    path = tmp_path / "truth.json"
    path.write_text(json.dumps(fault))
    with pytest.raises(TableError):
        read_true_landmarks(path)


def test_null_stands_for_not_found(tmp_path: Path) -> None:
    path = tmp_path / "output.json"
    path.write_text('{"a": {"nipple_left": null, "midline": [[0, 0, 0], [0, 1, 0]]}}')
    assert set(read_found_landmarks(path)["a"]) == {"midline"}
    assert FORMS["midline"] == "line"
