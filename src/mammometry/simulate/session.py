"""Write a whole session of a virtual rig: manifest, calibration and capture pictures, and the truth.

The folder is what a real rig would give, in the documented format, plus ``truth/``, which only
``mammometry evaluate`` reads. The same arguments give the same bytes, whatever the number of threads.
"""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Literal

import numpy as np
from PIL import Image

from mammometry.errors import SessionError, StorageError
from mammometry.geometry.arrays import Array, Float32
from mammometry.geometry.camera import Camera, Rig
from mammometry.geometry.transform import Transform
from mammometry.progress import Progress, no_progress, part
from mammometry.simulate.board import printed_cells, render_board
from mammometry.simulate.film import Film, develop
from mammometry.simulate.phantom import Solid, make_subject, rig_from_solid
from mammometry.simulate.poses import draw_poses
from mammometry.simulate.render import render_subject
from mammometry.simulate.rig import flashes, make_rig
from mammometry.simulate.scene import Scene, light_scene
from mammometry.simulate.skin import Skin
from mammometry.simulate.targets import BOARD, sees_target
from mammometry.simulate.truth import write_truth

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
        rig_from_board = draw_poses(true_rig, BOARD, poses, seed)
    except ValueError as error:
        raise SessionError(
            "simulate",
            found=str(error),
            expected="a rig, a subject, a scale and poses that can be rendered",
            remedy="Correct the argument; --help names the choices",
        ) from None
    place = rig_from_solid(solid, seed)
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        made = Path(tempfile.mkdtemp(prefix=f".{out.name}.", dir=out.parent))
        try:
            studio = _Studio(seed=seed, skin=skin, film=film, suffix=f".{image_format}")
            scene = _photograph(made, true_rig, rig_from_board, solid, place, studio, part(progress, 0.0, 0.97))
            (made / "session.toml").write_text(_manifest(true_rig, solid), encoding="utf-8")
            write_truth(
                made / "truth",
                rig=true_rig,
                target=BOARD,
                rig_from_board=rig_from_board,
                solid=solid,
                rig_from_solid=place,
                subject=scene.subject,
                seed=seed,
                scale=scale,
            )
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
        true_volumes_cc=MappingProxyType({"model": scene.subject.volume_mm3() / 1000.0}),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class _Studio:
    """What all pictures of a session have in common."""

    seed: int
    skin: Skin
    film: Film
    suffix: str


def _photograph(
    folder: Path,
    rig: Rig,
    rig_from_board: Mapping[str, Transform],
    solid: Solid,
    rig_from_solid: Transform,
    studio: _Studio,
    progress: Progress,
) -> Scene:
    """Take all pictures with as many threads as there are cores; the scene is lit while the boards are photographed."""
    lights = flashes()
    printed = printed_cells(BOARD)
    with ThreadPoolExecutor(max(1, min(_WORKERS_AT_MOST, _available_cores()))) as pool:
        lit = pool.submit(light_scene, solid, rig_from_solid, lights, backdrop=solid.facts.get("back") == "flat")
        taking: list[Future[None]] = []
        for number, (pose, placed) in enumerate(rig_from_board.items(), start=1):
            for index, camera in enumerate(rig.cameras.values()):
                if sees_target(camera, placed, BOARD):
                    path = folder / "calibration" / pose / f"{camera.name}{studio.suffix}"
                    render = partial(
                        render_board, camera, placed, BOARD, printed, lights, background=studio.film.stray_light
                    )
                    taking.append(
                        pool.submit(_take, path, render, studio.film, _noise_seed(studio.seed, number, index))
                    )
        # Submitted last: when the first of them begins, the scene's thread is done with it, or about to be.
        for index, camera in enumerate(rig.cameras.values()):
            path = folder / "capture" / f"{camera.name}{studio.suffix}"
            render = partial(_capture, lit, camera, studio)
            taking.append(pool.submit(_take, path, render, studio.film, _noise_seed(studio.seed, 0, index)))
        try:
            for done, future in enumerate(as_completed(taking), start=1):
                future.result()
                progress(done / len(taking))
        except BaseException:
            pool.shutdown(wait=True, cancel_futures=True)
            raise
        return lit.result()


def _capture(lit: Future[Scene], camera: Camera, studio: _Studio) -> Float32[Array, "h w 3"]:
    return render_subject(lit.result(), camera, studio.skin, seed=studio.seed, background=studio.film.stray_light)


def _take(path: Path, render: Callable[[], Float32[Array, "h w *c"]], film: Film, seed: int) -> None:
    """Render, develop and write one picture."""
    photograph = develop(render(), film, name=path.name, seed=seed)
    path.parent.mkdir(parents=True, exist_ok=True)
    image = Image.fromarray(photograph.pixels)
    if path.suffix == ".png":
        image.save(path, compress_level=3)
    else:
        image.save(path, quality=_JPEG_QUALITY, subsampling=0)


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


def _noise_seed(seed: int, pose: int, camera: int) -> int:
    return int(np.random.default_rng([seed, 31, pose, camera]).integers(1 << 62))


def _available_cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
