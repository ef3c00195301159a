"""A virtual rig's pictures without the renderer: a mottled ball before eight cameras, in a tenth of a second each."""

import json
from pathlib import Path

import numpy as np
from PIL import Image
from scipy.ndimage import map_coordinates

from mammometry.geometry.camera import Rig
from mammometry.io.cameras.own import cameras_table
from mammometry.simulate.rigs.build import REFERENCE, build_rig

RADIUS_MM = 130.0
RIG_TOML = """\
format = 1
units = "mm"
[rig]
name = "reference"
pairs = [
  {{ name = "front", left = "front_left", right = "front_right" }},
  {{ name = "floor", left = "floor_left", right = "floor_right" }},
  {{ name = "left", left = "left_left", right = "left_right" }},
  {{ name = "right", left = "right_left", right = "right_right" }},
]
[target]
kind = "charuco"
squares = [14, 10]
square_mm = 25.0
marker_mm = 18.0
dictionary = "DICT_5X5_250"
[subject]
kind = "{subject}"
[capture]
backend = "{backend}"
calibration = "calibrated"
timeout_s = {timeout_s}
{lines}
[capture.options]
{options}
"""


def ball(camera, seed=5):
    """A ball with the texture of skin about the rig's middle, lit from the camera."""
    height, width = camera.shape_hw
    v, u = np.mgrid[:height, :width]
    rays = camera.rays_world(np.stack([u, v], axis=-1).astype(float))
    centre = camera.centre_world
    along = rays @ centre
    under = along**2 - (centre @ centre - RADIUS_MM**2)
    hit = under > 0
    points = centre + rays * (-along - np.sqrt(np.where(hit, under, 0)))[..., None]
    rng = np.random.default_rng(seed)
    light = np.zeros(points.shape[:2])
    for cell_mm, weight in ((40.0, 0.10), (12.0, 0.15), (5.0, 0.15)):
        places = np.moveaxis((points + 2 * RADIUS_MM) / cell_mm, -1, 0)
        light += weight * map_coordinates(rng.normal(size=(60, 60, 60)), places, order=1, mode="wrap")
    towards = centre / np.linalg.norm(centre)
    shade = np.clip(points @ towards / RADIUS_MM, 0, 1)
    value = np.where(hit, np.clip(0.55 * (0.5 + 0.5 * shade) * (1 + light), 0, 0.95), 0.03)
    value = value + np.random.default_rng([seed, 1]).normal(0, 0.004, value.shape)
    return (255 * np.clip(value[..., None] * [1.0, 0.8, 0.7], 0, 1)).astype(np.uint8)


def make_pictures(folder: Path, scale: float = 0.15) -> Rig:
    """A session with ready-made cameras and one picture of each."""
    rig = build_rig(REFERENCE, scale, 3)
    (folder / "capture").mkdir(parents=True)
    pairs = "".join(f'{{ name = "{n}", left = "{a}", right = "{b}" }},' for n, (a, b) in rig.pair_names.items())
    (folder / "session.toml").write_text(
        f'format = 1\nunits = "mm"\n[rig]\nname = "reference"\npairs = [{pairs}]\n[subject]\nkind = "model"\n'
    )
    (folder / "cameras.json").write_text(json.dumps(cameras_table(rig.cameras)))
    for name, camera in rig.cameras.items():
        Image.fromarray(ball(camera)).save(folder / "capture" / f"{name}.png")
    return rig


def rig_file(folder: Path, *, faults="", lines="", backend="virtual", options=None, subject="model", timeout_s=0.3):
    """Write rig.toml beside the session ``calibrated``."""
    path = folder / "rig.toml"
    options = f'session = "{folder / "calibrated"}"\nfaults = {{ {faults} }}' if options is None else options
    text = RIG_TOML.format(subject=subject, backend=backend, timeout_s=timeout_s, lines=lines, options=options)
    path.write_text(text)
    return path
