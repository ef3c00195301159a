"""Score landmarks and borders found by any program on meshes whose truth is known.

::

    from pathlib import Path

    from mammometry.io.truth import read_found_landmarks, read_true_landmarks
    from mammometry.study.landmarks import scores

    truth = read_true_landmarks(Path("truth.json"))
    for score in scores(read_found_landmarks(Path("output.json")), truth):
        print(score.landmark, score.kind, score.median_mm)
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Literal, TypeAlias

import numpy as np

from mammometry.base.errors import TableError
from mammometry.base.value import value
from mammometry.geometry.arrays import Array, Float64
from mammometry.measure.landmarks.landmarks import LANDMARKS
from mammometry.study.evaluation import curve_distances, resampled
from mammometry.study.tables import TextTable, number, plain

Places: TypeAlias = Mapping[str, Float64[Array, "k 3"]]
"""Name → one point, or the corners of a curve in order, mm, frame of the mesh."""
Form: TypeAlias = Literal["point", "line", "curve"]
"""A point; a line with two ends; a closed curve, whose last corner joins the first."""

SIDES = ("left", "right")
FORMS: Mapping[str, Form] = {
    **{known.name: known.kind for known in LANDMARKS["torso"]},
    **{f"fold_curve_{side}": "line" for side in SIDES},
    **{f"border_{side}": "curve" for side in SIDES},
}
"""Names in both files → form. Left and right are the patient's."""
_ANOTHER_FRAME_MM = 100.0  # median error above which frame or unit must differ: the width of a breast
_LINE_STEP_MM = 0.1  # spacing of a compared line's points, as of a closed curve


@value(eq=False)
class TrueWoman:
    """One mesh with true landmarks and borders."""

    kind: str
    """Kind of input, such as ``clean`` or ``telephone``."""
    generator: str
    """Program that made the woman."""
    mesh: str
    """File with the mesh, relative to the truth file."""
    places: Places
    """Her true landmarks and borders, without unknown and absent ones."""
    absent: tuple[str, ...] = ()
    """Landmarks that she does not have. If a program proposes one, it is a false positive."""


@value(eq=False)
class Score:
    """Errors of one landmark for one kind of input and one generator."""

    landmark: str
    """Its name without the side."""
    kind: str
    generator: str
    true: int
    """Number of true landmarks."""
    invented: int
    """Number of false positives."""
    distances_mm: Float64[Array, " n"]
    """Error of each landmark that was found. Point: distance from the true one. Line: mean distance of the true line
    from it. Closed curve: mean of both curves' mean distances from each other."""

    @property
    def found(self) -> int:
        """Number of true landmarks that were found."""
        return len(self.distances_mm)

    @property
    def mean_mm(self) -> float | None:
        """Mean of the distances, mm. None if none was found."""
        return float(self.distances_mm.mean()) if self.found else None

    @property
    def median_mm(self) -> float | None:
        """Median of the distances, mm. None if none was found."""
        return self._quantile(0.5)

    @property
    def p95_mm(self) -> float | None:
        """95th percentile of the distances, mm. None if none was found."""
        return self._quantile(0.95)

    @property
    def worst_mm(self) -> float | None:
        """Largest distance, mm. None if none was found."""
        return self._quantile(1.0)

    def _quantile(self, share: float) -> float | None:
        return float(np.quantile(self.distances_mm, share)) if self.found else None


def distance_mm(form: Form, found: Float64[Array, "k 3"], true: Float64[Array, "m 3"]) -> float:
    """Error of one landmark, mm (see `Score.distances_mm`)."""
    if form == "point":
        return float(np.linalg.norm(found[0] - true[0]))
    if form == "curve":
        return float(np.mean([distances.mean() for distances in curve_distances(resampled(found), resampled(true))]))
    return float(curve_distances(_dense(true), _dense(found))[0].mean())


def _dense(line: Float64[Array, "k 3"]) -> Float64[Array, "n 3"]:
    """Points at most `_LINE_STEP_MM` apart along a line."""
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    at = np.linspace(0.0, along[-1], 2 + int(along[-1] / _LINE_STEP_MM))
    return np.stack([np.interp(at, along, line[:, axis]) for axis in range(3)], axis=1)


