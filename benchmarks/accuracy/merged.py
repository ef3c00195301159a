"""Ptotic breasts scanned from the front, from below, and merged, against the clean mesh's volume.

    python -m benchmarks.accuracy.merged --out rows --women 9600-9611
    python -m benchmarks.accuracy.merged --out rows --women 9600-9611 --refusals

A virtual telephone scans each woman twice: around her front, and from below at the height of her hips. The volumes are
those that the program finds in each scan without any drawing. The clean mesh, measured by the same program, is what
they are compared with. `--refusals` merges what must not be merged: another woman, the same woman leaning forward, the
second scan scaled by 1.01 and by 1.1, and mirrored. It also merges the second scan turned and moved at random, which
must give the same. Rows are kept in the folder, and what is there is not measured again.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path
from types import MappingProxyType

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.accuracy.scan_tables import SIDES, Row
from benchmarks.accuracy.scans import situation_of
from mammometry.api.mesh import MeshFiles, MeshJob
from mammometry.base.errors import MammometryError
from mammometry.geometry import Array, Float64, Transform, TriangleMesh
from mammometry.geometry.mesh_files.ply import write_ply
from mammometry.io.write import write_text
from mammometry.job.stages import measure
from mammometry.simulate.disturbances.registry import disturbed
from mammometry.simulate.recipe import parse_situation
from mammometry.simulate.scan import QUALITIES, clean_front, scan
from mammometry.simulate.subjects.registry import make_subject
from mammometry.simulate.subjects.solid import SubjectSolid

SCANS = ("clean", "front", "below", "merged")
_EDGE_MM = 2.0  # of the bodies' triangles, on the breasts
_SEEDS = (1, 2)  # of the scan from the front, and of that from below
_AT_RANDOM = "turned and moved"


@cache
def hanging_woman(number: int, posture: str = "standing") -> SubjectSolid:
    """Make a virtual woman whose nipples are 10 to 60 mm below the folds.

    Raises:
        ValueError: the simulator cannot make this one.
    """
    situation = parse_situation(situation_of(number, "hanging").replace("standing", posture))
    reshape = partial(disturbed, stage="patient", situation=situation, seed=number)
    return make_subject(f"torso_{number}", 0, edge_mm=_EDGE_MM, reshape=reshape)


def write_scans(solid: SubjectSolid, folder: Path, quality: str = "telephone") -> dict[str, Path]:
    """Scan a body, and write its clean mesh and both scans."""
    made = {"clean": clean_front(solid)}
    for walk, seed in zip(("front", "below"), _SEEDS, strict=True):
        made[walk] = scan(solid, QUALITIES[quality], seed, walk)  # type: ignore[arg-type]
    paths = {name: folder / f"{name}.ply" for name in made}
    for name, one in made.items():
        write_ply(paths[name], one.mesh, one.ply_colours, comments=("units: mm",))
    return paths


def measured(mesh: Path, also: Sequence[Path] = ()) -> Row:
    """Volumes and intervals of one or several merged mesh files by the command, or the refusal."""
    row: Row = {"sides": {}, "refused": "", "fit": []}
    with tempfile.TemporaryDirectory(prefix="mammometry-merged-") as folder:
        try:
            job = MeshJob(MeshFiles(mesh=mesh, also=tuple(also), units="mm", automatic=True), Path(folder) / "results")
            row["fit"] = [one.as_table() for one in job.also]
            for one in job.plan[measure.measurements]():
                row["sides"][one.name] = {"volume_cc": one.volume_cc, "interval_cc": one.interval_cc}
        except MammometryError as error:
            row["refused"] = str(error)
    return row


def rows_of(number: int) -> Iterator[Row]:
    """Yield a row for each kind of scan of one woman."""
    with tempfile.TemporaryDirectory(prefix="mammometry-merged-") as folder:
        paths = write_scans(hanging_woman(number), Path(folder))
        for name in SCANS:
            of = measured(paths["front"], [paths["below"]]) if name == "merged" else measured(paths[name])
            yield {"woman": number, "scan": name, "truth": hanging_woman(number).volumes_cc, **of}


@dataclass(frozen=True, slots=True, kw_only=True)
class _Pair:
    """Origin of the second scan of a pair."""

    woman: int = 0
    """Added to the woman's number."""
    posture: str = "standing"
    changed: Callable[[TriangleMesh], TriangleMesh] = lambda mesh: mesh


def _scaled(mesh: TriangleMesh, factor: float) -> TriangleMesh:
    return mesh.mapped(lambda points: factor * points)


def _mirrored(mesh: TriangleMesh) -> TriangleMesh:
    return mesh.mapped(lambda points: points * [-1.0, 1.0, 1.0]).turned_over()


def _moved(mesh: TriangleMesh) -> TriangleMesh:
    rng = np.random.default_rng(zlib.crc32(mesh.vertices[:100].tobytes()))
    shift_mm: Float64[Array, 3] = 500.0 * rng.normal(size=3)
    return mesh.transformed(Transform(rotation=Rotation.random(rng=rng).as_matrix(), translation_mm=shift_mm))


