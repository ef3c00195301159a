"""Tables of `benchmarks.accuracy.scans`."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np

from mammometry.geometry.arrays import Array, Float64
from mammometry.study.evaluation import compare_boundaries
from mammometry.study.icc import intraclass_correlations
from mammometry.study.landmarks import FORMS, TrueWoman, score_tables, scores
from mammometry.study.observers import scatter_of

Row: TypeAlias = dict[str, Any]
"""One measured scan, JSON-ready."""
SIDES = ("left", "right")
CLEAN = "clean"
PUBLISHED = (
    "Published: a mobile scanner against an established one −5 ± 32 mL over 42 women; a telephone's surface against a "
    "Vectra H2's 0.53 ± 1.81 mm."
)
_AHEAD = np.array([0.0, 0.0, 1.0])
_NOTCH_MM = 25.0  # a breast ends at least so far below the sternal notch: above it lies the collar bone
_ACROSS_MM = 10.0  # of a border across the midline
_BEHIND_MM = 20.0  # of a border behind the armpit's front and the true border
_BELOW_MM = 30.0  # of a border below the true one
_Cells: TypeAlias = Callable[[Sequence[Row]], Sequence[str]]


def tables(rows: Sequence[Row]) -> Iterator[str]:
    """Yield the tables, as Markdown."""
    first = [row for row in rows if row["repetition"] == 0]
    clean = {(row["woman"], row["posture"]): row for row in first if row["quality"] == CLEAN}
    yield from _table(
        first, ("measured", "refused with the scan", "refused alone", "removed said", "beyond", "faces", "seconds"),
        _sides,
    )  # fmt: skip
    yield from _table(
        first,
        ("volume − truth %", "held", "half-width % median", "volume − clean % median", "95 %", "sides"),
        lambda own: _volumes(own, clean),
    )
    yield from differences(rows)
    yield from _table(
        first, ("outline − truth mm", "95 %", "outline − clean mm", "95 %"), lambda own: _outlines(own, clean)
    )
    yield from _landmarks(first)
    yield from _reasons(first)
    yield from _repeatability(rows)


def differences(rows: Sequence[Row]) -> Iterator[str]:
    """Yield errors of left minus right, and half-widths of their intervals."""
    yield from _table(
        [row for row in rows if row["repetition"] == 0 and row.get("difference")],
        ("left − right − truth cc", "held", "RMS error / half-width", "of the volumes", "half-width cc median",
         "over the mean of both volumes' median", "less than either volume's"),
        _differences,
    )  # fmt: skip


def _differences(rows: Sequence[Row]) -> Sequence[str]:
    error, half, sides, of_volumes = [], [], [], []
    for row in rows:
        apart, both, true = row["difference"], [row["sides"][side] for side in SIDES], row["truth"]["volumes_cc"]
        sides.append([own["interval_cc"][1] - own["volume_cc"] for own in both])
        half.append(apart["interval_cc"][1] - apart["cc"])
        error.append(apart["cc"] - row["truth"]["difference_cc"])
        of_volumes += [
            (own["volume_cc"] - true[side]) / half_cc
            for side, own, half_cc in zip(SIDES, both, sides[-1], strict=True)
            if side in true
        ]
    relative = np.array(error) / np.array(half)
    share, less = np.array(half) / np.mean(sides, axis=1), np.array(half) < np.min(sides, axis=1)
    held = f"{(np.abs(relative) <= 1).sum()} of {len(relative)}"
    rms = [f"{np.sqrt(np.mean(np.square(own))):.2f}" if len(own) else "–" for own in (relative, of_volumes)]
    return _spread(error), held, *rms, _median(half), f"{np.median(share):.2f}", f"{less.sum()} of {len(less)}"


def _table(rows: Sequence[Row], heads: Sequence[str], cells: _Cells) -> Iterator[str]:
    """Yield one line for each posture and quality, and for each quality of the virtual women."""
    yield "| posture | scan | " + " | ".join(heads) + " |"
    yield "|" + " --- |" * (len(heads) + 2)
    qualities = list(dict.fromkeys(row["quality"] for row in rows))
    for posture in dict.fromkeys(row["posture"] for row in rows):
        for quality in qualities:
            own = [row for row in rows if row["posture"] == posture and row["quality"] == quality]
            if own:
                yield f"| {posture} | {quality} | " + " | ".join(cells(own)) + " |"
    for quality in qualities:
        own = [row for row in rows if row["posture"] != "shared" and row["quality"] == quality]
        if own:
            yield f"| all women | {quality} | " + " | ".join(cells(own)) + " |"
    yield ""


_WORST_PERCENT = 10.0  # beyond which a scan's volume may not differ from the clean mesh's without a word


def hanging_table(rows: Sequence[Row]) -> Iterator[str]:
    """Yield the table of hanging breasts: errors against truth and clean mesh, and ptosis."""
    clean = {row["woman"]: row for row in rows if row["quality"] == CLEAN}
    yield "| bodies | scan | measured | volume − truth % | held | − clean %: median, worst | held | beyond 10 % "\
        "| ptosis graded, wrongly |"  # fmt: skip
    yield "|" + " --- |" * 9
    for shared in (False, True):
        for quality in dict.fromkeys(row["quality"] for row in rows):
            own = [row for row in rows if row["quality"] == quality and (row["posture"] == "shared") == shared]
            if own:
                yield f"| {'shared' if shared else 'virtual'} | {quality} | " + " | ".join(_hanging(own, clean)) + " |"
    yield ""


def _hanging(rows: Sequence[Row], clean: Mapping[Any, Row]) -> Sequence[str]:
    sides = [(row, side, own) for row in rows for side, own in row["sides"].items()]
    true = [(own, row["truth"]["volumes_cc"][side]) for row, side, own in sides if row["truth"]["volumes_cc"]]
    pairs = _pairs(rows, {(row["woman"], row["posture"]): row for row in clean.values()})
    apart = [100 * abs(scan["volume_cc"] / one["volume_cc"] - 1) for scan, one in pairs]
    graded = [
        (grades, row["truth"].get("ptosis", {}).get(side)) for row in rows for side, grades in row["ptosis"].items()
    ]
    wrong = sum(true_grade not in (None, *grades) for grades, true_grade in graded)
    return (
        f"{len(sides)} of {2 * len(rows)}",
        _spread([100 * (own["volume_cc"] / volume_cc - 1) for own, volume_cc in true]),
        _held(true),
        f"{_median(apart)}, {max(apart):.1f}" if apart else "–",
        _held([(scan, one["volume_cc"]) for scan, one in pairs]) if apart else "–",
        str(sum(percent > _WORST_PERCENT for percent in apart)),
        f"{len(graded)}, {wrong}",
    )


def _held(volumes: Sequence[tuple[Any, float]]) -> str:
    held = sum(own["interval_cc"][0] <= true_cc <= own["interval_cc"][1] for own, true_cc in volumes)
    return f"{held} of {len(volumes)}"


def sides_of(row: Row) -> tuple[str, ...]:
    """Sides with a breast."""
    return tuple(side for side in SIDES if side in row["truth"]["outlines"])


def _sides(rows: Sequence[Row]) -> Sequence[str]:
    sides = [(row, side) for row in rows for side in sides_of(row)]
    removed = [(row, side) for row in rows for side in SIDES if side not in sides_of(row)]
    measured = [(row, side) for row, side in sides if side in row["sides"]]
    return (
        f"{len(measured)} of {len(sides)}",
        str(sum(bool(row["refused"]) for row, _ in sides)),
        str(sum(side in row["no_breast"] for row, side in sides)),
        f"{sum(side in row['no_breast'] for row, side in removed)} of {len(removed)}",
        str(sum(bool(beyond(row, side)) for row, side in measured)),
        f"{np.median([row['faces'] for row in rows]):.0f}",
        _median([row["seconds"] for row in rows if "seconds" in row]),
    )


def beyond(row: Row, side: str) -> tuple[str, ...]:
    """Anatomical bounds that a measured outline crosses, in words. Empty where the truth has no landmarks."""
    marks = row["truth"]["landmarks"]
    if "sternal_notch" not in marks:
        return ()
    outline, true = (np.array(where) for where in (row["sides"][side]["outline"], row["truth"]["outlines"][side]))
    line = np.array(sorted(marks["midline"], key=lambda point: point[1]))
    outwards = 1.0 if side == "left" else -1.0
    across = outwards * (np.interp(outline[:, 1], line[:, 1], line[:, 0]) - outline[:, 0])
    armpit = np.array(marks[f"anterior_axillary_line_{side}"])
    checks = {
        "above": outline[:, 1].max() > marks["sternal_notch"][0][1] - _NOTCH_MM,
        "across": across.max() > _ACROSS_MM,
        "behind": outline[:, 2].min() < min(armpit[:, 2].min(), true[:, 2].min()) - _BEHIND_MM,
        "below": outline[:, 1].min() < true[:, 1].min() - _BELOW_MM,
    }
    return tuple(name for name, crossed in checks.items() if crossed)


def _volumes(rows: Sequence[Row], clean: Mapping[Any, Row]) -> Sequence[str]:
    error, half, held = [], [], []
    for row in rows:
        for side, own in row["sides"].items():
            true = row["truth"]["volumes_cc"].get(side)
            low, high = own["interval_cc"] or (np.nan, np.nan)
            half.append(100 * (high - low) / 2 / own["volume_cc"])
            if true is not None:
                error.append(100 * (own["volume_cc"] / true - 1))
                held.append(low <= true <= high)
    change = [100 * abs(scan["volume_cc"] / one["volume_cc"] - 1) for scan, one in _pairs(rows, clean)]
    shown = f"{sum(held)} of {len(held)}"
    return _spread(error), shown, _median(half), _median(change), _quantile(change), str(len(half))


def _outlines(rows: Sequence[Row], clean: Mapping[Any, Row]) -> Sequence[str]:
    to_truth = [
        _apart(own["outline"], row["truth"]["outlines"][side])
        for row in rows
        for side, own in row["sides"].items()
        if side in row["truth"]["outlines"]
    ]
    to_clean = [_apart(scan["outline"], one["outline"]) for scan, one in _pairs(rows, clean)]
    return _spread(to_truth), _quantile(to_truth), _spread(to_clean), _quantile(to_clean)


def _pairs(rows: Sequence[Row], clean: Mapping[Any, Row]) -> list[tuple[Row, Row]]:
    """Each scan's side with the same of the clean mesh, where both are measured."""
    both = [(row, clean.get((row["woman"], row["posture"]))) for row in rows if row["quality"] != CLEAN]
    return [(row["sides"][s], one["sides"][s]) for row, one in both if one for s in row["sides"] if s in one["sides"]]


