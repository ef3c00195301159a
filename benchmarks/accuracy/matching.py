"""Disparity errors against ray-cast truth, with true cameras: `python -m benchmarks.accuracy.matching CAPTURES`.

CAPTURES is a folder laid out as ../shared/data/rendered. A pixel counts when its true surface point is seen by both
cameras inside both frames, more than 5 px from any occluding edge in either rectified picture, and by both at less than
70° of incidence. Truth is read here and nowhere in the product.
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from scipy import ndimage
from scipy.spatial import cKDTree
from skimage.measure import find_contours

from mammometry.geometry.camera import Camera, StereoPair
from mammometry.geometry.transform import Transform
from mammometry.io.images import read_photograph
from mammometry.matching.foreground import Foreground, estimate_foreground
from mammometry.matching.match import DisparityMap, match
from mammometry.matching.rectify import RectifiedPair, rectify
from mammometry.matching.settings import MatchSettings

EDGE_PX = 5.0
INCIDENCE_DEG = 70.0
NEAR_EDGE_PX = 20.0
SEEN_MM = 0.3  # a point is seen where the first hit of its ray is nearer to it than this
JUMP_MM = 3.0  # neighbouring pixels that differ by more lie on either side of an occluding edge


@dataclass(frozen=True)
class Truth:
    """What the renderer knows of one rectified pair; left image's pixels."""

    disparity_px: np.ndarray
    """NaN where no surface is hit."""
    counts: np.ndarray
    """Pixels that are judged."""
    edge_px: np.ndarray
    """Distance to the nearest occluding edge, in either picture."""


