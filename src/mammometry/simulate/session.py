"""Write a whole session of a virtual rig: manifest, calibration and capture pictures, and the truth.

The folder is what a real rig would give, in the documented format, plus ``truth/``, which only
``mammometry evaluate`` reads. The same arguments give the same bytes, whatever the number of threads.
"""

from __future__ import annotations

import json
import os
import shutil
import tempfile
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Literal

import numpy as np
from PIL import Image

from mammometry.calibration.target import CharucoTarget
from mammometry.errors import SessionError, StorageError
from mammometry.geometry.camera import Camera, Rig
from mammometry.geometry.mesh import TriangleMesh
from mammometry.geometry.transform import Transform
from mammometry.photograph import Photograph
from mammometry.progress import Progress, no_progress, part
from mammometry.simulate.board import BORDER_MM, printed_cells, render_board
from mammometry.simulate.film import Film, develop
from mammometry.simulate.phantom import Solid, make_subject, rig_from_solid
from mammometry.simulate.render import render_subject
from mammometry.simulate.rig import draw_board_poses, flashes, make_rig, sees_board
from mammometry.simulate.scene import Scene, light_scene
from mammometry.simulate.skin import Skin

BOARD = CharucoTarget(squares=(14, 10), square_mm=25.0, marker_mm=18.0, dictionary="DICT_5X5_250")
"""The board of the virtual rig."""
_JPEG_QUALITY = 95
_WORKERS_AT_MOST = 8


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SimulatedSession:
    """What was written, and what is true of it."""

    folder: Path
    rig: Rig
    """The true cameras, rig frame."""
    rig_from_board: Mapping[str, Transform]
    """Pose → rig from board; the first pose's board is a result's world."""
    scene: Scene
    """The subject where it stood, rig frame."""
    true_volumes_cc: Mapping[str, float]
    """Name ("model") → volume of the true mesh, cc."""