def _apart(points: Float64[Array, "n 3"], truth: Float64[Array, "m 3"]) -> float:
    return compare_boundaries(np.array(points), np.array(truth), _AHEAD).mean_mm


def _landmarks(rows: Sequence[Row]) -> Iterator[str]:
    """Yield the landmarks' table. All that a woman has is known: what else is proposed is invented."""
    rows = [row for row in rows if row["truth"]["landmarks"]]
    points = {name for name, form in FORMS.items() if form == "point"}
    truth = {
        row["key"]: TrueWoman(
            kind=row["quality"],
            generator="torso",
            mesh=row["key"],
            places={name: np.array(true) for name, true in row["truth"]["landmarks"].items() if name in points},
            absent=tuple(points - row["truth"]["landmarks"].keys()),
        )
        for row in rows
    }
    found = {
        row["key"]: {name: np.reshape(own, (-1, 3)) for name, own in row["landmarks"].items() if name in points}
        for row in rows
    }
    if any(found.values()):
        yield score_tables(scores(found, truth))[0].as_markdown()


def _reasons(rows: Sequence[Row]) -> Iterator[str]:
    """Yield reasons why breasts were not measured, without numbers, most frequent first."""
    reasons: Counter[str] = Counter()
    for row in rows:
        for side in sides_of(row):
            if side not in row["sides"]:
                why = row["refused"] or row["no_breast"].get(side, "no word")
                reasons[re.sub(r"[−-]?\d[\d.,]*", "#", why.replace("\n", " "))[:160]] += 1
    yield from (f"{count} × {why}" for why, count in reasons.most_common())
    yield ""


