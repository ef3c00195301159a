"""Benchmark of landmarks and borders: write its meshes and truth, and run our program on it.

    python -m benchmarks.accuracy.landmarks --write FOLDER --bodies ../shared/data
    python -m benchmarks.accuracy.landmarks --find FOLDER --out ours.json
    mammometry study landmarks ours.json FOLDER/truth.json

Writes a folder of meshes, mm, y to the head and z ahead, and one truth file; `--truth FILE` puts that elsewhere, for a
benchmark whose truth is hidden. Another program writes its own JSON instead of the second command
(docs/how-to/landmark-benchmark.md). Women of the generator `torso` stand, lean or lie, some operated on; `woman` is a
second generator, whose women have no arms and no sternal notch. The shared bodies are a third program's: known are the
line along which the cup lifts the skin by a tenth, which is not quite a border, and the nipples of two. `--sessions`
photographs women with a virtual rig, and the shared walks are photographs by one telephone: both kinds are meshes that
our own program made of the photographs. Develop on numbers below 9000, report on those from 9000 on. What is in the
folder already is not made again.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

import mammometry as mm
from benchmarks.accuracy.scan_tables import CLEAN, SIDES
from benchmarks.accuracy.scans import measured, posture_of, range_of, woman
from mammometry.api.photos import prepare_walk
from mammometry.base.machine.cores import available_cores
from mammometry.geometry.arrays import Array, Float64
from mammometry.geometry.mesh import TriangleMesh
from mammometry.geometry.mesh_files.ply import write_ply
from mammometry.geometry.transform import Transform
from mammometry.io.meshes.foreign import read_foreign
from mammometry.io.write import write_text
from mammometry.job.stages import surface
from mammometry.simulate.recipe import SessionRecipe
from mammometry.simulate.scan import QUALITIES, VirtualScan, clean_front, scan
from mammometry.simulate.session import write_session
from mammometry.simulate.subjects.solid import SubjectSolid
from mammometry.simulate.subjects.woman import woman_named
from mammometry.study.evaluation import resampled

Known: TypeAlias = dict[str, Float64[Array, "k 3"]]
_UPRIGHT = np.eye(3)  # frame of every mesh. Rows: the patient's left, the head, straight ahead
_FAMILIES = ("woman", "leaning-woman")  # of the second generator
_EDGE_MM = 2.5  # of its triangles
_LEVEL_MM = 0.3  # depth of the part of a fold that counts as lowest; a definition
_FOLD_HALF_ANGLE_RAD = np.deg2rad(45.0)  # the fold's extent to either side of straight down; a definition
_SCALE = 0.15  # of a virtual rig's photographs, of 4504 × 3000 pixels
_WALKS = {"clean": "4", "disturbed": "3"}  # walk → shared body
_RIG, _PHOTOGRAPHS = "rig", "photographs"
_SESSIONS, _RESULTS = "sessions", "results"  # folders of what is kept between calls


def fold_curve(border: Float64[Array, "b 3"], frame: Float64[Array, "3 3"]) -> Float64[Array, "k 3"]:
    """The fold: the border's part within 45° of straight down, seen from its middle, mm.

    Args:
        border: closed curve, mm.
        frame: rows: the patient's left, the head, straight ahead.
    """
    dense = resampled(border, 1.0)
    flat = (dense - dense.mean(axis=0)) @ frame[:2].T
    below = np.abs(np.arctan2(flat[:, 0], -flat[:, 1])) <= _FOLD_HALF_ANGLE_RAD
    first = int(np.argmax(below & ~np.roll(below, 1)))
    return np.roll(dense, -first, axis=0)[: int(below.sum())]


def lowest_point(border: Float64[Array, "b 3"], frame: Float64[Array, "3 3"]) -> Float64[Array, "1 3"]:
    """The fold's lowest point, mm.

    It is the middle of the border's part within 0.3 mm of the border's greatest distance from the head. Arguments as
    for `fold_curve`.
    """
    dense = resampled(border)
    depth = -dense @ frame[1]
    piece = dense[depth > depth.max() - _LEVEL_MM]
    middle = piece.mean(axis=0)
    return piece[np.argmin(np.linalg.norm(piece - middle, axis=1))][None]


def of_borders(borders: Mapping[str, Float64[Array, "b 3"]]) -> Known:
    """Borders, with the fold and its lowest point, which they define."""
    known: Known = {}
    for side, border in borders.items():
        known[f"border_{side}"] = border
        known[f"fold_curve_{side}"] = fold_curve(border, _UPRIGHT)
        known[f"inframammary_fold_{side}"] = lowest_point(border, _UPRIGHT)
    return known


def known_of(solid: SubjectSolid, *, notch: bool) -> Known:
    """True landmarks of one of our women, frame of the solid."""
    known = of_borders({side: solid.mesh.vertices[breast.boundary] for side, breast in solid.breasts.items()})
    points = ("nipple_left", "nipple_right", "midline", *(("sternal_notch",) if notch else ()))
    return known | {name: solid.landmarks[name] for name in points if name in solid.landmarks}


def add(folder: Path, name: str, kind: str, generator: str, make: Callable[[], tuple[VirtualScan, Known]]) -> str:
    """Write one mesh and its part of the truth, unless both are there."""
    part = folder / f"{name}.truth.json"
    if part.exists():
        return name
    try:
        made, known = make()
    except (ValueError, mm.MammometryError) as error:  # the simulator cannot make every one
        return f"{name}: {error}"
    write_ply(folder / f"{name}.ply", made.mesh, made.ply_colours, comments=("mm, y to the head, z ahead",))
    sided = ("nipple", "inframammary_fold", "fold_curve", "border")
    absent = [f"{one}_{side}" for side in SIDES for one in sided if f"{one}_{side}" not in known]
    only = generator == "torso"  # of the others it is not known what is missing
    own = {
        "kind": kind,
        "generator": generator,
        "mesh": f"{name}.ply",
        "landmarks": {name: np.round(points, 3).tolist() for name, points in known.items()},
        "absent": absent if only else [],
    }
    write_text(part, json.dumps(own))
    return name


def _of_torso(number: int, kind: str) -> tuple[VirtualScan, Known]:
    solid = woman(number, posture_of(number))
    return _scanned(solid, kind), known_of(solid, notch=True)


def _of_woman(number: int, kind: str) -> tuple[VirtualScan, Known]:
    solid = woman_named(f"{_FAMILIES[number % len(_FAMILIES)]}_{number}", 0, edge_mm=_EDGE_MM).solid
    return _scanned(solid, kind), known_of(solid, notch=False)


def _scanned(solid: SubjectSolid, kind: str) -> VirtualScan:
    return clean_front(solid) if kind == CLEAN else scan(solid, QUALITIES[kind], 0)


def _of_body(scans: Path, number: str, kind: str, nipples: Known) -> tuple[VirtualScan, Known]:
    file, units = (f"body_{number}_clean.ply", "mm") if kind == CLEAN else (f"body_{number}_scan.ply", "m")
    table = json.loads((scans / f"body_{number}_truth.json").read_text(encoding="utf-8"))
    borders = {side: np.array(points) for side, points in table["outline_10_percent"].items()}
    read = read_foreign(scans / file, units)
    return VirtualScan(mesh=read.mesh, colours=read.colours), of_borders(borders) | nipples


def _of_session(session: Path, number: int) -> tuple[VirtualScan, Known]:
    """Surface from a virtual rig's photographs by our program, solid's frame."""
    if not session.exists():
        write_session(session, SessionRecipe(subject=f"torso_{number}", seed=number, scale=_SCALE))
    truth = session / "truth"
    facts = json.loads((truth / "truth.json").read_text(encoding="utf-8"))
    boards = json.loads((truth / "boards.json").read_text(encoding="utf-8"))
    rig_from_solid = Transform.from_matrix(np.array(facts["rig_from_solid"]))
    rig_from_world = Transform.from_matrix(np.array(boards["rig_from_board"][min(boards["rig_from_board"])]))
    solid_from_rig = rig_from_solid.inverse()
    made = _reconstructed(session, solid_from_rig @ rig_from_world)
    marks = json.loads((truth / "landmarks.json").read_text(encoding="utf-8"))["landmarks"]
    known = of_borders(
        {side: solid_from_rig.apply(np.loadtxt(truth / f"boundary_{side}.xyz")) for side in SIDES
         if (truth / f"boundary_{side}.xyz").exists()}
    )  # fmt: skip
    names = ("nipple_left", "nipple_right", "midline", "sternal_notch")
    return made, known | {name: solid_from_rig.apply(np.array(marks[name])) for name in names if name in marks}


def _of_walk(session: Path, walk: Path, border: Known) -> tuple[VirtualScan, Known]:
    """Surface from one telephone's photographs by our program, body's frame."""
    truth = json.loads((walk / "truth" / "truth.json").read_text(encoding="utf-8"))
    prepare_walk(walk / "photos", session)
    made = _reconstructed(session, Transform.from_matrix(np.array(truth["board_pose"])))
    return made, border | nipples_of(walk)


def nipples_of(walk: Path) -> Known:
    """True nipples of a walk's body; a positive x is the patient's left."""
    places = json.loads((walk / "truth" / "truth.json").read_text(encoding="utf-8"))["nipples"]
    return {f"nipple_{'left' if place[0] > 0 else 'right'}": np.array([place]) for place in places}


def _reconstructed(session: Path, solid_from_world: Transform) -> VirtualScan:
    finished = mm.open_session(session).plan[surface.mesh]()
    mesh = finished.repaired.mesh
    moved = TriangleMesh(vertices=solid_from_world.apply(mesh.vertices), faces=mesh.faces)
    return VirtualScan(mesh=moved, colours=finished.textured.colours)


def write(folder: Path, arguments: argparse.Namespace) -> None:
    """Write all meshes and the truth."""
    sessions = folder / _SESSIONS
    sessions.mkdir(parents=True, exist_ok=True)
    wanted: list[Callable[[], str]] = []
    makers = {"torso": (_of_torso, arguments.women), "woman": (_of_woman, arguments.others)}
    for kind in arguments.kinds:
        for generator, (make, numbers) in makers.items():
            for number in numbers:
                name = f"{generator}-{number}-{kind}"
                wanted.append(partial(add, folder, name, kind, generator, partial(make, number, kind)))
    for number in arguments.sessions:
        name = f"torso-{number}-rig"
        wanted.append(partial(add, folder, name, _RIG, "torso", partial(_of_session, sessions / name, number)))
    if arguments.bodies is not None:
        wanted += _shared(folder, arguments.bodies, arguments.kinds, walks=arguments.walks)
    with ProcessPoolExecutor(arguments.workers, mp_context=multiprocessing.get_context("spawn")) as pool:
        for done in [pool.submit(one) for one in wanted]:
            print(done.result(), flush=True)
    parts = {path.name.removesuffix(".truth.json"): path for path in sorted(folder.glob("*.truth.json"))}
    women = {name: json.loads(path.read_text(encoding="utf-8")) for name, path in parts.items()}
    write_text(arguments.truth or folder / "truth.json", json.dumps({"units": "mm", "women": women}))
    for path in parts.values() if arguments.truth else ():
        path.unlink()


def _shared(folder: Path, data: Path, kinds: Sequence[str], *, walks: bool) -> list[Callable[[], str]]:
    """Existing shared bodies, with the scans to be made of them."""
    scans, photos = data / "scans", data / "photos"
    wanted: list[Callable[[], str]] = []
    nipples = {body: nipples_of(photos / walk) for walk, body in _WALKS.items() if (photos / walk).is_dir()}
    for path in sorted(scans.glob("body_*_truth.json")):
        number = path.name.split("_")[1]
        for kind in kinds:
            if kind in (CLEAN, "telephone"):
                make = partial(_of_body, scans, number, kind, nipples.get(number, {}))
                wanted.append(partial(add, folder, f"body-{number}-{kind}", kind, "shared", make))
    for walk, body in _WALKS.items() if walks else ():
        if (photos / walk).is_dir():
            table = json.loads((scans / f"body_{body}_truth.json").read_text(encoding="utf-8"))
            border = of_borders({side: np.array(points) for side, points in table["outline_10_percent"].items()})
            name = f"body-{body}-photographs"
            make = partial(_of_walk, folder / _SESSIONS / name, photos / walk, border)
            wanted.append(partial(add, folder, name, _PHOTOGRAPHS, "shared", make))
    return wanted


def found_by_us(path: Path) -> dict[str, Any]:
    """Landmarks that our program finds on one mesh, with the benchmark's names."""
    row = measured(path, report=False, results=path.parent / _RESULTS / path.stem)
    found: dict[str, Any] = dict(row["landmarks"])
    for side, own in row["sides"].items():
        border = np.array(own["outline"])
        found[f"border_{side}"] = own["outline"]
        found[f"fold_curve_{side}"] = np.round(fold_curve(border, _UPRIGHT), 3).tolist()
    return found


