"""Scans of standing, leaning and lying virtual women: errors, refusals and repeatability.

    python -m benchmarks.accuracy.scans --out rows --bodies ../shared/data/scans
    python -m benchmarks.accuracy.scans --out rows --one-posture
    python -m benchmarks.accuracy.scans --out rows --women 9000-9003 --repeat 10 --qualities telephone
    python -m benchmarks.accuracy.scans --out rows --women 9600-9611 --postures hanging --bodies ../shared/data/scans

Each woman is measured from her clean front and from scans that a virtual telephone makes of her, by the command's own
road, without any drawing. Develop on numbers below 9000, report on those from 9000 on. Every scan's row is kept in the
folder, and what is there is not measured again. `--one-posture` has each woman in one posture: over 36 women every
operation comes in every posture. Without reports a scan takes half the time. The shared bodies come from another
generator: their volumes stand above its smallest cup, not above a flat chest, so that only outlines, repetition and the
difference of both sides, from which what stands below that cup falls out, are judged by them. `--differences` prints
left less right alone. In the posture `hanging` women stand, their breasts have 300 to 1,500 cc, and their nipples are
10 to 60 mm below the fold, which no telephone sees: these are compared with the clean mesh, and their ptosis is graded.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import tempfile
import time
import traceback
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.accuracy.scan_tables import CLEAN, SIDES, Row, differences, hanging_table, tables
from mammometry.api.mesh import MeshFiles, MeshJob
from mammometry.base.errors import MammometryError
from mammometry.base.machine.cores import available_cores
from mammometry.geometry.mesh_files.ply import write_ply
from mammometry.io.meshes.foreign import read_foreign
from mammometry.io.outputs import take_folder
from mammometry.io.write import write_text
from mammometry.job.stages import measure
from mammometry.measure.settings import POSTURES
from mammometry.measure.volume.difference import difference
from mammometry.simulate.disturbances.registry import disturbed
from mammometry.simulate.recipe import parse_situation
from mammometry.simulate.scan import QUALITIES, clean_front, scan
from mammometry.simulate.subjects.registry import make_subject
from mammometry.simulate.subjects.solid import SubjectSolid

_EDGE_MM = 2.0  # of the bodies' triangles, on the breasts
# Share of the women who are operated on or differ, and how.
_OPERATIONS = (
    "", "", "arms=raised", "ptosis=2", "ptosis=3", "ratio=1.8", "removed=right", "removed=left", "mound=220",
    "build=thin", "build=obese", "arms=sides",
)  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class Body:
    """One woman in one posture, or one shared body, and the scans to make of it."""

    woman: int = 0
    posture: str = "shared"
    file: Path | None = None
    """Truth file of a shared body. None: a virtual woman."""
    scans: tuple[tuple[str, int], ...]
    """Quality and repetition of each."""
    report: bool = True
    """Whether lengths, symmetry and report are made, too, as the command does."""

    @property
    def name(self) -> str:
        """Name of the virtual woman or the shared body."""
        return str(self.woman) if self.file is None else self.file.name.removesuffix("_truth.json")

    @property
    def hangs(self) -> bool:
        """Whether its ptosis is graded, and its scan compared with its clean mesh."""
        return _HANGING in (self.posture, self.name.partition("_")[0])

    def key(self, quality: str, repetition: int) -> str:
        """Name of a row."""
        return f"{self.name}-{self.posture}-{quality}-{repetition}"


_HANGING = "hanging"
_BELOW_FOLD_MM = (10.0, 60.0)  # of the nipples of hanging breasts


def situation_of(number: int, posture: str) -> str:
    """Situation of a woman: her posture, and an operation, a build or hanging breasts."""
    if posture == _HANGING:
        below_mm = np.random.default_rng([number, 56]).uniform(*_BELOW_FOLD_MM)
        return f"posture=standing,hanging={below_mm:.0f}"
    return ",".join(filter(None, [f"posture={posture}", _OPERATIONS[number % len(_OPERATIONS)]]))


def posture_of(number: int) -> str:
    """Posture of a woman, chosen so that operations and postures combine evenly."""
    return POSTURES[(number + number // len(_OPERATIONS)) % len(POSTURES)]


def woman(number: int, posture: str) -> SubjectSolid:
    """Make a virtual woman.

    Raises:
        ValueError: the simulator cannot make this one.
    """
    reshape = partial(disturbed, stage="patient", situation=parse_situation(situation_of(number, posture)), seed=number)
    return make_subject(f"torso_{number}", 0, edge_mm=_EDGE_MM, reshape=reshape)


def measured(
    path: Path, units: str = "mm", *, report: bool = True, graded: bool = False, results: Path | None = None
) -> Row:
    """Measure a mesh file as the command does: volumes, outlines, landmarks, seconds, or the refusal.

    Args:
        path: of the mesh.
        units: of the mesh.
        report: whether the report is made, too.
        graded: whether the ptosis is graded: its possible grades by side.
        results: folder to keep the results in. What is current there is not computed again.
    """
    row: Row = {"sides": {}, "landmarks": {}, "no_breast": {}, "refused": ""}
    begun = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="mammometry-scans-") as folder:
        try:
            kept = Path(folder) / "results" if results is None else results
            take_folder(kept, command="measure")  # without a run nothing else marks it as ours
            job = MeshJob(MeshFiles(mesh=path, units=units, automatic=True), kept)
            if report:
                job.run()
                row["seconds"] = time.monotonic() - begun
            measurements = job.plan[measure.measurements]()
            curves = {boundary.name: boundary.points_world for boundary in job.plan[measure.boundaries]()}
            for measurement in measurements:
                side = measurement.name
                row["sides"][side] = {
                    "volume_cc": measurement.volume_cc,
                    "interval_cc": measurement.interval_cc,
                    "outline": np.round(curves[side], 2).tolist(),
                }
            both = {measurement.name: measurement for measurement in measurements}
            if {"left", "right"} <= both.keys():
                apart = difference(both["left"], both["right"], "sides")
                row["difference"] = {"cc": apart.difference_cc, "interval_cc": apart.difference_interval_cc}
            row["no_breast"] = {side.name: side.reason.code for side in job.plan.value(measure.absent) or ()}
            marks = job.plan.value(measure.landmarks) or ()
            row["landmarks"] = {mark.name: np.round(mark.points_world, 3).tolist() for mark in marks}
            shape = job.plan.value(measure.dimensions) if graded else None
            row["ptosis"] = {} if shape is None else {one.name: list(one.likely) for one in shape.ptosis}
        except MammometryError as error:
            row["refused"] = str(error)
        except Exception:  # a failure of ours is a failure, too
            row["refused"] = "FAILED " + traceback.format_exc(limit=-2)
    return row


def rows_of(body: Body) -> Iterator[Row]:
    """Yield one row per scan."""
    for quality, repetition, own in _shared_rows(body) if body.file is not None else _rows_of_woman(body):
        yield {
            "key": body.key(quality, repetition), "woman": body.name, "posture": body.posture, "quality": quality,
            "repetition": repetition, **own,
        }  # fmt: skip


def _rows_of_woman(body: Body) -> Iterator[tuple[str, int, Row]]:
    try:
        solid = woman(body.woman, body.posture)
    except ValueError as error:  # the simulator cannot make every one
        print(body.name, body.posture, error)
        return
    truth = {
        "volumes_cc": solid.volumes_cc,
        "difference_cc": _left_less_right(solid.volumes_cc),
        "outlines": {side: np.round(solid.mesh.vertices[b.boundary], 2).tolist() for side, b in solid.breasts.items()},
        "landmarks": {name: np.round(points, 2).tolist() for name, points in solid.landmarks.items()},
        "ptosis": true_grades(solid),
    }
    for quality, repetition in body.scans:
        made = clean_front(solid) if quality == CLEAN else scan(solid, QUALITIES[quality], repetition)
        with tempfile.TemporaryDirectory(prefix="mammometry-scans-") as folder:
            path = Path(folder) / "scan.ply"
            write_ply(path, made.mesh, made.ply_colours, comments=())
            yield quality, repetition, {
                "situation": situation_of(body.woman, body.posture), "truth": truth, "faces": len(made.mesh.faces),
                **measured(path, report=body.report, graded=body.hangs),
            }  # fmt: skip


def true_grades(solid: SubjectSolid) -> dict[str, str]:
    """Side → Regnault's grade by the true fold, nipple and lowest contour, for nipples below the fold."""
    grades = {}
    for side, breast in solid.breasts.items():
        fold, nipple = (solid.landmarks.get(f"{name}_{side}") for name in ("inframammary_fold", "nipple"))
        if fold is None or nipple is None or nipple[0, 1] > fold[0, 1]:
            continue
        below_mm = float(fold[0, 1] - nipple[0, 1])
        lowest_mm = float(nipple[0, 1] - solid.mesh.vertices[solid.mesh.faces[breast.skin_faces], 1].min())
        at_contour = below_mm > 10.0 and lowest_mm < 5.0
        grades[side] = "III" if below_mm > 30.0 or at_contour else "II" if below_mm > 10.0 else "I"
    return grades


