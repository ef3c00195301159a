"""Walks with one telephone around virtual women: surface and volumes against truth.

    python -m benchmarks.accuracy.photos --walks ../shared/data/photos --out OUT
    python -m benchmarks.accuracy.photos --walks ../shared/data/photos --shifted 10 --out OUT
    python -m benchmarks.accuracy.photos --walks ../shared/data/photos --compressed 50 --out OUT
    python -m benchmarks.accuracy.photos --walks ../shared/data/photos --filtered 25 --out OUT
    python -m benchmarks.accuracy.photos --women 9701 9702 9703 --out OUT

The first command measures walks from another renderer. The second one first crops each photograph at a random
position, with a standard deviation in pixels, as a stabilised lens shifts it. The third one compresses photographs to
this JPEG quality, and saves them as PNG, because the program leaves out JPEGs below 50. The fourth one smooths
differences of about that many grey levels, like a beauty filter. The last one renders its own walks, one for each
woman, with each of `CONDITIONS` in turn.

Each folder of `--walks` contains ``photos/`` and ``truth/`` (``truth.json`` with the board's pose and the nipples, and
``body.ply``). Errors are measured on the true skin within 85 mm of a nipple, whether the photographs show it or not,
and on the measured skin there. Each volume is compared with that of the true mesh by the same program, and for own
women also with the true volume. *Held* means that the interval contains it. A walk in OUT is not measured again.
`--peers` adds rows of other programs (`photo_peers`).
"""

from __future__ import annotations

import argparse
import json
import resource
import shutil
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from io import BytesIO
from pathlib import Path

import cv2
import numpy as np
from PIL import Image

import mammometry as mm
from benchmarks.accuracy.photo_peers import by_pycolmap, by_sgbm
from mammometry.api.mesh import MeshFiles, MeshJob
from mammometry.api.photos import prepare_walk
from mammometry.base.errors import MammometryError
from mammometry.geometry import TriangleMesh
from mammometry.geometry.mesh_files.ply import write_ply
from mammometry.geometry.nearest import closest_on_mesh
from mammometry.job.stages import surface
from mammometry.simulate.recipe import Situation, parse_situation
from mammometry.simulate.rendering.skin import SKINS
from mammometry.simulate.walk import WalkRecipe, write_walk
from mammometry.surface.repair.repair import Provenance

CONDITIONS = {
    "clean": ("skin", ""),
    "held": ("skin", "breath=0.3,autofocus=0.1,stabiliser=5,rolling=1"),
    "smooth": ("pale-skin", ""),
}
"""Name → skin and disturbances of a rendered walk. ``held``: a held breath, and a telephone's lens and shutter."""
_SCALE = 0.3  # photographs of 1210 × 907; limits time
_MOST_SHIFT_PX = 24  # largest shift of a photograph, in either direction
_NEAR_MM = 85.0  # largest distance from a nipple: contains a large breast's skin
_LEAST_SIGMA_MM = 0.1  # least σ of a vertex: errors of the cameras' positions add about this much
_FAR_MM = 1.0  # signed distances are clipped to this: a few outliers would dominate their mean


def true_body(path: Path) -> TriangleMesh:
    """The body of a walk's truth, mm."""
    data = path.read_bytes()
    start = data.index(b"end_header\n") + len(b"end_header\n")
    header = data[:start].decode()
    vertices, faces = (int(header.split(f"element {name} ")[1].split()[0]) for name in ("vertex", "face"))
    points = np.frombuffer(data, np.float32, 3 * vertices, start).reshape(-1, 3)
    corners = np.frombuffer(data, np.dtype([("n", "u1"), ("i", "<i4", 3)]), faces, start + 12 * vertices)["i"]
    return TriangleMesh(vertices=points.astype(float), faces=np.ascontiguousarray(corners, dtype=np.int32))


def surface_errors(mesh: TriangleMesh, body: TriangleMesh, nipples: np.ndarray) -> str:
    """Distance of the breasts' true skin from the measured mesh, by area: mean, RMS, 95 %, within 1 mm, bias."""
    middles = body.vertices[body.faces].mean(axis=1)
    near = np.linalg.norm(middles[:, None] - nipples[None], axis=2).min(axis=1) < _NEAR_MM
    vectors = body.face_vectors()[near]
    area = np.linalg.norm(vectors, axis=1)
    found = closest_on_mesh(middles[near], mesh)
    ahead = np.einsum("ij,ij->i", found.points - middles[near], vectors) / area
    order = np.argsort(found.distances_mm)
    share = np.cumsum(area[order]) / area.sum()
    most = found.distances_mm[order][np.searchsorted(share, 0.95)]
    mean = np.average(found.distances_mm, weights=area)
    rms = np.sqrt(np.average(found.distances_mm**2, weights=area))
    whole = area[found.distances_mm < 1.0].sum() / area.sum()
    bias = np.average(np.clip(ahead, -_FAR_MM, _FAR_MM), weights=area)
    return f"{mean:.3f} {rms:.2f} {most:.2f}, {100 * whole:.0f} %, {bias:+.2f}"


