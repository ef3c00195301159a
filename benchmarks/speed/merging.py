"""Time and memory of the first surface and of its repair on a scene of 350 × 300 × 200 mm at 0.5 mm.

    python -m benchmarks.speed.merging

Four views, 900 mm away, of half an ellipsoid of that size with waves of some millimetres on it, as exact ranges with
silhouettes; no photographs. Kernels are loaded by a small scene first. "Processor" counts all cores' seconds; memory is
what the stage adds to what the process held before.
"""

from __future__ import annotations

import argparse
import resource
import time
from collections.abc import Callable
from dataclasses import replace
from typing import TypeVar

import numpy as np
from scipy import ndimage

from mammometry.geometry.arrays import Array
from mammometry.geometry.camera import Camera, Rig
from mammometry.geometry.mesh import TriangleMesh
from mammometry.geometry.transform import Transform
from mammometry.matching.foreground.foreground import Foreground
from mammometry.study.rays import RayScene, pixel_grid
from mammometry.surface.fusion.fuse import extract
from mammometry.surface.ranges.dents import remove_dents
from mammometry.surface.ranges.range_image import RangeImage
from mammometry.surface.repair.repair import repair

SIZE_MM = (350.0, 300.0, 200.0)
_PLACES = {"front": (0.0, 0.0, 1.0), "floor": (0.0, -0.8, 0.9), "left": (-0.9, 0.1, 0.8), "right": (0.9, 0.1, 0.8)}
_DISTANCE_MM = 900.0
_MARGIN_PX = 20
_SIGMA_MM = 0.05

T = TypeVar("T")


def body(size_mm: Array, edge_mm: float) -> TriangleMesh:
    """Half an ellipsoid of that width, height and depth, closed by a plane, with waves on its skin."""
    count = int(np.pi * size_mm.max() / 2 / edge_mm)
    polar, around = np.linspace(0, np.pi / 2, count), np.linspace(0, 2 * np.pi, 2 * count, endpoint=False)
    a, b = np.meshgrid(polar[1:], around, indexing="ij")
    wave = 1 + 0.012 * np.sin(6 * b) * np.sin(4 * a) ** 2
    x, y, z = (wave * f for f in (np.sin(a) * np.cos(b), np.sin(a) * np.sin(b), np.cos(a)))
    skin = np.stack([x * size_mm[0] / 2, y * size_mm[1] / 2, z * size_mm[2]], axis=-1).reshape(-1, 3)
    vertices = np.concatenate([[[0, 0, size_mm[2]]], skin, [[0, 0, 0]]])
    row, column = np.indices((count - 2, 2 * count)).reshape(2, -1)
    right = (column + 1) % (2 * count)
    here, there, below, beyond = (
        1 + r * 2 * count + c for r, c in ((row, column), (row, right), (row + 1, column), (row + 1, right))
    )
    ring, after = np.arange(2 * count), (np.arange(2 * count) + 1) % (2 * count)
    last = 1 + (count - 2) * 2 * count
    faces = np.concatenate(
        [
            np.stack([np.zeros_like(ring), 1 + ring, 1 + after], axis=1),
            np.stack([here, below, beyond], axis=1),
            np.stack([here, beyond, there], axis=1),
            np.stack([last + ring, np.full_like(ring, len(vertices) - 1), last + after], axis=1),
        ]
    )
    return TriangleMesh(vertices=vertices, faces=faces.astype(np.int32))


def camera(name: str, direction: Array, pixel_mm: float, extent_mm: float) -> Camera:
    """A camera at 900 mm that sees the body whole, a pixel `pixel_mm` wide on it."""
    z = -direction / np.linalg.norm(direction)
    x = np.cross([0.0, 1.0, 0.0], z)
    x /= np.linalg.norm(x)
    rotation = np.stack([x, np.cross(z, x), z])
    size = int(1.4 * extent_mm / pixel_mm) + 2 * _MARGIN_PX
    focal, middle = _DISTANCE_MM / pixel_mm, (size - 1) / 2
    return Camera(
        name=name,
        size_wh=(size, size),
        matrix=np.array([[focal, 0, middle], [0, focal, middle], [0, 0, 1.0]]),
        distortion=np.zeros(5),
        camera_from_world=Transform(rotation=rotation, translation_mm=np.array([0, 0, _DISTANCE_MM])),
    )


def scene(size_mm: Array, pixel_mm: float) -> tuple[list[RangeImage], dict[str, Foreground], Rig]:
    """What four views see of the body, exactly, but for elements turned away by more than 80°."""
    rays = RayScene(body(size_mm, 1.0))
    images, foregrounds = [], {}
    cameras: dict[str, Camera] = {}
    for name, direction in _PLACES.items():
        view = camera(f"{name}_left", np.array(direction), pixel_mm, float(size_mm.max()))
        hits = rays.cast(view.centre_world, view.rays_world(pixel_grid(view)))
        valid = hits.hit & (np.nan_to_num(hits.cosine) > np.cos(np.radians(80)))
        rows, columns = ndimage.find_objects(valid.astype(np.uint8))[0]  # cropped, as rectification does
        seen, ranges = valid[rows, columns], hits.range_mm[rows, columns]
        shift = np.array([[1.0, 0, -columns.start], [0, 1, -rows.start], [0, 0, 1]])
        images.append(
            RangeImage(
                name=name,
                camera=replace(view, matrix=shift @ view.matrix, size_wh=seen.shape[::-1]),
                range_mm=np.where(seen, ranges, 0.0).astype(np.float32),
                sigma_mm=np.where(seen, _SIGMA_MM, 0.0).astype(np.float32),
                confidence=seen.astype(np.float32),
                valid=seen.copy(),
            )
        )
        foregrounds[view.name] = Foreground(
            camera=view.name, coverage=hits.hit.astype(np.float32), contour_level=0.5, everything=False
        )
        cameras |= {view.name: view, f"{name}_right": view}
    pairs = {name: (f"{name}_left", f"{name}_right") for name in _PLACES}
    return images, foregrounds, Rig(name="four", cameras=cameras, pair_names=pairs)


def measured(label: str, stage: Callable[[], T]) -> T:
    """Run a stage and print what it took."""
    before = _peak_mb()
    wall, processor = time.monotonic(), time.process_time()
    result = stage()
    wall, processor = time.monotonic() - wall, time.process_time() - processor
    print(f"| {label} | {wall:.1f} | {processor:.1f} | {_peak_mb() - before:.0f} |", flush=True)
    return result


def _peak_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def main() -> None:
    """Build, repair, print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--pixel-mm", type=float, default=0.25, help="width of an element on the subject")
    arguments = parser.parse_args()
    images, foregrounds, rig = scene(np.array(SIZE_MM) / 10, 0.5)
    small = remove_dents(images, None)
    repair(extract(small.range_images, foregrounds, rig), small)
    images, foregrounds, rig = scene(np.array(SIZE_MM), arguments.pixel_mm)
    print("| stage | wall s | processor s | memory MB |\n| --- | --- | --- | --- |")
    valid = measured("dents", lambda: remove_dents(images, None))
    first = measured("first surface", lambda: extract(valid.range_images, foregrounds, rig))
    repaired = measured("repair", lambda: repair(first, valid))
    state = "watertight" if repaired.mesh.is_watertight() else "not watertight"
    print(
        f"\n{len(first.vertices):,d} vertices, {len(first.faces):,d} faces, Euler number {first.euler_number()}; "
        f"after the repair {state}, {repaired.crossings} pairs of faces cross"
    )


if __name__ == "__main__":
    main()
