"""Every chest wall on open fronts of virtual women with real statistics, and automatic boundaries.

    python -m benchmarks.accuracy.women --women 40 --first 1000

No photographs: what is measured is the open mesh of the front alone, cut off 110 to 200 mm behind its foremost point,
as a scanner would give it. Two truths are known of every breast: what stands before a flat chest that carries the layer
found at the boundary, and what stands before the muscle. Develop on numbers below 1000, report on those from 1000 on.
"""

from __future__ import annotations

import argparse
import json
import traceback
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from mammometry.base.errors import MammometryError
from mammometry.geometry.mesh import TriangleMesh
from mammometry.measure import scanned
from mammometry.measure.boundary.boundary import Boundary, outline_torso
from mammometry.measure.scan_repair import RepairedScan
from mammometry.measure.settings import MeasureSettings
from mammometry.measure.trunk.body import find_body
from mammometry.measure.wall import chest_wall
from mammometry.measure.wall.open_breast import OpenBreast, open_breasts
from mammometry.simulate.subjects.woman import woman_named

SIDES = ("left", "right")
FAMILIES = ("woman", "leaning-woman", "woman-wide", "leaning-woman-wide")
_UPRIGHT = np.eye(3)


def rows_of(name: str, edge_mm: float) -> Iterator[dict[str, object]]:
    """One row a breast, wall and boundary."""
    made = woman_named(name, 0, edge_mm=edge_mm)
    front = made.front()
    curves = {side: made.solid.mesh.vertices[made.solid.breasts[side].boundary] for side in SIDES}
    truths = {
        side: {"flat_cc": made.solid.closed_breast(side).volume_mm3() / 1000, "muscle_cc": made.muscle_cc(side)}
        for side in SIDES
    }
    for row in _measured(front, _drawn(curves), WALLS):
        yield {"woman": name, "boundary": "true", **truths[str(row["side"])], **row}
    surface = scanned.as_scanned(front)
    try:
        found = outline_torso(surface, _UPRIGHT).boundaries
        failed = ""
    except MammometryError as error:
        found, failed = (), str(error)
    there = {boundary.name for boundary in found}
    for side in SIDES:
        if side not in there:
            yield {"woman": name, "boundary": "automatic", "side": side, "failed": failed or "no breast or unclear"}
    for row in _measured(front, found, WALLS[:1]):
        yield {"woman": name, "boundary": "automatic", **truths[str(row["side"])], **row}


def _drawn(curves: dict[str, np.ndarray]) -> tuple[Boundary, ...]:
    return tuple(Boundary(name=side, points_world=curve, method="true") for side, curve in curves.items())  # type: ignore[arg-type]


def _measured(front: TriangleMesh, boundaries: tuple[Boundary, ...], walls: list[str]) -> Iterator[dict[str, object]]:
    fine = scanned.finer_scan(RepairedScan.unchanged(front), [boundary.points_world for boundary in boundaries]).mesh
    surface = scanned.as_scanned(fine)
    curves = [boundary.points_world for boundary in boundaries]
    frame = find_body(surface, _UPRIGHT, boundaries=curves).frame if boundaries else _UPRIGHT
    for breast in open_breasts(boundaries, surface, MeasureSettings(), frame=frame):
        yield from _walls(breast, walls)


WALLS = [
    "rounded-membrane",
    "cylinder-membrane",
    "thorax-fit",
    "tangent-continuous",
    "membrane",
    "thin-plate",
    "coons",
    "plane",
]


def _walls(breast: OpenBreast, walls: list[str]) -> Iterator[dict[str, object]]:
    side = breast.boundary.name
    try:
        trunk = breast.trunk
        axis = {"half_width_mm": trunk.half_width_mm, "assumed": trunk.assumed}
    except MammometryError:
        axis = {}
    for kind in walls:
        try:
            wall = chest_wall.fit(breast, kind)
        except MammometryError as error:
            yield {"side": side, "wall": kind, "failed": str(error), **axis}
        except Exception:  # a failure of ours is a failure, too
            yield {"side": side, "wall": kind, "failed": traceback.format_exc(limit=-1), **axis}
        else:
            yield {
                "side": side,
                "wall": kind,
                "volume_cc": wall.closed.volume_mm3() / 1000,
                "base_cm2": wall.mesh.area_mm2() / 100,
                **axis,
            }


