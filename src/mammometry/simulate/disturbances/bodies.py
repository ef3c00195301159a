"""Patients: mastectomy, mounds without a fold, flaps, ptosis, build, arm positions, posture.

All sizes here are made up; no measurement uses them.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from mammometry.simulate.disturbances.registry import Number, Word, disturbance
from mammometry.simulate.subjects.marks import Point, SkinMark
from mammometry.simulate.subjects.torso_shape import SIDES, BreastDesign, TorsoShape

_SCAR = (0.92, 0.70, 0.68)  # colour of a healed scar relative to the skin's: redder


@disturbance("removed", "patient", "one breast removed", Word(usual="right", words=SIDES), order=1)
def _removed(shape: TorsoShape, side: str, rng: np.random.Generator) -> TorsoShape:
    return _with(shape, side, replace(shape.breasts[side], removed=True))


@disturbance(
    "scar",
    "patient",
    "a scar across each side that is removed or rebuilt",
    Number(usual=3.0, within=(0.5, 12.0), unit="mm"),
    order=4,
)
def _scar(shape: TorsoShape, width_mm: float, rng: np.random.Generator) -> TorsoShape:
    marks: list[SkinMark] = []
    for side in operated(shape):
        line = _across(shape.breasts[side], rng)
        marks.append(
            SkinMark(
                side=side, line_mm=line, half_width_mm=0.5 * width_mm + 1.0, colour=_SCAR, height_mm=-0.5 * width_mm
            )
        )
        for place in ((line[-1][0] - 6.0, line[-1][1] - 34.0), (line[-1][0] + 8.0, line[-1][1] - 40.0)):
            marks.append(
                SkinMark(side=side, line_mm=(place,), half_width_mm=4.0, colour=_SCAR, height_mm=-0.8)
            )  # drains
    return replace(shape, marks=(*shape.marks, *marks))


@disturbance(
    "loose-skin",
    "patient",
    "folds of loose skin where a breast was removed",
    Number(usual=6.0, within=(1.0, 15.0), unit="mm"),
    order=4,
)
def _loose_skin(shape: TorsoShape, height_mm: float, rng: np.random.Generator) -> TorsoShape:
    marks: list[SkinMark] = []
    for side, breast in shape.breasts.items():
        if not breast.removed:
            continue
        line = _across(breast, rng)
        for shift in (-14.0, 13.0):
            beside = tuple((x, y + shift + 4.0 * math.sin(0.05 * x)) for x, y in line)
            marks.append(
                SkinMark(side=side, line_mm=beside, half_width_mm=3.0, height_mm=0.45 * height_mm, slope_mm=5.0)
            )
        end = (line[-1][0] + 6.0, line[-1][1])
        marks.append(
            SkinMark(side=side, line_mm=(end,), half_width_mm=3.0, height_mm=height_mm, slope_mm=12.0)
        )  # dog ear
    return replace(shape, marks=(*shape.marks, *marks))


@disturbance(
    "mound",
    "patient",
    "one breast an expander's or implant's mound, without fold, areola or nipple",
    Number(usual=150.0, within=(40.0, 700.0), likely=(80.0, 400.0), unit="cc"),
    order=2,
)
def _mound(shape: TorsoShape, volume_cc: float, rng: np.random.Generator) -> TorsoShape:
    side = _one_side(shape, rng)
    breast = shape.breasts[side]
    radius = (volume_cc * 1000.0 / (0.5 * rng.uniform(0.42, 0.62))) ** (1.0 / 3.0)
    limits = [breast.apex_mm[0] - 4.0, 74.0, 92.0, 92.0]
    inner, outer, upper, lower = np.minimum(radius * rng.uniform(0.95, 1.08, 4), limits).tolist()
    mound = replace(
        breast,
        volume_cc=volume_cc,
        radii_mm=(inner, outer, upper, lower),
        projection_mm=0.45 * radius,
        hang_mm=rng.uniform(0.0, 0.06) * radius,
        fullness=0.0,
        cap=rng.uniform(2.3, 3.6),
        bare=True,
        removed=False,
        unevenness_mm=rng.uniform(0.2, 0.6),
        nipple_place=(0.0, 0.0),
    )
    return _with(shape, side, mound)


@disturbance(
    "flap",
    "patient",
    "one breast a flap with a paddle of other skin, without nipple",
    Word(usual="left", words=SIDES),
    order=2,
)
def _flap(shape: TorsoShape, side: str, rng: np.random.Generator) -> TorsoShape:
    breast = shape.breasts[side]
    inner, outer, upper, lower = breast.radii_mm
    angle = np.linspace(0.0, 2.0 * math.pi, 24, endpoint=False)
    wide, high, turn = rng.uniform(0.4, 0.6), rng.uniform(0.2, 0.35), rng.uniform(-0.4, 0.4)
    x, y = wide * 0.5 * (inner + outer) * np.cos(angle), high * 0.5 * (upper + lower) * np.sin(angle)
    x, y = x * math.cos(turn) - y * math.sin(turn), x * math.sin(turn) + y * math.cos(turn) - 0.1 * lower
    outline: tuple[Point, ...] = tuple((float(a), float(b)) for a, b in zip(x, y, strict=True))
    shade = float(rng.uniform(1.08, 1.25))
    paddle = SkinMark(side=side, line_mm=outline, half_width_mm=1.0, colour=(shade, shade, 0.98 * shade), filled=True)
    seam = SkinMark(
        side=side, line_mm=(*outline, outline[0]), half_width_mm=1.5, colour=_SCAR, height_mm=-1.0, slope_mm=3.0
    )
    changed = replace(breast, bare=True, fullness=0.8 * breast.fullness, hang_mm=0.6 * breast.hang_mm)
    return replace(_with(shape, side, changed), marks=(*shape.marks, paddle, seam))


@disturbance(
    "new-nipple",
    "patient",
    "a rebuilt nipple, low and with a tattooed areola, on a mound or flap",
    Number(usual=2.0, within=(0.0, 6.0), unit="mm"),
    order=3,
)
def _new_nipple(shape: TorsoShape, height_mm: float, rng: np.random.Generator) -> TorsoShape:
    for side, breast in shape.breasts.items():
        if breast.bare:
            areola = float(rng.uniform(12.0, 20.0))
            shape = _with(shape, side, replace(breast, bare=False, nipple_mm=height_mm, areola_mm=areola))
    return shape


@disturbance(
    "no-nipple", "patient", "a breast whose nipple and areola are lost", Word(usual="left", words=SIDES), order=3
)
def _no_nipple(shape: TorsoShape, side: str, rng: np.random.Generator) -> TorsoShape:
    return _with(shape, side, replace(shape.breasts[side], bare=True))


@disturbance("ptosis", "patient", "grade of ptosis of both breasts", Number(usual=2.0, within=(0.0, 3.0)), order=3)
def _ptosis(shape: TorsoShape, grade: float, rng: np.random.Generator) -> TorsoShape:
    for side, breast in shape.breasts.items():
        if not (breast.removed or breast.fullness == 0.0):
            radius = float(np.mean(breast.radii_mm))
            place = (breast.nipple_place[0], -0.06 - 0.12 * grade)
            hang = (0.1 + 0.3 * grade) * radius
            shape = _with(shape, side, replace(breast, hang_mm=hang, nipple_place=place))
    return shape


@disturbance("ratio", "patient", "volume of the left breast over the right one", Number(usual=2.0, within=(0.2, 5.0)))
def _ratio(shape: TorsoShape, ratio: float, rng: np.random.Generator) -> TorsoShape:
    left, right = (shape.breasts[side] for side in SIDES)
    mean_cc = math.sqrt(left.volume_cc * right.volume_cc)
    volumes = (mean_cc * math.sqrt(ratio), mean_cc / math.sqrt(ratio))
    if max(volumes) > 1160.0:  # largest volume of the family
        volumes = tuple(volume * 1160.0 / max(volumes) for volume in volumes)  # type: ignore[assignment]
    for side, volume_cc in zip(SIDES, volumes, strict=True):
        shape = _with(shape, side, _grown(shape, shape.breasts[side], volume_cc))
    return shape


_HANGING_CC = (300.0, 1500.0)  # volumes of hanging breasts: uniform in their logarithm


@disturbance(
    "hanging",
    "patient",
    "large, hanging breasts of 300 to 1,500 cc: how far their nipples are below the fold",
    Number(usual=30.0, within=(0.0, 60.0), unit="mm"),
    order=3,
)
def _hanging(shape: TorsoShape, below_mm: float, rng: np.random.Generator) -> TorsoShape:
    mean_cc = math.exp(rng.uniform(*np.log(_HANGING_CC)))
    for side, breast in shape.breasts.items():
        if not (breast.removed or breast.fullness == 0.0):
            volume_cc = float(np.clip(mean_cc * math.exp(rng.normal(0.0, 0.1)), *_HANGING_CC))
            changed = replace(
                _grown(shape, breast, volume_cc),
                below_fold_mm=below_mm + rng.uniform(-3.0, 3.0),
                nipple_place=(breast.nipple_place[0], rng.uniform(-0.3, -0.1)),
                fullness=rng.uniform(0.85, 1.0),
                sag=rng.uniform(1.8, 3.2),
            )
            shape = _with(shape, side, changed)
    return shape


def _grown(shape: TorsoShape, breast: BreastDesign, volume_cc: float) -> BreastDesign:
    """A breast scaled to another volume, as far as the chest has room for its base."""
    grown = (volume_cc / breast.volume_cc) ** (1.0 / 3.0)
    limits = (breast.apex_mm[0] - 3.0, shape.body.half_width_mm + 4.0 - breast.apex_mm[0], 94.0 - breast.apex_mm[1])
    inner, outer, upper = (min(grown * length, limit) for length, limit in zip(breast.radii_mm, limits, strict=False))
    return replace(
        breast,
        volume_cc=volume_cc,
        radii_mm=(inner, outer, upper, grown * breast.radii_mm[3]),
        projection_mm=grown * breast.projection_mm,
        hang_mm=grown * breast.hang_mm,
        areola_mm=min(grown * breast.areola_mm, 29.0),
    )


@disturbance("arms", "patient", "position of the arms", Word(usual="raised", words=("raised", "sides", "frame")))
def _arms(shape: TorsoShape, where: str, rng: np.random.Generator) -> TorsoShape:
    out_deg, back_deg = {"raised": (128.0, 5.0), "sides": (14.0, 6.0), "frame": (62.0, -32.0)}[where]
    out, back = (math.radians(angle + rng.uniform(-5.0, 5.0)) for angle in (out_deg, back_deg))
    return replace(shape, body=replace(shape.body, arm_out_rad=out, arm_back_rad=back))


@disturbance("build", "patient", "an obese or a thin body", Word(usual="obese", words=("obese", "thin")))
def _build(shape: TorsoShape, build: str, rng: np.random.Generator) -> TorsoShape:
    body = shape.body
    if build == "obese":
        changed = replace(
            body, half_width_mm=body.half_width_mm + 22.0, depth=0.82, belly_mm=rng.uniform(25.0, 60.0), arm_mm=62.0,
            rib_mm=0.0, clavicle_mm=0.5,
        )  # fmt: skip
    else:
        changed = replace(body, depth=0.64, arm_mm=34.0, rib_mm=0.7, clavicle_mm=7.0, sternum_mm=7.0)
    return replace(shape, body=changed)


_POSTURES = ("leaning", "standing", "lying")
_SPREAD = (1.06, 0.8)  # growth of a lying breast's base, and remaining share of its fall


@disturbance("posture", "patient", "posture of the patient", Word(usual="standing", words=_POSTURES), order=-1)
def _posture(shape: TorsoShape, posture: str, rng: np.random.Generator) -> TorsoShape:
    if posture == "leaning":
        return shape
    out_deg, back_deg = rng.uniform(18.0, 40.0), rng.uniform(0.0, 12.0)
    body = replace(shape.body, arm_out_rad=math.radians(out_deg), arm_back_rad=math.radians(back_deg))
    if posture == "standing":
        return replace(shape, body=body, lean_rad=math.radians(rng.uniform(0.0, 6.0)))
    grown, left = _SPREAD
    breasts = {}
    for side, breast in shape.breasts.items():
        aside, height = breast.apex_mm
        limits = (aside - 3.0, body.half_width_mm + 4.0 - aside, 94.0 - height)
        inner, outer, upper = (
            min(grown * length, limit) for length, limit in zip(breast.radii_mm, limits, strict=False)
        )
        breasts[side] = replace(
            breast, radii_mm=(inner, outer, upper, grown * breast.radii_mm[3]), hang_mm=left * breast.hang_mm,
            fullness=0.6 * breast.fullness,
        )  # fmt: skip
    return replace(shape, body=body, breasts=breasts, lean_rad=math.radians(rng.uniform(-90.0, -80.0)))


def operated(shape: TorsoShape) -> list[str]:
    """Sides that were removed, are mounds without a fold, or have no nipple."""
    return [side for side, breast in shape.breasts.items() if breast.removed or breast.bare or breast.fullness == 0.0]


def _one_side(shape: TorsoShape, rng: np.random.Generator) -> str:
    """The side to rebuild: the removed one, if any, or else a random one."""
    drawn = str(rng.choice(SIDES))
    return next((side for side in SIDES if shape.breasts[side].removed), drawn)


def _with(shape: TorsoShape, side: str, breast: BreastDesign) -> TorsoShape:
    return replace(shape, breasts={name: breast if name == side else old for name, old in shape.breasts.items()})


def _across(breast: BreastDesign, rng: np.random.Generator) -> tuple[Point, ...]:
    """Line of a mastectomy's scar, slightly bent, from near the breastbone to below the armpit."""
    inner, outer, upper, _ = breast.radii_mm
    bend, rise = rng.uniform(-8.0, 2.0), rng.uniform(0.05, 0.35) * upper
    share = np.linspace(0.0, 1.0, 13)
    x = -0.75 * inner + share * (0.75 * inner + 0.9 * outer)
    y = -6.0 + rise * share + bend * np.sin(math.pi * share) + 0.8 * np.sin(9.0 * share)
    return tuple((float(a), float(b)) for a, b in zip(x, y, strict=True))
