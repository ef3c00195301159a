"""Results for each side of torsos with one breast removed, and with mounds without a fold.

    python -m benchmarks.accuracy.sides
    python -m benchmarks.accuracy.sides --clinic --first 500 --torsos 12

No photographs: the skin is the simulator's own, as far as cameras in front would see it, with noise along its normals,
and the frame that tells head from foot is turned at random. Of each torso the right breast is removed (its skin is the
chest's), or replaced by a mound of 80 to 400 cc that runs out flat all around, without areola and nipple. Prints what
was said of each side, the error of the mound's volume against what the same wall makes of the true skin within the true
boundary, how far its interval holds, and by how much the intact side's volume changes when the other breast is gone.
With `--clinic` the right side is operated as the virtual clinic does it: mounds as flat as it draws them, scars, folds
of loose skin. Numbers of torsos are then seeds; held-out ones are skipped.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.accuracy.walls import as_seen, true_boundaries
from mammometry.base.errors import MeasureError
from mammometry.geometry.arrays import Array, Float64
from mammometry.geometry.mesh import TriangleMesh
from mammometry.measure.boundary.boundary import Boundary, outline_torso
from mammometry.measure.trunk.body import find_body
from mammometry.measure.volume.deficit import volume_deficit
from mammometry.measure.volume.measurement import VolumeMeasurement
from mammometry.measure.volume.volumes import measure_volumes
from mammometry.measure.wall import chest_wall
from mammometry.measure.wall.open_breast import open_breasts
from mammometry.simulate.disturbances.draw import is_held_out
from mammometry.simulate.disturbances.registry import disturbed
from mammometry.simulate.recipe import parse_situation
from mammometry.simulate.subjects.registry import make_subject
from mammometry.simulate.subjects.solid import rig_from_solid
from mammometry.simulate.subjects.torso import torso
from mammometry.simulate.subjects.torso_shape import BreastDesign, TorsoShape, torso_shape
from mammometry.surface.repair.repair import RepairedSurface

_NOISE_MM, _TILT_DEG, _EDGE_MM = 0.15, 8.0, 3.0
_MOUNDS_CC = (80.0, 400.0)


@dataclass(frozen=True)
class Case:
    """A body in front of the cameras."""

    name: str
    surface: RepairedSurface
    boundaries: dict[str, Boundary]
    """True ones, of the sides that bear a breast."""
    lacking_cc: float
    """Left less right, true, cc."""


def mound(shape: TorsoShape, volume_cc: float, rng: np.random.Generator) -> BreastDesign:
    """A right mound that runs out flat all around: an expander, or a flap."""
    radius = (volume_cc * 1000 / (0.3 * np.pi * rng.uniform(0.4, 0.65))) ** (1 / 3)
    old = shape.breasts["right"]
    inner = min(radius, old.apex_mm[0])
    aside = inner + 8.0
    return replace(
        old,
        volume_cc=volume_cc,
        apex_mm=(aside, old.apex_mm[1] + rng.uniform(0.0, 25.0)),
        radii_mm=(inner, min(radius, shape.body.half_width_mm + 4.0 - aside), radius, radius),
        projection_mm=0.5 * radius,
        hang_mm=rng.uniform(0.0, 4.0),
        fullness=0.0,
        nipple_mm=0.0,
    )


def cases(number: int, seed: int) -> Iterator[Case]:
    """One torso with two breasts, with the left one alone, and with a mound on the right."""
    rng = np.random.default_rng([seed, number, 26])
    shape = torso_shape(f"torso_{number}", seed)
    volume_cc = float(np.exp(rng.uniform(*np.log(_MOUNDS_CC))))
    with_mound = replace(shape, breasts={**shape.breasts, "right": mound(shape, volume_cc, rng)})
    for kind, each in (("two", shape), ("removed", shape), ("mound", with_mound)):
        solid = torso(each, name=f"torso_{number}", seed=seed, edge_mm=_EDGE_MM)
        solid = solid.placed(rig_from_solid(solid, seed))
        vertices, faces = solid.mesh.vertices.copy(), solid.mesh.faces
        edges: dict[str, Boundary] = {edge.name: edge for edge in true_boundaries(solid, vertices)}
        volumes = {side: solid.closed_breast(side).volume_mm3() / 1000 for side in edges}
        if kind == "removed":
            inside = np.unique(faces[solid.breasts["right"].skin_faces])
            assert solid.wall_vertices is not None  # every torso has one
            vertices[inside] = solid.wall_vertices[inside]
            volumes["right"] = 0.0
            del edges["right"]
        mesh = TriangleMesh(vertices=vertices, faces=faces)
        noise = np.random.default_rng([seed, number, 27]).normal(0.0, _NOISE_MM, len(vertices))
        noisy = TriangleMesh(vertices=vertices + mesh.vertex_normals() * noise[:, None], faces=faces)
        yield Case(name=kind, surface=as_seen(noisy), boundaries=edges, lacking_cc=volumes["left"] - volumes["right"])


def clinic_cases(number: int, seed: int) -> Iterator[Case]:
    """These three cases, made by disturbances of the virtual clinic."""
    if is_held_out(number):
        return
    rng = np.random.default_rng([seed, number, 29])
    scar_mm, loose_mm, mound_cc = (
        rng.uniform(1.0, 8.0),
        rng.uniform(4.0, 12.0),
        np.exp(rng.uniform(*np.log(_MOUNDS_CC))),
    )
    build = str(rng.choice(["", ",build=thin", ",build=obese"]))
    operated = {
        "two": "",
        "removed": f"removed=right,scar={scar_mm:.1f},loose-skin={loose_mm:.1f}",
        "mound": f"removed=right,mound={mound_cc:.3g},scar={scar_mm:.1f}",  # the side that was removed is rebuilt
    }
    for kind, text in operated.items():
        situation = parse_situation((text + build).strip(","))
        reshape = partial(disturbed, stage="patient", situation=situation, seed=number)
        solid = make_subject("torso", number, edge_mm=_EDGE_MM, reshape=reshape)
        solid = solid.placed(rig_from_solid(solid, number))
        mesh = solid.mesh
        noise = np.random.default_rng([seed, number, 27]).normal(0.0, _NOISE_MM, len(mesh.vertices))
        noisy = TriangleMesh(vertices=mesh.vertices + mesh.vertex_normals() * noise[:, None], faces=mesh.faces)
        volumes = {"left": 0.0, "right": 0.0} | solid.volumes_cc
        yield Case(
            name=kind,
            surface=as_seen(noisy),
            boundaries={
                side: Boundary(name=side, points_world=mesh.vertices[breast.boundary], method="true")  # type: ignore[arg-type]
                for side, breast in solid.breasts.items()
            },
            lacking_cc=volumes["left"] - volumes["right"],
        )


def same_wall_cc(case: Case, frame: Float64[Array, "3 3"]) -> dict[str, float]:
    """Volume of true skin and boundaries with the default wall, cc."""
    opened = open_breasts(tuple(case.boundaries.values()), case.surface, frame=frame)
    return {each.boundary.name: chest_wall.fit(each).closed.volume_mm3() / 1000 for each in opened}


def rows_of(number: int, seed: int, clinic: bool = False) -> Iterator[dict[str, object]]:
    """Rows of all cases."""
    rng = np.random.default_rng([seed, number, 28])
    rough = Rotation.from_rotvec(np.deg2rad(_TILT_DEG) * rng.uniform(-1, 1, 3)).as_matrix()
    for case in (clinic_cases if clinic else cases)(number, seed):
        row: dict[str, object] = {"torso": number, "case": case.name, "true": sorted(case.boundaries)}
        try:
            found = outline_torso(case.surface, rough)
            row["found"] = sorted(each.name for each in found.boundaries)
            row["unclear"] = sorted(each.name for each in found.absent if each.unclear)
            curves = [each.points_world for each in found.boundaries]
            body = find_body(case.surface, rough, boundaries=curves)
            row["plane_mm"] = body.plane_sigma_mm
            measured = measure_volumes(open_breasts(found.boundaries, case.surface, frame=body.frame))
            row |= _volumes(case, measured, same_wall_cc(case, body.frame))
            less = volume_deficit(case.surface, measured, body)
            if less is not None and less.interval_cc is not None:
                sign = 1.0 if less.name == "right" else -1.0
                row["lacking_error"] = less.volume_cc - sign * case.lacking_cc
                row["lacking_held"] = less.interval_cc[0] <= sign * case.lacking_cc <= less.interval_cc[1]
        except MeasureError as error:
            row["refused"] = str(error)
        yield row


def _volumes(case: Case, measured: tuple[VolumeMeasurement, ...], same: dict[str, float]) -> dict[str, object]:
    values: dict[str, object] = {}
    for each in measured:
        values[each.name] = each.volume_cc
        if each.name in same:
            values[f"{each.name}_true"] = same[each.name]
            held = each.as_defined_cc
            values[f"{each.name}_held"] = held is not None and held[0] <= same[each.name] <= held[1]
    return values


def summary(rows: list[dict[str, object]]) -> Iterator[str]:
    """Lines of the summary: sides that were found correctly, and errors of the mounds."""
    by_case = {name: [row for row in rows if row["case"] == name] for name in ("two", "removed", "mound")}
    yield "| right side | bodies | both sides rightly told | unclear or refused | wrong |"
    yield "| --- | --- | --- | --- | --- |"
    for name, own in by_case.items():
        right = sum(row.get("found") == row["true"] for row in own)
        unclear = sum(bool(row.get("unclear")) or "refused" in row for row in own)
        yield f"| {name} | {len(own)} | {right} | {unclear} | {len(own) - right - unclear} |"
    mounds = [row for row in by_case["mound"] if "right_true" in row]
    error, true = (np.array([float(row[key]) for row in mounds]) for key in ("right", "right_true"))  # type: ignore[arg-type]
    error = error - true
    held = np.mean([bool(row["right_held"]) for row in mounds])
    good = np.abs(error) <= np.maximum(0.15 * true, 25.0)
    yield ""
    yield (
        f"mounds of {true.min():.0f} to {true.max():.0f} cc before the same wall: {error.mean():+.1f} ± "
        f"{error.std(ddof=1):.1f} cc, worst {error[np.argmax(np.abs(error))]:+.1f}; within 15 % or 25 cc "
        f"{100 * good.mean():.0f} %; interval as defined held {100 * held:.0f} %"
    )
    whole = {row["torso"]: float(row["left"]) for row in by_case["two"] if "left" in row}  # type: ignore[arg-type]
    change = np.array([
        100 * (float(row["left"]) / whole[row["torso"]] - 1)  # type: ignore[arg-type]
        for row in by_case["removed"] if "left" in row and row["torso"] in whole
    ])  # fmt: skip
    spread = f"{change.mean():+.2f} ± {change.std(ddof=1):.2f} %"
    yield f"left with the right one removed against the same body with both: {spread}"
    less = [row for row in rows if "lacking_error" in row]
    errors = np.array([float(row["lacking_error"]) for row in less])  # type: ignore[arg-type]
    held = np.mean([bool(row["lacking_held"]) for row in less])
    yield f"volume lacking: {errors.mean():+.1f} ± {errors.std(ddof=1):.1f} cc, held {100 * held:.0f} % of {len(less)}"


def main() -> None:
    """Make the bodies, print the rows and the summary."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--torsos", type=int, default=12)
    parser.add_argument("--first", type=int, default=1)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--clinic", action="store_true", help="operate the right side as the virtual clinic does")
    arguments = parser.parse_args()
    rows = []
    for number in range(arguments.first, arguments.first + arguments.torsos):
        for row in rows_of(number, arguments.seed, arguments.clinic):
            rows.append(row)
            print(row, flush=True)
    print("\n".join(summary(rows)))


if __name__ == "__main__":
    main()
