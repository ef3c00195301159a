"""Truth of a virtual session, including the depth of every pixel, for ``mammometry evaluate``."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from mammometry.base.progress import Progress, no_progress
from mammometry.geometry import Array, Camera, Float32, Rig, Transform, TriangleMesh
from mammometry.geometry.mesh_files.ply import write_ply
from mammometry.simulate.disturbances.registry import as_truth
from mammometry.simulate.disturbances.surfaces import merged
from mammometry.simulate.recipe import SessionRecipe
from mammometry.simulate.rendering import kernels
from mammometry.simulate.rendering.sampling import lens_parameters, picture_window
from mammometry.simulate.rendering.scene import StudioScene, moved
from mammometry.simulate.rigs.targets import described
from mammometry.simulate.studio import Arrangement, Studio
from mammometry.simulate.subjects.solid import rounded_mesh

_ROWS_AT_ONCE = 256  # rows traced at a time; limits memory
_STEPS_PER_MM = 1024.0  # depths are rounded to a micrometre, so that the file compresses well


def true_depth(scene: StudioScene, camera: Camera) -> Float32[Array, "h w"]:
    """Depth z of the subject along each pixel's ray, camera's frame, mm. NaN where it is not visible.

    Rounded to 1/1024 mm, a twentieth of the precision of a float32 ray.
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
    """Write depth and its mask as a float32 TIFF of two pages with lossless compression (deflate)."""
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


def write_truth(
    folder: Path,
    arrangement: Arrangement,
    scene: StudioScene,
    studio: Studio,
    recipe: SessionRecipe,
    *,
    progress: Progress = no_progress,
) -> None:
    """Write the truth of a session, rig frame, mm. The files are listed in docs/how-to/simulate.md.

    Args:
        folder: folder to create.
        arrangement: positions of everything.
        scene: the photographed scene.
        studio: how the pictures were taken.
        recipe: recipe of the session.
        progress: called with the fraction of the depth maps that are written.
    """
    folder.mkdir()
    rig, solid, rig_from_solid = arrangement.rig, arrangement.solid, arrangement.rig_from_solid
    exposure, disturbances = arrangement.exposure, recipe.situation
    _write_cameras(folder, arrangement, studio, recipe)
    placed = solid.placed(rig_from_solid)
    mesh = placed.mesh
    _write_mesh(folder / "mesh.ply", mesh)
    if arrangement.things:
        _write_mesh(folder / "things.ply", merged([thing.props for thing in arrangement.things]))
    boundaries = {name: mesh.vertices[breast.boundary] for name, breast in placed.breasts.items()}
    if placed.base_boundary is not None:
        boundaries["base"] = placed.base_boundary
    for name, points in boundaries.items():
        lines = "\n".join(" ".join(f"{value:.4f}" for value in point) for point in points)
        (folder / f"boundary_{name}.xyz").write_text(f"# closed polyline, rig frame, mm\n{lines}\n", encoding="utf-8")
    for name in placed.breasts:
        _write_mesh(folder / f"wall_{name}.ply", placed.chest_wall(name))
        _write_mesh(folder / f"breast_{name}.ply", placed.closed_breast(name))
    facts = dict(solid.facts)
    nipple = facts.pop("nipple_solid", None)
    if nipple is not None:
        facts["nipple_rig"] = rig_from_solid.apply(np.array(nipple)).tolist()
    if placed.landmarks:
        points = {name: points.tolist() for name, points in placed.landmarks.items()}
        _write_json(folder / "landmarks.json", {"frame": "rig, mm", "units": "mm", "landmarks": points})
    volumes_cc = placed.volumes_cc
    _write_json(
        folder / "truth.json",
        {
            "subject": solid.name,
            **facts,
            "frame": "rig, mm",
            **({"volume_cc": volumes_cc["model"]} if "model" in volumes_cc else {}),
            "volumes_cc": volumes_cc,
            "rig_from_solid": rig_from_solid.matrix.tolist(),
            "vertices": len(mesh.vertices),
            "faces": len(mesh.faces),
            "area_mm2": mesh.area_mm2(),
            "seed": recipe.seed,
            "scale": recipe.scale,
            **(
                {"disturbances": as_truth(disturbances), "capture": _at_capture(arrangement)}
                if str(disturbances)
                else {}
            ),
        },
    )
    (folder / "depth").mkdir()
    for done, (name, camera) in enumerate(exposure.capture_rig.cameras.items(), start=1):
        still = exposure.motion is None or not exposure.seconds[name]
        then = scene if still or exposure.motion is None else moved(scene, exposure.motion, exposure.seconds[name])
        write_depth(folder / "depth" / f"{name}.tif", true_depth(then, camera))
        progress(done / len(rig.cameras))