def write_session(
    out: Path,
    *,
    rig: str = "reference",
    subject: str = "plaster_5",
    scale: float = 0.25,
    seed: int = 7,
    poses: int = 8,
    image_format: Literal["jpg", "png"] = "jpg",
    skin: Skin = Skin(),
    film: Film = Film(),
    progress: Progress = no_progress,
) -> SimulatedSession:
    """Render a session of a virtual rig into a new folder, truth included.

    Everything is made in a temporary folder beside `out` and renamed at the end: `out` is whole, or is not there.

    Args:
        out: the session folder to make; it must not exist, or be empty.
        rig: ``reference`` (eight cameras, four pairs), or some of its pairs as in ``reference:front,floor``.
        subject: ``plaster_1`` … ``plaster_9``, ``plaster``, ``sphere``, ``cylinder`` or ``plate``.
        scale: of the 4504 × 3000 images; 0.25 gives 1126 × 750.
        seed: of all that is drawn: errors of the rig, poses, shape, mottling, noise.
        poses: of the calibration board.
        image_format: JPEG of quality 95, or PNG.
        skin: how the subject is painted.
        film: blur and noise of the cameras.
        progress: fraction of the pictures that are written.

    Raises:
        SessionError: `out` holds something already, or an argument names nothing that exists.
        StorageError: the disk is full or may not be written.
    """
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise SessionError(
            str(out),
            found="something there already",
            expected="a folder that does not exist yet, or an empty one",
            remedy="Choose another name, or remove it",
        )
    try:
        true_rig = make_rig(rig, scale, seed)
        # Edges of about a pixel and a half, so that no facet shows.
        solid = make_subject(subject, seed, edge_mm=float(np.clip(0.7 * 0.25 / scale, 0.4, 2.0)))
        rig_from_board = draw_board_poses(true_rig, BOARD, poses, seed)
    except ValueError as error:
        raise SessionError(
            "simulate",
            found=str(error),
            expected="a rig, a subject, a scale and poses that can be rendered",
            remedy="Correct the argument; --help names the choices",
        ) from None
    lights = flashes()
    scene = light_scene(solid, rig_from_solid(solid, seed), lights, backdrop=solid.facts.get("back") == "flat")
    progress(0.05)

    printed = printed_cells(BOARD)
    stray = film.stray_light
    pictures: dict[str, Callable[[], Photograph]] = {}
    for index, camera in enumerate(true_rig.cameras.values()):
        name = f"capture/{camera.name}.{image_format}"

        def picture(camera: Camera = camera, name: str = name, noise: int = _noise_seed(seed, 0, index)) -> Photograph:
            radiance = render_subject(scene, camera, skin, seed=seed, background=stray)
            return develop(radiance, film, name=name, seed=noise)

        pictures[name] = picture
    for number, (pose, placed) in enumerate(rig_from_board.items()):
        for index, camera in enumerate(true_rig.cameras.values()):
            if not sees_board(camera, placed, BOARD):
                continue
            name = f"calibration/{pose}/{camera.name}.{image_format}"

            def view(
                camera: Camera = camera,
                name: str = name,
                placed: Transform = placed,
                noise: int = _noise_seed(seed, number + 1, index),
            ) -> Photograph:
                radiance = render_board(camera, placed, BOARD, printed, lights, background=stray)
                return develop(radiance, film, name=name, seed=noise)

            pictures[name] = view

    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        made = Path(tempfile.mkdtemp(prefix=f".{out.name}.", dir=out.parent))
        try:
            _write_pictures(made, pictures, part(progress, 0.05, 0.97))
            (made / "session.toml").write_text(_manifest(true_rig, solid), encoding="utf-8")
            _write_truth(made / "truth", true_rig, rig_from_board, scene, solid, seed, scale)
            made.chmod(0o755)
            if out.exists():
                out.rmdir()
            made.replace(out)
        except BaseException:
            shutil.rmtree(made, ignore_errors=True)
            raise
    except OSError as error:
        raise StorageError(
            str(out),
            found=error.strerror or str(error),
            expected="a folder that can be written, with room for the pictures",
            remedy="Free some space or choose another place",
        ) from None
    progress(1.0)
    return SimulatedSession(
        folder=out,
        rig=true_rig,
        rig_from_board=MappingProxyType(dict(rig_from_board)),
        scene=scene,
        true_volumes_cc=MappingProxyType(_volumes_cc(scene)),
    )


def _write_pictures(folder: Path, pictures: Mapping[str, Callable[[], Photograph]], progress: Progress) -> None:
    """Render, develop and encode with as many threads as there are cores."""

    def write(name: str) -> None:
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        image = Image.fromarray(pictures[name]().pixels)
        if path.suffix == ".png":
            image.save(path, compress_level=3)
        else:
            image.save(path, quality=_JPEG_QUALITY, subsampling=0)

    workers = max(1, min(_WORKERS_AT_MOST, _available_cores()))
    with ThreadPoolExecutor(workers) as pool:
        waiting = [pool.submit(write, name) for name in pictures]
        try:
            for done, future in enumerate(as_completed(waiting), start=1):
                future.result()
                progress(done / len(waiting))
        except BaseException:
            pool.shutdown(wait=True, cancel_futures=True)
            raise


def _manifest(rig: Rig, solid: Solid) -> str:
    """session.toml of this rig, its board and the subject."""
    pairs = ",\n".join(
        f'  {{ name = "{name}", left = "{left}", right = "{right}" }}' for name, (left, right) in rig.pair_names.items()
    )
    return f"""\
# A virtual capture. What is true of it stands in truth/, which no command but "mammometry evaluate" reads.
format = 1
units = "mm"

[rig]
name = "{rig.name}"
pairs = [
{pairs},
]

[target]
kind = "{BOARD.kind}"
squares = [{BOARD.squares[0]}, {BOARD.squares[1]}]
square_mm = {BOARD.square_mm}
marker_mm = {BOARD.marker_mm}
dictionary = "{BOARD.dictionary}"

[subject]
kind = "{solid.subject_kind}"
"""