def scores(found: Mapping[str, Places], truth: Mapping[str, TrueWoman]) -> tuple[Score, ...]:
    """Errors of a program's landmarks, by landmark, kind of input and generator.

    A woman or a landmark that is missing in `found` counts as not found.

    Raises:
        TableError: a woman is not in the truth, or positions are in another frame or unit.
    """
    unknown = sorted(found.keys() - truth.keys())
    if unknown:
        raise TableError(
            f"woman {unknown[0]!r}",
            found="no such woman in the truth",
            expected=f"names as in the truth file, such as {next(iter(truth), 'none')!r}",
            remedy="Score the output with the truth of the same meshes",
        )
    errors = {
        (woman, name): distance_mm(FORMS[name], found[woman][name], true)
        for woman, known in truth.items()
        for name, true in known.places.items()
        if name in found.get(woman, {})
    }
    _require_one_frame(list(errors.values()))
    return tuple(_scored(found, truth, errors))


def _require_one_frame(errors_mm: Sequence[float]) -> None:
    if errors_mm and float(np.median(errors_mm)) > _ANOTHER_FRAME_MM:
        raise TableError(
            "output",
            found=f"places {np.median(errors_mm):.0f} mm from the truth in the median: another frame, unit or side",
            expected="millimetres in the frame of each mesh's file; left and right are the patient's",
            remedy="Check units and axes, and whether left and right are exchanged",
        )


def _scored(
    found: Mapping[str, Places], truth: Mapping[str, TrueWoman], errors: Mapping[tuple[str, str], float]
) -> Iterator[Score]:
    groups = tuple(dict.fromkeys((known.kind, known.generator) for known in truth.values()))
    for landmark in dict.fromkeys(without_side(name) for name in FORMS):
        names = [name for name in FORMS if without_side(name) == landmark]
        for kind, generator in groups:
            women = [woman for woman, known in truth.items() if (known.kind, known.generator) == (kind, generator)]
            true = [(woman, name) for woman in women for name in names if name in truth[woman].places]
            absent = [(woman, name) for woman in women for name in names if name in truth[woman].absent]
            if true or absent:
                yield Score(
                    landmark=landmark,
                    kind=kind,
                    generator=generator,
                    true=len(true),
                    invented=sum(name in found.get(woman, {}) for woman, name in absent),
                    distances_mm=np.array([errors[one] for one in true if one in errors]),
                )


def without_side(name: str) -> str:
    """Name of a landmark without its side."""
    return name.removesuffix("_left").removesuffix("_right")


PUBLISHED: tuple[tuple[str, str, str], ...] = (
    (
        "border, two ratings of one place",
        "3.5 to 6.7 (means at three places, 16 women)",
        "doi 10.1007/s00238-018-1431-2",
    ),
)
"""Published figures for raters: what, mm, source. There is no published error of an automatic fold or midline."""


def score_tables(found: Sequence[Score]) -> tuple[TextTable, ...]:
    """The errors of each landmark and kind, and published figures of raters."""
    return (
        TextTable(
            title="Landmarks and borders, errors in mm",
            columns=("landmark", "input", "women", "found", "invented", "median", "mean", "95 %", "worst"),
            rows=tuple(_row(one) for one in found),
        ),
        TextTable(title="Published figures of raters", columns=("what", "mm", "source"), rows=PUBLISHED),
    )


def _row(one: Score) -> tuple[str, ...]:
    counts = (f"{one.found} of {one.true}", str(one.invented))
    figures = (number(figure, ".1f") for figure in (one.median_mm, one.mean_mm, one.p95_mm, one.worst_mm))
    return (one.landmark, one.kind, one.generator, *counts, *figures)


def scores_json(found: Sequence[Score]) -> dict[str, Any]:
    """All figures as data for JSON, with null for unknown ones."""
    table: dict[str, Any] = plain(
        {
            "scores": [
                {
                    "landmark": one.landmark,
                    "kind": one.kind,
                    "generator": one.generator,
                    "true": one.true,
                    "found": one.found,
                    "invented": one.invented,
                    "median_mm": one.median_mm,
                    "mean_mm": one.mean_mm,
                    "p95_mm": one.p95_mm,
                    "worst_mm": one.worst_mm,
                }
                for one in found
            ]
        }
    )
    return table
