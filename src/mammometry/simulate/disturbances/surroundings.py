"""Disturbances around the body: rails, bands, cloth, walls, a hand.

In the solid's frame, y = 0 is at about the nipples' height, and z points out of the chest. All sizes here are made up;
no measurement uses them.
"""

from __future__ import annotations

import math
from dataclasses import replace
from types import MappingProxyType

import numpy as np

from mammometry.simulate.disturbances.about import Surroundings
from mammometry.simulate.disturbances.registry import Number, Word, disturbance
from mammometry.simulate.disturbances.surfaces import ball, bar, box, sheet, straight, together
from mammometry.simulate.rendering.props import Props
from mammometry.simulate.subjects.solid import waves

_STEEL, _RUBBER, _NAVY = (0.42, 0.43, 0.45), (0.05, 0.05, 0.055), (0.03, 0.04, 0.09)
_GOLD, _GAUZE, _BROWN_HAIR = (0.75, 0.52, 0.18), (0.80, 0.80, 0.78), (0.045, 0.028, 0.018)
_WHITE, _WOOD, _HAND = (0.60, 0.60, 0.58), (0.45, 0.33, 0.22), np.array([0.62, 0.40, 0.31])
_CLOTHS = MappingProxyType(
    {
        "white": (0.82, 0.82, 0.80),
        "beige": (0.60, 0.48, 0.36),
        "blue": (0.12, 0.22, 0.45),
        "black": (0.025, 0.025, 0.03),
    }
)
_WALL_Z_MM = -600.0  # position of a wall behind the body, rig frame
_DAYLIGHT = 8.0  # brightness of a window relative to the room's light on a white wall
_ABOVE_TABLE_MM = 1.6  # gap between a cast and the table, in which the dark board of a flat back fits
_BOARD_HALF_MM, _BOARD_CELL_MM = 210.0, 3.0
"""Half the side of a board below a cast, and the side of a cell of its texture."""
_UNDER_CAST_MM = 0.4  # gap between a cast and a board, larger than that to the dark board of a flat back
_CHECK_CELLS = 5  # cells per square of a patterned board, which is 15 mm wide
_BOARDS = MappingProxyType(
    {  # reflectances, and shares of the cells with each
        "plain": ((0.10,), (1.0,)),
        "speckled": ((0.05, 0.16, 0.02), (0.6, 0.25, 0.15)),
        "patterned": ((0.08, 0.55), (0.5, 0.5)),
    }
)
_ENDS_MM = -366.0  # height of the trunk's lower end, solid's frame


@disturbance(
    "rail",
    "thing",
    "a level rail of a posing frame in front of the body: its height over the nipples",
    Number(usual=-95.0, within=(-400.0, 300.0), likely=(-140.0, 40.0), unit="mm"),
)
def _rail(about: Surroundings, height_mm: float, rng: np.random.Generator) -> Surroundings:
    z = about.front_mm(height_mm - 30.0, height_mm + 30.0, about.half_width_mm) + 34.0
    line = straight((-520.0, height_mm, z), (520.0, height_mm, z))
    return about.plus_at_body(bar(line, 13.0), _STEEL, smooth=0.9, moves=False)


@disturbance(
    "upright",
    "thing",
    "an upright of a posing frame in front of the body: its place to the patient's left",
    Number(usual=110.0, within=(-400.0, 400.0), likely=(-160.0, 160.0), unit="mm"),
)
def _upright(about: Surroundings, aside_mm: float, rng: np.random.Generator) -> Surroundings:
    vertices = about.rig_from_solid.apply(about.solid.mesh.vertices)
    near = (np.abs(vertices[:, 0] - aside_mm) < 40.0) & (np.abs(vertices[:, 1]) < 250.0)
    z = float(vertices[near, 2].max() if near.any() else 60.0) + 40.0
    line = straight((aside_mm, -520.0, z), (aside_mm, 520.0, z))
    return about.plus(bar(line, 16.0), _STEEL, smooth=0.9, curved=True)


