"""Scans of virtual women, standing, leaning and lying: what is measured, refused and missed, and how it repeats.

    python -m benchmarks.accuracy.scans --women 40 --first 9000 --out scans.jsonl
    python -m benchmarks.accuracy.scans --women 4 --repeat 10 --qualities telephone
    python -m benchmarks.accuracy.scans --women 0 --bodies ../shared/data/scans

Each woman is measured from her clean front and from scans that a virtual telephone makes of her, by the command's own
road, without any drawing. Develop on numbers below 9000, report on those from 9000 on. A file that exists already is
gone on with. The shared bodies come from another generator: their volumes stand above its smallest cup, not above a
flat chest, so that only outlines and repetition are judged by them.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
import traceback
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from mammometry.api.mesh import MeshFiles, MeshJob
from mammometry.base.errors import MammometryError
from mammometry.geometry.arrays import Array, Float64
from mammometry.io.meshes.foreign import read_foreign
from mammometry.io.meshes.own_ply import write_ply
from mammometry.job.stages import measure
from mammometry.simulate.disturbances.registry import disturbed
from mammometry.simulate.scanning.scan import QUALITIES, VirtualScan, clean_front, scan
from mammometry.simulate.situation import parse_situation
from mammometry.simulate.subjects.registry import make_subject
from mammometry.simulate.subjects.solid import Solid
from mammometry.study.accuracy_boundary import compare_boundaries
from mammometry.study.icc import intraclass_correlations
from mammometry.study.observers import scatter_of

SIDES = ("left", "right")
POSTURES = ("standing", "leaning", "lying")
CLEAN = "clean"
PUBLISHED = (
    "Published: a mobile scanner against an established one −5 ± 32 mL over 42 women; a telephone's surface against a "
    "Vectra H2's 0.53 ± 1.81 mm."
)
_AHEAD = np.array([0.0, 0.0, 1.0])
_EDGE_MM = 2.0  # of the bodies' triangles, on the breasts
# Share of the women who are operated on or differ, and how.
_OPERATIONS = (
    "", "", "", "ptosis=2", "ptosis=3", "ratio=1.8", "removed=right", "removed=left", "mound=220", "build=thin",
    "build=obese", "arms=sides",
)  # fmt: skip
_NOTCH_MM = 25.0  # an outline that comes this near to the sternal notch's height has left the breast
Row = dict[str, Any]


def situation_of(number: int, posture: str) -> str:
    """What is special about a woman: her posture, and an operation or a build."""
    return ",".join(filter(None, [f"posture={posture}", _OPERATIONS[number % len(_OPERATIONS)]]))


def woman(number: int, posture: str) -> Solid:
    """Make a virtual woman.

    Raises:
        ValueError: the simulator cannot make this one.
    """
    reshape = partial(disturbed, stage="patient", situation=parse_situation(situation_of(number, posture)), seed=number)
    return make_subject(f"torso_{number}", 0, edge_mm=_EDGE_MM, reshape=reshape)


def scanned(solid: Solid, quality: str, repetition: int) -> VirtualScan:
    """A woman's scan of one quality."""
    return clean_front(solid) if quality == CLEAN else scan(solid, QUALITIES[quality], repetition)


def measured(path: Path, units: str = "mm") -> Row:
    """Measure a mesh file as the command does: volumes, outlines, landmarks, seconds, or the refusal."""
    row: Row = {"sides": {}, "landmarks": {}, "no_breast": {}, "refused": ""}
    begun = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="mammometry-scans-") as folder:
        try:
            job = MeshJob(MeshFiles(mesh=path, units=units, automatic=True), Path(folder) / "results")
            results = job.run(report=False)
            row["seconds"] = time.monotonic() - begun
            curves = {boundary.name: boundary.points_world for boundary in job.plan[measure.boundaries]()}
            for side, found in results.measurements.items():
                row["sides"][side] = {
                    "volume_cc": found.volume_cc,
                    "interval_cc": found.interval_cc,
                    "outline": np.round(curves[side], 2).tolist(),
                }
            row["no_breast"] = dict(results.no_breast)
            marks = job.plan.value(measure.landmarks) or ()
            row["landmarks"] = {mark.name: np.asarray(mark.points_world)[0].tolist() for mark in marks}
        except MammometryError as error:
            row["refused"] = str(error)
        except Exception:  # a failure of ours is a failure, too
            row["refused"] = "FAILED " + traceback.format_exc(limit=-2)
        row.setdefault("seconds", time.monotonic() - begun)
    return row