def measured_errors(vertices: np.ndarray, sigma_mm: np.ndarray, body: TriangleMesh, nipples: np.ndarray) -> str:
    """Distance of measured vertices on the breasts from the true skin, mm: mean, 95 %, and share beyond 3 σ."""
    near = np.linalg.norm(vertices[:, None] - nipples[None], axis=2).min(axis=1) < _NEAR_MM
    distances_mm = closest_on_mesh(vertices[near], body).distances_mm
    beyond = np.mean(distances_mm > 3 * np.maximum(sigma_mm[near], _LEAST_SIGMA_MM))
    return f"{distances_mm.mean():.3f} {np.quantile(distances_mm, 0.95):.2f}, {100 * beyond:.1f} %"


def measured(walk: Path, out: Path) -> str:
    """One row of the table."""
    truth = json.loads((walk / "truth" / "truth.json").read_text(encoding="utf-8"))
    body, pose = true_body(walk / "truth" / "body.ply"), np.array(truth["board_pose"])
    clean = out / f"{walk.name}-true.ply"
    if not clean.exists():
        write_ply(clean, body)
    files = MeshFiles(mesh=clean, units="mm", automatic=True, head="y", ahead="z")
    true_cc = MeshJob(files, out / f"{walk.name}-true").run().volumes_cc
    begun_s = processor_s()
    try:
        found = prepare_walk(walk / "photos", out / walk.name)
        job = mm.open_session(out / walk.name)
        results = job.run()
    except MammometryError as error:
        return f"| {walk.name} | refused: {error} | | | | |"
    repaired = job.plan[surface.repaired]()
    mesh = repaired.mesh
    moved = TriangleMesh(vertices=mesh.vertices @ pose[:3, :3].T + pose[:3, 3], faces=mesh.faces)
    volumes = []
    for side, volume_cc in true_cc.items():
        if side not in results.volumes_cc:
            volumes.append(f"{side} {volume_cc:.0f}: none")
            continue
        interval = results.intervals_cc[side]
        held = interval is not None and interval[0] <= volume_cc <= interval[1]
        off = 100 * (results.volumes_cc[side] / volume_cc - 1)
        volumes.append(f"{side} {volume_cc:.0f}: {off:+.1f} %, {'held' if held else 'not held'}")
        if true := truth.get("true_volumes_cc"):
            holds = interval is not None and interval[0] <= true[side] <= interval[1]
            off = 100 * (results.volumes_cc[side] / true[side] - 1)
            volumes[-1] += f" (truth {true[side]:.0f}: {off:+.1f} %, {'held' if holds else 'not held'})"
    nipples = np.array(truth["nipples"])
    seen = repaired.provenance == Provenance.MEASURED
    skin = measured_errors(moved.vertices[seen], repaired.sigma_mm[seen], body, nipples)
    errors = f"{surface_errors(moved, body, nipples)} | {skin}"
    used = f"{len(found.used)} of {found.pictures}"
    return f"| {walk.name} | {used} | {errors} | {'; '.join(volumes)} | {processor_s() - begun_s:.0f} |"


def peers(walk: Path, out: Path) -> Iterator[str]:
    """A row for each other program, for a walk that `measured` has measured."""
    truth = json.loads((walk / "truth" / "truth.json").read_text(encoding="utf-8"))
    body, pose = true_body(walk / "truth" / "body.ply"), np.array(truth["board_pose"])
    makers: dict[str, Callable[[], tuple[str, TriangleMesh | None]]] = {
        "SGBM and TSDF, our positions": lambda: ("", by_sgbm(out / walk.name)),
        "pycolmap's positions, our stages": lambda: by_pycolmap(
            walk / "photos", out / walk.name, out / f"{walk.name}-pycolmap"
        ),
    }
    for name, maker in makers.items():
        begun_s = processor_s()
        note, mesh = maker()
        errors = ""
        if mesh is not None:
            moved = TriangleMesh(vertices=mesh.vertices @ pose[:3, :3].T + pose[:3, 3], faces=mesh.faces)
            errors = surface_errors(moved, body, np.array(truth["nipples"]))
        yield f"| {walk.name}: {name} | {note} | {errors} | | | {processor_s() - begun_s:.0f} |"


