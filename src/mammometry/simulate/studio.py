"""Take all pictures of a virtual session: the target in its poses, and the subject, with as many threads as cores."""

from __future__ import annotations

import csv
from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Literal, cast

import numpy as np
import tifffile
from PIL import Image

from mammometry.base.cores import available_cores
from mammometry.base.errors import SettingsError
from mammometry.base.progress import Progress, no_progress
from mammometry.calibration.targets.target import Target
from mammometry.geometry.arrays import Array, Float32, Float64
from mammometry.geometry.camera import Camera, Rig
from mammometry.geometry.transform import Transform
from mammometry.simulate.rendering.film import Film, develop
from mammometry.simulate.rendering.mitsuba_renderer import render_by_mitsuba, require_mitsuba
from mammometry.simulate.rendering.render import render_subject
from mammometry.simulate.rendering.scene import Scene, light_scene
from mammometry.simulate.rendering.skin import Skin, make_skin
from mammometry.simulate.rendering.solid_target import render_target
from mammometry.simulate.rigs.targets import BOARD, make_target, sees_target, visible_points
from mammometry.simulate.subjects.solid import Solid

_SKIN, _FILM = Skin(), Film()
_WORKERS_AT_MOST = 8
_MEASURED_PX = 0.03
"""Standard deviation of the points of a dotted frame, which another program would have measured, px."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Studio:
    """How a session's pictures are taken, whatever stands before the cameras."""

    target: Target = BOARD
    """What is photographed for calibration."""
    skin: Skin = _SKIN
    """How the subject is painted."""
    film: Film = _FILM
    """Lens and sensor."""
    background: Literal["dark", "clutter"] = "dark"
    """What is seen behind the subject: nothing, or a room full of things."""
    renderer: Literal["built-in", "mitsuba"] = "built-in"
    """What makes the pictures of the subject; Mitsuba 3 follows light on its ways between surfaces."""
    image_format: Literal["jpg", "png", "tif"] = "jpg"
    """Of the pictures' files; tif has 16 bits a channel."""


def make_studio(
    *,
    target: str = "charuco",
    skin: str = "plaster",
    contrast: float | None = None,
    hair_per_cm2: float = 0.0,
    background: str = "dark",
    f_number: float | None = None,
    focus_mm: float | None = None,
    vignetting: float = _FILM.vignetting,
    noise: float = 1.0,
    jpeg_quality: int = _FILM.jpeg_quality,
    image_format: str = "jpg",
    renderer: str = "built-in",
) -> Studio:
    """Compose a studio from the words of the command line.

    Args:
        target: a name in `targets.VIRTUAL_TARGETS`.
        skin: a name in `skin.SKINS`.
        contrast: of the mottling, in place of the skin's own.
        hair_per_cm2: hairs.
        background: ``dark`` or ``clutter``.
        f_number: of the lenses; None for all depths sharp.
        focus_mm: depth that is sharp; None for each camera's own depth of the middle of the rig.
        vignetting: loss of light in the corners, 0…1.
        noise: standard deviation of the noise relative to the usual sensor's; 0 for hardly any.
        jpeg_quality: 1…100.
        image_format: ``jpg``, ``png``, or ``tif`` with 16 bits a channel.
        renderer: ``built-in`` or ``mitsuba``.

    Raises:
        SettingsError: a word names nothing that exists, a number is out of its range, or the renderer is not installed.
    """
    try:
        _require_one_of("background", background, ("dark", "clutter"))
        _require_one_of("image format", image_format, ("jpg", "png", "tif"))
        _require_one_of("renderer", renderer, ("built-in", "mitsuba"))
        if not 0.0 <= noise <= 100.0:
            raise ValueError(f"noise must lie between 0 and 100, found {noise:g}")
        grain = max(noise, 1e-3)
        studio = Studio(
            target=make_target(target),
            skin=make_skin(skin, contrast=contrast, hair_per_cm2=hair_per_cm2),
            film=Film(
                vignetting=vignetting,
                electrons=_FILM.electrons / grain**2,
                read_noise=_FILM.read_noise / grain,
                f_number=f_number,
                focus_mm=focus_mm,
                jpeg_quality=jpeg_quality,
            ),
            background=cast(Literal["dark", "clutter"], background),
            image_format=cast(Literal["jpg", "png", "tif"], image_format),
            renderer=cast(Literal["built-in", "mitsuba"], renderer),
        )
    except ValueError as error:
        raise SettingsError(
            "simulate",
            found=worded(error),
            expected="options that can be rendered",
            remedy="Correct the option; --help names the choices",
        ) from None
    if renderer == "mitsuba":
        require_mitsuba()
    return studio