def rows_of_woman(number: int, posture: str, qualities: Sequence[str], repeat: int, known: set[str]) -> Iterator[Row]:
    """Yield one row a scan. What is known already is left out."""
    wanted = [(quality, repetition) for quality in qualities for repetition in range(1 if quality == CLEAN else repeat)]
    keys = {(quality, repetition): f"{number}/{posture}/{quality}/{repetition}" for quality, repetition in wanted}
    if all(key in known for key in keys.values()):
        return
    solid = woman(number, posture)
    truth = {
        "volumes_cc": solid.volumes_cc,
        "outlines": {side: np.round(solid.mesh.vertices[b.boundary], 2).tolist() for side, b in solid.breasts.items()},
        "landmarks": {name: points[0].tolist() for name, points in solid.landmarks.items()},
    }
    for (quality, repetition), key in keys.items():
        if key in known:
            continue
        begun = time.monotonic()
        made = scanned(solid, quality, repetition)
        seconds = time.monotonic() - begun
        with tempfile.TemporaryDirectory(prefix="mammometry-scans-") as folder:
            path = Path(folder) / "scan.ply"
            colours = {
                name: np.ascontiguousarray(made.colours[:, k]) for k, name in enumerate(("red", "green", "blue"))
            }
            write_ply(path, made.mesh, colours, comments=())
            yield {
                "key": key, "woman": number, "posture": posture, "quality": quality, "repetition": repetition,
                "situation": situation_of(number, posture), "truth": truth, "faces": len(made.mesh.faces),
                "scan_seconds": seconds, **measured(path),
            }  # fmt: skip


def rows_of_bodies(folder: Path, known: set[str]) -> Iterator[Row]:
    """Yield two rows a shared body: clean and as a telephone fuses it."""
    for path in sorted(folder.glob("body_*_truth.json")):
        table = json.loads(path.read_text(encoding="utf-8"))
        name = path.name.removesuffix("_truth.json")
        truth = {"volumes_cc": {}, "outlines": table["outline_10_percent"], "landmarks": {}}
        for quality, file, units in ((CLEAN, "clean", "mm"), ("telephone", "scan", "m")):
            key, mesh = f"{name}/{quality}", path.with_name(f"{name}_{file}.ply")
            if key not in known:
                yield {
                    "key": key, "woman": name, "posture": "shared", "quality": quality, "repetition": 0,
                    "situation": "", "truth": truth, "faces": len(read_foreign(mesh, units).mesh.faces),
                    "scan_seconds": 0.0, **measured(mesh, units),
                }  # fmt: skip


def sides_of(row: Row) -> tuple[str, ...]:
    """Sides with a breast."""
    return tuple(side for side in SIDES if side in row["truth"]["outlines"])


def tables(rows: Sequence[Row]) -> Iterator[str]:
    """Yield the tables, as Markdown."""
    clean = {(row["woman"], row["posture"]): row for row in rows if row["quality"] == CLEAN}
    heads = (
        "posture", "scan", "sides measured", "no breast said wrongly", "refused", "removed said",
        "volume − truth %", "held", "half-width %", "volume − clean %: median, 95 %", "outline − truth mm",
        "outline − clean mm", "beyond", "seconds",
    )  # fmt: skip
    yield "| " + " | ".join(heads) + " |"
    yield "|" + " --- |" * len(heads)
    for posture in dict.fromkeys(row["posture"] for row in rows):
        for quality in dict.fromkeys(row["quality"] for row in rows):
            own = [row for row in rows if row["posture"] == posture and row["quality"] == quality]
            if own:
                yield _line(posture, quality, own, clean)
    yield ""
    yield from _landmarks(rows)
    yield from _repeatability(rows)


def _line(posture: str, quality: str, rows: Sequence[Row], clean: Mapping[Any, Row]) -> str:
    sides = [(row, side) for row in rows for side in sides_of(row)]
    done = [(row, side) for row, side in sides if side in row["sides"]]
    lost = [side in row["no_breast"] for row, side in sides]
    refused = [bool(row["refused"]) for row in rows]
    removed = [(row, side) for row in rows for side in SIDES if side not in sides_of(row)]
    said = [side in row["no_breast"] for row, side in removed]
    error, half, held, beyond, to_truth = [], [], [], [], []
    for row, side in done:
        found, outline = row["sides"][side], np.array(row["sides"][side]["outline"])
        true = row["truth"]["volumes_cc"].get(side)
        low, high = found["interval_cc"] or (np.nan, np.nan)
        half.append(100 * (high - low) / 2 / found["volume_cc"])
        if true is not None:
            error.append(100 * (found["volume_cc"] / true - 1))
            held.append(low <= true <= high)
            notch = row["truth"]["landmarks"]["sternal_notch"][1]
            beyond.append(outline[:, 1].max() > notch - _NOTCH_MM)
        to_truth.append(_apart(outline, np.array(row["truth"]["outlines"][side])))
    both = [(row, side, clean.get((row["woman"], row["posture"]))) for row, side in done]
    pairs = [(row["sides"][side], one["sides"][side]) for row, side, one in both if one and side in one["sides"]]
    change = [100 * abs(scan["volume_cc"] / one["volume_cc"] - 1) for scan, one in pairs]
    to_clean = [_apart(np.array(scan["outline"]), np.array(one["outline"])) for scan, one in pairs]
    cells = [
        posture, quality, f"{len(done)} of {len(sides)}", str(sum(lost)), str(sum(refused)),
        f"{sum(said)} of {len(said)}", _spread(error), f"{sum(held)} of {len(held)}", _median(half),
        f"{_median(change)}, {_quantile(change)}", _spread(to_truth), _spread(to_clean), str(sum(beyond)),
        _median([row["seconds"] for row in rows]),
    ]  # fmt: skip
    return "| " + " | ".join(cells) + " |"