def render(women: list[int], folder: Path) -> Iterator[Path]:
    """Walks of these women, each rendered when it is needed, unless it exists."""
    for number, seed in enumerate(women):
        name = list(CONDITIONS)[number % len(CONDITIONS)]
        skin, disturbances = CONDITIONS[name]
        out = folder / f"{seed}-{name}"
        if not out.exists():
            recipe = WalkRecipe(
                subject=f"torso_{seed}",
                seed=seed,
                scale=_SCALE,
                skin=SKINS[skin],
                situation=parse_situation(disturbances) if disturbances else Situation(),
            )
            write_walk(out, recipe)
        yield out


def shifted(walk: Path, out: Path, std_px: float) -> Path:
    """The walk with each photograph cropped at a random position, as by a stabilised lens."""
    if not out.exists():
        shutil.copytree(walk / "truth", out / "truth")
        (out / "photos").mkdir()
        rng = np.random.default_rng(5)
        for path in sorted((walk / "photos").iterdir()):
            if path.suffix != ".jpg":
                shutil.copy(path, out / "photos")
                continue
            with Image.open(path) as image:
                (width, height), most = image.size, _MOST_SHIFT_PX
                x, y = np.clip(np.rint(rng.normal(0.0, std_px, 2)), -most, most).astype(int)
                part = image.crop((most + x, most + y, width - most + x, height - most + y))
                part.save(out / "photos" / path.name, quality=97, subsampling=0)
    return out


def changed(walk: Path, out: Path, change: Callable[[Image.Image], Image.Image]) -> Path:
    """The walk with the pixels of each photograph changed, as PNG."""
    if not out.exists():
        shutil.copytree(walk / "truth", out / "truth")
        (out / "photos").mkdir()
        for path in sorted((walk / "photos").iterdir()):
            if path.suffix != ".jpg":
                shutil.copy(path, out / "photos")
                continue
            with Image.open(path) as image:
                change(image).save(out / "photos" / f"{path.stem}.png", compress_level=1)
    return out


def compressed(image: Image.Image, quality: int) -> Image.Image:
    """A photograph compressed as by a messenger."""
    small = BytesIO()
    image.save(small, "JPEG", quality=quality)
    return Image.open(small)


def filtered(image: Image.Image, levels: float) -> Image.Image:
    """A photograph with smoothed skin, as by a beauty filter: bilateral, 4 px."""
    return Image.fromarray(cv2.bilateralFilter(np.asarray(image), 0, levels, 4.0))


def processor_s() -> float:
    """Processor seconds of this process and its children so far."""
    own, children = resource.getrusage(resource.RUSAGE_SELF), resource.getrusage(resource.RUSAGE_CHILDREN)
    return own.ru_utime + own.ru_stime + children.ru_utime + children.ru_stime


def main() -> None:
    """Measure all walks, and print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    walks = parser.add_mutually_exclusive_group(required=True)
    walks.add_argument("--walks", type=Path)
    walks.add_argument("--women", type=int, nargs="+")
    parser.add_argument("--shifted", type=float, default=0.0, help="px")
    parser.add_argument("--compressed", type=int, default=0, help="JPEG quality")
    parser.add_argument("--filtered", type=float, default=0.0, help="grey levels that a beauty filter smooths")
    parser.add_argument("--peers", action="store_true", help="other programs on the same walks")
    parser.add_argument("--out", type=Path, required=True)
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    found: Iterable[Path] = (
        render(arguments.women, arguments.out / "rendered")
        if arguments.women
        else sorted(path for path in arguments.walks.iterdir() if (path / "truth").is_dir())
    )
    columns = (
        "walk", "pictures used", "surface, mm: mean RMS 95 %, within 1 mm, bias", "measured, mm: mean 95 %, beyond 3 σ",
        "true mesh, cc: error", "CPU s",
    )  # fmt: skip
    print("| " + " | ".join(columns) + " |")
    print("| --- " * len(columns) + "|")
    for walk in found:
        if arguments.shifted:
            px = arguments.shifted
            walk = shifted(walk, arguments.out / "shifted" / f"{walk.name}-{px:g}px", px)
        if quality := arguments.compressed:
            to = arguments.out / "compressed" / f"{walk.name}-q{quality}"
            walk = changed(walk, to, partial(compressed, quality=quality))
        if levels := arguments.filtered:
            to = arguments.out / "filtered" / f"{walk.name}-{levels:g}"
            walk = changed(walk, to, partial(filtered, levels=levels))
        print(measured(walk, arguments.out), flush=True)
        for row in peers(walk, arguments.out) if arguments.peers else ():
            print(row, flush=True)


if __name__ == "__main__":
    main()
