"""Boundaries drawn by virtual observers: scatter of volumes, and intervals.

    python -m benchmarks.accuracy.observers --women 10 --first 1000

The persons are not made of the terms from which the interval's boundary term is computed. Each marks six to twelve
places of the true curve, each off across and along it as published raters are, and joins them smoothly. A part of
their error is common to all of one person's marks: a habit. Their curves are laid on an open front, measured, and
compared with both truths of these women. Develop on numbers below 1000, report on those from 1000 on.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.stats import beta

from benchmarks.accuracy.women import FAMILIES
from mammometry.base.errors import MammometryError
from mammometry.geometry.arrays import Array, Float64
from mammometry.geometry.mesh import TriangleMesh
from mammometry.measure import scanned
from mammometry.measure.boundary.boundary import Boundary
from mammometry.measure.scan_repair import RepairedScan
from mammometry.measure.settings import MeasureSettings
from mammometry.measure.trunk.body import find_body
from mammometry.measure.volume import volumes
from mammometry.measure.volume.boundary_jitter import boundary_std_cc, drawn_sigma_mm, redraw
from mammometry.measure.volume.difference import difference
from mammometry.measure.volume.measurement import VolumeMeasurement
from mammometry.measure.volume.uncertainty import EarlierErrors, VolumeEvidence
from mammometry.measure.wall import chest_wall
from mammometry.measure.wall.open_breast import open_breasts
from mammometry.measure.wall.registry import TORSO_WALLS
from mammometry.simulate.subjects.woman import woman_named

SIDES = ("left", "right")
_FAMILIES = FAMILIES[:2]
_MARKS = (6, 12)
_HABIT = 0.5  # share of a mark's variance that all marks of one person have in common; not published, chosen
_UPRIGHT = np.eye(3)
_SCALE_STD = 1e-3  # of lengths, drawn; the interval is told the same


def drawn_by(boundary: Boundary, mesh: TriangleMesh, habit: float, rng: np.random.Generator) -> Boundary:
    """A curve drawn by one observer: displaced marks, joined smoothly on the skin.

    Args:
        boundary: the true curve.
        mesh: the skin, upright: x to the patient's left, y to the head.
        habit: how wide this person draws, in standard deviations.
        rng: of this one drawing.
    """
    sigma = drawn_sigma_mm(boundary, _UPRIGHT, MeasureSettings().observers)
    count = len(boundary.points_world)
    marks = int(rng.integers(_MARKS[0], _MARKS[1] + 1))
    at = np.sort((rng.uniform() + np.arange(marks) / marks + rng.normal(0, 0.1 / marks, marks)) % 1.0)
    around = np.arange(count) / count
    loop = np.concatenate([boundary.points_world, boundary.points_world[:1]])
    length_mm = float(np.linalg.norm(np.diff(loop, axis=0), axis=1).sum())
    own = np.interp(at, around, sigma, period=1.0)
    across = np.sqrt(_HABIT) * habit + np.sqrt(1 - _HABIT) * rng.normal(size=marks)
    at = np.sort((at + own * rng.normal(size=marks) / length_mm) % 1.0)  # along the curve: costs nothing
    at += 1e-6 * np.arange(marks)
    spline = CubicSpline(np.append(at, at[0] + 1), np.append(across, across[0]), bc_type="periodic")
    return redraw(boundary, sigma * spline(around), mesh)


def rows_of(
    name: str, persons: int, edge_mm: float, rng: np.random.Generator, settings: MeasureSettings
) -> Iterator[dict[str, object]]:
    """Rows of one woman: each drawing, and each left minus right."""
    made = woman_named(name, 0, edge_mm=edge_mm)
    front = made.front()
    true = tuple(
        Boundary(name=side, points_world=made.solid.mesh.vertices[made.solid.breasts[side].boundary], method="true")  # type: ignore[arg-type]
        for side in SIDES
    )
    flat = {side: made.solid.closed_breast(side).volume_mm3() / 1000 for side in SIDES}
    fine = scanned.finer_scan(RepairedScan.unchanged(front), [boundary.points_world for boundary in true]).mesh
    curves = [boundary.points_world for boundary in true]
    frame = find_body(scanned.as_scanned(fine), _UPRIGHT, boundaries=curves).frame
    for row in measured(true, fine, frame, settings):
        yield {"woman": name, "person": -1, **row, **_truths(made, flat, str(row["side"]))}
    for person in range(persons):
        habit = rng.normal()
        scale = 1 + _SCALE_STD * rng.normal()
        drawn = [drawn_by(boundary, fine, habit, rng) for boundary in true]
        grown = TriangleMesh(vertices=fine.vertices * scale, faces=fine.faces)
        theirs = [Boundary(name=one.name, points_world=one.points_world * scale, method="drawn") for one in drawn]
        for row in measured(theirs, grown, frame, settings):
            yield {"woman": name, "person": person, **row, **_truths(made, flat, str(row["side"]))}


def _truths(made, flat: dict[str, float], side: str) -> dict[str, float]:  # type: ignore[no-untyped-def]
    if side == "difference":
        return {"flat_cc": flat["left"] - flat["right"]}
    return {"flat_cc": flat[side], "muscle_cc": made.muscle_cc(side)}


def measured(
    boundaries: Sequence[Boundary], mesh: TriangleMesh, frame: Float64[Array, "3 3"], settings: MeasureSettings
) -> Iterator[dict[str, object]]:
    """Both breasts and left minus right, with their intervals."""
    surface = scanned.as_scanned(mesh)
    both: list[VolumeMeasurement] = []
    for breast in open_breasts(boundaries, surface, settings, frame=frame):
        side = breast.boundary.name
        try:
            wall = chest_wall.fit(breast)
            std_cc = boundary_std_cc(breast, wall)
            evidence = VolumeEvidence(
                surface=surface,
                earlier=EarlierErrors(scale_std=_SCALE_STD),
                boundary_std_cc=std_cc,
                axis_assumed=breast.trunk.assumed,
            )
            found = volumes.measure(breast.boundary, wall, settings, evidence=evidence)
        except MammometryError as error:
            yield {"side": side, "failed": str(error)}
            continue
        both.append(found)
        yield {
            "side": side,
            "cc": found.volume_cc,
            "base_cm2": found.base_area_cm2,
            "boundary_std_cc": std_cc,
            "assumed": breast.trunk.assumed,
            "terms": dict(found.interval_terms_cc),
            **{
                one.meaning: {"cc": one.volume_cc, "half_cc": one.interval_cc[1] - one.volume_cc}
                for one in found.definitions
            },
        }
    if len(both) == 2:
        verdict = difference(both[0], both[1], "sides")
        if verdict.difference_interval_cc is not None:
            half = verdict.difference_interval_cc[1] - verdict.difference_cc
            yield {"side": "difference", "difference": {"cc": verdict.difference_cc, "half_cc": half}}


def tables(rows: list[dict[str, object]]) -> Iterator[str]:
    """Tables in Markdown: scatter between observers, and coverage of the intervals."""
    good = [row for row in rows if "failed" not in row]
    yield f"{len(rows) - len(good)} of {len(rows)} failed"
    for family in dict.fromkeys(_family(row) for row in good):
        own = [row for row in good if _family(row) == family]
        yield f"\n{family}: standard deviation of one breast's volume between persons"
        yield from _scatter(own)
        yield "\n| interval | drawn by | number | held | 95 % of that share | bias | error / half width RMS | half |"
        yield "| --- " * 8 + "|"
        for meaning, truth in (
            ("flat chest", "flat_cc"),
            ("named wall", "named_cc"),
            ("muscle", "muscle_cc"),
            ("difference", "flat_cc"),
        ):
            for who, some in (("true curve", [row for row in own if row["person"] == -1]),
                              ("persons", [row for row in own if row["person"] != -1])):  # fmt: skip
                yield from _held(meaning, truth, who, some, own)


def _family(row: dict[str, object]) -> str:
    return str(row["woman"]).rpartition("_")[0]


def _scatter(rows: list[dict[str, object]]) -> Iterator[str]:
    actual, predicted, percent = [], [], []
    for key in dict.fromkeys((row["woman"], row["side"]) for row in rows if row["side"] != "difference"):
        drawn = [row for row in rows if (row["woman"], row["side"]) == key and row["person"] != -1]
        if len(drawn) < 2:
            continue
        own = np.array([row["cc"] for row in drawn], dtype=float)
        terms = [row["boundary_std_cc"] for row in drawn if row["boundary_std_cc"] is not None]
        actual.append(own.std(ddof=1))
        predicted.append(np.sqrt(np.mean(np.square(terms))))  # type: ignore[arg-type]
        percent.append(100 * own.std(ddof=1) / own.mean())
    if actual:
        both = [np.sqrt(np.mean(np.square(each))) for each in (actual, predicted, percent)]
        yield (
            f"persons {both[0]:.1f} cc ({both[2]:.1f} %), by the term {both[1]:.1f} cc: {both[0] / both[1]:.2f} of it "
            f"({len(actual)} breasts)"
        )


def _held(
    meaning: str, truth: str, who: str, rows: list[dict[str, object]], own: list[dict[str, object]]
) -> Iterator[str]:
    exact = {(row["woman"], row["side"]): row.get("cc") for row in own if row["person"] == -1}
    errors, halves = [], []
    for row in rows:
        found = row.get(meaning)
        if not isinstance(found, dict):
            continue
        wanted = exact.get((row["woman"], row["side"])) if truth == "named_cc" else row[truth]
        if wanted is not None:
            errors.append(found["cc"] - float(wanted))  # type: ignore[arg-type]
            halves.append(found["half_cc"])
    if not errors:
        return
    error, half = np.array(errors), np.array(halves)
    n, k = len(error), int((np.abs(error) <= half).sum())
    low = beta.ppf(0.025, k, n - k + 1) if k else 0.0
    high = beta.ppf(0.975, k + 1, n - k) if k < n else 1.0
    ratio: Float64[Array, " n"] = error / half
    yield (
        f"| {meaning} | {who} | {n} | {100 * k / n:.1f} % | {100 * low:.0f} … {100 * high:.0f} % | "
        f"{error.mean():+.1f} cc | {np.sqrt(np.mean(ratio**2)):.2f} | {np.median(half):.0f} cc |"
    )


def main() -> None:
    """Make the women, draw their boundaries, print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--women", type=int, default=10, help="of each family")
    parser.add_argument("--first", type=int, default=1000)
    parser.add_argument("--persons", type=int, default=4)
    parser.add_argument("--families", nargs="*", default=list(_FAMILIES), choices=FAMILIES)
    parser.add_argument("--wall", default="default", choices=("default", *TORSO_WALLS), help="that closes the breasts")
    parser.add_argument("--edge-mm", type=float, default=3.0)
    parser.add_argument("--out", type=Path, default=None, help="JSON: all rows")
    arguments = parser.parse_args()
    settings = MeasureSettings(wall=arguments.wall)
    rows: list[dict[str, object]] = []
    for family in arguments.families:
        for number in range(arguments.first, arguments.first + arguments.women):
            rng = np.random.default_rng([number, 19])
            try:
                rows += rows_of(f"{family}_{number}", arguments.persons, arguments.edge_mm, rng, settings)
            except ValueError as error:  # the simulator cannot make every one
                print(error)
    if arguments.out is not None:
        arguments.out.write_text(json.dumps(rows))
    print("\n".join(tables(rows)))
    for row in rows:
        if "failed" in row:
            print(row["woman"], row["person"], row["side"], row["failed"])


if __name__ == "__main__":
    main()