def _at_capture(arrangement: Arrangement) -> dict[str, dict[str, object]]:
    """Camera → what changed between calibration and capture."""
    exposure, lit = arrangement.exposure, arrangement.lights[:, 3] * arrangement.exposure.lights[:, 3] > 0
    front = arrangement.rig_from_solid.apply(
        arrangement.solid.mesh.vertices[:: max(1, len(arrangement.solid.areola) // 2000)]
    )
    facts: dict[str, dict[str, object]] = {}
    for name, camera in exposure.rig.cameras.items():
        now, film = exposure.capture_rig.cameras[name], exposure.films[name]
        turn = Transform(
            rotation=now.camera_from_world.rotation @ camera.camera_from_world.rotation.T, translation_mm=np.zeros(3)
        )
        shift_mm = exposure.shift_mm(name, front)
        facts[name] = {
            "turned_deg": math.degrees(float(np.linalg.norm(turn.rotation_vector_rad))),
            "shifted_mm": float(np.linalg.norm(now.centre_world - camera.centre_world)),
            "exposed_ms": 1e3 * exposure.seconds[name],
            "subject_moved_mm": {"mean": float(shift_mm.mean()), "largest": float(shift_mm.max())},
            "gain_rgb": list(film.gain_rgb),
            "blur_px": film.blur_px,
            "flashes_fired": lit.tolist(),
        }
    return facts


def _write_cameras(folder: Path, arrangement: Arrangement, studio: Studio, recipe: SessionRecipe) -> None:
    """Write cameras.json and boards.json, and capture_cameras.json if the cameras have moved since."""
    rig_from_board, rigs = arrangement.rig_from_target, {"cameras.json": arrangement.rig}
    if arrangement.exposure.capture_rig is not arrangement.rig:
        rigs["capture_cameras.json"] = arrangement.exposure.capture_rig
    for file, rig in rigs.items():
        _write_rig(folder / file, rig, rig_from_board, studio, recipe)
    first = next(iter(rig_from_board))
    _write_json(
        folder / "boards.json",
        {
            "frame": "rig_from_board 4x4, mm",
            "board0": f"pose {first}",
            "target": described(studio.target),
            "rig_from_board": {pose: placed.matrix.tolist() for pose, placed in rig_from_board.items()},
        },
    )


def _write_rig(
    path: Path, rig: Rig, rig_from_board: Mapping[str, Transform], studio: Studio, recipe: SessionRecipe
) -> None:
    first = next(iter(rig_from_board))
    cameras = {
        name: {
            "K": camera.matrix.tolist(),
            "dist": camera.distortion.tolist(),
            "R": camera.camera_from_world.rotation.tolist(),
            "t": camera.camera_from_world.translation_mm.tolist(),
            "image_size": list(camera.size_wh),
            "centre": camera.centre_world.tolist(),
            "focus_mm": studio.film.focused_mm(camera),
        }
        for name, camera in rig.cameras.items()
    }
    _write_json(
        path,
        {
            "convention": "OpenCV: x_cam = R x_rig + t; dist = k1,k2,p1,p2,k3; pixel centres at integers; mm",
            "seed": recipe.seed,
            "scale": recipe.scale,
            "rig_from_board0": rig_from_board[first].matrix.tolist(),
            "cameras": cameras,
        },
    )


def _write_json(path: Path, value: object) -> None:
    # `dict` converts frozen mappings
    path.write_text(json.dumps(value, indent=1, default=dict) + "\n", encoding="utf-8")


def _write_mesh(path: Path, mesh: TriangleMesh) -> None:
    write_ply(path, rounded_mesh(mesh.vertices, mesh.faces), comments=("mm, rig frame",))