@disturbance(
    "band",
    "thing",
    "a dark elastic band around the trunk, below the breasts: its width",
    Number(usual=30.0, within=(4.0, 120.0), likely=(15.0, 60.0), unit="mm"),
)
def _band(about: Surroundings, width_mm: float, rng: np.random.Generator) -> Surroundings:
    folds = [points[0, 1] for name, points in about.solid.landmarks.items() if name.startswith("inframammary_fold")]
    top = float(min(folds, default=-70.0)) - 8.0
    cloth = about.outside.cloth(np.linspace(top, top - width_mm, 9), np.full((9, 1), 1.4))
    return about.plus_at_body(cloth, _RUBBER, smooth=0.6)


@disturbance(
    "trousers",
    "thing",
    "trousers up to a height over the nipples",
    Number(usual=-215.0, within=(-360.0, -100.0), likely=(-300.0, -170.0), unit="mm"),
)
def _trousers(about: Surroundings, top_mm: float, rng: np.random.Generator) -> Surroundings:
    cloth = about.outside.cloth(np.linspace(top_mm, _ENDS_MM, 30), np.full((30, 1), 3.0))
    return about.plus_at_body(cloth, _NAVY, smooth=0.3)


@disturbance("towel", "thing", "a towel around the waist", Word(usual="white", words=tuple(_CLOTHS)))
def _towel(about: Surroundings, colour: str, rng: np.random.Generator) -> Surroundings:
    heights = np.linspace(-165.0 + rng.uniform(-25.0, 15.0), _ENDS_MM, 45)
    angle = np.arange(180) * (2.0 * math.pi / 180)
    folds = 5.0 * np.sin(9.0 * angle + rng.uniform(0.0, 6.0)) * np.linspace(0.2, 1.0, 45)[:, None]
    cloth = about.outside.cloth(heights, 10.0 + folds + 2.0 * np.sin(5.0 * angle))
    return about.plus_at_body(cloth, _CLOTHS[colour], smooth=0.0)


@disturbance("gown", "thing", "an open gown over arms and back", Word(usual="blue", words=tuple(_CLOTHS)))
def _gown(about: Surroundings, colour: str, rng: np.random.Generator) -> Surroundings:
    vertices = about.solid.mesh.vertices
    x, y, z = vertices.T
    covered = ((np.abs(x) > about.half_width_mm - 8.0) | (z < -25.0)) & (y < 205.0) & (y > _ENDS_MM)
    uneven = waves(vertices, rng, shortest_mm=25.0, longest_mm=90.0)
    return about.plus_at_body(about.outside.shell(covered, 9.0 + 3.0 * uneven), _CLOTHS[colour], smooth=0.3)


@disturbance(
    "dressing",
    "thing",
    "a dressing on the upper chest: its width",
    Number(usual=60.0, within=(40.0, 160.0), likely=(40.0, 100.0), unit="mm"),
)
def _dressing(about: Surroundings, width_mm: float, rng: np.random.Generator) -> Surroundings:
    x, y, z = about.solid.mesh.vertices.T
    aside, height = rng.choice([-1.0, 1.0]) * rng.uniform(55.0, 85.0), rng.uniform(80.0, 115.0)
    covered = (np.abs(x - aside) < 0.5 * width_mm) & (np.abs(y - height) < 0.35 * width_mm) & (z > 0.0)
    return about.plus_at_body(about.outside.shell(covered, np.full(1, 0.9)), _GAUZE, smooth=0.4)


@disturbance(
    "necklace",
    "thing",
    "a chain around the neck with a pendant: its radius",
    Number(usual=1.2, within=(0.4, 4.0), likely=(0.6, 2.0), unit="mm"),
)
def _necklace(about: Surroundings, radius_mm: float, rng: np.random.Generator) -> Surroundings:
    angle = np.linspace(-math.pi, math.pi, 241)
    height = 205.0 - rng.uniform(60.0, 115.0) * np.exp(-((angle / 0.8) ** 2))
    radius = about.outside.radius_mm(height, angle, -20.0) + radius_mm
    line = np.stack([radius * np.sin(angle), height, radius * np.cos(angle) - 20.0], axis=1)
    pendant = ball(line[120] + np.array([0.0, -5.0, 3.5]), 4.5)
    return about.plus_at_body(together([bar(line, radius_mm, 8), pendant]), _GOLD, smooth=1.0)


