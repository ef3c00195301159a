"""Take all pictures of a virtual session: the target in its poses, and the subject."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from PIL import Image

from mammometry.base.csv_cells import CsvWriter
from mammometry.base.errors import MammometryError, UnknownWordError
from mammometry.base.machine.cores import available_cores
from mammometry.base.progress import Progress, no_progress
from mammometry.calibration.targets.target import Target
from mammometry.geometry import Array, Camera, Float32, Float64, Rig, Transform
from mammometry.simulate.disturbances.exposure import CaptureConditions
from mammometry.simulate.rendering.develop import develop
from mammometry.simulate.rendering.film import Film
from mammometry.simulate.rendering.registry import BUILT_IN, RENDERERS
from mammometry.simulate.rendering.scene import Prop, Room, StudioScene, light_scene, moved
from mammometry.simulate.rendering.skin import SkinReflectance
from mammometry.simulate.rendering.solid_target import render_target
from mammometry.simulate.rigs.targets import BOARD, sees_target, visible_points
from mammometry.simulate.subjects.solid import SubjectSolid


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Arrangement:
    """Positions of everything in a virtual session, rig frame, mm."""

    exposure: CaptureConditions
    """Cameras at calibration and capture, films, flashes and times."""
    lights: Float64[Array, "l 4"]
    """Each flash at the calibration: position, and irradiance × mm² at distance 1."""
    rig_from_target: Mapping[str, Transform]
    """Pose → placement of the calibration target."""
    solid: SubjectSolid
    """The subject, in its own frame."""
    rig_from_solid: Transform
    """Pose of the subject."""
    things: tuple[Prop, ...] = ()
    """Other objects in the scene."""

    @property
    def rig(self) -> Rig:
        """The true cameras at the calibration."""
        return self.exposure.rig


_SKIN, _FILM = SkinReflectance(), Film()
_BACKGROUNDS = ("dark", "clutter")
_IMAGE_FORMATS = ("jpg", "png", "tif")
_WORKERS_AT_MOST = 8  # most threads, each of which stores a picture's radiance: 160 MB at full size
_MEASURED_PX = 0.03
"""Standard deviation of the given points of a dotted frame, as from a measuring program, px. Made up."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Studio:
    """Target, skin, film and files for a session's pictures, independent of the scene."""

    target: Target = BOARD
    """Object that is photographed for the calibration."""
    skin: SkinReflectance = _SKIN
    """Appearance of the subject's skin."""
    film: Film = _FILM
    """Lens and sensor."""
    background: str = "dark"
    """Background behind the subject. ``dark``: nothing; ``clutter``: a room full of objects."""
    renderer: str = BUILT_IN
    """Renderer of the subject's pictures, a name in `rendering.registry.RENDERERS`."""
    image_format: str = "jpg"
    """Format of the picture files: ``jpg``, ``png``, or ``tif`` with 16 bits per channel."""

    def __post_init__(self) -> None:
        """Check the values.

        Raises:
            ValueError: a word is unknown.
            SettingsError: the renderer does not exist or is not installed.
        """
        _require_one_of("background", self.background, _BACKGROUNDS)
        _require_one_of("image format", self.image_format, _IMAGE_FORMATS)
        RENDERERS.find(self.renderer, "--renderer").require()


@contextmanager
def refusing(error: type[MammometryError], *, expected: str, remedy: str) -> Iterator[None]:
    """Turn a ValueError about a word or number into an error for the user."""
    try:
        yield
    except ValueError as wrong:
        found = f"{wrong.found}, but {wrong.rule}" if isinstance(wrong, UnknownWordError) else str(wrong)
        raise error("simulate", found=found, expected=expected, remedy=remedy) from None


def _require_one_of(what: str, word: str, choices: tuple[str, ...]) -> None:
    if word not in choices:
        raise UnknownWordError(f"the {what} is one of {', '.join(choices)}", f"{word!r}")


