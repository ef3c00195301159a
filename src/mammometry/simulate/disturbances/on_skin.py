"""Skin types and marks on skin: dark, pale, older, wet, hairy, tattooed.

All sizes here are made up; no measurement uses them.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from mammometry.simulate.disturbances.registry import Number, Word, disturbance
from mammometry.simulate.rendering.skin import SKINS, SkinReflectance
from mammometry.simulate.subjects.marks import SkinMark
from mammometry.simulate.subjects.torso_shape import SIDES, TorsoShape

_LIVING = ("skin", "dark-skin", "pale-skin", "sweat")
_INK = (0.22, 0.26, 0.34)  # colour of a tattoo's lines relative to the skin's


@disturbance("skin", "skin", "the skin of a living person in place of the usual one", Word(usual="skin", words=_LIVING))
def _skin(skin: SkinReflectance, name: str, rng: np.random.Generator) -> SkinReflectance:
    return replace(SKINS[name], hair_per_cm2=skin.hair_per_cm2)


@disturbance(
    "older-skin",
    "skin",
    "older skin: how much more mottled, spotted and veined",
    Number(usual=1.0, within=(0.0, 3.0), likely=(0.3, 1.5)),
    order=1,
)
def _older(skin: SkinReflectance, more: float, rng: np.random.Generator) -> SkinReflectance:
    return replace(
        skin,
        contrast=skin.contrast * (1.0 + 0.8 * more),
        colour_contrast=skin.colour_contrast * (1.0 + more),
        moles=skin.moles + 40.0 * more,
        veins=skin.veins + 0.15 * more,
        roughness=skin.roughness + 0.05 * more,
    )


@disturbance(
    "wet",
    "skin",
    "sweat on whatever skin it is: strength of the sheen",
    Number(usual=0.10, within=(0.0, 0.5), likely=(0.04, 0.16)),
    order=1,
)
def _wet(skin: SkinReflectance, specular: float, rng: np.random.Generator) -> SkinReflectance:
    return replace(skin, specular=specular, exponent=70.0, sheen_patches=0.8, roughness=0.18)


@disturbance(
    "body-hair",
    "skin",
    "fine dark hairs: their number on 1 cm²",
    Number(usual=1.0, within=(0.0, 20.0), likely=(0.2, 3.0)),
    order=1,
)
def _hairy(skin: SkinReflectance, per_cm2: float, rng: np.random.Generator) -> SkinReflectance:
    return replace(skin, hair_per_cm2=per_cm2)


@disturbance("tattoo", "patient", "a tattoo above one breast", Word(usual="right", words=SIDES), order=4)
def _tattoo(shape: TorsoShape, side: str, rng: np.random.Generator) -> TorsoShape:
    x, y = rng.uniform(-15.0, 25.0), 0.62 * shape.breasts[side].radii_mm[2]
    marks = []
    for petal in range(6):
        share = np.linspace(0.0, 1.0, 15)
        angle = 2.0 * math.pi * petal / 6.0 + 0.9 * (share - 0.5)
        reach = 22.0 * np.sin(math.pi * share)
        line = tuple(zip((x + reach * np.cos(angle)).tolist(), (y + reach * np.sin(angle)).tolist(), strict=True))
        marks.append(SkinMark(side=side, line_mm=line, half_width_mm=1.5, colour=_INK))
    return replace(shape, marks=(*shape.marks, *marks))