@disturbance(
    "long-hair",
    "thing",
    "dark hair over the shoulders and the upper chest: its length below the neck's end",
    Number(usual=190.0, within=(30.0, 280.0), likely=(120.0, 250.0), unit="mm"),
)
def _long_hair(about: Surroundings, length_mm: float, rng: np.random.Generator) -> Surroundings:
    locks = []
    for number in range(120):
        side = 1.0 if number % 2 else -1.0
        angle = side * rng.uniform(0.55, 2.4) + np.linspace(0.0, rng.normal(0.0, 0.12), 12)
        height = np.linspace(248.0, 248.0 - length_mm * rng.uniform(0.75, 1.0), 12)
        radius = np.minimum(about.outside.radius_mm(height, angle, -20.0), 150.0) + rng.uniform(2.0, 12.0)
        line = np.stack([radius * np.sin(angle), height, radius * np.cos(angle) - 20.0], axis=1)
        line[1:-1] = 0.25 * line[:-2] + 0.5 * line[1:-1] + 0.25 * line[2:]
        locks.append(bar(line, np.linspace(4.5, 1.0, 12).tolist(), 7))
    return about.plus_at_body(together(locks), _BROWN_HAIR, smooth=0.0)


@disturbance(
    "pale-wall",
    "thing",
    "a pale wall behind the body: its reflectance",
    Number(usual=0.75, within=(0.02, 0.95), likely=(0.45, 0.85)),
)
def _pale_wall(about: Surroundings, reflectance: float, rng: np.random.Generator) -> Surroundings:
    wall = sheet((0.0, 300.0, _WALL_Z_MM), (2600.0, 0.0, 0.0), (0.0, 2200.0, 0.0), 45.0)
    return about.plus(wall, (reflectance, reflectance, 0.96 * reflectance), smooth=0.92)


@disturbance(
    "table",
    "thing",
    "a bright table under the subject or the cast: its reflectance",
    Number(usual=0.7, within=(0.02, 0.95)),
)
def _table(about: Surroundings, reflectance: float, rng: np.random.Generator) -> Surroundings:
    colour, vertices = (reflectance, 0.97 * reflectance, 0.9 * reflectance), about.solid.mesh.vertices
    if about.solid.base_boundary is not None:
        lowest = float(vertices[:, 2].min()) - _ABOVE_TABLE_MM
        top = sheet((0.0, 0.0, lowest), (700.0, 0.0, 0.0), (0.0, 700.0, 0.0), 20.0)
        return about.plus_at_body(top, colour, smooth=0.3, moves=False)
    lowest = float(about.rig_from_solid.apply(vertices)[:, 1].min()) - 0.1
    return about.plus(sheet((0.0, lowest, 0.0), (0.0, 0.0, 700.0), (700.0, 0.0, 0.0), 20.0), colour, smooth=0.3)