class Scene:
    """A true mesh to cast rays at."""

    def __init__(self, mesh_path: Path) -> None:
        self.mesh = trimesh.load(mesh_path, process=False)
        self._intersector = trimesh.ray.ray_pyembree.RayMeshIntersector(self.mesh)

    def cast(self, origin: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Range (mm, NaN where nothing is hit) and cosine of incidence along unit directions (n, 3)."""
        hit = self._intersector.intersects_first(np.broadcast_to(origin, directions.shape), directions)
        corners = self.mesh.vertices[self.mesh.faces[np.maximum(hit, 0)]]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        towards = np.einsum("ij,ij->i", directions, normals)
        ranges = np.einsum("ij,ij->i", corners[:, 0] - origin, normals) / towards
        return np.where(hit >= 0, ranges, np.nan), np.where(hit >= 0, -towards, np.nan)

    def image(self, camera: Camera) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Range, cosine of incidence and ray of every pixel of a camera."""
        uv = np.stack(np.meshgrid(*(np.arange(n, dtype=np.float64) for n in camera.size_wh)), axis=-1)
        rays = camera.rays_world(uv)
        ranges, cosines = self.cast(camera.centre_world, rays.reshape(-1, 3))
        return ranges.reshape(camera.shape_hw), cosines.reshape(camera.shape_hw), rays


def read_cameras(captures: Path) -> dict[str, Camera]:
    """The renderer's own cameras."""
    table = json.loads((captures / "truth" / "cameras.json").read_text())["cameras"]
    return {
        name: Camera(
            name=name,
            size_wh=tuple(entry["image_size"]),
            matrix=np.array(entry["K"]),
            distortion=np.array(entry["dist"]),
            camera_from_world=Transform(rotation=np.array(entry["R"]), translation_mm=np.array(entry["t"])),
        )
        for name, entry in table.items()
    }


def true_disparity(scene: Scene, pair: StereoPair, rectified: RectifiedPair) -> Truth:
    """Cast the left rectified rays, look at their points from the right camera, and choose what counts."""
    ranges, cosines, rays = scene.image(rectified.left)
    hit = np.isfinite(ranges)
    points = rectified.left.centre_world + ranges[..., None] * rays
    right_uv = rectified.right.project(points)
    columns = np.arange(ranges.shape[1], dtype=np.float64)
    disparity = columns - right_uv[..., 0]

    towards = points[hit] - rectified.right.centre_world
    distance = np.linalg.norm(towards, axis=1)
    first, right_cosines = scene.cast(rectified.right.centre_world, towards / distance[:, None])
    least = np.cos(np.radians(INCIDENCE_DEG))
    counts = np.zeros(hit.shape, dtype=bool)
    counts[hit] = (np.abs(first - distance) < SEEN_MM) & (right_cosines > least) & (cosines[hit] > least)
    for camera in (pair.left, pair.right):
        uv = camera.project(points)
        with np.errstate(invalid="ignore"):
            counts &= ((uv >= 0) & (uv <= np.array(camera.size_wh) - 1)).all(axis=-1)

    def from_edge(image: np.ndarray) -> np.ndarray:
        filled = np.where(np.isfinite(image), image, 1e4)
        jump = ndimage.maximum_filter(filled, 3) - ndimage.minimum_filter(filled, 3) > JUMP_MM
        return ndimage.distance_transform_edt(~jump)

    right_edge = from_edge(scene.image(rectified.right)[0])
    rows = np.broadcast_to(np.arange(ranges.shape[0])[:, None], ranges.shape)
    seen_there = ndimage.map_coordinates(right_edge, [rows, np.nan_to_num(right_uv[..., 0], nan=-1.0)], order=1)
    edge = np.minimum(from_edge(ranges), seen_there)
    return Truth(disparity_px=disparity, counts=counts & (edge > EDGE_PX), edge_px=edge)


def judge(truth: Truth, found: DisparityMap) -> dict[str, float]:
    """The figures of one pair."""
    error = found.d_h_px - truth.disparity_px
    judged = truth.counts & found.valid
    size = np.abs(error[judged])
    focal = found.left.matrix[0, 0]
    baseline = float(np.linalg.norm(found.left.centre_world - found.right.centre_world))
    parallax = found.left.matrix[0, 2] - found.right.matrix[0, 2]
    depth = focal * baseline / (found.d_h_px[judged] - parallax)
    true_depth = focal * baseline / (truth.disparity_px[judged] - parallax)
    near = judged & (truth.edge_px < NEAR_EDGE_PX)
    anywhere = found.valid & np.isfinite(truth.disparity_px)
    score = np.abs(error[judged]) / found.sigma_px[judged]
    return {
        "median_px": float(np.median(size)),
        "p95_px": float(np.percentile(size, 95)),
        "beyond_1_px_percent": float(100 * np.mean(size > 1)),
        "complete_percent": float(100 * judged.sum() / truth.counts.sum()),
        "depth_bias_mm": float(np.median(depth - true_depth)),
        "near_edge_median_px": float(np.median(np.abs(error[near]))),
        "all_accepted_beyond_1_px_percent": float(100 * np.mean(np.abs(error[anywhere]) > 1)),
        "error_over_sigma": float(1.4826 * np.median(score)),
        "beyond_3_sigma_percent": float(100 * np.mean(score > 3)),
        "d_v_median_px": float(np.median(found.d_v_px[found.valid])),
    }


def judge_silhouette(scene: Scene, camera: Camera, foreground: Foreground) -> dict[str, float]:
    """Signed distance of the silhouette from the true one, px, positive outside; the frame does not count."""
    ranges = scene.image(camera)[0]
    coverage = np.isfinite(ranges).astype(np.float64)
    band = ndimage.binary_dilation(coverage > 0, iterations=2) & ~ndimage.binary_erosion(
        coverage > 0, iterations=2, border_value=1
    )
    rows, columns = np.nonzero(band)
    steps = (np.arange(8) + 0.5) / 8 - 0.5
    offsets = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    uv = np.stack([columns, rows], axis=1)[:, None] + offsets
    hits = np.isfinite(scene.cast(camera.centre_world, camera.rays_world(uv.reshape(-1, 2)))[0])
    coverage[rows, columns] = hits.reshape(-1, len(offsets)).mean(axis=1)
    true = np.concatenate(find_contours(coverage, 0.5))
    found = np.concatenate(find_contours(np.asarray(foreground.coverage), foreground.contour_level))
    inner = ((found > 3) & (found < np.array(camera.shape_hw) - 4)).all(axis=1)
    found = found[inner]
    distance = cKDTree(true).query(found)[0]
    distance *= np.where(ndimage.map_coordinates(coverage, found.T, order=1) > 0.5, -1, 1)
    return {"mean_px": float(distance.mean()), "p95_px": float(np.percentile(np.abs(distance), 95))}


def measure(captures: Path, subjects: list[str], pairs: list[str], settings: MatchSettings) -> list[dict[str, Any]]:
    """One row a subject and pair."""
    described = json.loads((captures / "session.json").read_text())
    cameras = read_cameras(captures)
    rows: list[dict[str, Any]] = []
    for subject in subjects or described["subjects"]:
        scene = Scene(captures / subject / "truth" / "mesh.ply")
        for name in pairs or described["pairs"]:
            pair = StereoPair(
                name=name, left=cameras[described["pairs"][name][0]], right=cameras[described["pairs"][name][1]]
            )
            begun = time.perf_counter()
            photographs = [
                read_photograph(
                    captures / subject / "capture" / f"{camera.name}.{described['image_format']}", camera.name
                )
                for camera in (pair.left, pair.right)
            ]
            foregrounds = [
                estimate_foreground(photograph, photograph.name, settings.foreground) for photograph in photographs
            ]
            rectified = rectify(pair, *photographs, *foregrounds, settings.rectify)
            prepared = time.perf_counter()
            found = match(rectified, settings)
            ended = time.perf_counter()
            truth = true_disparity(scene, pair, rectified)
            silhouettes = [
                judge_silhouette(scene, camera, foreground)
                for camera, foreground in zip((pair.left, pair.right), foregrounds, strict=True)
            ]
            rows.append(
                {
                    "subject": subject,
                    "pair": name,
                    **judge(truth, found),
                    "silhouette_mean_px": float(np.mean([s["mean_px"] for s in silhouettes])),
                    "silhouette_p95_px": float(np.max([s["p95_px"] for s in silhouettes])),
                    "prepare_seconds": prepared - begun,
                    "match_seconds": ended - prepared,
                }
            )
    return rows


COLUMNS = {
    "median_px": ("median px", ".3f"),
    "p95_px": ("95 % px", ".3f"),
    "beyond_1_px_percent": ("> 1 px %", ".2f"),
    "complete_percent": ("complete %", ".1f"),
    "depth_bias_mm": ("bias mm", "+.3f"),
    "near_edge_median_px": ("< 20 px of edge", ".3f"),
    "error_over_sigma": ("error / σ", ".2f"),
    "silhouette_mean_px": ("outline px", "+.2f"),
    "silhouette_p95_px": ("outline 95 %", ".2f"),
    "match_seconds": ("match s", ".1f"),
}


def table(rows: list[dict[str, Any]]) -> str:
    """Markdown."""
    head = ["subject", "pair", *(title for title, _ in COLUMNS.values())]
    lines = [head, ["---"] * len(head)]
    lines += [
        [row["subject"], row["pair"], *(format(row[key], form) for key, (_, form) in COLUMNS.items())] for row in rows
    ]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def main() -> None:
    """Print the table; write JSON where asked."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("captures", type=Path)
    parser.add_argument("--subject", action="append", default=[], help="one subject; may be repeated; default: all")
    parser.add_argument("--pair", action="append", default=[], help="one pair; may be repeated; default: all")
    parser.add_argument("--json", type=Path, help="write the figures there")
    arguments = parser.parse_args()
    rows = measure(arguments.captures, arguments.subject, arguments.pair, MatchSettings())
    if arguments.json:
        arguments.json.write_text(json.dumps(rows, indent=1))
    print(table(rows))


if __name__ == "__main__":
    main()