def _repeatability(rows: Sequence[Row]) -> Iterator[str]:
    """Yield SEM, MDC and ICC of breasts that were scanned again."""
    for quality in dict.fromkeys(row["quality"] for row in rows):
        volumes: dict[tuple[Any, str, str], list[float]] = {}
        for row in rows:
            for side, own in row["sides"].items() if row["quality"] == quality else ():
                volumes.setdefault((row["woman"], row["posture"], side), []).append(own["volume_cc"])
        often = max(map(len, volumes.values()), default=0)
        if often < 2:
            continue
        repeated = {key: own for key, own in volumes.items() if len(own) > 1}
        within, _ = scatter_of([[np.array(own)] for own in repeated.values()])
        assert within is not None
        complete = np.array([own for own in repeated.values() if len(own) == often])
        icc = next(
            (f"{one.value:.4f}" for one in intraclass_correlations(complete) if one.shrout_fleiss == "ICC(2,1)"), "–"
        ) if len(complete) > 1 else "–"  # fmt: skip
        yield (
            f"{quality}: {len(repeated)} breasts, scanned up to {often} times: SEM {within.sem.value:.1f} cc "
            f"({within.percent:.1f} %), MDC {within.mdc.value:.1f} cc, ICC(2,1) {icc}. {PUBLISHED}"
        )


def _spread(values: Sequence[float]) -> str:
    return f"{np.mean(values):+.1f} ± {np.std(values):.1f}" if values else "–"


def _median(values: Sequence[float]) -> str:
    return f"{np.median(values):.1f}" if values else "–"


def _quantile(values: Sequence[float]) -> str:
    return f"{np.quantile(values, 0.95):.1f}" if values else "–"
