"""True depth of every pixel of a camera, for a session's truth."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mammometry.geometry.arrays import Array, Float32
from mammometry.geometry.camera import Camera
from mammometry.simulate.rendering import kernels
from mammometry.simulate.rendering.sampling import lens_parameters, picture_window
from mammometry.simulate.rendering.scene import Scene

_ROWS_AT_ONCE = 256  # traced at a time, so that memory stays small
_STEPS_PER_MM = 1024.0  # depths are rounded to a micrometre, so that the file compresses


def true_depth(scene: Scene, camera: Camera) -> Float32[Array, "h w"]:
    """Depth z of the subject along every pixel's ray, camera's frame, mm.

    Not a number where the subject is not seen. Rounded to 1/1024 mm, a twentieth of what a ray in float32 can tell, so
    that it packs well.
    """
    depth = np.full(camera.shape_hw, np.nan, dtype=np.float32)
    top, bottom, left, right = picture_window(camera, scene.mesh.vertices[: scene.subject_vertices : 7], margin_px=8)
    centre = camera.centre_world.astype(np.float32)
    for start in range(top, bottom, _ROWS_AT_ONCE):
        rows = slice(start, min(start + _ROWS_AT_ONCE, bottom))
        row, column = np.mgrid[rows, left:right]
        uv = np.stack([column.ravel(), row.ravel()], axis=1).astype(np.float64)
        directions = np.empty((len(uv), 3), dtype=np.float32)
        kernels.rays(uv, lens_parameters(camera), camera.camera_from_world.rotation.copy(), directions)
        origins = np.ascontiguousarray(np.broadcast_to(centre, directions.shape))
        hit = scene.rays.run(origins, directions, output=True)
        seen = (hit["primID"] >= 0) & (hit["primID"] < scene.subject_faces)
        z = np.where(seen, hit["tfar"], 0.0) * (directions @ camera.axis_world.astype(np.float32))
        rounded = np.round(z * _STEPS_PER_MM) / _STEPS_PER_MM
        depth[rows, left:right] = np.where(seen, rounded, np.nan).reshape(row.shape)
    return depth


def write_depth(path: Path, depth_mm: Float32[Array, "h w"]) -> None:
    """Write depth and its mask as a float32 TIFF of two pages. Packed losslessly (deflate)."""
    import tifffile

    known = np.isfinite(depth_mm)
    with tifffile.TiffWriter(path) as tiff:
        for name, page in (("depth_mm", np.where(known, depth_mm, np.float32(0.0))), ("valid", known.astype(np.uint8))):
            tiff.write(
                page,
                photometric="minisblack",
                compression="zlib",
                compressionargs={"level": 4},
                extratags=[(285, 2, None, name, True)],
                metadata=None,
                contiguous=False,
                rowsperstrip=64,
            )