@disturbance(
    "board",
    "thing",
    "a board of 420 mm under the cast: its texture",
    Word(usual="speckled", words=tuple(_BOARDS)),
)
def _board(about: Surroundings, texture: str, rng: np.random.Generator) -> Surroundings:
    lowest = float(about.solid.mesh.vertices[:, 2].min()) - _UNDER_CAST_MM
    half = _BOARD_HALF_MM
    top = sheet((0.0, 0.0, lowest), (half, 0.0, 0.0), (0.0, half, 0.0), _BOARD_CELL_MM)
    reflectances, shares = _BOARDS[texture]
    count = round(2.0 * half / _BOARD_CELL_MM)
    row, column = np.indices((count, count))
    if texture == "patterned":
        cells = (row // _CHECK_CELLS + column // _CHECK_CELLS) % 2
    else:
        cells = rng.choice(len(shares), p=shares, size=(count, count))
    top = replace(top, material=np.tile(cells.ravel(), 2).astype(np.uint8))  # two triangles per cell
    colours = [(value, 0.98 * value, 0.95 * value) for value in reflectances]
    return about.plus_at_body(top, *colours, smooth=0.8, moves=False)


@disturbance(
    "window",
    "thing",
    "a bright window behind the body: its width",
    Number(usual=600.0, within=(50.0, 2000.0), likely=(300.0, 1000.0), unit="mm"),
)
def _window(about: Surroundings, width_mm: float, rng: np.random.Generator) -> Surroundings:
    x, y = rng.uniform(-350.0, 350.0), rng.uniform(100.0, 350.0)
    panes = sheet((x, y, _WALL_Z_MM + 8.0), (0.5 * width_mm, 0.0, 0.0), (0.0, 0.65 * width_mm, 0.0), 60.0)
    posts = [
        box((x + side * width_mm, y, _WALL_Z_MM + 18.0), (24.0, 1.34 * width_mm, 20.0)) for side in (-0.5, 0.0, 0.5)
    ]
    bright = about.plus(panes, (0.85, 0.92, 1.0), smooth=1.0, glow=_DAYLIGHT)
    return bright.plus(together(posts), _WHITE, smooth=0.9)


@disturbance(
    "shelf",
    "thing",
    "a shelf with objects behind the body: their number",
    Number(usual=14.0, within=(1.0, 60.0), likely=(5.0, 30.0), whole=True),
)
def _shelf(about: Surroundings, number: float, rng: np.random.Generator) -> Surroundings:
    level, count = rng.uniform(-120.0, 160.0), round(number)
    about = about.plus(box((0.0, level - 12.0, _WALL_Z_MM + 140.0), (1400.0, 22.0, 240.0)), _WOOD, smooth=0.2)
    things: dict[int, list[Props]] = {}
    for index, place in enumerate(np.linspace(-620.0, 620.0, count)):
        size = rng.uniform((20.0, 60.0, 60.0), (70.0, 220.0, 180.0))
        middle = (place + rng.uniform(-10.0, 10.0), level + 0.5 * size[1], _WALL_Z_MM + 140.0)
        things.setdefault(index % 6, []).append(box(middle, size))
    for alike in things.values():
        red, green, blue = np.clip(rng.uniform(0.05, 0.8) * rng.uniform(0.4, 1.3, 3), 0.02, 0.9)
        about = about.plus(together(alike), (red, green, blue), smooth=0.2)
    return about


@disturbance(
    "mat",
    "thing",
    "a mat of the skin's colour close behind the body: its width",
    Number(usual=700.0, within=(200.0, 2000.0), likely=(400.0, 1200.0), unit="mm"),
)
def _mat(about: Surroundings, width_mm: float, rng: np.random.Generator) -> Surroundings:
    behind = float(about.solid.mesh.vertices[:, 2].min()) - 25.0
    mat = sheet((0.0, -60.0, behind), (0.5 * width_mm, 0.0, 0.0), (0.0, 420.0, 0.0), 20.0)
    red, green, blue = (0.97 * value for value in about.skin.base_rgb)
    return about.plus_at_body(mat, (red, green, blue), smooth=0.8, moves=False)


@disturbance(
    "hand",
    "thing",
    "a technician's hand on one shoulder, with the forearm",
    Word(usual="left", words=("left", "right")),
)
def _hand(about: Surroundings, side: str, rng: np.random.Generator) -> Surroundings:
    sign, width = (1.0 if side == "left" else -1.0), about.half_width_mm
    out = np.array([sign, 1.0, 1.0])
    palm = np.array([sign * (width + 4.0), 190.0, 12.0])
    elbow = np.array([sign * (width + 260.0), 330.0, 70.0])
    forearm, back = straight(palm, elbow), straight(palm + [30.0, 22.0, 0.0] * out, palm + [-26.0, -14.0, 26.0] * out)
    limb = [bar(forearm, np.linspace(27.0, 44.0, len(forearm)).tolist(), 24), bar(back, 23.0, 20)]
    for finger in range(4):
        start = palm + np.array([-30.0 + 9.0 * finger, -8.0 - 5.0 * finger, 30.0]) * out
        limb.append(bar(straight(start, start + np.array([-26.0, -50.0 + 3.0 * finger, 28.0]) * out, 6.0), 8.5, 12))
    red, green, blue = rng.uniform(0.3, 1.05) * _HAND
    hand = about.plus_at_body(together(limb), (red, green, blue), smooth=0.75, moves=False)
    sleeve = bar(straight(0.55 * palm + 0.45 * elbow, elbow), 52.0, 24)
    return hand.plus_at_body(sleeve, _CLOTHS["blue"], smooth=0.3, moves=False)
