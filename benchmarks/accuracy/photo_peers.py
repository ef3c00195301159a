"""Other programs on a walk that was measured: their surfaces, for the table of `benchmarks.accuracy.photos`.

`by_sgbm` has our positions and pairs, OpenCV's semi-global matcher and a TSDF. `by_pycolmap` has positions and lens by
structure from motion (pycolmap, whole photographs), and our pairs, matcher and fusion. Structure from motion has no
scale and no frame: both are those of our positions, which favours it. pycolmap is no dependency of the project.
"""

from __future__ import annotations

import importlib
import json
import shutil
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

import mammometry as mm
from benchmarks.speed.peers import sgbm_tsdf
from mammometry.base.errors import MammometryError
from mammometry.geometry import Camera, Transform, TriangleMesh
from mammometry.io.cameras.own import cameras_table
from mammometry.job.stages import surface

_REACH_MM = 250.0  # of the search for depths, before and behind the middle
_FEATURES = 3000  # of each photograph; with all 11,000 the matching takes most of an hour
_BLOCK_PX = 160  # of a stored photograph, by which its place in the whole one is found


def by_sgbm(session: Path) -> TriangleMesh:
    """Surface by SGBM and TSDF with our positions, mm, board's frame. It is open, with what it found of the room."""
    return sgbm_tsdf(session, _REACH_MM)


def by_pycolmap(photographs: Path, session: Path, out: Path) -> tuple[str, TriangleMesh | None]:
    """What happened, and the surface by our stages with pycolmap's positions and lens, mm, board's frame.

    Args:
        photographs: folder of the walk.
        session: the measured walk.
        out: new folder.
    """
    try:
        pycolmap = importlib.import_module("pycolmap")
    except ImportError:
        return "not installed", None
    rig = mm.open_session(session).calibrate().rig
    files = dict(enumerate(sorted(path for path in photographs.iterdir() if path.suffix != ".toml"), start=1))
    model = _reconstruct(pycolmap, photographs, out)
    placed = {image.name: image for image in model.images.values()}
    shared = {name: placed[files[int(name)].name] for name in rig.cameras if files[int(name)].name in placed}
    if len(shared) < len(rig.cameras):
        return f"{len(shared)} of {len(rig.cameras)} photographs placed", None
    scale, turn, shift, rms_mm = _similarity(
        np.array([image.projection_center() for image in shared.values()]),
        np.array([rig.cameras[name].centre_world for name in shared]),
    )
    cameras = {}
    for name, image in shared.items():
        pose = image.cam_from_world() if callable(image.cam_from_world) else image.cam_from_world
        rotation = pose.rotation.matrix() @ turn.T
        centre = scale * turn @ image.projection_center() + shift
        whole = _lens(model.cameras[image.camera_id], rig.cameras[name], rotation, -rotation @ centre)
        cameras[name] = _part(whole, files[int(name)], session / "capture" / f"{name}.png")
    again = out / "session"
    shutil.copytree(session, again, ignore=shutil.ignore_patterns("results"))
    (again / "cameras.json").write_text(json.dumps(cameras_table(cameras)), encoding="utf-8")
    said = f"positions {rms_mm:.2f} mm from ours (RMS)"
    try:
        job = mm.open_session(again)
        return said, job.plan[surface.repaired]().mesh
    except MammometryError as error:
        return f"{said}; refused: {error.found}", None


def _reconstruct(pycolmap: ModuleType, photographs: Path, out: Path) -> Any:
    """The largest model by incremental structure from motion, with one lens for all photographs."""
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir(parents=True)
    database = out / "database.db"
    options = pycolmap.FeatureExtractionOptions()
    options.sift.max_num_features, options.sift.first_octave = _FEATURES, 0
    pycolmap.extract_features(
        database,
        photographs,
        camera_mode=pycolmap.CameraMode.SINGLE,
        extraction_options=options,
        reader_options=pycolmap.ImageReaderOptions(camera_model="OPENCV"),
    )
    pycolmap.match_exhaustive(database)
    models = pycolmap.incremental_mapping(database, photographs, out / "models")
    return max(models.values(), key=lambda model: model.num_reg_images())


def _similarity(points: np.ndarray, onto: np.ndarray) -> tuple[float, np.ndarray, np.ndarray, float]:
    """Scale, rotation, shift and remaining RMS (Umeyama 1991)."""
    a, b = points - points.mean(axis=0), onto - onto.mean(axis=0)
    turn = Rotation.align_vectors(b, a)[0].as_matrix()
    turned = a @ turn.T
    scale = float((turned * b).sum() / (turned * turned).sum())
    shift = onto.mean(axis=0) - scale * turn @ points.mean(axis=0)
    rest = scale * turned - b
    return scale, turn, shift, float(np.sqrt((rest**2).sum(axis=1).mean()))


def _lens(lens: Any, ours: Camera, rotation: np.ndarray, translation_mm: np.ndarray) -> Camera:
    """Camera of a whole photograph. COLMAP counts pixels from their corner."""
    fx, fy, cx, cy, *distortion = lens.params
    return replace(
        ours,
        size_wh=(lens.width, lens.height),
        matrix=np.array([[fx, 0.0, cx - 0.5], [0.0, fy, cy - 0.5], [0.0, 0.0, 1.0]]),
        distortion=np.array([*distortion, 0.0]),
        camera_from_world=Transform(rotation=rotation, translation_mm=translation_mm),
    )


def _part(camera: Camera, photograph: Path, stored: Path) -> Camera:
    """Camera of the part of a photograph that the session keeps."""
    whole, part = (cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) for path in (photograph, stored))
    assert whole is not None
    assert part is not None
    row, column = (side // 2 - _BLOCK_PX // 2 for side in part.shape)
    block = part[row : row + _BLOCK_PX, column : column + _BLOCK_PX]
    at = cv2.minMaxLoc(cv2.matchTemplate(whole, block, cv2.TM_SQDIFF))[2]
    matrix = camera.matrix.copy()
    matrix[:2, 2] -= at[0] - column, at[1] - row
    return replace(camera, matrix=matrix, size_wh=(part.shape[1], part.shape[0]))