def worded(error: ValueError) -> str:
    """What was found and what rule it breaks, in the words of an error that says "<rule>, found <what>"."""
    rule, _, found = str(error).rpartition(", found ")
    return f"{found}, but {rule}" if rule else str(error)


def _require_one_of(what: str, word: str, choices: tuple[str, ...]) -> None:
    if word not in choices:
        raise ValueError(f"the {what} is one of {', '.join(choices)}, found {word!r}")


def photograph(
    folder: Path,
    rig: Rig,
    lights: Float64[Array, "l 4"],
    rig_from_target: Mapping[str, Transform],
    solid: Solid,
    rig_from_solid: Transform,
    studio: Studio,
    *,
    seed: int,
    progress: Progress = no_progress,
) -> Scene:
    """Write ``calibration/`` and ``capture/``; returns the scene of the capture, rig frame.

    The scene is lit while the target is photographed. The same arguments give the same pictures, whatever the number
    of threads. A frame of points, which no program can tell apart in a picture, has its points measured: a table
    ``id,u,v`` beside each photograph, of those that are seen, with a little noise.

    Args:
        folder: the session, which exists.
        rig: the true cameras, rig frame.
        lights: position, rig frame, mm, and irradiance × mm² at distance 1.
        rig_from_target: pose → where the target is held.
        solid: the subject.
        rig_from_solid: where it stands.
        studio: how pictures are taken.
        seed: of paint and noise.
        progress: fraction of the pictures that are written.
    """
    film, suffix = studio.film, f".{studio.image_format}"
    with ThreadPoolExecutor(max(1, min(_WORKERS_AT_MOST, available_cores()))) as pool:
        lit = pool.submit(
            light_scene,
            solid,
            rig_from_solid,
            lights,
            backdrop=solid.facts.get("back") == "flat",
            skin=studio.skin,
            clutter=studio.background == "clutter",
            seed=seed,
        )
        taking: list[Future[None]] = []
        for number, (pose, placed) in enumerate(rig_from_target.items(), start=1):
            for index, camera in enumerate(rig.cameras.values()):
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
                taking.append(pool.submit(_take, path, render, film, noise))
                if studio.target.body.comes_measured:
                    taking.append(pool.submit(_measure, path, camera, placed, studio.target, noise))
        # Submitted last: when the first of them begins, the scene's thread is done with it, or about to be.
        for index, camera in enumerate(rig.cameras.values()):
            path = folder / "capture" / f"{camera.name}{suffix}"
            render = partial(_capture, lit, camera, studio, seed)
            taking.append(pool.submit(_take, path, render, film, _noise_seed(seed, 0, index)))
        try:
            for done, future in enumerate(as_completed(taking), start=1):
                future.result()
                progress(done / len(taking))
        except BaseException:
            pool.shutdown(wait=True, cancel_futures=True)
            raise
        return lit.result()


def _capture(lit: Future[Scene], camera: Camera, studio: Studio, seed: int) -> Float32[Array, "h w 3"]:
    film = studio.film
    render = render_by_mitsuba if studio.renderer == "mitsuba" else render_subject
    return render(
        lit.result(), camera, studio.skin, seed=seed, aperture=film.aperture(camera), background=film.stray_light
    )


def _take(path: Path, render: Callable[[], Float32[Array, "h w *c"]], film: Film, seed: int) -> None:
    """Render, develop and write one picture."""
    sixteen = path.suffix == ".tif"
    pixels = develop(render(), film, name=path.name, seed=seed, bits=16 if sixteen else 8).pixels
    path.parent.mkdir(parents=True, exist_ok=True)
    if sixteen:  # Pillow writes no colours of 16 bits
        tifffile.imwrite(path, pixels, photometric="rgb", compression="zlib", predictor=True, metadata=None)
    elif path.suffix == ".png":
        Image.fromarray(pixels).save(path, compress_level=3)
    else:
        Image.fromarray(pixels).save(path, quality=film.jpeg_quality, subsampling=0)


def _measure(path: Path, camera: Camera, placed: Transform, target: Target, seed: int) -> None:
    """Write the table of the points seen in a picture, as a program that measures targets would."""
    seen = np.flatnonzero(visible_points(camera, placed, target))
    uv = camera.project(placed.apply(target.points_target[seen]))
    uv += np.random.default_rng([seed, 1]).normal(0.0, _MEASURED_PX, uv.shape)
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.with_suffix(".csv").open("w", encoding="utf-8", newline="") as lines:
        table = csv.writer(lines)
        table.writerow(["id", "u", "v"])
        table.writerows((int(point), f"{u:.4f}", f"{v:.4f}") for point, (u, v) in zip(seen, uv, strict=True))


def _noise_seed(seed: int, pose: int, camera: int) -> int:
    return int(np.random.default_rng([seed, 31, pose, camera]).integers(1 << 62))
