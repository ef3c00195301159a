"""One picture of what the virtual subject can look like: the page on simulation shows it.

    python -m benchmarks.appearances docs/img/appearances.jpg

From left to right, row by row: plaster, plain, skin; dark skin, pale skin, sweat; hair, a cluttered room, an open lens.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image

from mammometry.simulate.rendering.develop import develop
from mammometry.simulate.rendering.film import Film
from mammometry.simulate.rendering.render import render_subject
from mammometry.simulate.rendering.scene import Room, light_scene
from mammometry.simulate.rendering.skin import SKINS
from mammometry.simulate.rigs.build import flashes
from mammometry.simulate.rigs.rig_file import make_rig
from mammometry.simulate.subjects.registry import make_subject
from mammometry.simulate.subjects.solid import rig_from_solid

_SEED = 7
_HALF_PX = 165
_OPEN_LENS = Film(f_number=1.4, focus_mm=720.0, vignetting=0.5)


def main() -> None:
    """Render nine appearances and write them as one JPEG."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("out", type=Path)
    out = parser.parse_args().out
    camera = make_rig("reference:front", 0.2, _SEED).cameras["front_left"]
    solid = make_subject("plaster_6", _SEED, edge_mm=0.9)
    place = rig_from_solid(solid, _SEED)
    cases = [(skin, "dark", Film()) for skin in SKINS.values()]
    cases += [(replace(SKINS["skin"], hair_per_cm2=3.0), "dark", Film())]
    cases += [(SKINS["pale-skin"], "clutter", Film()), (SKINS["skin"], "clutter", _OPEN_LENS)]
    tiles = []
    for skin, background, film in cases:
        scene = light_scene(solid, place, flashes(), skin=skin, room=Room(clutter=background == "clutter"), seed=_SEED)
        radiance = render_subject(
            scene, camera, skin, seed=_SEED, aperture=film.aperture(camera), background=film.stray_light
        )
        pixels = develop(radiance, film, name="tile", seed=1).pixels
        column, row = np.rint(camera.project(scene.subject.vertices.mean(axis=0)[None])[0]).astype(int)
        tiles.append(pixels[row - _HALF_PX : row + _HALF_PX, column - _HALF_PX : column + _HALF_PX])
    sheet = np.vstack([np.hstack(tiles[start : start + 3]) for start in range(0, len(tiles), 3)])
    Image.fromarray(sheet).save(out, quality=88)


if __name__ == "__main__":
    main()
