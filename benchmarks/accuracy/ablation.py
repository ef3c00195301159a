"""Rules for merging views on self-occluding surfaces: nearest, furthest, TSDF, Poisson, ours.

    python -m benchmarks.accuracy.ablation --out build/ablation

Three virtual casts where dents occur (a deep fold under the breast, a ptotic breast, a long nipple), photographed by
the reference rig at a quarter of its size, true cameras. Each rule works on the range data as they come ("all") and on
those that are left after the dented ones are removed ("kept"). The rules nearest, furthest and TSDF have no elastic
repair; ours is shown without it and with it. Screened Poisson is `benchmarks.poisson`, on a grid of 0.8 mm. Judged at
the true vertices that a pair sees, unaligned, and apart from those at the ones near an occlusion: within 6 mm of a
vertex that faces a left camera and is hidden from it.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from benchmarks.pairs import foregrounds_of
from benchmarks.poisson import screened_poisson
from mammometry.geometry.arrays import Array
from mammometry.geometry.camera import Rig
from mammometry.geometry.mesh import TriangleMesh
from mammometry.io.photographs.images import read_photograph
from mammometry.matching.dense.match import match
from mammometry.matching.foreground.foreground import Foreground
from mammometry.matching.rectify import rectify
from mammometry.matching.settings import MatchSettings
from mammometry.report.figures.canvas import PanelSheet
from mammometry.report.figures.shading import ShadedMesh, front_frame, picture_wh, standard_views
from mammometry.report.figures.surface import show
from mammometry.simulate.disturbances.exposure import plain_exposure
from mammometry.simulate.rigs.build import flashes
from mammometry.simulate.rigs.rig_file import make_rig
from mammometry.simulate.studio import Arrangement, Studio, photograph
from mammometry.simulate.subjects.plaster import PlasterShape, plaster
from mammometry.simulate.subjects.solid import rig_from_solid
from mammometry.study.accuracy import compare_surfaces
from mammometry.study.rays import RayScene, seen_by_pairs
from mammometry.surface.fusion.fuse import extract
from mammometry.surface.ranges.dents import decompose, remove_dents
from mammometry.surface.ranges.range_image import RangeImage, triangulate
from mammometry.surface.repair.repair import repair
from mammometry.surface.settings import DentSettings, ExtractSettings

SHAPES = {
    "fold": PlasterShape(volume_cc=450.0, sag=0.45, fold=0.24),
    "ptotic": PlasterShape(volume_cc=650.0, sag=0.8, fold=0.15, projection=0.95),
    "nipple": PlasterShape(volume_cc=400.0, nipple_mm=11.0, areola_mm=20.0),
}
NEAR_MM = 6.0
_EVERY = 5
_ERROR_MM = 1.0


def capture(name: str, folder: Path, scale: float, seed: int) -> tuple[Rig, TriangleMesh]:
    """Photograph a cast into `folder`, unless it is there; the true rig and the true surface, rig frame."""
    solid = plaster(SHAPES[name], name=name, seed=seed, edge_mm=0.7 * 0.25 / scale)
    rig, place = make_rig("reference", scale, seed), rig_from_solid(solid, seed)
    if not (folder / "capture").is_dir():
        folder.mkdir(parents=True, exist_ok=True)
        studio = Studio()
        stands = Arrangement(
            exposure=plain_exposure(rig, flashes(), studio.film),
            lights=flashes(),
            rig_from_target={},
            solid=solid,
            rig_from_solid=place,
        )
        photograph(folder, stands, studio, seed=seed)
    return rig, solid.mesh.transformed(place)


def range_images(rig: Rig, folder: Path) -> tuple[list[RangeImage], dict[str, Foreground]]:
    """Match every pair."""
    settings = MatchSettings()
    files = {path.stem: path for path in (folder / "capture").iterdir()}
    photographs = {name: read_photograph(files[name], name) for name in rig.cameras}
    seen = foregrounds_of(rig, photographs, settings.foreground)
    images = []
    for pair in rig.pairs:
        left, right = pair.left.name, pair.right.name
        both = rectify(pair, photographs[left], photographs[right], seen[left], seen[right])
        images.append(triangulate(match(both, settings)))
    return images, seen


def surfaces(
    rig: Rig, images: Sequence[RangeImage], foregrounds: Mapping[str, Foreground], cube_mm: float
) -> Iterator[tuple[str, str, TriangleMesh]]:
    """(rule, data, surface) for every rule."""
    patches = decompose(images)
    data = {"all": remove_dents(images, patches, DentSettings(rule="none")), "kept": remove_dents(images, patches)}
    plain = ExtractSettings(cube_mm=cube_mm)
    for label, valid in data.items():
        for rule in ("nearest", "furthest", "tsdf", "default"):
            first = extract(valid.range_images, foregrounds, rig, replace(plain, rule=rule))
            yield {"default": "ours without elastic repair", "tsdf": "TSDF average"}.get(rule, rule), label, first
            if rule == "default":
                yield "ours, with elastic repair", label, repair(first, valid).mesh
        yield "screened Poisson", label, screened_poisson(valid.range_images)


def occluded(scene: RayScene, rig: Rig, chosen: Array) -> Array:
    """Mask of the true vertices near one that faces a left camera and is hidden from it."""
    points, normals = scene.mesh.vertices[chosen], scene.mesh.vertex_normals()[chosen]
    hidden = np.zeros(len(points), dtype=bool)
    for pair in rig.pairs:
        towards = pair.left.centre_world - points
        facing = np.einsum("ij,ij->i", towards, normals) > 0.2 * np.linalg.norm(towards, axis=1)
        hidden[facing] |= scene.hides(pair.left.centre_world, points[facing])
    if not hidden.any():
        return hidden
    return np.asarray(cKDTree(points[hidden]).query(points)[0] <= NEAR_MM)


def judge(mesh: TriangleMesh, truth: TriangleMesh, seen: Array, near: Array) -> dict[str, Any]:
    """Errors of one surface."""
    whole = compare_surfaces(mesh, truth, at=seen)
    row: dict[str, Any] = {
        "mean_mm": whole.mean_mm,
        "rms_mm": whole.rms_mm,
        "p95_mm": whole.p95_mm,
        "bias_mm": whole.bias_mm,
        "complete_percent": whole.complete_percent,
        "euler": mesh.euler_number(),
        "watertight": mesh.is_watertight(),
    }
    if len(near):
        folds = compare_surfaces(mesh, truth, at=near)
        row |= {"near_mean_mm": folds.mean_mm, "near_p95_mm": folds.p95_mm}
    return row


def picture(drawn: Mapping[str, TriangleMesh], truth: TriangleMesh, rig: Rig, title: str) -> bytes:
    """Every surface from below, coloured by its distance from the truth."""
    import matplotlib as mpl

    view = standard_views(truth, front_frame(rig))[-1]
    columns = -(-len(drawn) // 2)
    sheet = PanelSheet(columns, 2, picture_wh(view, 260), bars=True)
    tree, normals = cKDTree(truth.vertices), truth.vertex_normals()
    colours = mpl.colormaps["coolwarm"]
    for index, (name, mesh) in enumerate(drawn.items()):
        nearest = tree.query(mesh.vertices)[1]
        signed = np.einsum("ij,ij->i", mesh.vertices - truth.vertices[nearest], normals[nearest])
        painted = (255 * colours(np.clip(signed / (2 * _ERROR_MM) + 0.5, 0, 1))[:, :3]).astype(np.uint8)
        show(sheet.panel(index, name), ShadedMesh(mesh).render(view, size_px=400, colours=painted), view)
    scale = mpl.cm.ScalarMappable(norm=mpl.colors.Normalize(-_ERROR_MM, _ERROR_MM), cmap="coolwarm")
    for row in range(2):
        sheet.bar(row, scale, "outside the truth, mm")
    return sheet.png(title, "Distance from the truth of each rule's surface; red lies outside.")


HEADS = {
    "mean_mm": ("mean mm", ".3f"),
    "rms_mm": ("RMS", ".3f"),
    "p95_mm": ("95 %", ".3f"),
    "bias_mm": ("bias", "+.3f"),
    "complete_percent": ("complete %", ".1f"),
    "near_mean_mm": ("folds: mean", ".3f"),
    "near_p95_mm": ("folds: 95 %", ".3f"),
    "euler": ("Euler", "d"),
}


def main() -> None:
    """Photograph, reconstruct by every rule, print the table, write it and the pictures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("build/ablation"))
    parser.add_argument("--shapes", nargs="+", choices=list(SHAPES), default=list(SHAPES))
    parser.add_argument("--scale", type=float, default=0.25)
    parser.add_argument("--cube-mm", type=float, default=0.5)
    parser.add_argument("--seed", type=int, default=3)
    arguments = parser.parse_args()
    rows: list[dict[str, Any]] = []
    print("| cast | rule | data |" + "".join(f" {title} |" for title, _ in HEADS.values()))
    print("| --- " * (len(HEADS) + 3) + "|", flush=True)
    for name in arguments.shapes:
        rig, truth = capture(name, arguments.out / name, arguments.scale, arguments.seed)
        images, foregrounds = range_images(rig, arguments.out / name)
        scene = RayScene(truth)
        chosen, by_pair = seen_by_pairs(scene, rig, every=_EVERY)
        seen = np.any(list(by_pair.values()), axis=0)
        near = chosen[seen & occluded(scene, rig, chosen)]
        drawn = {}
        for rule, data, mesh in surfaces(rig, images, foregrounds, arguments.cube_mm):
            row = {"cast": name, "rule": rule, "data": data, **judge(mesh, truth, chosen[seen], near)}
            rows.append(row)
            cells = " | ".join(format(row[key], form) if key in row else "" for key, (_, form) in HEADS.items())
            print(f"| {name} | {rule} | {data} | {cells} |", flush=True)
            if data == ("kept" if rule.startswith("ours") else "all"):
                drawn[rule] = mesh
        (arguments.out / f"{name}.png").write_bytes(picture(drawn, truth, rig, f"Merging views: {name}"))
    (arguments.out / "ablation.json").write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