PAIRS: Mapping[str, _Pair] = MappingProxyType({
    _AT_RANDOM: _Pair(changed=_moved),
    "another woman": _Pair(woman=1),
    "leaning forward": _Pair(posture="leaning"),
    "scaled by 1.01": _Pair(changed=partial(_scaled, factor=1.01)),
    "scaled by 1.1": _Pair(changed=partial(_scaled, factor=1.1)),
    "mirrored": _Pair(changed=_mirrored),
})  # fmt: skip


def refusal_rows_of(number: int) -> Iterator[Row]:
    """Yield the registration of each pair of scans, or its refusal."""
    first = scan(hanging_woman(number), QUALITIES["telephone"], _SEEDS[0])
    for name, pair in PAIRS.items():
        second = scan(hanging_woman(number + pair.woman, pair.posture), QUALITIES["telephone"], _SEEDS[1], "below")
        second = replace(second, mesh=pair.changed(second.mesh))
        row: Row = {"woman": number, "scan": name, "refused": "", "fit": []}
        from mammometry.measure.merging.registration import fit_scans

        try:
            fit = fit_scans(first.mesh, second.mesh)
            row["fit"] = [{"overlap": fit.overlap, "within_mm": fit.within_mm, "scale": fit.scale}]
        except MammometryError as error:
            row["refused"] = str(error)
        yield row


def table(rows: Sequence[Row]) -> Iterator[str]:
    """Yield each kind of scan's volumes against the clean mesh's, as Markdown."""
    clean = {row["woman"]: row["sides"] for row in rows if row["scan"] == "clean"}
    yield "| scan | sides measured | refused | \\|volume − clean\\| %, median | worst | clean within the interval |"
    yield "| --- | --: | --: | --: | --: | --: |"
    for name in SCANS:
        own = [row for row in rows if row["scan"] == name]
        pairs = [
            (row["sides"][side], clean[row["woman"]][side])
            for row in own
            for side in SIDES
            if side in row["sides"] and side in clean.get(row["woman"], {})
        ]
        off = [100 * abs(one["volume_cc"] / true["volume_cc"] - 1) for one, true in pairs]
        held = sum(one["interval_cc"][0] <= true["volume_cc"] <= one["interval_cc"][1] for one, true in pairs)
        cells = [
            name,
            f"{sum(len(row['sides']) for row in own)} of {2 * len(own)}",
            str(sum(bool(row["refused"]) for row in own)),
            *((f"{np.median(off):.1f}", f"{max(off):.1f}") if off else ("–", "–")), f"{held} of {len(pairs)}",
        ]  # fmt: skip
        yield f"| {' | '.join(cells)} |"


def refusal_table(rows: Sequence[Row]) -> Iterator[str]:
    """Yield how many pairs of each kind were merged and refused, as Markdown."""
    yield "| second scan | merged | refused | residual mm, largest of the merged | why refused |"
    yield "| --- | --: | --: | --: | --- |"
    for name in PAIRS:
        own = [row for row in rows if row["scan"] == name]
        within = [fit["within_mm"] for row in own for fit in row["fit"]]
        whys = sorted(
            {row["refused"].partition("expected")[0].partition("found ")[2][:40] for row in own if row["refused"]}
        )
        refused = sum(bool(row["refused"]) for row in own)
        yield f"| {name} | {len(within)} | {refused} | {max(within, default=0):.1f} | {'; '.join(whys[:3])} |"


def main() -> None:
    """Scan, measure, print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, required=True, help="folder of the rows; gone on with if it exists")
    parser.add_argument("--women", default="9600-9611", help="first and last, as 9600-9611")
    parser.add_argument("--refusals", action="store_true", help="merge what must not be merged instead")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    first, _, last = arguments.women.partition("-")
    kind, make, names = ("refusals", refusal_rows_of, tuple(PAIRS)) if arguments.refusals else ("scans", rows_of, SCANS)
    rows: list[Row] = []
    for number in range(int(first), int(last or first) + 1):
        path = arguments.out / f"{kind}-{number}.json"
        if not path.exists():
            try:
                write_text(path, json.dumps(list(make(number))))
            except ValueError as error:  # the simulator cannot make every one
                print(number, error)
                continue
        rows += json.loads(path.read_text(encoding="utf-8"))
        for row in rows[-len(names) :]:
            sides = {side: round(one["volume_cc"]) for side, one in row.get("sides", {}).items()}
            print(
                row["woman"],
                row["scan"],
                sides or "",
                row["fit"][0]["within_mm"] if row["fit"] else "",
                row["refused"][:150],
                flush=True,
            )
    print("\n".join(refusal_table(rows) if arguments.refusals else table(rows)))


if __name__ == "__main__":
    main()