def _left_less_right(volumes_cc: Mapping[str, float]) -> float | None:
    return volumes_cc["left"] - volumes_cc["right"] if {"left", "right"} <= volumes_cc.keys() else None


def _shared_rows(body: Body) -> Iterator[tuple[str, int, Row]]:
    """Yield rows of a shared body, clean and as a telephone fuses it."""
    assert body.file is not None
    table = json.loads(body.file.read_text(encoding="utf-8"))
    apart_cc = _left_less_right(table["above_smallest_cup_cc"])
    outlines = table.get("outline_10_percent", {})
    truth = {
        "volumes_cc": {}, "above_smallest_cup_cc": table["above_smallest_cup_cc"], "difference_cc": apart_cc,
        "outlines": outlines, "landmarks": {},
    }  # fmt: skip
    for quality, repetition in body.scans:
        kind, units = ("clean", "mm") if quality == CLEAN else ("scan", "m")
        path = body.file.with_name(f"{body.name}_{kind}.ply")
        faces = len(read_foreign(path, units).mesh.faces)
        own = measured(path, units, report=body.report, graded=body.hangs)
        yield quality, repetition, {"situation": "", "truth": truth, "faces": faces, **own}


def write_rows(body: Body, folder: Path) -> list[str]:
    """Measure a body's scans, keep each row, and return a line about each."""
    lines = []
    for row in rows_of(body):
        write_text(folder / f"{row['key']}.json", json.dumps(row))
        lines.append(f"{row['key']} {row['situation']} {_summary(row)}")
    return lines


