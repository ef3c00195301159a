"""Disturbances of rigs and cameras: drift, times, mounting, films, flashes.

Drift is that of mounts that warm up or are pushed. Sway and breathing are some mm/s, as in people who stand still. Lens
effects scale with the picture. Effects of sensor and software (mosaic, sharpening, JPEG, noise) are per pixel at any
scale. All sizes here are made up; no measurement uses them.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from mammometry.geometry import Array, Float64, Rig
from mammometry.simulate.disturbances.exposure import CaptureConditions, shifted, turned, with_cameras
from mammometry.simulate.disturbances.registry import Number, Word, disturbance
from mammometry.simulate.rendering.scene import SubjectMotion
from mammometry.simulate.rigs.build import FULL_SIZE_WH

_FRONT = (0.0, -math.sin(math.radians(35.0)), math.cos(math.radians(35.0)))
"""Direction out of the chest for a body that leans forward by 35°, rig frame."""
_SWAY_MM_S, _TURN_DEG_S, _BREATH_MM_S = (4.0, 10.0), (0.2, 0.8), (3.0, 8.0)
"""Ranges of the speeds of a moving patient (uniform distribution), mm/s and degrees/s."""
_ROLLS_DEG = {"upside-down": 180.0, "portrait-left": 90.0, "portrait-right": -90.0}
_NOT_FIRED = 0.0  # irradiance × mm² at distance 1 of a flash that did not fire


@disturbance(
    "drift",
    "shoot",
    "every camera turned after the calibration",
    Number(usual=0.02, within=(0.0, 0.5), likely=(0.005, 0.05), unit="deg"),
)
def _drift(exposure: CaptureConditions, angle_deg: float, rng: np.random.Generator) -> CaptureConditions:
    return _turned(exposure, angle_deg, tuple(exposure.rig.cameras), rng)


@disturbance(
    "drift-one",
    "shoot",
    "one camera turned after the calibration",
    Number(usual=0.05, within=(0.0, 0.5), likely=(0.005, 0.05), unit="deg"),
)
def _drift_one(exposure: CaptureConditions, angle_deg: float, rng: np.random.Generator) -> CaptureConditions:
    return _turned(exposure, angle_deg, (str(rng.choice(list(exposure.rig.cameras))),), rng)


@disturbance(
    "lens",
    "shoot",
    "every lens's radial distortion k1 changed after the calibration",
    Number(usual=0.02, within=(-0.2, 0.2)),
)
def _lens(exposure: CaptureConditions, change: float, rng: np.random.Generator) -> CaptureConditions:
    first = np.array([change, 0.0, 0.0, 0.0, 0.0])
    return replace(
        exposure,
        capture_rig=with_cameras(
            exposure.capture_rig, lambda camera: replace(camera, distortion=camera.distortion + first)
        ),
    )


@disturbance(
    "pair-shift",
    "shoot",
    "one pair shifted as a whole after the calibration",
    Number(usual=0.5, within=(0.0, 10.0), likely=(0.1, 2.0), unit="mm"),
)
def _pair_shift(exposure: CaptureConditions, shift_mm: float, rng: np.random.Generator) -> CaptureConditions:
    names = exposure.rig.pair_names[str(rng.choice(list(exposure.rig.pair_names)))]
    shift = shift_mm * _direction(rng)
    return replace(
        exposure, capture_rig=with_cameras(exposure.capture_rig, lambda camera: shifted(camera, shift), names)
    )


@disturbance(
    "asynchronous",
    "shoot",
    "pairs exposed one after another, from first to last, while the body sways and breathes",
    Number(usual=50.0, within=(0.0, 500.0), likely=(2.0, 200.0), unit="ms"),
)
def _asynchronous(exposure: CaptureConditions, span_ms: float, rng: np.random.Generator) -> CaptureConditions:
    pairs = list(exposure.rig.pair_names.values())
    moments = 1e-3 * span_ms * (np.linspace(-0.5, 0.5, len(pairs)) if len(pairs) > 1 else np.zeros(1))
    seconds = dict(exposure.seconds)
    for pair, moment in zip(rng.permutation(len(pairs)), moments, strict=True):
        seconds |= dict.fromkeys(pairs[pair], float(moment))
    return replace(exposure, seconds=seconds, motion=_motion(rng))


@disturbance(
    "breathing",
    "shoot",
    "pairs exposed one after another within a breath, the chest a random part of this further out at each",
    Number(usual=1.0, within=(0.0, 5.0), likely=(0.2, 1.5), unit="mm"),
)
def _breathing(exposure: CaptureConditions, depth_mm: float, rng: np.random.Generator) -> CaptureConditions:
    pairs = list(exposure.rig.pair_names.values())
    parts = np.array([0.0, 1.0, *rng.uniform(size=len(pairs))])[: len(pairs)]
    seconds = dict(exposure.seconds)
    for pair, part in zip(rng.permutation(len(pairs)), parts - parts.mean(), strict=True):
        seconds |= dict.fromkeys(pairs[pair], float(part))
    still = np.zeros(3)
    # A breath takes one second.
    motion = SubjectMotion(sway_mm_s=still, turn_rad_s=still, breath_mm_s=depth_mm * np.array(_FRONT), chest=still)
    return replace(exposure, seconds=seconds, motion=motion)


@disturbance(
    "asynchronous-cameras",
    "shoot",
    "cameras exposed one after another, from first to last, while the body sways and breathes",
    Number(usual=20.0, within=(0.0, 500.0), likely=(2.0, 50.0), unit="ms"),
    order=1,
)
def _asynchronous_cameras(exposure: CaptureConditions, span_ms: float, rng: np.random.Generator) -> CaptureConditions:
    names = list(exposure.rig.cameras)
    moments = 1e-3 * span_ms * np.linspace(-0.5, 0.5, len(names))
    order = rng.permutation(len(names))
    seconds = {
        names[place]: exposure.seconds[names[place]] + float(moment)
        for place, moment in zip(order, moments, strict=True)
    }
    return replace(exposure, seconds=seconds, motion=exposure.motion or _motion(rng))


@disturbance(
    "mounted",
    "shoot",
    "all cameras rolled about their lines of sight",
    Word(usual="upside-down", words=tuple(_ROLLS_DEG)),
)
def _mounted(exposure: CaptureConditions, how: str, rng: np.random.Generator) -> CaptureConditions:
    roll = np.array([0.0, 0.0, math.radians(_ROLLS_DEG[how])])
    rig, capture = (
        with_cameras(rig, lambda camera: turned(camera, roll)) for rig in (exposure.rig, exposure.capture_rig)
    )
    if how == "upside-down":  # left and right are swapped in the pictures, and so within pairs
        names = {pair: (right, left) for pair, (left, right) in rig.pair_names.items()}
        rig, capture = (Rig(name=chosen.name, cameras=chosen.cameras, pair_names=names) for chosen in (rig, capture))
    return replace(exposure, rig=rig, capture_rig=capture)


@disturbance("grey", "shoot", "sensors without colour, files with one channel", Word(usual="grey", words=("grey",)))
def _grey(exposure: CaptureConditions, word: str, rng: np.random.Generator) -> CaptureConditions:
    return exposure.with_films(lambda film: replace(film, grey=True))


@disturbance("mosaic", "shoot", "sensors with a Bayer mosaic", Word(usual="rggb", words=("rggb",)))
def _mosaic(exposure: CaptureConditions, pattern: str, rng: np.random.Generator) -> CaptureConditions:
    return exposure.with_films(lambda film: replace(film, mosaic=True))


@disturbance(
    "aberration",
    "shoot",
    "red magnified more than green, and blue less, by lenses' chromatic aberration",
    Number(usual=4e-4, within=(0.0, 0.01), likely=(1e-4, 1e-3)),
)
def _aberration(exposure: CaptureConditions, larger: float, rng: np.random.Generator) -> CaptureConditions:
    return exposure.with_films(lambda film: replace(film, aberration=(larger, -0.7 * larger)))


@disturbance(
    "sharpening", "shoot", "pictures sharpened in the camera", Number(usual=0.8, within=(0.0, 5.0), likely=(0.3, 1.5))
)
def _sharpening(exposure: CaptureConditions, share: float, rng: np.random.Generator) -> CaptureConditions:
    return exposure.with_films(lambda film: replace(film, sharpening=share))


@disturbance(
    "jpeg",
    "shoot",
    "JPEG files of this quality, with colour at half the resolution (4:2:0)",
    Number(usual=85.0, within=(1.0, 100.0), likely=(75.0, 95.0), whole=True),
)
def _jpeg(exposure: CaptureConditions, quality: float, rng: np.random.Generator) -> CaptureConditions:
    return exposure.with_films(lambda film: replace(film, jpeg_quality=round(quality), chroma_halved=True))


@disturbance(
    "exposures",
    "shoot",
    "exposure different in each camera: standard deviation of its logarithm",
    Number(usual=0.2, within=(0.0, 1.0), likely=(0.05, 0.4)),
)
def _exposures(exposure: CaptureConditions, spread: float, rng: np.random.Generator) -> CaptureConditions:
    return _gains(exposure, np.repeat(np.exp(rng.normal(0.0, spread, (len(exposure.films), 1))), 3, axis=1))


@disturbance(
    "white-balance",
    "shoot",
    "white balance different in each camera: standard deviation of the logarithm of red and blue over green",
    Number(usual=0.1, within=(0.0, 0.7), likely=(0.03, 0.25)),
)
def _white_balance(exposure: CaptureConditions, spread: float, rng: np.random.Generator) -> CaptureConditions:
    gains = np.exp(rng.normal(0.0, spread, (len(exposure.films), 3)))
    return _gains(exposure, gains / gains[:, 1:2])


@disturbance(
    "out-of-focus",
    "shoot",
    "one camera out of focus: standard deviation of its blur, in pixels of a picture 4504 wide",
    Number(usual=4.0, within=(0.0, 50.0), likely=(1.0, 8.0), unit="px of 4504"),
)
def _out_of_focus(exposure: CaptureConditions, blur_px: float, rng: np.random.Generator) -> CaptureConditions:
    """Blur one camera's pictures by the same angle at every scale.

    The reference rig's lens at f/11, focused half a metre behind the body, blurs by 4 px.
    """
    return _blurred(exposure, blur_px, (str(rng.choice(list(exposure.films))),))


@disturbance(
    "soft-focus",
    "shoot",
    "every camera out of focus: standard deviation of the blur, in pixels of a picture 4504 wide",
    Number(usual=8.0, within=(0.0, 50.0), unit="px of 4504"),
)
def _soft_focus(exposure: CaptureConditions, blur_px: float, rng: np.random.Generator) -> CaptureConditions:
    return _blurred(exposure, blur_px, tuple(exposure.films))


@disturbance(
    "flash-failed",
    "shoot",
    "one flash not fired at the capture: its number",
    Number(usual=1.0, within=(1.0, 64.0), likely=(1.0, 4.0), whole=True),
)
def _flash_failed(exposure: CaptureConditions, number: float, rng: np.random.Generator) -> CaptureConditions:
    lights = exposure.lights.copy()
    lights[(round(number) - 1) % len(lights), 3] = _NOT_FIRED
    return replace(exposure, lights=lights)


def _turned(
    exposure: CaptureConditions, angle_deg: float, names: tuple[str, ...], rng: np.random.Generator
) -> CaptureConditions:
    """Rotate each camera about its own random axis."""
    turns = {name: math.radians(angle_deg) * _direction(rng) for name in names}
    return replace(
        exposure,
        capture_rig=with_cameras(exposure.capture_rig, lambda camera: turned(camera, turns[camera.name]), names),
    )


def _blurred(exposure: CaptureConditions, blur_px: float, names: tuple[str, ...]) -> CaptureConditions:
    """Blur some cameras' pictures. `blur_px`: σ in pixels of the reference rig's full-size pictures."""
    films = dict(exposure.films)
    for name in names:
        own_px = blur_px * exposure.rig.cameras[name].size_wh[0] / FULL_SIZE_WH[0]
        films[name] = replace(films[name], blur_px=math.hypot(films[name].blur_px, own_px))
    return replace(exposure, films=films)


def _gains(exposure: CaptureConditions, gains: Float64[Array, "n 3"]) -> CaptureConditions:
    films = {}
    for (name, film), own in zip(exposure.films.items(), gains, strict=True):
        red, green, blue = (np.array(film.gain_rgb) * own).tolist()
        films[name] = replace(film, gain_rgb=(red, green, blue))
    return replace(exposure, films=films)


def _motion(rng: np.random.Generator) -> SubjectMotion:
    """Motion of a body that sways and breathes."""
    return SubjectMotion(
        sway_mm_s=rng.uniform(*_SWAY_MM_S) * _direction(rng),
        turn_rad_s=math.radians(rng.uniform(*_TURN_DEG_S)) * _direction(rng),
        breath_mm_s=rng.choice([-1.0, 1.0]) * rng.uniform(*_BREATH_MM_S) * np.array(_FRONT),
        chest=np.array([0.0, 0.0, 0.0]),
    )


def _direction(rng: np.random.Generator) -> Float64[Array, 3]:
    vector = rng.normal(size=3)
    unit: Float64[Array, 3] = vector / np.linalg.norm(vector)
    return unit