def _apart(found: Float64[Array, "n 3"], truth: Float64[Array, "m 3"]) -> float:
    return compare_boundaries(found, truth, _AHEAD).mean_mm


def _landmarks(rows: Sequence[Row]) -> Iterator[str]:
    names = list(dict.fromkeys(name for row in rows for name in row["landmarks"] if name in points_of(row)))
    if not names:
        return
    yield "| landmark | scan | proposed | error mm median | 95 % | worst |"
    yield "|" + " --- |" * 6
    for name in names:
        for quality in dict.fromkeys(row["quality"] for row in rows):
            own = [row for row in rows if row["quality"] == quality and name in points_of(row)]
            error = [
                float(np.linalg.norm(np.subtract(row["landmarks"][name], row["truth"]["landmarks"][name])))
                for row in own
                if name in row["landmarks"]
            ]
            if error:
                shown = f"{len(error)} of {len(own)} | {_median(error)} | {_quantile(error)} | {max(error):.1f}"
                yield f"| {name} | {quality} | {shown} |"
    yield ""


def points_of(row: Row) -> set[str]:
    """True landmarks that are one point."""
    return set(row["truth"]["landmarks"]) - {"midline"}


def _repeatability(rows: Sequence[Row]) -> Iterator[str]:
    """Yield SEM, MDC and ICC of breasts that were scanned anew."""
    for quality in dict.fromkeys(row["quality"] for row in rows):
        volumes: dict[tuple[Any, str, str], list[float]] = {}
        for row in rows:
            for side, found in row["sides"].items() if row["quality"] == quality else ():
                volumes.setdefault((row["woman"], row["posture"], side), []).append(found["volume_cc"])
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


def main() -> None:
    """Scan, measure, print the tables."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--women", type=int, default=40)
    parser.add_argument("--first", type=int, default=9000)
    parser.add_argument("--postures", nargs="*", default=list(POSTURES), choices=POSTURES)
    parser.add_argument("--qualities", nargs="*", default=[CLEAN, *QUALITIES], choices=[CLEAN, *QUALITIES])
    parser.add_argument("--repeat", type=int, default=1, help="scans of each woman, of each quality")
    parser.add_argument("--bodies", type=Path, default=None, help="folder of the shared bodies")
    parser.add_argument("--out", type=Path, default=None, help="JSON lines of all rows; gone on with if it exists")
    parser.add_argument("--failures", action="store_true", help="print every refusal")
    arguments = parser.parse_args()
    rows: list[Row] = []
    if arguments.out is not None and arguments.out.exists():
        rows = [json.loads(line) for line in arguments.out.read_text(encoding="utf-8").splitlines()]
    known = {row["key"] for row in rows}

    def keep(made: Iterator[Row]) -> None:
        for row in made:
            rows.append(row)
            print(row["key"], row["situation"], _summary(row), flush=True)
            if arguments.out is not None:
                with arguments.out.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(row) + "\n")

    for number in range(arguments.first, arguments.first + arguments.women):
        for posture in arguments.postures:
            try:
                keep(rows_of_woman(number, posture, arguments.qualities, arguments.repeat, known))
            except ValueError as error:  # the simulator cannot make every one
                print(number, posture, error)
    if arguments.bodies is not None:
        keep(rows_of_bodies(arguments.bodies, known))
    print("\n".join(tables(rows)))
    if arguments.failures:
        for row in rows:
            for what in (row["refused"], *(f"{side}: {why}" for side, why in row["no_breast"].items())):
                if what:
                    print(row["key"], row["situation"], what)


def _summary(row: Row) -> str:
    if row["refused"]:
        return "refused: " + row["refused"].replace("\n", " ")[:110]
    parts = []
    for side in SIDES:
        true, found = row["truth"]["volumes_cc"].get(side), row["sides"].get(side)
        known = "" if true is None else f" for {true:.0f}"
        parts.append(f"{side} {'–' if found is None else format(found['volume_cc'], '.0f')}{known}")
    return ", ".join(parts) + f" ({row['seconds']:.0f} s)"


if __name__ == "__main__":
    main()