def _summary(row: Row) -> str:
    if row["refused"]:
        return "refused: " + row["refused"].replace("\n", " ")[:110]
    parts = []
    for side in SIDES:
        true, own = row["truth"]["volumes_cc"].get(side), row["sides"].get(side)
        least = row["truth"].get("above_smallest_cup_cc", {}).get(side)
        known = f" for {true:.0f}" if true is not None else "" if least is None else f" for more than {least:.0f}"
        low, high = (own and own["interval_cc"]) or (np.nan, np.nan)
        parts.append(f"{side} " + ("–" if own is None else f"{own['volume_cc']:.0f} [{low:.0f}, {high:.0f}]") + known)
    return ", ".join(parts)


def _missing(body: Body, folder: Path) -> Body:
    """The body with only those scans that have no row."""
    scans = tuple(one for one in body.scans if not (folder / f"{body.key(*one)}.json").exists())
    return replace(body, scans=scans)


def range_of(text: str) -> range:
    """Numbers from first to last, as in 9000-9039."""
    first, _, last = text.partition("-")
    return range(int(first), int(last or first) + 1)


def _bodies(arguments: argparse.Namespace) -> Sequence[Body]:
    scans = tuple(
        (quality, repetition)
        for quality in arguments.qualities
        for repetition in range(1 if quality == CLEAN else arguments.repeat)
    )
    bodies = [
        Body(woman=number, posture=posture, scans=scans, report=arguments.reports)
        for number in arguments.women
        for posture in ([posture_of(number)] if arguments.one_posture else arguments.postures)
    ]
    if arguments.bodies is not None:
        kind = _HANGING if _HANGING in arguments.postures else "body"
        files = sorted(arguments.bodies.glob(f"{kind}_*_truth.json"))
        shared = ((CLEAN, 0), ("telephone", 0))
        bodies += [Body(file=file, scans=shared, report=arguments.reports) for file in files]
    left = [_missing(body, arguments.out) for body in bodies]
    return [body for body in left if body.scans]


def main() -> None:
    """Scan, measure, print the tables."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, required=True, help="folder of the rows; gone on with if it exists")
    parser.add_argument("--women", type=range_of, default=range_of("9000-9039"), help="first and last, as 9000-9039")
    parser.add_argument("--postures", nargs="*", default=list(POSTURES), choices=(*POSTURES, _HANGING))
    parser.add_argument("--one-posture", action="store_true", help="each woman in one posture: a third of the time")
    parser.add_argument("--qualities", nargs="*", default=[CLEAN, *QUALITIES], choices=[CLEAN, *QUALITIES])
    parser.add_argument("--repeat", type=int, default=1, help="scans of each woman, of each quality")
    parser.add_argument("--bodies", type=Path, default=None, help="folder of the shared bodies")
    parser.add_argument("--no-reports", dest="reports", action="store_false", help="sides, volumes and landmarks alone")
    parser.add_argument("--workers", type=int, default=available_cores())
    parser.add_argument("--differences", action="store_true", help="print left less right alone")
    parser.add_argument("--failures", action="store_true", help="print every refusal")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    with ProcessPoolExecutor(arguments.workers, mp_context=multiprocessing.get_context("spawn")) as pool:
        for done in as_completed([pool.submit(write_rows, body, arguments.out) for body in _bodies(arguments)]):
            print("\n".join(done.result()), flush=True)
    rows = [json.loads(path.read_text(encoding="utf-8")) for path in sorted(arguments.out.glob("*.json"))]
    hanging = [row for row in rows if row.get("ptosis") is not None]
    print(
        "\n".join(differences(rows) if arguments.differences else hanging_table(hanging) if hanging else tables(rows))
    )
    if arguments.failures:
        for row in rows:
            for why in (row["refused"], *(f"{side}: {text}" for side, text in row["no_breast"].items())):
                if why:
                    print(row["key"], row["situation"], why)


if __name__ == "__main__":
    main()