def photograph(
    folder: Path, arrangement: Arrangement, studio: Studio, *, seed: int, progress: Progress = no_progress
) -> StudioScene:
    """Write ``calibration/`` and ``capture/``, and return the capture's scene, rig frame.

    The light is computed while the target is photographed. The same arguments give the same pictures with any number of
    threads. No program can identify the points of a dotted frame in a picture, so they are given: a table ``id,u,v`` of
    the visible points for each photograph, with a little noise.

    Args:
        folder: session folder, which exists.
        arrangement: positions of everything.
        studio: how pictures are taken.
        seed: seed of skin and noise.
        progress: called with the fraction of the pictures that are written.
    """
    exposure, lights, solid = arrangement.exposure, arrangement.lights, arrangement.solid
    suffix = f".{studio.image_format}"
    with ThreadPoolExecutor(max(1, min(_WORKERS_AT_MOST, available_cores()))) as pool:
        lit = pool.submit(
            light_scene,
            solid,
            arrangement.rig_from_solid,
            exposure.lights,
            Room(
                backdrop=solid.facts.get("back") == "flat",
                clutter=studio.background == "clutter",
                things=arrangement.things,
            ),
            skin=studio.skin,
            seed=seed,
        )
        taking: list[Future[None]] = []
        for number, (pose, placed) in enumerate(arrangement.rig_from_target.items(), start=1):
            for index, camera in enumerate(exposure.rig.cameras.values()):
                film = exposure.films[camera.name]
                if not sees_target(camera, placed, studio.target):
                    continue
                path = folder / "calibration" / pose / f"{camera.name}{suffix}"
                render = partial(
                    render_target,
                    camera,
                    placed,
                    studio.target,
                    lights,
                    aperture=film.aperture(camera),
                    background=film.stray_light,
                )
                noise = _noise_seed(seed, number, index)
                taking.append(pool.submit(take_picture, path, render, film, noise))
                if studio.target.body.comes_measured:
                    taking.append(pool.submit(_measure, path, camera, placed, studio.target, noise))
        # Submitted last: when the first of them starts, the light is computed, or nearly so.
        for index, name in enumerate(exposure.rig.cameras):
            path, film = folder / "capture" / f"{name}{suffix}", exposure.films[name]
            render = partial(_capture, lit, name, exposure, studio, seed)
            taking.append(pool.submit(take_picture, path, render, film, _noise_seed(seed, 0, index)))
        finish(pool, taking, progress)
        return lit.result()


def finish(pool: ThreadPoolExecutor, taking: Sequence[Future[None]], progress: Progress) -> None:
    """Wait for all pictures. If one cannot be taken, cancel the others."""
    try:
        for done, future in enumerate(as_completed(taking), start=1):
            future.result()
            progress(done / len(taking))
    except BaseException:
        pool.shutdown(wait=True, cancel_futures=True)
        raise


def _capture(
    lit: Future[StudioScene], name: str, exposure: CaptureConditions, studio: Studio, seed: int
) -> Float32[Array, "h w 3"]:
    film, camera, scene = exposure.films[name], exposure.capture_rig.cameras[name], lit.result()
    if exposure.motion is not None and exposure.seconds[name]:
        scene = moved(scene, exposure.motion, exposure.seconds[name])
    return RENDERERS[studio.renderer].render(
        scene, camera, studio.skin, seed=seed, aperture=film.aperture(camera), background=film.stray_light
    )


def take_picture(path: Path, render: Callable[[], Float32[Array, "h w *c"]], film: Film, seed: int) -> None:
    """Render, develop and write one picture."""
    sixteen = path.suffix == ".tif"
    pixels = develop(render(), film, name=path.name, seed=seed, bits=16 if sixteen else 8).pixels
    path.parent.mkdir(parents=True, exist_ok=True)
    if sixteen:  # Pillow cannot write colour with 16 bits
        import tifffile

        photometric = "rgb" if pixels.ndim == 3 else "minisblack"
        tifffile.imwrite(path, pixels, photometric=photometric, compression="zlib", predictor=True, metadata=None)
    elif path.suffix == ".png":
        Image.fromarray(pixels).save(path, compress_level=3)
    else:
        Image.fromarray(pixels).save(path, quality=film.jpeg_quality, subsampling=2 if film.chroma_halved else 0)


def _measure(path: Path, camera: Camera, placed: Transform, target: Target, seed: int) -> None:
    """Write the table of visible points, in the same way as a measuring program."""
    seen = np.flatnonzero(visible_points(camera, placed, target))
    uv = camera.project(placed.apply(target.points_target[seen]))
    uv += np.random.default_rng([seed, 1]).normal(0.0, _MEASURED_PX, uv.shape)
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.with_suffix(".csv").open("w", encoding="utf-8", newline="") as lines:
        table = CsvWriter(lines)
        table.row(("id", "u", "v"))
        for point, (u, v) in zip(seen, uv, strict=True):
            table.row((int(point), f"{u:.4f}", f"{v:.4f}"))


def _noise_seed(seed: int, pose: int, camera: int) -> int:
    return int(np.random.default_rng([seed, 31, pose, camera]).integers(1 << 62))