def tables(rows: list[dict[str, object]]) -> Iterator[str]:
    """Markdown: one table a family, then the automatic boundaries."""
    families = dict.fromkeys(str(row["woman"]).partition("_")[0] for row in rows)
    for family in families:
        own = [row for row in rows if str(row["woman"]).partition("_")[0] == family]
        yield f"\n{family}, true boundary\n"
        yield "| wall | breasts | failed | bias cc | bias mm | SD mm | 95 % mm | error % | of muscle: bias mm | SD mm |"
        yield "| --- " * 10 + "|"
        kinds = dict.fromkeys(str(row["wall"]) for row in own if row["boundary"] == "true")
        for kind in kinds:
            of_wall = [row for row in own if row["boundary"] == "true" and row.get("wall") == kind]
            good = [row for row in of_wall if "volume_cc" in row]
            if not good:
                yield f"| {kind} | {len(of_wall)} | {len(of_wall)} |" + " – |" * 7
                continue
            volume, flat, muscle, base = _columns(good, "volume_cc", "flat_cc", "muscle_cc", "base_cm2")
            error, deep = 10 * (volume - flat) / base, 10 * (volume - muscle) / base
            percent = 100 * (volume - flat) / flat
            yield (
                f"| {kind} | {len(of_wall)} | {len(of_wall) - len(good)} | {(volume - flat).mean():+.1f} | "
                f"{error.mean():+.2f} | {error.std(ddof=1):.2f} | {np.quantile(np.abs(error), 0.95):.2f} | "
                f"{percent.mean():+.1f} ± {percent.std(ddof=1):.1f} | {deep.mean():+.1f} | {deep.std(ddof=1):.1f} |"
            )
        yield from _automatic(own)


def _automatic(rows: list[dict[str, object]]) -> Iterator[str]:
    """How often the automatic boundary was found, and how far area and volume are from the true boundary's."""

    def default(boundary: str) -> dict[tuple[str, str], dict[str, object]]:
        return {
            (str(row["woman"]), str(row["side"])): row
            for row in rows
            if row["boundary"] == boundary and row.get("wall") == WALLS[0] and "volume_cc" in row
        }

    true, found = default("true"), default("automatic")
    wanted = {(str(row["woman"]), str(row["side"])) for row in rows}
    both = sorted(true.keys() & found.keys())
    if not both:
        yield f"\nautomatic boundary: found 0 of {len(wanted)}"
        return
    ratio = {
        name: np.array([float(found[key][name]) / float(true[key][name]) - 1 for key in both])  # type: ignore[arg-type]
        for name in ("base_cm2", "volume_cc")
    }
    area, volume = 100 * ratio["base_cm2"], 100 * ratio["volume_cc"]
    near, alike = 100 * np.mean(np.abs(area) < 10), 100 * np.mean(np.abs(volume) < 8)
    yield (
        f"\nautomatic boundary: found and measured {len(found)} of {len(wanted)}; "
        f"area {area.mean():+.1f} ± {area.std(ddof=1):.1f} %, within 10 % {near:.0f} %; "
        f"volume {volume.mean():+.1f} ± {volume.std(ddof=1):.1f} %, within 8 % {alike:.0f} %"
    )


def _columns(rows: list[dict[str, object]], *names: str) -> tuple[np.ndarray, ...]:
    return tuple(np.array([float(row[name]) for row in rows]) for name in names)  # type: ignore[arg-type]


def main() -> None:
    """Make the women, print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--women", type=int, default=20, help="of each family")
    parser.add_argument("--first", type=int, default=1000)
    parser.add_argument("--families", nargs="*", default=list(FAMILIES[:2]), choices=FAMILIES)
    parser.add_argument("--edge-mm", type=float, default=2.5)
    parser.add_argument("--failures", action="store_true", help="print the message of every failure")
    parser.add_argument("--out", type=Path, default=None, help="JSON: all rows")
    parser.add_argument("--walls", nargs="*", default=WALLS, choices=WALLS)
    arguments = parser.parse_args()
    WALLS[:] = arguments.walls
    rows: list[dict[str, object]] = []
    for family in arguments.families:
        for number in range(arguments.first, arguments.first + arguments.women):
            try:
                rows += rows_of(f"{family}_{number}", arguments.edge_mm)
            except ValueError as error:  # the simulator cannot make every one
                print(error)
    if arguments.out is not None:
        arguments.out.write_text(json.dumps(rows))
    print("\n".join(tables(rows)))
    if arguments.failures:
        for row in rows:
            if "failed" in row:
                print(row["woman"], row["boundary"], row["side"], row.get("wall", "–"), row["failed"])


if __name__ == "__main__":
    main()