def find(folder: Path, out: Path, workers: int) -> None:
    """Run our program on every mesh of a folder, and write its JSON."""
    meshes = sorted(folder.glob("*.ply"))
    with ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("spawn")) as pool:
        found = dict(zip((path.stem for path in meshes), pool.map(found_by_us, meshes), strict=True))
    write_text(out, json.dumps(found))


def main() -> None:
    """Write the benchmark, or find its landmarks with our program."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--write", type=Path, default=None, help="folder of the meshes")
    parser.add_argument("--truth", type=Path, default=None, help="file of the truth, if not in the folder")
    parser.add_argument("--women", type=range_of, default=range_of("9500-9523"), help="first and last, as 9500-9523")
    parser.add_argument("--others", type=range_of, default=range_of("9500-9507"), help="of the second generator")
    parser.add_argument("--sessions", type=int, nargs="*", default=[], help="women to photograph with a virtual rig")
    parser.add_argument("--kinds", nargs="*", default=[CLEAN, "telephone"], choices=[CLEAN, *QUALITIES])
    parser.add_argument("--bodies", type=Path, default=None, help="folder of the shared data")
    parser.add_argument("--walks", action="store_true", help="with the shared walks of one telephone")
    parser.add_argument("--find", type=Path, default=None, help="folder of meshes to find landmarks on")
    parser.add_argument("--out", type=Path, default=Path("ours.json"), help="JSON of what was found")
    parser.add_argument("--workers", type=int, default=available_cores())
    arguments = parser.parse_args()
    if arguments.write is not None:
        write(arguments.write, arguments)
    if arguments.find is not None:
        find(arguments.find, arguments.out, arguments.workers)


if __name__ == "__main__":
    main()