def _write_truth(
    folder: Path,
    rig: Rig,
    rig_from_board: Mapping[str, Transform],
    scene: Scene,
    solid: Solid,
    seed: int,
    scale: float,
) -> None:
    """truth/: cameras.json, boards.json, mesh.ply, boundary_base.xyz and truth.json; rig frame, mm."""
    folder.mkdir()
    first = next(iter(rig_from_board))
    cameras = {
        name: {
            "K": camera.matrix.tolist(),
            "dist": camera.distortion.tolist(),
            "R": camera.camera_from_world.rotation.tolist(),
            "t": camera.camera_from_world.translation_mm.tolist(),
            "image_size": list(camera.size_wh),
            "centre": camera.centre_world.tolist(),
        }
        for name, camera in rig.cameras.items()
    }
    _write_json(
        folder / "cameras.json",
        {
            "convention": "OpenCV: x_cam = R x_rig + t; dist = k1,k2,p1,p2,k3; pixel centres at integers; mm",
            "seed": seed,
            "scale": scale,
            "rig_from_board0": rig_from_board[first].matrix.tolist(),
            "cameras": cameras,
        },
    )
    _write_json(
        folder / "boards.json",
        {
            "frame": "rig_from_board 4x4, mm",
            "board0": f"pose {first}",
            "spec": {
                "charuco": {
                    "type": BOARD.kind,
                    "squares_x": BOARD.squares[0],
                    "squares_y": BOARD.squares[1],
                    "square_mm": BOARD.square_mm,
                    "marker_mm": BOARD.marker_mm,
                    "dictionary": BOARD.dictionary,
                    "legacy_pattern": BOARD.legacy_pattern,
                    "border_mm": BORDER_MM,
                }
            },
            "rig_from_board": {pose: placed.matrix.tolist() for pose, placed in rig_from_board.items()},
        },
    )
    subject = scene.subject
    _write_ply(folder / "mesh.ply", subject)
    facts = dict(solid.facts)
    place = rig_from_solid(solid, seed)
    nipple = facts.pop("nipple_solid", None)
    if nipple is not None:
        facts["nipple_rig"] = place.apply(np.array(nipple)).tolist()
    if solid.base_boundary is not None:
        boundary = "\n".join(" ".join(f"{value:.4f}" for value in point) for point in place.apply(solid.base_boundary))
        (folder / "boundary_base.xyz").write_text(f"# closed polyline, rig frame, mm\n{boundary}\n", encoding="utf-8")
    volumes_cc = _volumes_cc(scene)
    _write_json(
        folder / "truth.json",
        {
            "subject": solid.name,
            **facts,
            "frame": "rig, mm",
            "volume_cc": volumes_cc["model"],
            "volumes_cc": volumes_cc,
            "rig_from_solid": place.matrix.tolist(),
            "vertices": len(subject.vertices),
            "faces": len(subject.faces),
            "area_mm2": subject.area_mm2(),
            "seed": seed,
            "scale": scale,
        },
    )


def _volumes_cc(scene: Scene) -> dict[str, float]:
    return {"model": scene.subject.volume_mm3() / 1000.0}


def _write_json(path: Path, value: object) -> None:
    path.write_text(json.dumps(value, indent=1) + "\n", encoding="utf-8")


def _write_ply(path: Path, mesh: TriangleMesh) -> None:
    """Binary PLY in float32, which the vertices are rounded to already."""
    header = (
        "ply\nformat binary_little_endian 1.0\ncomment mm, rig frame\n"
        f"element vertex {len(mesh.vertices)}\nproperty float x\nproperty float y\nproperty float z\n"
        f"element face {len(mesh.faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    faces = np.empty(len(mesh.faces), dtype=[("n", "u1"), ("v", "<i4", 3)])
    faces["n"] = 3
    faces["v"] = mesh.faces
    with path.open("wb") as file:
        file.write(header.encode("ascii"))
        file.write(mesh.vertices.astype("<f4").tobytes())
        file.write(faces.tobytes())


def _noise_seed(seed: int, pose: int, camera: int) -> int:
    return int(np.random.default_rng([seed, 31, pose, camera]).integers(1 << 62))


def _available_cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
